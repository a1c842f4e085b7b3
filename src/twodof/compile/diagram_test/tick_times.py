"""Where a time [s] lies among the ticks k * dt."""

import math

_ROUNDING = 1e-6
"""In ticks: .3 s is tick 75 of 4 ms, although .3 / .004 is a little less than 75 in binary."""

_FAR = 2.0**53
"""No tick is as late as that; a time that is (or infinite) is after the end of any scenario."""


def first_tick(time: float, dt: float) -> int:
    """The first tick at or after `time` [s]."""
    return math.ceil(max(-_FAR, min(_FAR, time / dt)) - _ROUNDING)


def last_tick(time: float, dt: float) -> int:
    """The last tick at or before `time` [s]."""
    return math.floor(max(-_FAR, min(_FAR, time / dt)) + _ROUNDING)
