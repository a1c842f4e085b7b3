"""Inputs that move between samples: against exact frequency responses, scipy, and what the samples themselves are."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lsim

from twodof.blocks import Block, Diagram, Param, Port, State
from twodof.blocks.library import FirstOrder, Gain, Sum
from twodof.errors import IdentificationError
from twodof.identify import Record, fit
from twodof.identify.record import HOLDS
from twodof.identify.record_simulator import RecordSimulator, ticks
from twodof.models import Structure, pitch_rate
from twodof.models.plant import PitchRate

pytestmark = pytest.mark.slow

DT, N = 0.004, 3000
TIME = DT * np.arange(N)
PLANT = {"w_n": 25.0, "xi": 0.7, "mu": 400.0, "tau": 0.0, "theta_0": 0.0, "q_0": 0.0}


def simulated(structure: Structure, values: dict[str, float], u: np.ndarray, hold: str, output: str) -> np.ndarray:
    (name,) = structure.inputs
    record = Record.from_columns(TIME, {name: u, output: u}, [name], [output], hold=hold)
    return RecordSimulator(structure, record).run(values)[output]


def direct() -> Structure:
    """y = u / (1 + .02 s) + .5 u."""
    diagram = Diagram("direct")
    diagram.input("u")
    diagram.param("gain", 0.5)
    diagram.add("lag", FirstOrder(time_constant=0.02), u="u")
    diagram.add("through", Gain(), params={"k": "gain"}, u="u")
    diagram.add("sum", Sum("++"), a="lag", b="through")
    diagram.output("y", "sum")
    return Structure(diagram, ("gain",))


@pytest.mark.parametrize("hertz", [3.0, 40.0, 100.0])
def test_a_sine_between_its_samples_meets_the_exact_frequency_response(hertz: float) -> None:
    omega = 2.0 * math.pi * hertz
    model = PitchRate(w_n=25.0, xi=0.7, mu=400.0, tau=0.0).state_space().response(omega)[0, 1, 0]
    u = np.sin(omega * TIME)
    expected = (model * np.exp(1j * omega * TIME)).imag
    inner = slice(N // 3, 2 * N // 3)  # 4 s after the start, 70 time constants; far from the ends
    size = abs(model)
    errors = {
        hold: float(np.abs(simulated(pitch_rate(), PLANT, u, hold, "q") - expected)[inner].max()) / size
        for hold in HOLDS
    }
    # The fifth power of the step over the time constant, 4 ms / 40 ms, and what the ends of the record leave here.
    assert errors["band-limited"] < 1e-5
    # The held input is half a step late: pi f dt.
    assert errors["zoh"] > 0.8 * min(math.pi * hertz * DT, 1.0)
    assert errors["linear"] < errors["zoh"]


def test_straight_lines_agree_with_scipy_and_reach_a_direct_output_at_once() -> None:
    u = np.random.default_rng(2).standard_normal(N)  # the roughest there is: a corner at each sample
    found = simulated(direct(), {"gain": 0.5}, u, "linear", "y")
    system = ([[-50.0]], [[50.0]], [[1.0]], [[0.5]])
    _, expected, _ = lsim(system, u, TIME, interp=True)
    # dt / (20 ms) = .2, and the exponential's series ends after the second moment, at .2^3 / 3!, of which the ticks'
    # means leave little.
    assert np.abs(found - expected).max() < 2e-3
    held = simulated(direct(), {"gain": 0.5}, u, "zoh", "y")
    assert np.abs(held - expected).max() > 0.05


class Duffing(Block):
    """y'' = g u - k y - d y' - c y^3."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)
    params = (Param("g", 300.0), Param("k", 300.0), Param("d", 5.0), Param("c", 100.0))
    states = (State("y", continuous=True), State("v", continuous=True))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.y

    def derivative(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"y": x.v, "v": p.g * u.u - p.k * x.y - p.d * x.v - p.c * x.y * x.y * x.y}


def test_a_nonlinear_system_is_found_from_samples_of_a_multisine() -> None:
    truth = {"g": 400.0, "k": 400.0, "d": 4.0, "c": 300.0}
    step, size = 0.02, 600  # six samples a period at the resonance
    time = step * np.arange(size)
    hertz = np.arange(1, 60, 2) / (step * size)
    phase = np.random.default_rng(6).uniform(0.0, 2.0 * np.pi, hertz.size)

    def force(t: float) -> float:
        return float(0.5 * np.sin(2.0 * np.pi * hertz * t + phase).sum() / 3.0)

    def moved(t: float, s: np.ndarray) -> list[float]:
        pull = truth["k"] * s[0] + truth["d"] * s[1] + truth["c"] * s[0] ** 3
        return [s[1], truth["g"] * force(t) - pull]

    found = solve_ivp(moved, (0.0, time[-1]), [0.0, 0.0], "DOP853", time, rtol=1e-8, atol=1e-10)
    table = {"u": np.array([force(t) for t in time]), "y": found.y[0]}
    structure = Structure.of_block(Duffing(), substeps=8)
    left = {}
    for hold in ("zoh", "band-limited"):
        estimate = fit(structure, Record.from_columns(time, table, ["u"], ["y"], hold=hold), disturbance="white")
        left[hold] = estimate.identification[0].rmse / found.y[0].std()
        if hold == "band-limited":
            for name, value in truth.items():
                # What is left are the ends: the multisine has a whole period in the record, which nobody is told.
                assert estimate[name] == pytest.approx(value, rel=2e-3)
    assert left["band-limited"] < 1e-3
    assert left["zoh"] > 0.05


@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize("pieces", [4, 7])
def test_the_first_tick_of_a_step_can_be_the_sample_and_the_moments_stay(hold: str, pieces: int) -> None:
    # Sines up to .8 of half the sampling rate, which the nodes inside a step resolve to 1e-6.
    u = sum(np.sin(w * np.arange(300) + w) for w in (0.1, 0.7, 2.5))
    plain, exact = ticks(u, hold, pieces), ticks(u, hold, pieces, direct=True)
    inner = slice(50, -50)  # a band-limited record is continued at its ends by a guess
    assert np.allclose(exact[::pieces][inner], u[inner], atol=1e-3)
    number = np.arange(pieces) + 0.5
    for power in range(3):
        moments = [(x.reshape(-1, pieces) * number**power).sum(axis=1) for x in (plain, exact)]
        assert np.allclose(*moments, atol=1e-9)


@pytest.mark.parametrize("n", [1, 2, 3, 10])
@pytest.mark.parametrize("hold", HOLDS)
def test_a_line_and_the_shortest_records_stay_what_they_are(n: int, hold: str) -> None:
    assert np.allclose(ticks(np.full(n, 7.0), hold, 4), 7.0, atol=1e-12)
    if hold != "zoh" and n > 3:
        ramp = ticks(np.arange(float(n)), hold, 4).reshape(n, 4)[:-1]
        middle = (np.arange(4.0) - 1.5) / 4.0
        assert np.allclose(ramp.mean(axis=1), np.arange(n - 1) + 0.5, atol=1e-9)
        # The mean of (t - 1/2)^2 over the step is 1/12.
        assert np.allclose(ramp @ middle / 4.0, 1.0 / 12.0, atol=1e-9)


def test_an_input_on_another_clock_is_read_between_its_stamps() -> None:
    slow = np.arange(-0.01, 12.0, 0.01)
    channels = {"u": (TIME, TIME), "w": (slow, slow), "y": (TIME, TIME)}
    record = Record.from_channels(channels, ["u", "w"], ["y"], hold={"w": "linear"}, stop=11.9)
    assert record.hold == {"w": "linear"}
    assert np.allclose(record.inputs["w"], record.time, atol=1e-9)
    assert record.part(1.0, 2.0).hold_of("w") == "linear"
    assert record.hold_of("u") == "zoh"


def test_a_hold_that_is_not_there_is_refused() -> None:
    table = {"u": TIME, "y": TIME}
    for wrong in ("foh", "", {"u": "spline"}, {"u": 3}, None, 3):
        with pytest.raises(IdentificationError, match="no hold"):
            Record.from_columns(TIME, table, ["u"], ["y"], hold=wrong)  # type: ignore[arg-type]
    with pytest.raises(IdentificationError, match="not an input"):
        Record.from_columns(TIME, table, ["u"], ["y"], hold={"y": "linear"})
    with pytest.raises(IdentificationError, match="smooth"):
        Record.from_columns(TIME, table, ["u"], ["y"], smooth=["u"], hold="linear")
