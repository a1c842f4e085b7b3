"""Ticks on the wire: 32 bits, which run over after 198 days (in milliseconds after 49), and the tick that is meant."""

from twodof.signals import TICK_MS

RUN_OVER = 2**32
MASK_32 = RUN_OVER - 1
RUN_OVER_MS = RUN_OVER // TICK_MS
"""Ticks after which a stamp in milliseconds begins anew."""


def meant(value: int, now: int, run_over: int = RUN_OVER) -> int:
    """The tick that a field of 32 bits names: of the ticks that look like `value`, the one nearest to `now`.

    None is before tick 0, so until the first half of the field's range has passed it is `value` itself.
    """
    nearest = now + (value - now + run_over // 2) % run_over - run_over // 2
    return nearest if nearest > 0 else value


def acts_at(tick: int, now: int) -> int:
    """The tick at which something acts whose field says `tick`; 0, what a client leaves out, is at once."""
    return meant(tick, now) if tick else 0


def acts_at_ms(time_boot_ms: int, now: int) -> int:
    """The same by a stamp in milliseconds: the first tick that is not before it."""
    return meant(-(-time_boot_ms // TICK_MS), now, RUN_OVER_MS) if time_boot_ms else 0
