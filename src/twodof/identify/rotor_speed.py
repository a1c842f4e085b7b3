"""RotorSpeed: how fast the rotors turned in a flight, from the vibration that the IMU folds down.

A rotor out of balance shakes the drone once a turn. The real drone's rotors make about 280 turns a second at hover, and
its IMU is logged at 250 Hz. So the line of a rotor stands at its speed less 250 Hz, between 15 and 50 Hz. The line says
what no channel of the log does: the speed goes with the battery's voltage, and thrust goes with the square of it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from twodof.errors import IdentificationError, LogError
from twodof.flightlog.log import FlightLog
from twodof.signals import HOVER

Array = NDArray[np.float64]

SLOPE = 265.0
"""What a unit of command adds to a rotor's speed, near hover [Hz]: the lines of six logs are sharpest with 225 to 285.

It also tells the speed itself. As lines rise with the command, the rotors turn at 250 n + line. A rotor's thrust is k
speed^2. So the moment of a command goes with 4 k speed SLOPE in hover. In the free response one pair goes from 64 to
125 Hz for M = .1, which is k (125^2 - 64^2) / .1. The ratio was identified as 2.4. n = 1 gives 2.6, n = 2 gives 4.9.
"""

FOLDS = 1
"""How many sampling frequencies are added to what stands in the log."""

SHORTEST = 4.0
LONGEST = 300.0
"""Stretch that is looked at [s]."""

CONTRAST = 2.0
"""Least mean log of a line's power over the median: noise without a line gives 1.4 at most (tests)."""

_CHANNELS = (("acc", 0), ("acc", 1), ("acc", 2), ("gyr", 0), ("gyr", 2))  # gyr y has the motion itself
_DELAY, _LAG = 0.010, 0.012  # s, from command to speed, as the rig `lab` was calibrated
_BAND = (12.0, 110.0)  # Hz, of the signal
_LINES = (8.0, 60.0)  # Hz, where a line is looked for
_FRAME, _HOP, _PADDED = 256, 32, 1024  # samples
_STEP = 0.5  # Hz, of the first search; a frame tells a line to 1 Hz
_DROPS = [float(drop) for drop in range(25)]  # Hz
_TIMES = (3.0, 4.0, 5.0, 6.5, 8.0, 10.0, 13.0, 17.0, 23.0, 30.0)  # s
_SKIP = 3  # frames overlap by seven eighths, so the first search looks at every third
_HALVINGS = 7


@dataclass(frozen=True)
class RotorSpeed:
    """The speed of a pair's clearest rotor at hover command: settled + drop exp(-(t - start) / time_constant) [Hz].

    `start` [s] is when the stretch begins. `contrast` is the mean log of the line's power over the median of its
    spectrum: below `CONTRAST` there would be no line.
    """

    settled: float
    drop: float
    time_constant: float
    start: float
    contrast: float

    def at(self, time: ArrayLike) -> Array:
        """Turns a second at `time` (n,) [s of the log], of hover command whatever was commanded then."""
        since = np.asarray(time, dtype=np.float64) - self.start
        return np.asarray(self.settled + self.drop * np.exp(-since / self.time_constant))


@dataclass(frozen=True)
class RotorSpeeds:
    """The rotors of both pairs."""

    front: RotorSpeed
    aft: RotorSpeed

    def mean(self, start: float, stop: float) -> float:
        """Mean of both pairs from `start` to `stop` [s of the log], in turns a second at hover command."""
        time = np.linspace(start, stop, 101)
        return float(0.5 * (self.front.at(time) + self.aft.at(time)).mean())


def rotor_speeds(log: FlightLog, start: float, stop: float) -> RotorSpeeds:
    """The speeds of front and aft rotors from `start` to `stop` [s], a stretch with thrust all the time.

    The commands move a line: T + M that of the front pair, T - M that of the aft one. Each is taken away at `SLOPE`, so
    what is left is the speed at hover command. The curve is the one along which the lines of accelerometer and gyro
    stand out most. Raises LogError for a missing channel. Raises IdentificationError for a stretch that is too short or
    too long, or without thrust at some time, and where no line stands out.
    """
    where = f"{log.source}, {start:g} to {stop:g} s"
    if not SHORTEST <= stop - start <= LONGEST:
        raise IdentificationError(
            f"the stretch lasts {stop - start:.3g} s", where, f"give {SHORTEST:g} to {LONGEST:g} s with thrust"
        )
    thrust = log["T"].slice(start, stop).value
    if not thrust.size or thrust.min() < 0.5 * HOVER:
        raise IdentificationError("the rotors did not run all the time", where, "give a stretch with thrust")
    period = _period(log, start, stop, where)
    steps = np.arange(start, stop, period)
    signals = [_band_passed(_on(log, name, axis, steps), period) for name, axis in _CHANNELS]
    found = []
    for sign in (1.0, -1.0):
        command = _held(log, "T", steps) - HOVER + sign * _held(log, "M", steps)
        turned = 2.0 * math.pi * SLOPE * period * np.cumsum(_followed(command, period))
        power = sum((_power(signal * np.exp(-1j * turned)) for signal in signals), np.zeros(()))
        found.append(_ridge(power, period, start, where))
    return RotorSpeeds(*found)


def _period(log: FlightLog, start: float, stop: float, where: str) -> float:
    """The sampling period of the IMU [s], which is what folds the lines."""
    if log["acc"].value.ndim != 2 or log["gyr"].value.ndim != 2:
        raise LogError("acc and gyr have one axis", where, "three are needed")
    period = log["acc"].slice(start, stop).period()
    if not 0.0 < period < 0.5 / _BAND[1]:
        raise IdentificationError(f"the IMU was logged every {1e3 * period:.3g} ms", where, "it takes 4 ms or less")
    return period


def _on(log: FlightLog, name: str, axis: int, steps: Array) -> Array:
    channel = log[name]
    return np.asarray(np.interp(steps, channel.time, channel.value[:, axis]))


def _held(log: FlightLog, name: str, steps: Array) -> Array:
    channel = log[name]
    return np.asarray(channel.value[np.maximum(channel.index(steps), 0)])


def _followed(command: Array, period: float) -> Array:
    """What the rotors make of a command: a dead time of whole samples and a first-order lag."""
    late = round(_DELAY / period)
    given = np.concatenate([np.full(late, command[0]), command[: command.size - late]])
    keep = math.exp(-period / _LAG)
    # A lag as a sum over the last samples: by then it has forgotten the rest to the last bit.
    weights = (1.0 - keep) * keep ** np.arange(math.ceil(_LAG / period * 37.0))
    before = np.full(weights.size - 1, given[0])
    return np.asarray(np.convolve(np.concatenate([before, given]), weights, "valid") / weights.sum())


def _band_passed(signal: Array, period: float) -> Array:
    """The signal within `_BAND`, with variance 1; zeros where there is nothing."""
    spectrum = np.fft.rfft(signal - signal.mean())
    hertz = np.fft.rfftfreq(signal.size, period)
    spectrum[(hertz < _BAND[0]) | (hertz > _BAND[1])] = 0.0
    passed = np.fft.irfft(spectrum, signal.size)
    size = float(passed.std())
    return np.asarray(passed / size if size > 0.0 else passed)


def _power(signal: NDArray[np.complex128]) -> Array:
    """Power of tapered frames, shape (frames, `_PADDED`)."""
    frames = sliding_window_view(signal, _FRAME)[::_HOP]
    return np.asarray(np.abs(np.fft.fft(frames * np.hanning(_FRAME), _PADDED)) ** 2)


def _ridge(power: Array, period: float, start: float, where: str) -> RotorSpeed:
    """The curve along which the log of the power is largest in the mean."""
    hertz = np.fft.fftfreq(_PADDED, period)
    kept = (hertz > _LINES[0]) & (hertz < _LINES[1])
    lines: Array = np.asarray(hertz[kept], dtype=np.float64)
    height = power[:, kept].T
    typical = float(np.median(height))
    if not typical > 0.0:
        raise IdentificationError("acc and gyr do not move", where, "take a log with the IMU's samples")
    height = np.log(height / typical + 0.3)  # a gap between lines costs no more than this
    since: Array = period * (0.5 * _FRAME + _HOP * np.arange(height.shape[1], dtype=np.float64))
    settled: Array = np.arange(lines[0], lines[-1], _STEP, dtype=np.float64)
    best = _best(height[:, ::_SKIP], lines, since[::_SKIP], settled, _DROPS, _TIMES)
    part = 1.0
    for _ in range(_HALVINGS):
        _, line, drop, time = best
        drops = [max(0.0, drop + 2.0 * _STEP * part * k) for k in (-1, 0, 1)]
        times = [max(1.0, time * (1.0 + 0.2 * part * k)) for k in (-1, 0, 1)]
        best = _best(height, lines, since, line + _STEP * part * np.array([-1.0, 0.0, 1.0]), drops, times)
        part /= 2.0
    contrast, line, drop, time_constant = best
    if contrast < CONTRAST:
        raise IdentificationError(
            f"no line of a rotor stands out (contrast {contrast:.2f}, it takes {CONTRAST:g})",
            where,
            "take a longer stretch; a virtual drone's rotors are in balance",
        )
    return RotorSpeed(line + FOLDS / period, drop, time_constant, start, contrast)


def _best(
    height: Array, lines: Array, since: Array, settled: Array, drops: Sequence[float], times: Sequence[float]
) -> tuple[float, float, float, float]:
    """(mean height, settled, drop, time constant) of the highest of these curves."""
    spacing, column = float(lines[1] - lines[0]), np.arange(since.size)
    best = (-math.inf, 0.0, 0.0, 0.0)
    for time_constant in times:
        shape = np.exp(-since / time_constant)
        for drop in drops:
            place = np.clip((settled[:, None] + drop * shape - lines[0]) / spacing, 0.0, lines.size - 1.001)
            low = place.astype(np.intp)
            part = place - low
            mean = ((1.0 - part) * height[low, column] + part * height[low + 1, column]).mean(axis=1)
            top = int(np.argmax(mean))
            if mean[top] > best[0]:
                best = (float(mean[top]), float(settled[top]), drop, time_constant)
    return best
