"""The control period: the drone's ticks as they stand on the wire, in stamps and intervals.

It is `signals.PERIOD`, in whole numbers.
"""

from twodof.signals import PERIOD

TICK_US = round(PERIOD * 1e6)
"""Microseconds of a tick; what `time_usec` and the intervals of command 511 count in."""
TICK_MS = TICK_US // 1000
"""Milliseconds; what `time_boot_ms` counts in."""
TICK_NS = TICK_US * 1000
"""Nanoseconds; what the clocks of this machine count in."""
TICK_S = TICK_US / 1e6
"""Seconds."""
