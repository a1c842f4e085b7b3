"""The lease: who may command. One holder at most; it ends by itself, in bounded time, when its holder falls silent."""

from __future__ import annotations

from typing import NamedTuple

from twodof.fcu.command.result import Source
from twodof.signals import PERIOD

COMMANDING = round(2.0 / PERIOD)
"""Ticks after the holder's last command for which it keeps the lease while disarmed."""

HEARD = round(3.0 / PERIOD)
"""Ticks after the holder's last frame of any kind for which it keeps the lease while armed."""

LONGEST = round(30.0 / PERIOD)
"""Most ticks that a lease is asked for at once."""


class LeaseState(NamedTuple):
    """Who holds the lease (None: nobody), for how many ticks still, and a count of the changes of holder."""

    holder: Source | None
    left: int
    revision: int


class CommandLease:
    """Who holds the lease, and until when; time is a tick that only `moved` sets back.

    `orphaned`: the holder fell silent or gave it up while armed, and nobody took the lease since. Then no other
    client keeps the link alive: the drone is without its pilot, also where others listen.

    Where time stands still until its holder grants it (`stands`), a dead holder would hold it for ever. So another may
    take it after `HEARD` ticks of standing time without a word of the holder. Until another does, nothing changes: a
    flight must not depend on how long a client thinks.

    `tuning_withheld`: nobody but the holder may change parameters.
    """

    def __init__(self) -> None:
        self.holder: Source | None = None
        self.orphaned = False
        self.revision = 0
        self.tuning_withheld = False
        self._until = 0
        self._heard = 0
        self._stood = 0

    def end(self, armed: bool) -> int:
        """First tick at which it is free if nothing more is heard; means nothing while nobody holds it."""
        return max(self._until, self._heard + HEARD) if armed else self._until

    def state(self, tick: int, armed: bool) -> LeaseState:
        """How it stands at `tick`."""
        if self.holder is None:
            return LeaseState(None, 0, self.revision)
        left = self.end(armed) - tick
        if self._stood:
            left = min(left, HEARD - self._stood)
        return LeaseState(self.holder, max(0, left), self.revision)

    def ask(self, source: Source, tick: int, ticks: int, withhold_tuning: bool = False) -> bool:
        """Takes it, or renews it for `ticks` from now, 1 to LONGEST; False while another holds it."""
        if not self._take(source, tick):
            return False
        self.tuning_withheld = withhold_tuning
        self._until = tick + min(max(ticks, 1), LONGEST)
        return True

    def command(self, source: Source, tick: int) -> bool:
        """Whether `source` may command: it holds the lease, or takes a free one by commanding. Renews it."""
        if not self._take(source, tick):
            return False
        self._until = max(self._until, tick + COMMANDING)
        return True

    def may_tune(self, source: Source) -> bool:
        """Whether `source` may change parameters: anybody, unless the holder withholds it. Takes no lease."""
        return not self.tuning_withheld or self.holder == source

    def give_up(self, source: Source, armed: bool) -> bool:
        """Frees it; False if `source` does not hold it."""
        if self.holder != source:
            return False
        self._free()
        self.orphaned = armed
        return True

    def hear(self, source: Source, tick: int) -> bool:
        """Notes a frame of any kind; whether it is the holder's."""
        if self.holder != source:
            return False
        self._heard, self._stood = tick, 0
        return True

    def stands(self, ticks: int) -> None:
        """Time stood still for so long, in ticks, while nothing was heard of the holder."""
        self._stood = min(self._stood + ticks, HEARD)

    def expire(self, tick: int, armed: bool) -> None:
        """Frees it if its time is over."""
        if self.holder is not None and tick >= self.end(armed):
            self._free()
            self.orphaned = armed

    def moved(self, ticks: int) -> None:
        """The count of ticks was changed by `ticks`: the time that is left stays the same."""
        self._until += ticks
        self._heard += ticks

    def _take(self, source: Source, tick: int) -> bool:
        if self.holder is None or (self.holder != source and self._stood >= HEARD):
            self.holder, self.orphaned, self._until = source, False, tick
            self.tuning_withheld = False
            self.revision += 1
        elif self.holder != source:
            return False
        self._heard, self._stood = tick, 0
        return True

    def _free(self) -> None:
        self.holder, self.tuning_withheld = None, False
        self.revision += 1
