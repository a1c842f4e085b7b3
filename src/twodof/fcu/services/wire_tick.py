"""Ticks on the wire: 32 bits, which run over after 198 days (in milliseconds after 49), and the tick that is meant."""

from __future__ import annotations

from twodof.link.tick import TICK_MS

RUN_OVER = 2**32
RUN_OVER_MS = RUN_OVER // TICK_MS
"""Ticks after which a stamp in milliseconds begins anew."""


def meant(value: int, now: int, run_over: int = RUN_OVER) -> int:
    """The tick that a field of 32 bits names: the one of all that look like `value` that is nearest to `now`.

    None is before tick 0, so until the first half of the field's range has passed it is `value` itself.
    """
    nearest = now + (value - now + run_over // 2) % run_over - run_over // 2
    return nearest if nearest >= 0 else value


def meant_by_ms(time_boot_ms: int, now: int) -> int:
    """The first tick that is not before the stamp `time_boot_ms`, of all that have it the one nearest to `now`."""
    return meant(-(-time_boot_ms // TICK_MS), now, RUN_OVER_MS)
