"""Start of a flight as read from a log: flights of the virtual rig, and made-up ones, whose start is known."""

from collections.abc import Mapping

import numpy as np
import pytest
from numpy.typing import NDArray

from twodof.errors import LogError
from twodof.experiment.flight import Laboratory, flight_log
from twodof.flight.gains import DEFAULT, STUDENT
from twodof.flightlog.log import Channel, FlightLog
from twodof.flightlog.steps import BOOT
from twodof.rig.parameters import lab
from twodof.rig.rig import rail_force
from twodof.signals import HOVER, MODES, PERIOD
from twodof.sim.closed_loop import InitialState
from twodof.sim.flight_segment import default_window, read_segment
from twodof.sim.resimulation import LoggedFlight, resimulation_loop

pytestmark = pytest.mark.slow

Floats = NDArray[np.float64]
TIME = np.arange(8.0, 50.0, PERIOD)


@pytest.mark.parametrize("push", [0.15, -0.1])
def test_the_push_of_a_rail_is_found_from_the_flight_before_the_window(push: float) -> None:
    """The sweep moves the cart, so friction is on both sides and what is left of the mean is the push.

    Gusts leave .01 rad of pitch, .03 N; dry friction, which is taken off the push, is .03 N.
    """
    log = Laboratory("lab", conditions={"rail_force": push}).fly("position-sweep", seed=2).log
    flown = read_segment(log, DEFAULT, (log.armed()[0][1] - 1.0, log.armed()[0][1]))
    found = rail_force(lab(), *flown.balance)
    assert found == pytest.approx(push, abs=0.05)
    assert found * push > 0.0


def test_a_short_flight_before_the_window_says_nothing() -> None:
    log = Laboratory("lab", conditions={"rail_force": 0.15}).fly("velocity-doublets", seed=2).log
    start = log.armed()[0][0]
    assert read_segment(log, DEFAULT, (start + 4.9, start + 6.0)).balance == (0.0, 0.0, 0.0)
    assert read_segment(log, DEFAULT, (start + 5.5, start + 7.0)).balance != (0.0, 0.0, 0.0)


def test_nothing_after_the_windows_start_is_used() -> None:
    log = Laboratory("lab").fly("velocity-doublets", seed=2).log
    window = (log.armed()[0][0] + 8.0, log.armed()[0][1])
    cut = FlightLog({name: channel.slice(0.0, window[0] + 0.2) for name, channel in log.channels.items()})
    whole = read_segment(log, DEFAULT, window).balance
    assert read_segment(cut, DEFAULT, (window[0], window[0] + 0.1)).balance == pytest.approx(whole, abs=1e-9)


@pytest.mark.parametrize(
    ("mode", "amplitude", "least"),
    [("rate", 0.3, 98.5), ("attitude", 0.1, 99.0), ("velocity", 0.15, 97.0), ("position", 0.1, 95.0)],
)
def test_a_simulated_flight_is_resumed_from_its_log(mode: str, amplitude: float, least: float) -> None:
    """The states of the controllers are those of the simulation, and what follows fits without noise."""
    loop, rig, (before, after), off = resimulation_loop(), lab().snapshot(), (2500, 1500), 50
    loop.tune(STUDENT)
    loop.configure({**rig, "rings": mode in ("rate", "attitude"), "ring_place": 0.0})
    loop.start(InitialState())
    k = np.arange(before + after)
    wave = amplitude * np.where(k // 250 % 2, -1.0, 1.0)
    flown = {"mode": np.where(k < off, 0, MODES.index(mode)).astype(np.int32), "thrust": np.where(k < off, 0.0, HOVER)}
    flown |= dict.fromkeys(("q0", "theta0", "v0", "x0"), wave)
    first = loop.fly(before, {name: column[:before] for name, column in flown.items()})
    loops = ("rate.sum", "rate.slope", "rate.error", *(["velocity.sum"] if mode in ("velocity", "position") else []))
    states = {name: float(loop.machine.state(f"flight.cascade.{name}")) for name in loops}
    rest = loop.fly(after, {name: column[before:] for name, column in flown.items()})
    log = flight_log({name: np.concatenate([first[name], rest[name]]) for name in first}, flown["mode"], {})
    logged = LoggedFlight(log, STUDENT, (BOOT + (before - 0.5) * PERIOD, BOOT + (before + after - 10) * PERIOD))
    segment = logged.flown
    assert segment.states == pytest.approx(states, rel=1e-9, abs=1e-15)
    assert segment.spun_up == pytest.approx((before - off) * PERIOD, abs=1e-4)
    assert len(segment.time) == after - 9
    assert any(segment.balance) is (mode in ("velocity", "position"))
    assert segment.commands[-1] == (first["M"][-1], first["T"][-1])
    fit = logged.compare(loop, rig).fit
    assert min(fit[name] for name in ("theta", "q", *(("v",) if segment.rails else ()))) > least, fit


def made_up(modes: Mapping[float, str], steps: Mapping[str, float], **columns: Floats) -> FlightLog:
    """Motors from 10 to 40 s and from 45 s on, in attitude mode up to `modes`; set-points step by .05 at `steps`."""
    armed = (TIME >= 10.0) & (TIME < 40.0) | (TIME >= 45.0)
    mode = np.where(armed, MODES.index("attitude"), 0)
    for since, name in modes.items():
        mode = np.where(armed & (since <= TIME), MODES.index(name), mode)
    zeros = dict.fromkeys(("M", "theta", "theta0", "q", "q0", "v", "v0", "x", "x0"), np.zeros(len(TIME)))
    stepped = {name: np.where(at <= TIME, 0.05, 0.0) for name, at in steps.items()}
    given = {**zeros, **stepped, **columns, "T": HOVER * armed, "mode": mode}
    return FlightLog({name: Channel(TIME, values) for name, values in given.items()})


@pytest.mark.parametrize(
    ("begin", "modes", "steps", "hold"),
    [
        (30.0, {}, {}, (24.0, 30.0)),  # the last 6 s
        (12.0, {}, {}, (10.5, 12.0)),  # .5 s after the start of the motors
        (30.0, {}, {"theta0": 26.0}, (28.0, 30.0)),  # 2 s after a step
        (30.0, {}, {"theta0": 26.0, "x0": 27.0}, (29.0, 30.0)),
        (30.0, {}, {"theta0": 10.2}, (24.0, 30.0)),
        (29.5, {29.0: "open-loop"}, {}, (23.0, 29.0)),
        (29.5, {29.0: "rate"}, {}, (23.0, 29.0)),
        (29.5, {29.0: "velocity"}, {}, (23.0, 29.0)),
        (29.5, {29.0: "position"}, {}, (23.5, 29.5)),
        (45.6, {}, {}, (34.0, 40.0)),  # too short since the motors started: of the flight before
        (45.8, {}, {}, (45.5, 45.8)),
        (10.6, {}, {}, None),
    ],
)
def test_the_trim_is_the_mean_of_the_last_hold(
    begin: float, modes: dict[float, str], steps: dict[str, float], hold: tuple[float, float] | None
) -> None:
    log = made_up(modes, steps, M=1e-3 * TIME, theta=-2e-3 * TIME)  # ramps: the means tell the hold
    segment = read_segment(log, DEFAULT, (begin, begin + 1.0))
    assert segment.hold == (hold and pytest.approx(hold, abs=0.01))
    if hold:
        middle = np.mean(hold)
        assert (segment.trim_moment, segment.trim_theta) == pytest.approx((1e-3 * middle, -2e-3 * middle), abs=5e-5)


@pytest.mark.parametrize(("before", "bias"), [(20.0, 0.05), (4.0, 0.05), (1.1, 0.05), (0.9, 0.0)])
def test_the_bias_of_the_speed_is_that_of_the_last_6_s(before: float, bias: float) -> None:
    """The cart goes .1 m in a second from 24 s on, and the estimated speed is .05 m/s too large."""
    log = made_up({20.0: "velocity"}, {}, x=0.1 * np.maximum(TIME, 24.0), v=np.where(TIME < 24.0, 0.5, 0.15))
    found = read_segment(log.slice(30.0 - before, 32.0), DEFAULT, (30.0, 31.0))
    assert found.velocity_bias == pytest.approx(bias, abs=1e-9)


@pytest.mark.parametrize(
    ("modes", "steps", "window"),
    [
        ({}, {"theta0": 26.0}, (25.7, 28.0)),
        ({}, {"theta0": 39.0}, (38.7, 40.0)),  # one stretch with thrust
        ({}, {"theta0": 10.2}, (10.0, 12.2)),
        ({20.0: "position"}, {"theta0": 15.0, "x0": 30.0}, (14.7, 17.0)),  # the first stretch of equally many steps
        ({20.0: "position"}, {"theta0": 20.0, "x0": 30.0}, (29.7, 32.0)),  # steps with the mode do not count
    ],
)
def test_the_default_window_is_around_the_steps(
    modes: dict[float, str], steps: dict[str, float], window: tuple[float, float]
) -> None:
    log = made_up(modes, steps)
    assert default_window(log) == pytest.approx(window, abs=0.01)
    handed_over = made_up({20.0: "position"}, {"x0": 30.0}, x=np.where(TIME >= 30.0, 0.05, 0.0))
    with pytest.raises(LogError, match="no set-point has a step"):
        default_window(handed_over)
