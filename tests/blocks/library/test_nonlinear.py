"""Nonlinear blocks and state machines against what their definitions say, sample by sample."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.blocks.library.harness import alone, assert_close, few, noise, run, run_y
from twodof.blocks.library import (
    Backlash,
    Bitwise,
    Compare,
    CompareToConstant,
    Counter,
    DeadZone,
    DynamicSaturation,
    EdgeDetector,
    FlipFlop,
    Logic,
    Quantiser,
    RateLimit,
    Relay,
    Saturation,
    Timer,
)
from twodof.blocks.reference.interpreter import Reference

U = 2.0 * noise(60)
signals = st.lists(st.floats(-5, 5), min_size=1, max_size=30)
flags = st.lists(st.booleans(), min_size=1, max_size=30)


def test_saturations_clip() -> None:
    assert run_y(Saturation(-0.5, 1.5), U).tolist() == np.clip(U, -0.5, 1.5).tolist()
    wide = U.reshape(20, 3)
    assert run_y(Saturation(-0.5, 1.5, width=3), wide).tolist() == np.clip(wide, -0.5, 1.5).tolist()
    assert run_y(Saturation(-2, 2, "int32"), [-5, 0, 5]).tolist() == [-2, 0, 2]
    moving = {"u": U, "low": -np.abs(noise(60, 2)), "high": np.abs(noise(60, 3))}
    assert run(DynamicSaturation(), 60, inputs=moving)["y"].tolist() == np.clip(*moving.values()).tolist()


@pytest.mark.parametrize("block", [Saturation(), DeadZone(), Quantiser(), RateLimit(), Backlash()])
def test_nan_stays_nan(block: Saturation) -> None:
    assert np.isnan(run_y(block, np.array([np.nan]))[0])


def test_a_dead_zone_is_what_a_saturation_leaves() -> None:
    assert_close(run_y(DeadZone(-0.5, 1.0), U), U - np.clip(U, -0.5, 1.0))


@few
@given(signals, st.floats(0.01, 3))
def test_a_quantiser_is_at_most_half_a_step_off(values: list[float], step: float) -> None:
    y = run_y(Quantiser(step), np.array(values))
    assert np.max(np.abs(y - values)) <= 0.5 * step * (1 + 1e-12)
    assert_close(y / step, np.round(y / step))
    assert run_y(Quantiser(0.0), np.array(values)).tolist() == values


@few
@given(signals, st.floats(0, 20), st.floats(0, 20))
def test_a_rate_limit_limits_the_rate_and_no_more(values: list[float], rising: float, falling: float) -> None:
    u = np.array(values)
    y = run_y(RateLimit(rising, falling, 0.5), u, 0.1)
    before = 0.5
    for k, now in enumerate(y):
        assert now == max(before - falling * 0.1, min(before + rising * 0.1, u[k]))
        before = now


def test_a_relay_has_hysteresis() -> None:
    u = np.array([0.0, 0.4, 0.5, 0.1, -0.4, -0.5, 0.4, 0.6])
    rows = run(Relay(0.5, -0.5, 2.0, -1.0), 8, inputs={"u": u})
    assert rows["on"].tolist() == [False, False, True, True, True, False, False, True]
    assert rows["y"].tolist() == [-1, -1, 2, 2, 2, -1, -1, 2]
    assert run_y(Relay(initial=True), np.array([0.0])).tolist() == [1.0]


def test_backlash_follows_only_when_pushed() -> None:
    u = np.concatenate((np.linspace(0, 2, 21), np.linspace(2, 0, 21)))
    y = run_y(Backlash(0.6), u)
    assert_close(y, np.concatenate((np.maximum(0.0, u[:21] - 0.3), np.minimum(1.7, u[21:] + 0.3))))


@pytest.mark.parametrize("operation", ["<", "<=", ">", ">=", "==", "!="])
def test_comparisons(operation: str) -> None:
    a, b = np.array([1.0, 2.0, 3.0, np.nan]), np.full(4, 2.0)
    expected = {"<": a < b, "<=": a <= b, ">": a > b, ">=": a >= b, "==": a == b, "!=": a != b}[operation]
    assert run(Compare(operation), 4, inputs={"a": a, "b": b})["y"].tolist() == expected.tolist()
    assert run_y(CompareToConstant(operation, 2.0), a).tolist() == expected.tolist()
    integers = [1, 2, 3]
    assert run_y(CompareToConstant(operation, 2, "int32"), integers).tolist() == expected[:3].tolist()


def test_logic_tables() -> None:
    a, b = np.array([False, False, True, True]), np.array([False, True, False, True])
    table = {"and": a & b, "or": a | b, "xor": a ^ b, "nand": ~(a & b), "nor": ~(a | b)}
    for operation, expected in table.items():
        assert run(Logic(operation), 4, inputs={"a": a, "b": b})["y"].tolist() == expected.tolist()
    assert run_y(Logic("not"), a).tolist() == (~a).tolist()
    three = run(Logic("nor", 3), 4, inputs={"a": a, "b": b, "c": False})["y"]
    assert three.tolist() == [True, False, False, False]


def test_bits() -> None:
    both = {"a": [0b1100, -8], "b": [0b1010, 33]}
    for operation, expected in {"and": [8, 32], "or": [14, -7], "xor": [6, -39], "right": [0, -4]}.items():
        assert run(Bitwise(operation, "int32"), 2, inputs=both)["y"].tolist() == expected
    assert run(Bitwise("left"), 2, inputs={"a": [1, 3], "b": [31, 31]})["y"].tolist() == [2**31, 2**31]


@few
@given(flags, st.booleans())
def test_edges(values: list[bool], initial: bool) -> None:
    before = [initial, *values[:-1]]
    pairs = list(zip(before, values, strict=True))
    assert run_y(EdgeDetector("rising", initial), values).tolist() == [v and not b for b, v in pairs]
    assert run_y(EdgeDetector("falling", initial), values).tolist() == [b and not v for b, v in pairs]
    assert run_y(EdgeDetector("either", initial), values).tolist() == [b != v for b, v in pairs]


@few
@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=30), st.integers(0, 4))
def test_a_counter_counts(rows: list[tuple[bool, bool]], modulus: int) -> None:
    count, expected = 0, []
    for u, clear in rows:
        count = (0 if clear else count) + u
        count = count % modulus if modulus else count
        expected.append(count)
    u, clear = zip(*rows, strict=True)
    assert run(Counter(modulus), len(rows), inputs={"u": u, "clear": clear})["y"].tolist() == expected


def test_a_flip_flop_remembers() -> None:
    inputs = {"set": [False, True, False, False, True, False], "clear": [False, False, False, True, True, False]}
    assert run(FlipFlop(), 6, inputs=inputs)["y"].tolist() == [False, True, True, False, False, False]
    assert run(FlipFlop("set", True), 6, inputs=inputs)["y"].tolist() == [True, True, True, False, True, True]


@few
@given(flags, st.integers(0, 5))
def test_a_timer_measures_how_long(values: list[bool], duration: int) -> None:
    rows = run(Timer(duration * 0.02), len(values), 0.02, {"u": values})
    true_for, done, elapsed = 0, [], []
    for value in values:
        elapsed.append(true_for * 0.02 if value else 0.0)
        done.append(value and true_for >= duration)
        true_for = true_for + 1 if value else 0
    assert rows["done"].tolist() == done
    assert rows["elapsed"].tolist() == elapsed


def test_a_timer_does_not_begin_anew_after_all_its_numbers() -> None:
    machine = Reference(alone(Timer(1.0)), 0.01).machine()
    machine.set_state("block.x", 2**32 - 2)
    assert machine.run(5, {"u_in": True})["done_out"].tolist() == [True] * 5
    assert machine.state("block.x") == 2**32 - 1
