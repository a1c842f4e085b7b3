"""Each test signal against its definition, its published property, or a known quantity."""

import dataclasses
import json
from collections.abc import Callable
from math import pi, radians, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import chirp

from twodof.errors import ExperimentError
from twodof.excitation import (
    KINDS,
    LIMITS,
    Doublet,
    Excitation,
    Impulse,
    Multisine,
    Prbs,
    Steps,
    Sweep,
    ThreeTwoOneOne,
    from_dict,
    from_json,
)

pytestmark = pytest.mark.slow

PERIOD = 0.004

SECONDS = st.floats(0.001, 5.0)
AMPLITUDE = st.floats(1e-6, 0.4) | st.floats(-0.4, -1e-6)
OPTIONS = st.fixed_dictionaries(
    {
        "unit": st.sampled_from(sorted(LIMITS)),
        "lead": st.floats(0.0, 5.0),
        "settle": st.floats(0.0, 5.0),
        "pause": st.floats(0.0, 5.0),
        "repeat": st.integers(1, 4),
    }
)
SIGNALS = st.one_of(
    st.builds(lambda o, a, w: Impulse(a, w, **o), OPTIONS, AMPLITUDE, SECONDS),
    st.builds(lambda o, a, w: Doublet(a, w + 0.001, **o), OPTIONS, AMPLITUDE, SECONDS),
    st.builds(lambda o, a, w: ThreeTwoOneOne(a, w, **o), OPTIONS, AMPLITUDE, SECONDS),
    st.builds(lambda o, a, w: Steps(tuple(a), w, **o), OPTIONS, st.lists(AMPLITUDE, min_size=1, max_size=5), SECONDS),
    st.builds(
        lambda o, a, f, g, w: Sweep(a, f, g, w, "logarithmic", **o), OPTIONS, AMPLITUDE, SECONDS, SECONDS, SECONDS
    ),
    st.builds(lambda o, a, w, n: Prbs(a, w / 50 + 0.001, n, **o), OPTIONS, AMPLITUDE, SECONDS, st.integers(3, 6)),
    st.builds(lambda o, a, w: Multisine.schroeder(abs(a), w + 1.0, (1, 3, 4), **o), OPTIONS, AMPLITUDE, SECONDS),
)


@given(SIGNALS)
def test_json_round_trip(signal: Excitation) -> None:
    back = from_json(signal.to_json())
    assert back == signal
    assert type(back) is type(signal)
    grid = np.linspace(0.0, signal.duration, 50)
    assert back.at(grid).tobytes() == signal.at(grid).tobytes()


@given(SIGNALS)
def test_nothing_outside_and_never_above_the_peak(signal: Excitation) -> None:
    end = signal.duration
    assert not signal.at([-1.0, -1e-6, end, end + 1e-6, end + 100.0]).any()
    assert not signal.at(signal.lead / 2 - 1e-6).any()
    # A multisine's peak is found on a grid and may be .13 % low.
    assert np.abs(signal.at(np.linspace(0.0, end, 2000))).max() <= 1.0013 * signal.peak


@given(SIGNALS, st.integers(0, 3))
def test_a_repetition_is_the_pattern_again(signal: Excitation, turn: int) -> None:
    once = dataclasses.replace(signal, lead=0.0, settle=0.0, pause=0.0, repeat=1)
    phase = np.linspace(0.0, once.duration, 40, endpoint=False).round(6)
    start = signal.lead.__round__(6) + turn * (once.duration + round(signal.pause, 6))
    expected = once.at(phase) if turn < signal.repeat else np.zeros(40)
    np.testing.assert_array_equal(signal.at(start + phase), expected)


def test_edges_fall_on_control_steps_in_spite_of_rounding() -> None:
    # 0.004 * 75 is 0.3 and 0.004 * 175 is 0.7000000000000001; 3 * 0.1 is 0.30000000000000004.
    doublet = Doublet(0.03, 0.6)
    flown = doublet.at(PERIOD * np.arange(151))
    assert flown.tolist() == [0.03] * 75 + [-0.03] * 75 + [0.0]
    assert doublet.at(3 * 0.1) == -0.03
    assert doublet.at(0.3 - 1e-6) == 0.03


def test_the_papers_experiments() -> None:
    impulse = Impulse(0.1, 0.2, settle=16.0)
    assert impulse.duration == 16.2
    _, value = impulse.samples(PERIOD)
    assert value.sum() * PERIOD == pytest.approx(0.1 * 0.2, rel=1e-12)
    doublet = Doublet(0.03, 0.6, repeat=3, pause=2.0, lead=1.0)
    assert doublet.duration == 1.0 + 3 * 0.6 + 2 * 2.0
    edges = np.array([1.0, 1.3, 1.6, 3.6, 3.9, 4.2, 6.2, 6.5, 6.8])
    assert doublet.at(edges).tolist() == [0.03, -0.03, 0.0] * 3
    assert doublet.at(edges - 1e-6).tolist() == [0.0, 0.03, -0.03] * 3


@given(AMPLITUDE, SECONDS)
def test_areas(amplitude: float, width: float) -> None:
    step = round(width, 3)
    # On a grid that divides every hold, the sum is the integral; rounding adds up to one ulp a sample.
    grid = np.arange(round(7 * step / 1e-3)) * 1e-3
    assert ThreeTwoOneOne(amplitude, step).at(grid).sum() * 1e-3 == pytest.approx(amplitude * step, rel=1e-9)
    grid = np.arange(round(2 * step / 1e-3)) * 1e-3
    assert Doublet(amplitude, 2 * step).at(grid).sum() == pytest.approx(0.0, abs=1e-9 * abs(amplitude) * len(grid))


@pytest.mark.parametrize("order", range(3, 17))
def test_prbs_is_maximal_length(order: int) -> None:
    n = 2**order - 1
    signal = Prbs(0.5, 0.01, order, seed=n)
    bits = signal.at((np.arange(n) + 0.5) * 0.01) / 0.5
    # Golomb: one more of one kind than of the other, and a two-valued autocorrelation. FFT rounding: 1e-9.
    assert abs(bits.sum()) == 1
    correlation = np.fft.ifft(np.abs(np.fft.fft(bits)) ** 2).real
    np.testing.assert_allclose(correlation, [n, *[-1] * (n - 1)], atol=1e-9 * n)


def test_prbs_seeds_are_shifts() -> None:
    def bits(seed: int) -> list[float]:
        return Prbs(1.0, 0.01, 5, seed).at((np.arange(31) + 0.5) * 0.01).tolist()

    shifts = {tuple(np.roll(bits(1), k)) for k in range(31)}
    assert {tuple(bits(seed)) for seed in range(1, 32)} == shifts


@pytest.mark.parametrize(("law", "method"), [("linear", "linear"), ("logarithmic", "logarithmic")])
def test_sweep_is_scipys_chirp(law: str, method: str) -> None:
    sweep = Sweep(0.2, 0.1, 1.0, 26.0, law, unit="m")
    time = np.arange(0, 6500) * PERIOD
    theirs = 0.2 * chirp(time, 0.1, 26.0, 1.0, method, phi=-90)
    # Both add up some 15 turns: rounding of 100 rad in float64.
    np.testing.assert_allclose(sweep.at(time), theirs, atol=1e-13 * 2 * pi * 15)


def test_sweep_of_one_frequency_is_a_sine() -> None:
    time = np.linspace(0.0, 1.9, 20).round(6)
    for law in ("linear", "logarithmic"):
        np.testing.assert_allclose(Sweep(0.2, 3.0, 3.0, 2.0, law).at(time), 0.2 * np.sin(6 * pi * time), atol=1e-14)


@pytest.mark.parametrize("end_hz", [1.0 + 1e-15, 1.0 - 2.0**-53, 1.0 + 1e-9, 1.0 + 1e-5])
def test_sweep_of_nearly_one_frequency_keeps_its_digits(end_hz: float) -> None:
    """Both laws agree to second order in the logarithm of the frequencies' ratio, here over 20 turns."""
    time = np.linspace(0.0, 19.9, 200).round(6)
    theirs = Sweep(0.2, 1.0, end_hz, 20.0, "linear").at(time)
    bound = 1e-12 + 0.2 * 2 * pi * 20.0 * (end_hz - 1.0) ** 2
    np.testing.assert_allclose(Sweep(0.2, 1.0, end_hz, 20.0, "logarithmic").at(time), theirs, atol=bound)


def test_multisine_has_its_lines_and_no_other() -> None:
    harmonics = (1, 2, 3, 5, 8, 13)
    signal = Multisine.schroeder(0.1, 10.0, harmonics, powers=(1, 2, 1, 1, 0.5, 0.25), repeat=2)
    _, value = signal.samples(0.02)
    spectrum = np.abs(np.fft.rfft(value[:500])) / 250
    np.testing.assert_allclose(spectrum[list(harmonics)], signal.amplitudes, rtol=1e-12)
    others = np.delete(spectrum, list(harmonics))
    assert others.max() < 1e-15
    power = np.square(signal.amplitudes)
    np.testing.assert_allclose(power / power[0], [1, 2, 1, 1, 0.5, 0.25], rtol=1e-12)
    assert signal.peak == pytest.approx(0.1, rel=1e-12)
    np.testing.assert_array_equal(value[:500], value[500:1000])


@pytest.mark.long
def test_schroeders_phases_lower_the_crest() -> None:
    harmonics = tuple(range(1, 32))
    flat = Multisine.schroeder(0.5, 10.0, harmonics)
    in_phase = Multisine(10.0, harmonics, (0.01,) * 31, (0.0,) * 31)
    # All in phase, the peak is the sum of the amplitudes.
    assert in_phase.peak == pytest.approx(0.31, rel=1e-12)
    # Schroeder (1970), for a flat spectrum: phi_n = phi_1 - pi n (n - 1) / N.
    n = np.arange(1, 32)
    np.testing.assert_allclose(np.exp(1j * np.array(flat.phases)), np.exp(-1j * pi * n * (n - 1) / 31), atol=1e-12)
    random = np.random.default_rng(4)
    drawn = [Multisine(10.0, harmonics, (0.01,) * 31, tuple(random.uniform(0, 2 * pi, 31))) for _ in range(200)]

    def crest(one: Multisine) -> float:
        return one.peak / sqrt(0.5 * sum(a * a for a in one.amplitudes))

    assert crest(flat) < min(map(crest, drawn))


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Doublet(20.0, 1.0, unit="rad"), "if 20 is in degrees, give 0.3491"),
        (lambda: Doublet(1.1, 1.0), "doublet.amplitude: peak 1.1 - is not within 0 to 1"),
        (lambda: Impulse(0.0, 1.0), "choose one that is not zero"),
        (lambda: Impulse(float("nan"), 1.0), "impulse.amplitude: nan is not a finite number"),
        (lambda: Impulse("0.1", 1.0), "impulse.amplitude: '0.1' is not a finite number"),
        (lambda: Impulse(True, 1.0), "impulse.amplitude: True is not a finite number"),
        (lambda: Impulse(0.1, 0.0), "impulse.width: 0 is outside 0.001"),
        (lambda: Impulse(0.1, -1.0), "impulse.width: -1 is outside"),
        (lambda: Impulse(0.1, 1.0, unit="deg"), "impulse.unit: unknown unit 'deg' .use one of -, rad"),
        (lambda: Impulse(0.1, 1.0, repeat=0), "impulse.repeat: 0 is outside 1"),
        (lambda: Impulse(0.1, 1.0, repeat=1.5), "impulse.repeat: 1.5 is not a whole number"),
        (lambda: Impulse(0.1, 1000.0, repeat=10), "impulse.duration: it lasts 10000 s"),
        (lambda: Steps((), 1.0), "steps.levels: it has 0 numbers"),
        (lambda: Steps(0.1, 1.0), "steps.levels: 0.1 is not a list of numbers"),
        (lambda: Steps((0.1, float("inf")), 1.0), "steps.levels: inf is not a finite number"),
        (lambda: Steps(np.array([0.1j]), 1.0), "steps.levels: an array of numpy.s type complex128 is given"),
        (lambda: Sweep(0.1, 0.0, 1.0, 5.0, "logarithmic"), "cannot start or end at 0 Hz"),
        (lambda: Sweep(0.1, 0.0, 0.0, 5.0), "gives no signal"),
        (lambda: Sweep(0.1, 1.0, 200.0, 5.0), "sweep.end_hz: 200 is outside 0 to 125"),
        (lambda: Sweep(0.1, 1.0, 2.0, 5.0, "cubic"), "unknown law 'cubic'"),
        (lambda: Prbs(0.1, 0.1, 2), "prbs.order: 2 is outside 3 to 16"),
        (lambda: Prbs(0.1, 0.1, 4, 16), "prbs.seed: 16 is outside 1 to 15"),
        (lambda: Prbs(0.1, 2.0, 12), "prbs.duration: it lasts 8190 s"),
        (lambda: Multisine(1.0, (1, 1), (0.1, 0.1), (0.0, 0.0)), "different whole numbers from 1 on"),
        (lambda: Multisine(1.0, (200,), (0.1,), (0.0,)), "200 Hz cannot be played"),
        (lambda: Multisine(1.0, (1, 2), (0.1,), (0.0, 0.0)), "multisine.amplitudes: there are 1 for 2 harmonics"),
        (lambda: Multisine.schroeder(0.1, 1.0, ()), "the powers of the harmonics are not all"),
        (lambda: Multisine.schroeder(0.1, 1.0, (1, 0)), "whole numbers from 1"),
        (
            lambda: Multisine.schroeder(0.1, 1.0, (1, 2), powers=(1.0, -1.0)),
            "the powers of the harmonics are not all 0 or more",
        ),
        (lambda: Doublet(0.1, 1.0).at(float("nan")), "doublet.t: a time is NaN"),
        (lambda: Doublet(0.1, 1.0).samples(0.0), "doublet.period: 0 s"),
    ],
)
def test_mistakes_say_what_and_where(make: Callable[[], object], says: str) -> None:
    with pytest.raises(ExperimentError, match=says):
        make()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"kind": "triangle"}, "unknown kind 'triangle' .there are: impulse, doublet"),
        ({"kind": ["doublet"]}, "unknown kind"),
        ({"version": 2}, "it has version 2"),
        ({"amplitud": 0.1}, "unknown value 'amplitud'"),
        ({"amplitude": "0.1"}, "not a finite number"),
        ({"amplitude": None}, "not a finite number"),
        ({"unit": ["rad"]}, "unknown unit"),
    ],
)
def test_foreign_json_is_refused(change: dict, says: str) -> None:
    values = {**Doublet(0.1, 1.0).to_dict(), **change}
    with pytest.raises(ExperimentError, match=says):
        from_json(json.dumps(values))


@given(SIGNALS)
def test_numpy_gives_the_same_excitation(signal: Excitation) -> None:
    values = {f.name: getattr(signal, f.name) for f in dataclasses.fields(signal)}
    for made in (np.array, lambda v: np.repeat(np.array(v), 2)[::2] if isinstance(v, tuple) else np.asarray(v)[()]):
        again = type(signal)(**{k: v if isinstance(v, str) else made(v) for k, v in values.items()})
        assert again == signal
        assert again.to_json() == signal.to_json()


def test_json_that_is_none() -> None:
    for text in ("", "[]", "1", "{", "[" * 100_000):
        with pytest.raises(ExperimentError, match=r"is not JSON|is not a JSON object"):
            from_json(text)
    with pytest.raises(ExperimentError, match="a value is missing"):
        from_dict({"kind": "doublet", "version": 1, "amplitude": 0.1})


def test_kinds_are_called_what_they_say() -> None:
    assert list(KINDS) == ["impulse", "doublet", "3-2-1-1", "steps", "sweep", "prbs", "multisine"]
    assert LIMITS["rad"] == radians(50.0)


def test_a_form_with_a_peak_is_schroeders() -> None:
    form = {"kind": "multisine", "version": 1, "peak": 0.1, "period": 2.0, "harmonics": [1, 3, 7], "unit": "rad"}
    assert from_dict(form) == Multisine.schroeder(0.1, 2.0, [1, 3, 7], unit="rad")
    for wrong in ({"amplitudes": [0.1]}, {"period": None}, {"harmonics": 3}):
        with pytest.raises(ExperimentError):
            from_dict(form | wrong)
