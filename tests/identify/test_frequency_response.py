"""Spectra against scipy's; several inputs and closed loops against systems whose truth is known."""

import control
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from tests.identify.signals import DT, doublet, pitch_record
from twodof.errors import DiagramError, IdentificationError
from twodof.identify.frequency_response import FrequencyResponse, frequency_response
from twodof.identify.greybox import fit
from twodof.identify.record import Record
from twodof.identify.simulation import model_response
from twodof.models.plant import PitchRate
from twodof.models.structures import free_response, pitch_rate

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]

FIRST, SECOND = control.ss(-8.0, 8.0, 3.0, 0.0), control.ss(-20.0, 20.0, -1.5, 0.0)
HELD = [control.c2d(one, DT, "zoh") for one in (FIRST, SECOND)]


def exact(system: control.StateSpace, omega: Array) -> NDArray[np.complex128]:
    return np.asarray(system(np.exp(1j * omega * DT))).ravel()


def run(system: control.StateSpace, u: Array) -> Array:
    return np.asarray(control.forced_response(system, U=u).outputs)


def table(**columns: Array) -> Record:
    time = DT * np.arange(len(next(iter(columns.values()))))
    return Record.from_columns(time, columns, [name for name in columns if name != "y"], ["y"])


def two_inputs(seed: int, steps: int = 8000, noise: float = 0.5) -> Record:
    """The second input follows the first, as a controller's does, and moves by itself as well."""
    rng = np.random.default_rng(seed)
    first, own = rng.standard_normal((2, steps // 4)).repeat(4, axis=1)
    second = 0.8 * first + 0.6 * own
    y = run(HELD[0], first) + run(HELD[1], second) + noise * rng.standard_normal(steps)
    return table(a=first, b=second, y=y)


def miss(found: FrequencyResponse, truth: NDArray[np.complex128]) -> Array:
    """How far off the response is, in units of the radius that should hold it in 95 %."""
    use = (found.omega > 4.0) & (found.omega < 200.0)
    return np.asarray((abs(found.response - truth) / found.radius(0.95))[use])


def test_one_input_gives_scipy_s_spectra() -> None:
    record = two_inputs(0)
    found = frequency_response(record, "a", "y", segment=2.0)
    u, y = record.inputs["a"], record.outputs["y"].value
    window = {"fs": 1.0 / DT, "window": "hann", "nperseg": 500, "noverlap": 250, "detrend": "constant"}
    p_uy, p_uu = signal.csd(u, y, **window)[1][1:], signal.welch(u, **window)[1][1:]
    inner = slice(0, -1)  # scipy halves the last, one-sided, point of both alike
    np.testing.assert_allclose(found.response[inner], (p_uy / p_uu)[inner], rtol=1e-10)
    coherence = signal.coherence(u, y, **window)[1][1:]
    np.testing.assert_allclose(found.coherence[inner], coherence[inner], rtol=1e-9)
    np.testing.assert_allclose(found.multiple[inner], coherence[inner], rtol=1e-9)


def test_correlated_inputs_need_conditioning() -> None:
    record = two_inputs(1)
    alone = frequency_response(record, "a", "y", segment=2.0)
    both = frequency_response(record, "a", "y", segment=2.0, given="b")
    other = frequency_response(record, "b", "y", segment=2.0, given=["a"])
    slow = (both.omega > 4.0) & (both.omega < 30.0)
    truth = exact(HELD[0], both.omega)
    # 80 % of the second input's effect is laid to the first: half of the gain is missing. What the second input does
    # by itself is noise here, .9 of 1.8 in gain; 13 points of 28 averages are known to some 6 %.
    mixed = truth + 0.8 * exact(HELD[1], both.omega)
    assert np.median(abs(alone.response / mixed)[slow]) == pytest.approx(1.0, abs=0.12)
    assert np.median(abs(alone.response / truth)[slow]) < 0.6
    # 28 averages of a coherence near .9 scatter by 4 %; the median of 13 points by less.
    assert np.median(abs(both.response / truth)[slow]) == pytest.approx(1.0, abs=0.05)
    assert np.median(abs(other.response / exact(HELD[1], both.omega))[slow]) == pytest.approx(1.0, abs=0.1)
    # What is left of the noise is what no input explains.
    assert (both.multiple >= both.coherence - 1e-12).all()
    assert np.median(both.multiple[slow]) > np.median(alone.multiple[slow]) + 0.1


def test_partial_coherence_is_that_of_the_residuals() -> None:
    """By its definition: both signals less what the other input explains of them, then the ordinary coherence."""
    record = two_inputs(2, 4000)
    found = frequency_response(record, "a", "y", segment=2.0, given="b")
    names = {"a": record.inputs["a"], "b": record.inputs["b"], "y": record.outputs["y"].value}
    window = {"fs": 1.0 / DT, "window": "hann", "nperseg": 500, "noverlap": 250, "detrend": "constant"}
    s = {i + j: signal.csd(names[i], names[j], **window)[1][1:] for i in names for j in names}
    left = {ij: s[ij] - s[ij[0] + "b"] * s["b" + ij[1]] / s["bb"] for ij in ("aa", "ay", "yy")}
    partial = abs(left["ay"]) ** 2 / (left["aa"].real * left["yy"].real)
    np.testing.assert_allclose(found.coherence[:-1], partial[:-1], rtol=1e-8)


@pytest.mark.long
def test_error_bars_hold_the_truth() -> None:
    share = []
    for seed in range(20):
        record = two_inputs(100 + seed, 4000)
        for name, given, system in (("a", "b", HELD[0]), ("b", "a", HELD[1])):
            found = frequency_response(record, name, "y", segment=2.0, given=given)
            share.append(np.mean(miss(found, exact(system, found.omega)) < 1.0))
    # 40 responses of some 30 independent points: the share is known to .006; the taper's leakage adds a little.
    assert np.mean(share) == pytest.approx(0.95, abs=0.03)


def closed_loop(seed: int, steps: int = 20000) -> Record:
    """u = r - 2 (y + noise of the sensor): at high frequency u follows y, and y does not follow u."""
    rng = np.random.default_rng(seed)
    r = 0.5 * signal.lfilter([0.1], [1.0, -0.9], rng.standard_normal(steps))
    noise = 0.5 * rng.standard_normal(steps)
    a, b = float(HELD[0].A[0, 0]), float(HELD[0].B[0, 0] * HELD[0].C[0, 0])
    y, u, state = np.zeros(steps), np.zeros(steps), 0.0
    for k in range(steps):
        y[k] = state + noise[k]
        u[k] = r[k] - 2.0 * y[k]
        state = a * state + b * u[k]
    return table(u=u, r=r, y=y)


def test_the_reference_removes_closed_loop_bias() -> None:
    record = closed_loop(5)
    biased = frequency_response(record, "u", "y", segment=2.0)
    found = frequency_response(record, "u", "y", segment=2.0, reference="r")
    truth = exact(HELD[0], found.omega)
    excited = (found.omega > 3.0) & (found.omega < 40.0)
    # H1 tends to -1 / controller, -1/2, where the noise outweighs the reference, and its error bars do not know it.
    fast = found.omega > 200.0
    assert np.median(biased.response[fast].real) == pytest.approx(-0.5, abs=0.05)
    assert (biased.coherence[fast] > 0.9).all()
    assert np.mean((abs(biased.response - truth) / biased.radius())[excited] < 1.0) < 0.1
    # The disks overlap in frequency: 37 points, half of them independent.
    assert np.mean((abs(found.response - truth) / found.radius())[excited] < 1.0) > 0.85
    # And it says where it knows nothing.
    assert np.median(found.coherence[fast]) < 0.2


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"given": "c"}, "does not hold 'c'"),
        ({"given": "a"}, "named twice"),
        ({"given": "y"}, "does not hold 'y' as input"),
        ({"output": "b"}, "'b' as output"),
        ({"reference": "r"}, "does not hold 'r'"),
        ({"reference": ["b", "y"]}, "2 references for 1 inputs"),
        ({"segment": float("nan")}, "the segment is nan"),
        ({"segment": [1.0, 4.0]}, "give a length in seconds"),
        ({"segment": 1e300}, "do not fit"),
        ({"window": "nothing"}, "no window is called"),
        ({"given": "twin"}, "move alike"),
        ({"given": "still"}, "does not move"),
        ({"segment": 20.0, "given": "b"}, "averages for 2 inputs"),
    ],
)
def test_wrong_arguments_are_refused_with_a_reason(arguments: dict[str, object], reason: str) -> None:
    source = two_inputs(3, 8000)
    columns = {name: source.inputs[name] for name in ("a", "b")} | {"y": source.outputs["y"].value}
    record = table(**columns, twin=2.0 * columns["a"], still=np.ones(8000))
    with pytest.raises(IdentificationError, match=reason):
        frequency_response(record, "a", **{"output": "y", **arguments})  # type: ignore[arg-type]


@pytest.mark.parametrize("level", [95, 1.0, 0.0, float("nan"), "95 %"])
def test_a_radius_needs_a_level_below_one(level: float) -> None:
    with pytest.raises(IdentificationError, match="between 0 and 1"):
        frequency_response(two_inputs(3, 8000), "a", "y").radius(level)


MODEL = PitchRate(3.437, 0.3, 358.5, 0.0187)


def sampled_model(omega: np.ndarray) -> np.ndarray:
    """Response of the held, delayed, sampled model: what a record of it contains."""
    system = control.ss(*MODEL.state_space().zero_order_hold(DT).augmented(), DT)
    return np.asarray(system(np.exp(1j * omega * DT)))[1, 0]


OMEGA = np.geomspace(1.0, 300.0, 25)
HELD_MODEL = {"estimate": ["mu", "tau"], "values": {"w_n": 3.437, "xi": 0.3}}


def test_the_response_is_that_of_the_sampled_model() -> None:
    record = pitch_record(MODEL, doublet(400, 0.2, 0.6, 0.03), 0.06, np.random.default_rng(1))
    found = fit(pitch_rate(), record, **HELD_MODEL)  # type: ignore[arg-type]
    made = model_response(pitch_rate(), found, "M", "q", OMEGA, DT)
    same = PitchRate(3.437, 0.3, found["mu"], found["tau"])
    system = control.ss(*same.state_space().zero_order_hold(DT).augmented(), DT)
    exact = np.asarray(control.frequency_response(system, OMEGA).complex)[1, 0]
    np.testing.assert_allclose(made.response, exact, rtol=1e-8)
    # mu scales the gain, tau turns the phase by omega; beyond that the held fraction of a step changes the gain little.
    slow = OMEGA < 30.0
    assert made.gain_sigma[slow] == pytest.approx(found.sigma("mu") / found["mu"], rel=0.02)
    assert made.phase_sigma[slow] == pytest.approx(OMEGA[slow] * found.sigma("tau"), rel=0.02)


def test_what_cannot_be_linearised_is_said() -> None:
    record = pitch_record(MODEL, doublet(400, 0.2, 0.6, 0.03), 0.06, np.random.default_rng(1))
    found = fit(pitch_rate(), record, **HELD_MODEL)  # type: ignore[arg-type]
    with pytest.raises(IdentificationError, match="no response leads from 'T'"):
        model_response(pitch_rate(), found, "T", "q", OMEGA, DT)
    with pytest.raises(DiagramError, match="kink"):
        model_response(free_response(), found, "M", "q", OMEGA, DT)
