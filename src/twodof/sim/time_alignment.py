"""Alignment of a log: the samples that the flight controller used at each of its steps, and the missing ones."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LogError
from twodof.flightlog.log import Channel, FlightLog
from twodof.signals import PERIOD

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

SETPOINTS = ("q0", "theta0", "v0", "T")
MEASURED = ("q", "theta", "v")

# A loop's output moves with its measurement at each step; a set-point that arrives as a message at 50 Hz stands still
# for four steps of five.
_STILL = 2
_SHORTEST = 25


@dataclass(frozen=True)
class AlignedLog:
    """A log on the controller's own grid of n steps, the stamps `time` (n,) [s] of the moment M.

    `value[name]` (n,) are M, T and the set-points q0, theta0, v0 of the same step, and the measurements q, theta and v
    that the step used. `lost[name]` (n,) is true if that sample is missing from the log (for M: a step is missing
    before this one). `active[name]` (n,), for M, q0, theta0 and T, is true if the drone was armed (T > 0) and the
    signal came from a loop, and false if it came from a message.
    """

    time: Floats
    value: Mapping[str, Floats]
    lost: Mapping[str, Flags]
    active: Mapping[str, Flags]


def align_log(log: FlightLog) -> AlignedLog:
    """Align the channels M, T, q0, theta0, v0, q, theta, v of a log. Raises LogError for one missing or too short.

    The rules were found from the drone's logs. The grid is that of M. A set-point's sample is the first one at or after
    M's stamp, as it is logged some microseconds later. A measurement's sample is the latest one at or before M's stamp:
    q is .3 to .7 ms old, theta 3.7 ms (the nearest theta, just after M, is wrong). The 100 Hz samples of v are held.
    """
    time = _filled(log, "M").time
    value = {"M": log["M"].value}
    lost = {"M": np.diff(time, prepend=time[0] - PERIOD) > 1.5 * PERIOD}
    for name in SETPOINTS:
        channel = _filled(log, name)
        index = channel.index(time, "next")
        lag = channel.time[index] - time
        lost[name] = (index < 0) | (lag > PERIOD / 4.0)
        value[name] = channel.value[index]
    for name in MEASURED:
        channel = _filled(log, name)
        index = channel.index(time, "hold")
        age = time - channel.time[index]
        lost[name] = (index < 0) | _stale(channel, index, age)
        value[name] = channel.value[np.maximum(index, 0)]
    armed = value["T"] > 0.0
    active = {name: armed & driven(value[name]) for name in ("M", "q0", "theta0")}
    return AlignedLog(time, value, lost, active | {"T": active["theta0"]})


def driven(values: Floats) -> Flags:
    """Return flags (n,) of the steps at which a signal (n,) comes from a loop, since it changes at each step.

    A set-point from messages changes at fewer steps. A stretch lasts at least 25 steps and may be constant for two of
    them; its last step, which may already be from a message, is left out.
    """
    moved = np.flatnonzero(np.diff(values, prepend=np.nan) != 0.0)
    found = np.zeros(len(values), dtype=np.bool_)
    if not moved.size:
        return found
    for run in np.split(moved, np.flatnonzero(np.diff(moved) > _STILL + 1) + 1):
        ends_with_log = run[-1] + _STILL >= len(values) - 1
        last = run[-1] if ends_with_log else run[-1] - 1
        if last - run[0] >= _SHORTEST:
            found[run[0] : last + 1] = True
    return found


def runs(flags: Flags) -> list[tuple[int, int]]:
    """Return the stretches of true values of `flags` (n,) as (first, one past the last)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def step_clock(stamps: Floats) -> tuple[float, float, int]:
    """Return period and origin [s] of the control steps by the drone's clock, and the number of the last of `stamps`.

    They are those of a line through the jittering `stamps` (n,), each at a whole number of steps after the first.
    """
    number = np.concatenate(([0.0], np.cumsum(np.round(np.diff(stamps) / PERIOD))))
    period, origin = np.polyfit(number, stamps, 1)
    return float(period), float(origin), int(number[-1])


def _stale(channel: Channel, index: NDArray[np.intp], age: Floats) -> Flags:
    """Where a newer sample than the one at `index` was due before the step and is not in the log."""
    if channel.period() < 1.5 * PERIOD:
        # Sampled at the controller's rate: the age is the same at each step, to the jitter of the stamps.
        return np.abs(age - np.median(age[index >= 0])) > PERIOD / 2.0
    # Slower, and in turn after two or three steps: of intervals of 8 and 12 ms, which the stamps' jitter makes 6.8 to
    # 13.2, two are never shorter than 14.8. The next sample is missing where the interval is longer than 1.4 periods,
    # and the steps are in doubt from when it was due at the earliest.
    steps = np.diff(channel.time)
    gap_after = np.append(steps > 1.4 * channel.period(), True)
    earliest = float(steps.min())
    return gap_after[index] & (age > earliest)


def _filled(log: FlightLog, name: str) -> Channel:
    channel = log[name]
    if len(channel) < 2 or channel.value.ndim != 1:
        what = "the channel is not a scalar, or has fewer than two samples"
        raise LogError(what, f"{log.source}: {name}", "give the log of a flight")
    return channel
