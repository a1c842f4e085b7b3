"""Where a time [s] lies among the ticks k * dt."""

import math

_ROUNDING = 1e-6
"""In ticks: .3 s is tick 75 of 4 ms, although .3 / .004 is a little less than 75 in binary."""


def first_tick(time: float, dt: float) -> int:
    """The first tick at or after `time` [s]."""
    return math.ceil(time / dt - _ROUNDING)


def last_tick(time: float, dt: float) -> int:
    """The last tick at or before `time` [s]."""
    return math.floor(time / dt + _ROUNDING)
