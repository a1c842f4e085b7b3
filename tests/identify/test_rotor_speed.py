"""RotorSpeed: the speeds of folded lines come back, and nothing is read where there is no line."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from twodof.errors import IdentificationError, LogError
from twodof.flightlog.files import read_log
from twodof.flightlog.log import Channel, FlightLog
from twodof.identify.rotor_speed import SLOPE, RotorSpeeds, rotor_speeds

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]
DT = 0.004


def flown(seconds: float = 12.0, line: float = 1.0, sway: float = 0.03, dt: float = DT, seed: int = 1) -> FlightLog:
    """A hover whose front rotors turn at 276 + 10 exp(-t / 8) a second and whose aft ones turn 3 faster, plus SLOPE M.

    `sway` is how far M moves, `line` the size of the lines in white noise of 1. Sampled at `dt`, they fold.
    """
    rng = np.random.default_rng(seed)
    fine = 16
    time = dt / fine * np.arange(round(seconds / dt) * fine)
    moment = sway * np.sin(2.0 * np.pi * 0.7 * time)
    reached = np.interp(time - 0.022, time, moment)  # dead time and lag of the rotors
    common = 276.0 + 10.0 * np.exp(-time / 8.0)
    shaking = sum(
        np.sin(2.0 * np.pi * dt / fine * np.cumsum(common + extra + SLOPE * sign * reached))
        for sign, extra in ((1.0, 0.0), (-1.0, 3.0))
    )
    at = slice(None, None, fine)
    noise = rng.standard_normal((time[at].size, 6))
    measured = noise + line * np.asarray(shaking)[at, None]
    stamps = time[at]
    return FlightLog(
        {
            "acc": Channel(stamps, measured[:, :3]),
            "gyr": Channel(stamps, measured[:, 3:]),
            "T": Channel(stamps, np.full(stamps.size, 0.4)),
            "M": Channel(stamps, moment[at]),
        }
    )


@pytest.mark.parametrize("dt", [DT, 1.001 * DT])
def test_speeds_come_back_whatever_was_commanded_and_whatever_the_clock(dt: float) -> None:
    found = rotor_speeds(flown(dt=dt), 0.1, 11.9)
    time = np.array([1.0, 4.0, 8.0, 11.0])
    truth = 276.0 + 10.0 * np.exp(-time / 8.0)
    # A frame of 1 s tells a line to about .3 Hz, and the curve goes through ninety of them.
    np.testing.assert_allclose(found.front.at(time), truth, atol=0.4)
    np.testing.assert_allclose(found.aft.at(time), truth + 3.0, atol=0.4)
    assert found.mean(4.0, 8.0) == pytest.approx(
        1.5 + 276.0 + 10.0 * 8.0 / 4.0 * (np.exp(-0.5) - np.exp(-1.0)), abs=0.4
    )


@pytest.mark.parametrize("seed", range(1, 9))
def test_noise_without_a_line_is_refused(seed: int) -> None:
    with pytest.raises(IdentificationError, match=r"no line of a rotor stands out \(contrast [01]\.\d\d, it takes 2\)"):
        rotor_speeds(flown(line=0.0, seed=seed), 0.1, 11.9)


def test_what_cannot_tell_is_refused() -> None:
    log = flown(seconds=6.0)
    with pytest.raises(IdentificationError, match="the stretch lasts 2 s"):
        rotor_speeds(log, 1.0, 3.0)
    stopped = dict(log.channels)
    stopped["T"] = Channel(log["T"].time, np.where(log["T"].time < 3.0, 0.4, 0.0))
    with pytest.raises(IdentificationError, match="the rotors did not run all the time"):
        rotor_speeds(FlightLog(stopped), 0.1, 5.9)
    with pytest.raises(IdentificationError, match="the IMU was logged every 20 ms"):
        rotor_speeds(flown(seconds=6.0, dt=0.02), 0.1, 5.9)
    flat = dict(log.channels)
    flat["acc"], flat["gyr"] = (Channel(log[name].time, 0.0 * log[name].value) for name in ("acc", "gyr"))
    with pytest.raises(IdentificationError, match="acc and gyr do not move"):
        rotor_speeds(FlightLog(flat), 0.1, 5.9)
    single = dict(log.channels)
    single["acc"] = Channel(log["acc"].time, log["acc"].value[:, 0])
    with pytest.raises(LogError, match="acc and gyr have one axis"):
        rotor_speeds(FlightLog(single), 0.1, 5.9)
    with pytest.raises(LogError, match="no channel"):
        rotor_speeds(FlightLog({"T": log["T"]}), 0.1, 5.9)


def speeds(folder: Path, name: str, start: float, stop: float) -> RotorSpeeds:
    return rotor_speeds(read_log(folder / f"{name}.mat"), start, stop)


def test_real_rotors_slow_down_in_hover_and_recover_in_a_pause(flight_data: Path) -> None:
    steps = speeds(flight_data, "attitude-steps-10deg-default", 126.2, 135.8)
    rates = speeds(flight_data, "rate-doublets-30dps-student", 344.3, 357.8)
    # Both pairs of both flights lose 7 to 9 turns a second of 286 in the first ten seconds, and go on slower.
    for pair, begin in ((steps.front, 126.0), (steps.aft, 126.0), (rates.front, 344.0), (rates.aft, 344.0)):
        first, later, last = pair.at([begin, begin + 5.0, begin + 10.0])
        assert 283.0 < first < 289.0
        assert first - last == pytest.approx(8.0, abs=1.5)
        assert first - later > later - last
    # The sweep's log has two hovers with a pause of 4.3 s: a part of the loss comes back.
    before = speeds(flight_data, "position-sweep-default", 107.9, 127.5)
    after = speeds(flight_data, "position-sweep-default", 132.3, 159.4)
    ended, begun = before.mean(127.0, 127.5), after.mean(132.3, 132.8)
    assert ended + 3.0 < begun < before.mean(108.0, 108.5) - 2.0
