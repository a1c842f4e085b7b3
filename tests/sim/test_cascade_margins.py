"""The loops as they fly: against compiled flights at the border, against one linearisation of the whole, by hand."""

import math
from functools import cache
from typing import Any

import numpy as np
import pytest

from tests.design.test_margins import RATES
from twodof.blocks.reference.interpreter import Reference
from twodof.compile.linear.linearize import linearize
from twodof.design import LoopMargins, LoopTransfer, margins
from twodof.errors import DiagramError, ParameterError
from twodof.flight.gains import DEFAULT, STUDENT, Gains
from twodof.flight.starters import starter
from twodof.models import PAPER_PITCH_RATE
from twodof.rig.parameters import load_rig
from twodof.rig.rig import BASE_DT, model_parameters
from twodof.rig.rotors import RING
from twodof.signals import HOVER, PERIOD, Q_AGE
from twodof.sim.closed_loop import ClosedLoop, InitialState, closed_loop
from twodof.sim.linear import LOOPS, _filter_at_rest, cascade_loop, cascade_margins, publishing_ages
from twodof.sim.resimulation import identified_rig, load_rig_or_model

pytestmark = pytest.mark.slow

DRY = {"coulomb_idle": 0.0, "coulomb_run": 0.0, "rail_coulomb": 0.0, "trim": 0.0, "trim_start": 0.0, "noise": 0.0}


@cache
def found(rig: str) -> dict[str, LoopMargins]:
    return cascade_margins(STUDENT, rig=rig)


@cache
def loops() -> tuple[ClosedLoop, ClosedLoop]:
    """The stock cascade, and the position controller whose gains have wide bounds."""
    return ClosedLoop(STUDENT), ClosedLoop(STUDENT, controllers=[starter("pid-position")])


FLIGHTS = {
    "rate": ("rate", {"q0": 1e-3}, 700, "true_q"),
    "motors": ("attitude", {"theta0": 1e-3}, 900, "true_theta"),
    "velocity": ("velocity", {"v0": 2e-3}, 2000, "true_theta"),
    "position": ("position", {"x0": 1e-3}, 4000, "true_x"),
}


def growth(rig: str, loop: str, factor: float) -> float:
    """How much larger the swing is in the last third of a flight, with `factor` times the loop's gain, than before."""
    mode, setpoint, steps, seen = FLIGHTS[loop]
    values: dict[str, Any] = {**load_rig(rig).snapshot(), **DRY}
    stock, own = loops()
    flown = stock if loop in ("rate", "motors") else own
    if loop in ("rate", "motors"):
        values["arm"] *= factor  # the pitch gain mu is in proportion to it
    flown.configure(values)
    if flown is own:
        kp, ki = STUDENT.velocity
        v, x = (factor, 1.0) if loop == "velocity" else (1.0, factor)
        gains = {"vx_kp": kp * v, "vx_ki": ki * v, "x_kp": STUDENT.position * x}
        flown.tune_controllers({f"position_control.{name}": value for name, value in gains.items()})
    flown.start(InitialState(hover=True))
    out = flown.fly(steps, {"mode": mode, "thrust": HOVER, **setpoint})[seen]
    middle, late = out[steps // 3 : 2 * steps // 3], out[2 * steps // 3 :]
    return float(np.ptp(late) / np.ptp(middle))


@pytest.mark.long
@pytest.mark.parametrize("rig", ["paper", "lab"])
@pytest.mark.parametrize("loop", FLIGHTS)
def test_a_flight_becomes_unstable_where_the_gain_margin_says(loop: str, rig: str) -> None:
    """With the range sensor's own clock, the publisher and the trigonometry: within 4 % of the gain."""
    border = found(rig)[loop].increase
    assert border is not None
    assert growth(rig, loop, 0.96 * border.factor) < 1.0 < growth(rig, loop, 1.04 * border.factor)


@pytest.mark.long
def test_a_flight_swings_and_grows_as_the_margins_say() -> None:
    rig = dict(load_rig("paper").snapshot()) | {"arm": 0.25}
    m = cascade_margins(rig=rig, loops=["rate"])["rate"]
    assert not m.stable
    assert m.motion is not None
    flown = loops()[0]
    flown.tune(DEFAULT)
    flown.configure(rig | DRY)
    flown.start(InitialState(hover=True))
    q = flown.fly(300, {"mode": "rate", "thrust": HOVER, "q0": 1e-6})["true_q"][150:]
    flown.tune(STUDENT)
    # q is growth exp(s t): two roots of the linear recurrence that its samples obey.
    rows = np.column_stack([q[1:-1], q[:-2]])
    root = complex(np.roots([1.0, *-np.linalg.lstsq(rows, q[2:], rcond=None)[0]])[0])
    s = np.log(root) / PERIOD
    assert abs(s.imag) == pytest.approx(m.motion.omega, rel=0.01)
    assert s.real == pytest.approx(m.motion.growth, rel=0.03)


@pytest.mark.soak
def test_in_parts_and_at_once_the_linearisation_is_the_same() -> None:
    """The rate loop of the whole closed loop, cut at q, by one call: 53 states through the same four ticks."""
    values = load_rig("lab").snapshot()
    still = {f"rig.{name}": value for name, value in (values | DRY).items()}
    still |= {f"rig.rotors.{pair}_ring": [HOVER] * RING for pair in ("fore", "aft")}
    still |= {f"rig.rotors.{pair}": HOVER for pair in ("fore", "aft")} | {"rig.rotors.wake": 1.0}
    still |= {"rig.battery.load": 1.0, "rig.battery.polarised": 1.0}
    at = still | {"mode": 2, "thrust": HOVER, "rig.range.phase": 2**32 - 1, "flight.arming.count": 1000}
    at |= {f"flight.{name}": value for name, value in _filter_at_rest(float(values["tof_rate"])).items()}
    at |= {"flight.estimator.filter.started": True}
    cut = "flight.estimator.filter.q"
    others = [
        "rig.battery.supply",
        "rig.turbulence.moment",
        "flight.estimator.publisher.x",
        "flight.estimator.publisher.v",
    ]
    whole = LoopTransfer.of(linearize(closed_loop(), BASE_DT, at, [cut, *others], [cut]), cut, negate=True)
    parts = cascade_loop("rate", rig="lab")
    omega = np.geomspace(0.1, 780.0, 60)
    np.testing.assert_allclose(parts.response(omega), whole.response(omega), rtol=1e-8)


@pytest.mark.long
def test_the_rate_loop_on_the_papers_rig_is_the_formulas() -> None:
    """The PID's z-transform times the exactly held plant, whose samples of q are .4 ms old: to the accuracy of RK4."""
    kp, ki, kd = RATES[30]
    p, n = PAPER_PITCH_RATE, 100.0
    plant = type(p)(p.w_n, p.xi, p.mu, p.tau + Q_AGE).state_space().zero_order_hold(PERIOD)
    held = LoopTransfer.of(plant, 0, 1)
    omega = np.geomspace(3.0, 700.0, 40)
    z = np.exp(1j * omega * PERIOD)
    law = kp + ki * PERIOD * z / (z - 1) + kd * (z - 1) / ((1 / n + PERIOD) * z - 1 / n)
    gains = Gains((kp, ki, kd), *(DEFAULT.attitude, DEFAULT.velocity, DEFAULT.position))
    # The estimator's bias takes away part of what is slow: .1 % at 3 rad/s.
    np.testing.assert_allclose(
        cascade_loop("rate", gains, rig="paper").response(omega), law * held.response(omega), rtol=2e-3
    )


@pytest.mark.long
def test_the_stock_cascade_as_a_diagram_has_the_stock_margins() -> None:
    own = [starter("pid-attitude"), starter("pid-position"), starter("stock-motor")]
    for name in LOOPS:
        one, other = cascade_loop(name, rig="paper"), cascade_loop(name, controllers=own, rig="paper")
        omega = np.geomspace(0.5, 700.0, 20)
        np.testing.assert_allclose(other.response(omega), one.response(omega), rtol=1e-7)


def test_at_rest_the_covariance_is_the_filters_own() -> None:
    """One step of the filter with a range sample at every step leaves it where it is."""
    from twodof.flight.estimator import estimator

    at = _filter_at_rest(18.35)
    machine = Reference(estimator(), PERIOD).machine()
    machine.set_many({"filter.sigma_range": at["estimator.filter.sigma_range"]})
    machine.reset()
    covariance = {path.removeprefix("estimator."): v for path, v in at.items() if "P_" in path}
    for path, value in covariance.items():
        machine.set_state(path, value)
    machine.set_state("filter.started", True)
    machine.step({"acc_z": -9.81, "dist": 0.5, "dist_new": True})
    for path, value in covariance.items():
        assert float(machine.state(path)) == pytest.approx(value, rel=1e-6, abs=1e-15), path


def test_the_publisher_is_two_or_three_steps_late_in_turn() -> None:
    """100 Hz of 250: read from the next step on, ages 1, 2, 3, 1, 2."""
    assert publishing_ages() == (0.0, 0.4, 0.4, 0.2)


@pytest.mark.long
def test_a_rig_from_a_model_has_the_models_figures(tmp_path: Any) -> None:
    model = {"w_n": 2.9, "xi": 0.11, "mu": 291.0, "tau": 0.0195, "k_v": 4.4, "p_v": 0.9}
    rig = identified_rig(model)
    figures = model_parameters(rig)
    for name, value in model.items():
        assert figures[name] == pytest.approx(value, rel=1e-9), name
    assert figures["xi_run"] == pytest.approx(0.11)
    part = identified_rig({"mu": 200.0})
    assert model_parameters(part)["w_n"] == pytest.approx(PAPER_PITCH_RATE.w_n)
    assert margins(cascade_loop("rate", rig=part)).crossover < margins(cascade_loop("rate", rig="paper")).crossover
    file = tmp_path / "model.json"
    file.write_text('{"estimates": {"mu": {"value": 200.0}}, "fixed": {"w_n": 3.437}}')
    assert load_rig_or_model(file) == pytest.approx(identified_rig({"mu": 200.0, "w_n": 3.437}))
    assert load_rig_or_model("lab") == dict(load_rig("lab").snapshot())


@pytest.mark.long
def test_bad_input_is_refused_with_the_remedy(tmp_path: Any) -> None:
    with pytest.raises(DiagramError, match="no loop named 'yaw'"):
        cascade_loop("yaw")
    for nothing in ({"a": 1.0}, {"lag": 0.01}):
        with pytest.raises(ParameterError, match="a rig needs one of"):
            identified_rig(nothing)
    for bad in (math.nan, -5.0, 1e12):
        with pytest.raises(ParameterError, match="no rig can have"):
            identified_rig({"mu": bad})
    with pytest.raises(ParameterError, match="no rig can have tau"):
        identified_rig({"tau": 0.5})
    with pytest.raises(DiagramError, match="template"):
        cascade_loop("rate", controllers=[closed_loop()])
    file = tmp_path / "empty.json"
    file.write_text("")
    with pytest.raises(ParameterError):
        load_rig_or_model(file)
