"""Thresholds, limits, gate and reasons: at and beside every threshold what is meant, and every mutant is seen."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.flight.failsafe.block_meanings import MEANINGS, Meaning
from tests.flight.failsafe.expr_arrays import graph_of, mutants, on_arrays
from tests.flight.failsafe.unrolled import unrolled
from twodof.blocks import Block
from twodof.flight.failsafe.flags import BatteryFlags, PlaceFlags

CASES = 12_000
DERIVED = {"per_tick": ("descent", 0.1, 1.0 / 25.0), "per_answer": ("answer", 0.016, 0.25), "per_dt": ("", 0.0, 250.0)}
"""Derived parameter -> the one that it is made of, what that is set to, and what is made of it."""
IDS = [type(meaning.block).__name__ for meaning in MEANINGS]


def cases(meaning: Meaning) -> dict[str, NDArray[Any]]:
    """Cases drawn from the values of each input, state and parameter; states are called `last_NAME`."""
    rng = np.random.default_rng(1)
    return {name: np.array(values)[rng.integers(len(values), size=CASES)] for name, values in meaning.values.items()}


@functools.cache
def table(index: int) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[Any]]]:
    """The cases of a row of MEANINGS, and what is expected in them."""
    drawn = cases(MEANINGS[index])
    return drawn, expected(MEANINGS[index], drawn)


def columns_of(meaning: Meaning, drawn: dict[str, NDArray[Any]]) -> dict[tuple[str, str], NDArray[Any]]:
    """The same by kind of leaf and name, as the expressions have them."""
    states = {s.name for s in meaning.block.states}
    parameters = {p.name for p in (*meaning.block.params, *meaning.block.derived)}
    return {
        ("state", name.removeprefix("last_"))
        if name.startswith("last_") and name.removeprefix("last_") in states
        else ("param" if name in parameters else "input", name): column
        for name, column in drawn.items()
    }


def expected(meaning: Meaning, drawn: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    rows = zip(*(column.tolist() for column in drawn.values()), strict=True)
    results = [meaning.meant(dict(zip(drawn, row, strict=True))) for row in rows]
    return {name: np.array([result[name] for result in results]) for name in results[0]}


def differing(out: dict[str, NDArray[Any]], wanted: dict[str, NDArray[Any]]) -> list[str]:
    """The names whose values differ somewhere; 0 and -0 are the same, NaN is NaN."""
    assert set(out) == set(wanted)
    return [name for name in out if not np.array_equal(out[name], wanted[name], equal_nan=out[name].dtype.kind == "f")]


@pytest.mark.parametrize("meaning", MEANINGS, ids=IDS)
def test_a_block_does_what_is_meant_at_and_beside_every_threshold(meaning: Meaning) -> None:
    drawn, wanted = table(MEANINGS.index(meaning))
    assert differing(on_arrays(graph_of(meaning.block), columns_of(meaning, drawn)), wanted) == []
    for name, values in wanted.items():
        assert len(np.unique(values)) > 1 or name == "output.own_given", f"{name} is always the same: more cases"


@pytest.mark.parametrize("meaning", MEANINGS, ids=IDS)
def test_the_compiled_block_does_the_same(meaning: Meaning) -> None:
    drawn = cases(meaning)
    block = meaning.block
    machine = unrolled(block)
    settable = {p.name for p in block.params} & set(drawn)
    for name in settable - {"watch_bits"}:
        machine.set(f"block.{name}", float(drawn[name][0]))
    for name, (parameter, value, made) in DERIVED.items():
        if name in drawn:
            machine.set_many({f"block.{parameter}": value} if parameter else {})
            drawn[name] = np.full(CASES, made)
    if "watch_bits" in drawn:
        drawn["watch_bits"] = np.full(CASES, True)
    inputs = {
        ("before_" + name.removeprefix("last_") if name.startswith("last_") else name): column
        for name, column in drawn.items()
        if name not in settable and name not in DERIVED
    }
    out = machine.run(CASES, inputs)
    named = {
        f"update.{name.removeprefix('after_')}" if name.startswith("after_") else f"output.{name}": column
        for name, column in out.items()
    }
    assert differing(named, expected(meaning, drawn)) == []


@pytest.mark.parametrize("meaning", MEANINGS, ids=IDS)
def test_no_mutant_of_a_block_survives_but_those_explained(meaning: Meaning) -> None:
    drawn, wanted = table(MEANINGS.index(meaning))
    columns = columns_of(meaning, drawn)
    survivors = {
        what.partition(" ")[2]
        for what, graph in mutants(graph_of(meaning.block))
        if not differing(on_arrays(graph, columns), wanted)
    }
    assert survivors == set(meaning.equivalent)


def single(bits: int, low: float, high: float) -> st.SearchStrategy[list[float]]:
    """Sequences of numbers of 32 or 64 bits, often the same ones again, some of them no numbers."""
    number = st.floats(low, high, width=bits)
    return st.lists(st.one_of(number, st.sampled_from([low, high, float("nan")])), min_size=1, max_size=60)


MACHINES = {
    (block, precision): unrolled(block(), precision)
    for block in (BatteryFlags, PlaceFlags)
    for precision in ("float32", "float64")
}


def hysteresis(
    block: type[Block], precision: str, state: str, column: str, values: list[float], **more: Any
) -> list[bool]:
    """The flag `state` of a compiled block, step after step."""
    machine, before, raised = MACHINES[block, precision], False, []
    for value in values:
        out = machine.step({column: value, f"before_{state}": before, **more})
        before = bool(out[f"after_{state}"])
        raised.append(before)
    return raised


@pytest.mark.parametrize("precision", ["float32", "float64"])
@given(data=st.data())
def test_a_low_voltage_counts_until_it_is_above_by_the_margin(precision: str, data: st.DataObject) -> None:
    number = np.dtype(precision).type
    values = data.draw(single(32 if precision == "float32" else 64, 10.875, 11.5))
    flag = hysteresis(BatteryFlags, precision, "low", "voltage", values)
    low, recovered = number(11.1), number(11.1) + number(0.2)
    before = False
    for value, raised in zip(values, flag, strict=True):
        assert raised == (not number(value) >= (recovered if before else low))
        before = raised


@pytest.mark.parametrize("precision", ["float32", "float64"])
@given(data=st.data())
def test_the_pitch_limit_lets_go_only_below_its_margin(precision: str, data: st.DataObject) -> None:
    number = np.dtype(precision).type
    values = data.draw(single(32 if precision == "float32" else 64, -1.0, 1.0))
    flag = hysteresis(PlaceFlags, precision, "pitch_near", "theta", values, q=0.0, x=0.0, v=0.0, rings=True)
    before = False
    for value, raised in zip(values, flag, strict=True):
        limit = number(0.8) - number(0.1) if before else number(0.8)
        assert raised == bool(abs(number(value)) > limit)
        before = raised
