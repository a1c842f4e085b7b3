"""The drone's estimator: the drone's own estimates from its logged sensors, its delay, and where it settles."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from twodof.blocks.reference.interpreter import Reference
from twodof.compile import CompiledProgram, build
from twodof.flightlog.files import read_log
from twodof.flightlog.log import FlightLog
from twodof.signals import GRAVITY, PERIOD, RAIL_CENTRE
from twodof.sim.drone_estimator import GAINS, HISTORY, LATE, drone_estimator, settled

Floats = NDArray[np.float64]
RATE = 18.35  # Hz, of the range sensor

# What the estimates differ by, RMS, on each log: pitch [rad], x [m], v [m/s]. The joint filter of the flight code comes
# within 2.1e-3 to 3.7e-3, 2.7e-3 to 4.8e-3 and .007 to .011 on the whole logs.
APART = {
    "free-response-impulse": (2.0e-3, 1.8e-3, 4.5e-3),
    "doublet-0.03": (1.5e-3, 1.5e-3, 3.8e-3),
    "attitude-steps-10deg-default": (2.0e-3, 1.8e-3, 4.5e-3),
    "rate-doublets-30dps-student": (2.5e-3, 3.2e-3, 8.0e-3),
    "velocity-doublets-0.25": (1.5e-3, 3.2e-3, 6.5e-3),
}


@pytest.fixture(scope="module")
def program() -> CompiledProgram | Reference:
    return build(drone_estimator(), PERIOD)


def ranges(steps: int) -> NDArray[np.bool_]:
    """The steps in which a range sample is handed over."""
    return np.asarray(np.diff(np.floor(RATE * PERIOD * np.arange(steps + 1))) > 0.0)


def start(machine: Any, states: Any) -> None:
    machine.reset()
    for name, value in states.items():
        machine.set_state(f"filter.{name}", value)


def estimated(program: Any, log: FlightLog) -> tuple[Floats, dict[str, Floats]]:
    """(time, estimates) from the logged sensors on a grid of control steps, lost samples interpolated."""
    gyro, acc, dist = log["gyr"], log["acc"], log["dist"]
    index = np.concatenate(([0.0], np.cumsum(np.round(np.diff(gyro.time) / PERIOD))))
    period, origin = np.polyfit(index, gyro.time, 1)
    time = origin + period * np.arange(int(index[-1]) + 1)
    at = np.searchsorted(time, dist.time)
    at, known = at[at < len(time)], at < len(time)
    measured, new = np.zeros(len(time)), np.zeros(len(time), dtype=bool)
    measured[at], new[at] = dist.value[known], True
    inputs = {"acc_x": acc.value[:, 0], "acc_z": acc.value[:, 2], "gyro_y": gyro.value[:, 1]}
    theta, x, v = (np.full(HISTORY, log[name].value[0]) for name in ("theta", "x", "v"))
    states = dict(settled(theta, x, v).states)
    states["bias"] = float(np.mean(gyro.value[:500, 1]) - np.mean(log["q"].value[:500]))
    states["gyro_y_ring"] = [states["bias"]] * len(states["gyro_y_ring"])
    machine = program.machine()
    start(machine, states)
    out = machine.run(
        len(time),
        {name: np.interp(time, gyro.time, values) for name, values in inputs.items()}
        | {"dist": measured, "dist_new": new},
    )
    return time, out


@pytest.mark.parametrize("name", list(APART))
def test_fed_with_the_logged_sensors_it_gives_the_drones_estimates(
    flight_data: Path, program: CompiledProgram, name: str
) -> None:
    log = read_log(flight_data / f"{name}.mat")
    time, out = estimated(program, log)
    for channel, most in zip(("theta", "x", "v"), APART[name], strict=True):
        given = log[channel].slice(time[0] + 4.0, time[-1])  # 4 s: what the drone knew before the log is forgotten
        # The drone stamps an estimate 1.9 ms after the gyro's sample that it is of.
        error = np.interp(given.time - 0.0019, time, out[channel]) - given.value
        assert float(np.std(error)) < most, channel


def test_a_range_sample_shows_after_88_ms_and_without_a_step(program: CompiledProgram) -> None:
    steps, at = 300, 100
    new = np.arange(steps) == at
    machine = program.machine()
    still = np.zeros(HISTORY)
    start(machine, settled(still, still, still).states)
    out = machine.run(steps, {"acc_z": -GRAVITY, "dist": RAIL_CENTRE + 0.01, "dist_new": new})
    assert not np.any(out["x"][: at + LATE])
    assert not np.any(out["v"][: at + LATE])
    assert out["x"][at + LATE] > 0.0
    # The filter jumps by k_x of the 10 mm; the output goes there with its time constant, by two pulls in five steps.
    jump = GAINS["k_x"] * 0.01
    assert np.max(out["x"][5:] - out["x"][:-5]) < 5.0 * jump * 2.0 * PERIOD / GAINS["follow"]
    assert np.max(out["x"]) > 0.5 * jump


@pytest.mark.parametrize(("bias", "speed"), [(0.0, 0.0), (0.0, 0.2), (0.03, 0.0), (-0.02, 0.1)])
def test_it_starts_settled(program: CompiledProgram, bias: float, speed: float) -> None:
    """A level cart at constant speed: v is wrong by the bias from the first step to the last, x and theta as said."""
    steps = 2500
    truth = speed * PERIOD * np.arange(-HISTORY, steps)
    before = truth[:HISTORY]
    own = settled(np.zeros(HISTORY), before, np.full(HISTORY, speed + bias), bias, RATE)
    own = settled(np.full(HISTORY, own.theta), before + own.x, np.full(HISTORY, speed + bias), bias, RATE)
    machine = program.machine()
    machine.set("filter.k_bias", 0.0)
    start(machine, own.states)
    sensors = {"acc_z": -GRAVITY, "dist": RAIL_CENTRE + truth[HISTORY:], "dist_new": ranges(steps)}
    out = machine.run(steps, sensors)
    # No range sample is on its way at the start, so once the range pulls late: by up to 11 % of the error of v and 28 %
    # of that of x. Later the samples come in turn after 13 and 14 steps, and x wanders by 3 %. Between two pulls of the
    # outputs, 8 or 12 ms, x runs on with v: by at most two steps.
    last, saw = slice(-1000, None), 2.0 * PERIOD * abs(bias)
    for found, error, most, lasting, runs_on in (
        (out["v"] - speed, bias, 0.12, 0.005, 0.0),
        (out["x"] - truth[HISTORY:], own.x, 0.3, 0.04, saw),
        (out["theta"], own.theta, 0.05, 0.005, 0.0),
    ):
        assert found == pytest.approx(error, abs=most * abs(error) + runs_on + 1e-9)
        assert np.mean(found[last]) == pytest.approx(error, abs=lasting * abs(error) + runs_on + 1e-9)
