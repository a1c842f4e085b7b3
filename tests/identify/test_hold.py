"""Inputs that move between samples: against exact frequency responses, scipy, and what the samples themselves are."""

import math

import numpy as np
import pytest
from scipy.signal import lsim

from twodof.blocks import Diagram
from twodof.blocks.library import FirstOrder, Gain, Sum
from twodof.errors import IdentificationError
from twodof.identify import Record, fit
from twodof.identify.record import HOLDS
from twodof.identify.record_simulator import RecordSimulator, ticks
from twodof.models import Structure, linear_model, pitch_rate
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
def test_held_sines_meet_the_exact_response(hertz: float) -> None:
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


def test_linear_holds_agree_with_scipy() -> None:
    u = np.random.default_rng(2).standard_normal(N)  # the roughest there is: a corner at each sample
    found = simulated(direct(), {"gain": 0.5}, u, "linear", "y")
    system = ([[-50.0]], [[50.0]], [[1.0]], [[0.5]])
    _, expected, _ = lsim(system, u, TIME, interp=True)
    # dt / (20 ms) = .2, and the exponential's series ends after the second moment, at .2^3 / 3!, of which the ticks'
    # means leave little.
    assert np.abs(found - expected).max() < 2e-3
    held = simulated(direct(), {"gain": 0.5}, u, "zoh", "y")
    assert np.abs(held - expected).max() > 0.05


@pytest.mark.parametrize("n", [1, 2, 3, 10])
@pytest.mark.parametrize("hold", HOLDS)
def test_lines_and_shortest_records_stay_the_same(n: int, hold: str) -> None:
    assert np.allclose(ticks(np.full(n, 7.0), hold, 4), 7.0, atol=1e-12)
    if hold != "zoh" and n > 3:
        ramp = ticks(np.arange(float(n)), hold, 4).reshape(n, 4)[:-1]
        middle = (np.arange(4.0) - 1.5) / 4.0
        assert np.allclose(ramp.mean(axis=1), np.arange(n - 1) + 0.5, atol=1e-9)
        # The mean of (t - 1/2)^2 over the step is 1/12.
        assert np.allclose(ramp @ middle / 4.0, 1.0 / 12.0, atol=1e-9)


def test_an_input_on_another_clock_is_interpolated() -> None:
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
        with pytest.raises(IdentificationError, match="no hold named"):
            Record.from_columns(TIME, table, ["u"], ["y"], hold=wrong)  # type: ignore[arg-type]
    with pytest.raises(IdentificationError, match="no hold named 'linear' is defined for an input 'y'"):
        Record.from_columns(TIME, table, ["u"], ["y"], hold={"y": "linear"})
    with pytest.raises(IdentificationError, match="smooth"):
        Record.from_columns(TIME, table, ["u"], ["y"], smooth=["u"], hold="linear")


@pytest.mark.parametrize("disturbance", ["auto", "white"])
def test_a_wrong_hold_is_named_and_the_named_one_mends_it(disturbance: str) -> None:
    spring = linear_model(
        [[0, 1], ["-k", "-d"]],
        [[0], ["b"]],
        [[1, 0]],
        inputs=["u"],
        outputs=["y"],
        guess={"k": 5000.0, "d": 10.0, "b": 5000.0},
    )
    generator = np.random.default_rng(1)
    bins = np.where((np.arange(N // 2 + 1) > 0) & (np.arange(N // 2 + 1) < 0.3 * N), 1.0, 0.0)  # up to 75 of 125 Hz
    u = np.fft.irfft(bins * np.exp(2j * np.pi * generator.uniform(size=bins.size)), N) * math.sqrt(N)
    truth = {"k": 7000.0, "d": 5.0, "b": 7000.0, "x1_0": 0.0, "x2_0": 0.0}
    y = simulated(spring, truth, u, "band-limited", "y")
    y = y + 1e-3 * y.std() * generator.standard_normal(N)
    table = {"u": u, "y": y}
    wrong = fit(spring, Record.from_columns(TIME, table, ["u"], ["y"]), disturbance=disturbance)  # type: ignore[arg-type]
    assert any("hold='band-limited'" in remark for remark in wrong.remarks), wrong.table()
    right = fit(spring, Record.from_columns(TIME, table, ["u"], ["y"], hold="band-limited"))
    assert right.identification[0].fit_percent > 99.8
    assert abs(right["k"] - 7000.0) < 4.0 * right.sigma("k")
    assert not right.suggestions
