"""The rotors' speed and with it the thrust of a flight, from the vibration of a log that has no voltage.

A rotor out of balance shakes the drone once a turn. In hover the real drone's rotors make about 280 turns a second, and
its IMU is logged at 250 Hz, so each of them is a line at 15 to 40 Hz. Commands move the lines. With that taken away
they fall slowly, as the battery tires. The front pair has the strongest line of the two.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from twodof.flightlog.log import FlightLog
from twodof.signals import HOVER

Array = NDArray[np.float64]

REFERENCE = 280.0
"""Turns a second at hover command at which k_v is stated: those of the real drone's velocity doublets."""

SUPPLY_DOUBT = 0.01
"""Standard deviation of a thrust that one rotor tells: front and aft rotors part by up to 1.4 turns between flights."""

_PER_COMMAND = 265.0
"""Turns a second that a command of 1 adds: in each log a line stays narrow with this taken away."""
_LAG_S = 0.012
_PIECE_S, _SHORTEST_S = 4.0, 2.0
_LINES = np.arange(12.0, 50.0, 0.1)
_FALLS = np.arange(-1.0, 0.21, 0.1)
_CLEAR = 30.0
"""Power of a line over the median, a mean over the pieces, that noise does not reach on any path: of 380 frequencies
the largest is about 25."""


def supply_of(log: FlightLog, start: float, stop: float) -> tuple[float, float] | None:
    """Return the thrust over that at `REFERENCE`, and its standard deviation, from `start` to `stop` [s].

    It is None without the channels acc, gyr, T and M, without a clear line, and where the log has the voltage, which
    tells the supply better.
    """
    if "voltage" in log or any(name not in log for name in ("acc", "gyr", "T", "M")):
        return None
    found = rotor_speed(log, start, stop)
    return None if found is None else ((found / REFERENCE) ** 2, SUPPLY_DOUBT)


def rotor_speed(log: FlightLog, start: float, stop: float) -> float | None:
    """Return the mean turns a second of the front rotor with the clearest line, at hover command; None without one.

    The line is the straight one, over time, along which the power's logarithm is largest.
    """
    edges = np.linspace(start, stop, max(1, round((stop - start) / _PIECE_S)) + 1)
    flown = log["T"].slice(start, stop).value
    if not edges[1] - edges[0] >= _SHORTEST_S or not flown.size or not flown.mean() > 0.5 * HOVER:
        return None
    powers = [_powers(log, a, b) for a, b in pairwise(edges.tolist())]
    logs = np.log(np.maximum(powers, 1e-9))
    middle = 0.5 * (edges[1:] + edges[:-1]) - 0.5 * (start + stop)
    best, at = -np.inf, 0.0
    for fall in _FALLS:
        paths = [np.interp(_LINES + fall * t, _LINES, own, -9.0, -9.0) for t, own in zip(middle, logs, strict=True)]
        along = np.mean(paths, axis=0)
        if along.max() > best:
            best, at = float(along.max()), float(_LINES[along.argmax()])
    return 1.0 / log["acc"].period() + at if best > np.log(_CLEAR) else None


def _powers(log: FlightLog, start: float, stop: float) -> Array:
    """Return the power of the IMU's six channels at `_LINES`, each over its median, without the front pair's commands.

    Shape (lines,). The stamps are those of a clock with lost samples, so the transform is a sum and no FFT.
    """
    thrust, moment = log["T"], log["M"]
    total = np.zeros(_LINES.size)
    for name in ("acc", "gyr"):
        own = log[name].slice(start, stop)
        time = own.time - _LAG_S
        command = np.interp(time, thrust.time, thrust.value) + np.interp(time, moment.time, moment.value) - HOVER
        turned = np.concatenate([[0.0], np.cumsum(0.5 * (command[1:] + command[:-1]) * np.diff(time))])
        phase = np.outer(_LINES, time - time[0]) + _PER_COMMAND * turned
        rows = np.hanning(time.size)[:, None] * (own.value - own.value.mean(axis=0))
        power = np.abs(np.exp(-2j * np.pi * phase) @ rows) ** 2
        total += (power / np.median(power, axis=0)).sum(axis=1)
    return total
