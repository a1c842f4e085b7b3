"""Events, modes and excitations found in synthetic logs and, against their description, in the real ones."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.flightlog.synthetic import attitude_steps, channel
from twodof.errors import LogError
from twodof.excitation import Doublet, Excitation, Impulse, Steps, Sweep, ThreeTwoOneOne
from twodof.flightlog.contents import describe, excitations, find_excitation, log_summary
from twodof.flightlog.events import (
    flown_steps,
    mode_at,
    modes,
    openloop_edges,
    setpoint_steps,
    steps_by,
    thrust_edges,
    window,
)
from twodof.flightlog.files import read_log
from twodof.flightlog.log import Channel, FlightLog
from twodof.flightlog.steps import SAFETY
from twodof.signals import MODES, PERIOD

# One sample of 4 ms: where between two samples a change fell is not known.
SAMPLE = 0.0041


def test_synthetic_events() -> None:
    log = attitude_steps()
    assert [(event.kind, event.after) for event in thrust_edges(log)] == [("thrust on", 0.4), ("thrust off", 0.0)]
    steps = setpoint_steps(log, "theta0")
    assert [event.time - 100.0 for event in steps] == pytest.approx([2.0, 3.0], abs=SAMPLE)
    assert [(event.before, event.after) for event in steps] == [(0.0, 0.1), (0.1, 0.0)]
    assert setpoint_steps(log, "q0") == []
    assert steps_by(log, "attitude", 0.104, 0.9) == steps, "up and down, within 5 %"
    assert steps_by(log, "attitude", 0.1, 1.1) == steps[1:], "the first is followed for 1 s"
    assert steps_by(log, "attitude", 0.11, 0.9) == steps_by(log, "rate", 0.1, 0.0) == []
    assert openloop_edges(log) == []
    assert window(log, steps) == pytest.approx((101.7, log.armed()[0][1]), abs=SAMPLE)
    with pytest.raises(LogError, match="no event"):
        window(log, [])


def test_a_mode_without_its_set_point_has_no_steps_and_takes_none_from_others() -> None:
    # As PX4 logs it: the mode says position, and x0 is not there.
    whole = attitude_steps()
    log = FlightLog({name: one for name, one in whole.channels.items() if name != "x0"})
    assert flown_steps(log, "position") == []
    assert flown_steps(log, "attitude")


def test_channel_mode_decides() -> None:
    log = attitude_steps()
    time = log["T"].time
    code = np.where(time < 103.0, MODES.index("rate"), MODES.index("position"))
    with_mode = FlightLog({**log.channels, "mode": channel("mode", time, code)})
    assert [stretch.mode for stretch in modes(with_mode)] == ["rate", "position"]
    with pytest.raises(LogError, match="mode numbers from 9 to 9"):
        modes(FlightLog({"mode": Channel([0.0], [9.0])}))


@pytest.mark.parametrize(
    ("signal", "name"),
    [
        (Doublet(0.1, 1.0, unit="rad"), "attitude-doublet"),
        (Doublet(0.1, 1.0, unit="rad", repeat=2), "attitude-doublets"),
        (ThreeTwoOneOne(0.1, 0.4, unit="rad"), "attitude-3-2-1-1"),
        (Steps((0.1, 0.0, -0.1), 0.7, unit="rad"), "attitude-steps"),
        (Impulse(0.1, 0.5, unit="rad"), "attitude-impulse"),
        (Sweep(0.1, 0.2, 2.0, 3.0, unit="rad"), "attitude-sweep"),
    ],
)
def test_flown_excitation_is_recognised(signal: Excitation, name: str) -> None:
    log = attitude_steps()
    time = log["theta0"].time
    # Set-points reach the controller at 50 Hz.
    flown = signal.at(np.floor((time - 101.5) / 0.02) * 0.02)
    theta0 = channel("theta0", time, flown)
    q0 = channel("q0", time, 11.0 * (flown - 0.01 * np.random.default_rng(3).standard_normal(len(time))))
    found = excitations(FlightLog({**log.channels, "theta0": theta0, "q0": q0}))
    assert [one.name for one in found] == [name]
    assert found[0].amplitude == pytest.approx(0.1, rel=1e-3)
    assert found[0].edges[0] == pytest.approx(101.5, abs=0.025)
    assert found[0].edges[-1] == pytest.approx(101.5 + signal.duration, abs=0.025)


def test_log_without_loops_is_described() -> None:
    found = describe(FlightLog({"theta": Channel([0.0, 0.1], [1.0, 2.0], "rad")}))
    assert found["channels"][0]["rate_hz"] == pytest.approx(10.0)
    assert (found["modes"], found["excitations"], found["experiment"]) == ([], [], None)
    assert describe(FlightLog({"q": Channel([0.0], [1.0])}))["channels"][0]["rate_hz"] is None
    with pytest.raises(LogError, match="no channel 'q0'"):
        excitations(FlightLog({"T": Channel([0.0], [1.0])}))


@pytest.mark.parametrize("after", ["open-loop", "attitude"])
def test_moments_that_level_the_drone_are_not_part_of_a_doublet(after: str) -> None:
    """Moments of the failsafe, and of the loop that is closed before the drone is disarmed, do not count."""
    tick = 10.0 + PERIOD * np.arange(500)
    moment = Doublet(0.03, 0.6, lead=0.2).at(tick - 10.0)
    levelled = tick >= 11.2
    moment[levelled] = 0.8 + 0.01 * np.arange(levelled.sum())
    mode = np.where(levelled, MODES.index(after), MODES.index("open-loop"))
    acts = levelled & (after == "open-loop")
    is_open = mode == MODES.index("open-loop")
    message = np.column_stack([moment, np.full(500, 0.4), is_open, np.ones((500, 2))])
    log = FlightLog(
        {
            # M and its message are stamped a little before the other words of their step.
            "lmnf": channel("lmnf", tick - 0.0015, message),
            "mode": channel("mode", tick, mode),
            "safety": Channel(tick, np.column_stack([acts, 4 * acts, 4 * acts]).astype(float), "", SAFETY, "safety"),
            **{name: channel(name, tick, np.full(500, 0.4)) for name in ("T", "q0", "theta0")},
            "M": channel("M", tick, moment),
        }
    )
    (found,) = excitations(log)
    assert found.name == "open-loop-doublet"
    assert found.edges == pytest.approx((10.2, 10.5, 10.8), abs=SAMPLE)
    assert found.window[1] == pytest.approx(11.2, abs=SAMPLE)
    assert log["M"].slice(*found.window).value.max() < 0.031


def test_failsafe_set_points_are_no_steps() -> None:
    tick = 10.0 + PERIOD * np.arange(2500)
    wanted = Steps((0.1, 0.0, 0.1, 0.0), 2.0, lead=0.5).at(tick - 10.0)
    acts = (tick >= 15.0) & (tick < 15.6)  # while 0.1 is asked for
    wanted[acts] = -0.05
    log = FlightLog(
        {
            "mode": channel("mode", tick, np.full(tick.size, MODES.index("attitude"))),
            "safety": Channel(tick, np.column_stack([acts, 4 * acts, 4 * acts]).astype(float), "", SAFETY, "safety"),
            "theta0": channel("theta0", tick, wanted),
            **{name: channel(name, tick, np.full(tick.size, 0.4)) for name in ("T", "q0")},
        }
    )
    before, after = excitations(log)
    assert [*before.edges, *after.edges] == pytest.approx([10.5, 12.5, 14.5, 16.5], abs=SAMPLE)
    assert before.window[1] == pytest.approx(15.0, abs=SAMPLE)
    assert after.window[0] == pytest.approx(16.2, abs=SAMPLE)


REAL = [
    ("free-response-impulse", "open-loop-impulse", 0.1, [188.456, 188.648], 188.30),
    ("doublet-0.03", "open-loop-doublet", 0.03, [244.808, 245.108, 245.405], 244.70),
    ("attitude-steps-10deg-default", "attitude-steps", 0.17453, [127.83, 129.82, 131.83, 133.83], 127.50),
    ("attitude-steps-10deg-student", "attitude-steps", 0.17453, [7.02, 9.00, 11.00, 13.02], 6.70),
    (
        "rate-doublets-30dps-student",
        "rate-doublets",
        0.5236,
        [346.64, 348.12, 349.64, 351.14, 352.64, 354.12, 355.64],
        346.34,
    ),
    ("velocity-doublets-0.25", "velocity-doublets", 0.25, [151.25, 153.22, 155.22, 157.22, 159.23], 150.95),
    ("position-sweep-default", "position-sweep", 0.2, [133.1, 159.42], 132.8),
]


@pytest.mark.parametrize(("file", "name", "amplitude", "edges", "start"), REAL)
def test_real_experiments_are_recognised(
    flight_data: Path, file: str, name: str, amplitude: float, edges: list[float], start: float
) -> None:
    log = read_log(flight_data / f"{file}.mat")
    found = describe(log)
    json.dumps(found, allow_nan=False)
    experiment = found["experiment"]
    assert experiment["name"] == name
    assert experiment["amplitude"] == pytest.approx(amplitude, rel=1e-4)
    # The description rounds to 10 ms; a message is up to one sample older than what it makes of M.
    assert list(experiment["edges"]) == pytest.approx(edges, abs=0.006)
    # The description's windows are rounded by hand, to .2 s at most.
    assert experiment["window"][0] == pytest.approx(start, abs=0.2)


def test_an_excitation_is_found_by_name_or_by_shape(flight_data: Path) -> None:
    log = read_log(flight_data / "velocity-doublets-0.25.mat")
    for name in ("velocity-doublets", "velocity-doublet", "doublet", "doublets"):
        assert find_excitation(log, name).edges[0] == pytest.approx(151.25, abs=0.006)
    assert find_excitation(log, "position-steps").amplitude == 0.2
    with pytest.raises(LogError, match=r"velocity-doublets-0\.25\.mat: no excitation 'sweep' .the log has: position-"):
        find_excitation(log, "sweep")
    with pytest.raises(LogError, match="the log has: attitude-steps"):
        find_excitation(attitude_steps(), "doublet")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        # The last message expires half a second after it came; of the doublet the description says off at 246.22.
        ("free-response-impulse", [("off", 171.58), ("open-loop", 188.05), ("off", 214.06)]),
        (
            "doublet-0.03",
            [("off", 192.42), ("attitude", 216.71), ("off", 236.71), ("open-loop", 244.67), ("off", 246.22)],
        ),
        ("attitude-steps-10deg-default", [("off", 121.11), ("attitude", 125.92), ("off", 135.92)]),
        (
            "rate-doublets-30dps-student",
            [("off", 335.16), ("attitude", 343.96), ("rate", 346.53), ("attitude", 356.42)],
        ),
        (
            "velocity-doublets-0.25",
            [("off", 118.32), ("position", 125.65), ("velocity", 151.12), ("position", 161.53), ("off", 165.55)],
        ),
        ("position-sweep-default", [("off", 93.63), ("position", 107.67), ("off", 127.68), ("position", 131.98)]),
    ],
)
def test_the_modes_of_the_real_flights(flight_data: Path, name: str, expected: list[tuple[str, float]]) -> None:
    log = read_log(flight_data / f"{name}.mat")
    found = modes(log)
    assert [stretch.mode for stretch in found] == [mode for mode, _ in expected]
    assert [stretch.t0 for stretch in found] == pytest.approx([t for _, t in expected], abs=0.011)
    # The same on the steps of M, each of which is in one mode.
    time = log["M"].time + 0.002
    flown = mode_at(log, time)
    starts = [0, *(np.flatnonzero(np.diff(flown[time < found[-1].t1])) + 1)]
    assert [MODES[flown[k]] for k in starts] == [mode for mode, _ in expected]
    assert [time[k] for k in starts] == pytest.approx([stretch.t0 for stretch in found], abs=0.005)


def test_real_armed_dropouts(flight_data: Path) -> None:
    log = read_log(flight_data / "position-sweep-default.mat")
    # 1-2 armed drop-outs in a long log, gaps of 8 to 68 ms, say the facts about the platform.
    for name in ("M", "q", "theta", "gyr"):
        armed = [gap for gap in log.gaps(name) if gap.armed]
        assert 1 <= len(armed) <= 2
        assert all(0.008 - 1e-3 <= gap.duration <= 0.068 for gap in armed)
    assert log.gaps("lmnf") == []


@pytest.mark.parametrize("file", ["doublet-0.03", "attitude-steps-10deg-default", "position-sweep-default"])
def test_the_open_loop_is_found_without_its_messages(flight_data: Path, file: str) -> None:
    """A loop moves M at each sample; where M stands still with the rotors running, no loop is closed."""
    log = read_log(flight_data / f"{file}.mat")
    without = FlightLog({name: c for name, c in log.channels.items() if name != "lmnf"})
    assert modes(without) == modes(log)


def test_a_px4_log_is_named_after_no_experiment() -> None:
    """Its set-points follow sticks and missions: what they resemble is nobody's experiment."""
    log = attitude_steps()
    of = {name: FlightLog(log.channels, {"ulog": {"info": {"sys_name": name}}}) for name in ("twodof", "PX4")}
    assert log_summary(log)["experiment"] == log_summary(of["twodof"])["experiment"] == "attitude-steps"
    assert log_summary(of["PX4"])["experiment"] is None
