"""Sources against closed forms, scipy and the definitions that the ground uses."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from tests.blocks.library.harness import assert_close, few, run, values_at
from twodof import excitation
from twodof.blocks.block import Block
from twodof.blocks.diagram import Diagram
from twodof.blocks.library import (
    Constant,
    DoubletSource,
    MultisineSource,
    Noise,
    PrbsSource,
    Pulse,
    Ramp,
    Sine,
    Step,
    SweepSource,
    ThreeTwoOneOneSource,
    Time,
    UniformNoise,
)
from twodof.blocks.library.waveforms import TAPS
from twodof.blocks.reference.interpreter import Reference

pytestmark = pytest.mark.slow

DT = 0.004


def y_of(block: Block, steps: int = 600, dt: float = DT, precision: str = "float64") -> np.ndarray:
    return run(block, steps, dt, precision=precision)["y"]


def test_constants_of_all_kinds() -> None:
    assert y_of(Constant(2.5), 2).tolist() == [2.5, 2.5]
    assert y_of(Constant([1, 2], "int32", 2), 1).tolist() == [[1, 2]]
    assert y_of(Constant(True, "bool"), 1).tolist() == [True]


def test_time_and_steps() -> None:
    rows = run(Time(), 5, 0.25)
    assert rows["y"].tolist() == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert rows["tick"].tolist() == [0, 1, 2, 3, 4]
    assert y_of(Step(0.5, -1.0, 2.0), 4, 0.25).tolist() == [-1.0, -1.0, 2.0, 2.0]
    assert y_of(Ramp(0.5, 2.0, 1.0), 5, 0.25).tolist() == [1.0, 1.0, 1.0, 1.5, 2.0]
    assert y_of(Pulse(0.25, 0.5, 3.0, 1.0), 6, 0.25).tolist() == [1, 4, 4, 1, 1, 1]
    assert y_of(Pulse(0.25, 0.25, 1.0, period=0.75), 8, 0.25).tolist() == [0, 1, 0, 0, 1, 0, 0, 1]


def test_a_slower_source_keeps_base_time() -> None:
    d = Diagram("slow")
    d.add("time", Time(), rate=(3, 1))
    d.add("step", Step(1.2), rate=(3, 1))
    d.output("t", "time.y")
    d.output("y", "step.y")
    rows = Reference(d, 0.25).machine().run(9)
    assert rows["t"].tolist() == [0, 0.25, 0.25, 0.25, 1.0, 1.0, 1.0, 1.75, 1.75]
    assert rows["y"].tolist() == [0, 0, 0, 0, 0, 0, 0, 1, 1]


@pytest.mark.parametrize("precision", ["float64", "float32"])
@few
@given(ticks=st.integers(0, 100_000), dt=st.sampled_from([0.001, 0.002, 0.004, 1 / 250, 0.01, 1 / 3000]))
def test_a_time_falls_on_its_tick(precision: str, ticks: int, dt: float) -> None:
    before = max(0, ticks - 1)
    found = values_at(Step(ticks * dt), range(before, before + 3), dt, precision)
    assert found.tolist() == ([0.0, 1.0, 1.0] if ticks else [1.0, 1.0, 1.0])


@pytest.mark.parametrize(
    ("block", "definition"),
    [
        (Pulse(0.1, 0.2, 0.1), excitation.Impulse(0.1, 0.2, lead=0.1, settle=3.0)),
        (DoubletSource(0.4, 0.6, 0.03), excitation.Doublet(0.03, 0.6, lead=0.4, settle=3.0)),
        (ThreeTwoOneOneSource(0.2, 0.24, 0.05), excitation.ThreeTwoOneOne(0.05, 0.24, lead=0.2, settle=3.0)),
    ],
)
def test_pulses_are_what_the_ground_means_by_them(block: Block, definition: excitation.Excitation) -> None:
    assert y_of(block).tolist() == definition.at(DT * np.arange(600)).tolist()


def test_waves_are_what_the_ground_means_by_them() -> None:
    t = DT * np.arange(600)
    for law in ("linear", "logarithmic"):
        sweep = excitation.Sweep(0.1, 0.2, 5.0, 2.0, law=law, lead=0.2, settle=1.0)
        assert_close(y_of(SweepSource(0.2, 5.0, 2.0, 0.1, law, start=0.2)), sweep.at(t))
    multisine = excitation.Multisine.schroeder(0.1, 0.8, [1, 2, 5], lead=0.2, repeat=2, settle=2.0)
    block = MultisineSource(multisine.harmonics, multisine.amplitudes, multisine.phases, 0.8, start=0.2)
    assert_close(y_of(block, 400), multisine.at(t[:400]))


@few
@given(st.integers(3, 9), st.integers(1, 600), st.integers(1, 5))
def test_a_prbs_is_what_the_ground_means_by_it(order: int, seed: int, hold: int) -> None:
    seed = seed % (2**order - 1) + 1
    definition = excitation.Prbs(0.5, hold * DT, order, seed, lead=3 * DT, settle=9.0)
    steps = min(3 + hold * (2**order - 1), 250)
    block = PrbsSource(hold * DT, 0.5, order, seed, start=3 * DT)
    assert y_of(block, steps).tolist() == definition.at(DT * np.arange(steps)).tolist()


@pytest.mark.parametrize("order", TAPS)
def test_the_taps_belong_to_primitive_polynomials(order: int) -> None:
    # A register of n bits runs through all its states if, and only if, the first return to 1 takes 2^n - 1 steps.
    register, steps = 1, 0
    while steps == 0 or register != 1:
        feedback = 0
        for tap in TAPS[order]:
            feedback ^= register >> (order - tap)
        register = (register >> 1) | ((feedback & 1) << (order - 1))
        steps += 1
    assert steps == 2**order - 1


def test_a_prbs_at_a_slower_rate_counts_its_own_periods() -> None:
    d = Diagram("slow")
    d.add("prbs", PrbsSource(8 * DT, 1.0, 4), rate=(4, 0))
    d.output("y", "prbs")
    y = Reference(d, DT).machine().run(120)["y"]
    assert np.array_equal(y.reshape(15, 8), np.repeat(y_of(PrbsSource(DT, 1.0, 4), 15)[:, None], 8, axis=1))


def test_seed_zero_is_taken_as_one() -> None:
    assert y_of(PrbsSource(DT, order=4, seed=16), 15).tolist() == y_of(PrbsSource(DT, order=4, seed=1), 15).tolist()


@few
@given(st.floats(0.0, 120.0), st.floats(-3, 3))
def test_a_sine_is_a_sine(frequency: float, phase: float) -> None:
    t = DT * np.arange(100)
    y = y_of(Sine(frequency, 2.0, phase, 0.5, start=0.1), 100)
    # Whole turns taken off beforehand: 100 ticks at 120 Hz are 300 rad, whose own rounding is 6e-14.
    expected = 0.5 + np.where(t > 0.0999, 2.0 * np.sin(2 * np.pi * frequency * (t - 0.1) + phase), 0.0)
    np.testing.assert_allclose(y, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("precision", "bound"), [("float64", 1e-9), ("float32", 2e-6)])
def test_a_sine_does_not_drift(precision: str, bound: float) -> None:
    # 1/8 turn a tick: after 2^31 ticks (25 days at 1 kHz) the phase is as sharp as at the start.
    step = 125.0 * 2.0**-10
    for tick in (0, 2**31, 2**32 - 8):
        ticks = tick + np.arange(8)
        exact = np.sin(2 * np.pi * np.mod(ticks * step, 1.0))  # 125 * 2^-10 is exact, and so is this remainder
        np.testing.assert_allclose(values_at(Sine(125.0), ticks, 2.0**-10, precision), exact, rtol=0, atol=bound)


@pytest.mark.parametrize(("law", "method"), [("linear", "linear"), ("logarithmic", "logarithmic")])
@pytest.mark.parametrize(("first", "last"), [(0.5, 10.0), (10.0, 0.5), (3.0, 3.0)])
def test_a_sweep_is_scipys_chirp(law: str, method: str, first: float, last: float) -> None:
    t = DT * np.arange(600)
    y = y_of(SweepSource(first, last, 10.0, law=law, phase=np.radians(35.0)))
    # 2.4 s at up to 10 Hz are 150 rad, and f0 L / log(f1/f0) = 33 turns are subtracted from each other.
    np.testing.assert_allclose(y, signal.chirp(t, first, 10.0, last, method=method, phi=-90 + 35), rtol=0, atol=1e-11)


def test_a_sweep_ends() -> None:
    y = y_of(SweepSource(1.0, 5.0, 1.0, bias=0.3, start=0.2))
    assert np.all(y[:50] == 0.3)
    assert np.all(y[300:] == 0.3)
    assert np.any(y[50:300] != 0.3)


@few
@given(st.integers(1, 900), st.lists(st.integers(1, 40), min_size=1, max_size=4))
def test_a_multisine_is_its_sum_and_repeats_exactly(length: int, harmonics: list[int]) -> None:
    amplitudes = [1.0 / (k + 1) for k in range(len(harmonics))]
    phases = [0.7 * k for k in range(len(harmonics))]
    block = MultisineSource(harmonics, amplitudes, phases, length * DT)
    first = y_of(block, 20)
    turns = np.outer(np.arange(20), harmonics) % length / length
    assert_close(first, np.cos(2 * np.pi * turns + phases) @ np.array(amplitudes), 1e-12)
    assert values_at(block, range(1000 * length, 1000 * length + 20), DT).tolist() == first.tolist()


def test_noise_has_the_moments_it_is_told() -> None:
    n = 500
    y = y_of(Noise(0.5, 2.0, seed=3, stream=1, width=3), n)
    # Four standard errors: 0.5 / sqrt(n) of a mean, sqrt(2/n) of a relative variance, 1 / sqrt(n) of a correlation.
    assert np.all(np.abs(np.mean(y, axis=0) - 2.0) < 4 * 0.5 / np.sqrt(n))
    assert np.all(np.abs(np.var(y, axis=0) / 0.25 - 1.0) < 4 * np.sqrt(2 / n))
    correlation = np.corrcoef(y.T)
    assert np.all(np.abs(correlation[~np.eye(3, dtype=bool)]) < 4 / np.sqrt(n))
    for width in (None, 2):
        w = y_of(UniformNoise(-1.0, 3.0, seed=3, stream=1, width=width), n)
        assert np.min(w) >= -1.0
        assert np.max(w) < 3.0
        assert np.all(np.abs(np.mean(w, axis=0) - 1.0) < 4 * 4 / np.sqrt(12 * n))


def test_noise_is_a_function_of_seed_stream_and_tick() -> None:
    first = y_of(Noise(seed=1, stream=2), 20)
    assert y_of(Noise(seed=1, stream=2), 20).tolist() == first.tolist()
    for other in (Noise(seed=2, stream=2), Noise(seed=1, stream=3)):
        assert not np.any(y_of(other, 20) == first)
    assert y_of(Noise(seed=1, stream=2, width=4), 20)[:, 0].tolist() == first.tolist()
    assert values_at(Noise(seed=1, stream=2), range(7, 12), DT).tolist() == first[7:12].tolist()
