"""The lease: who may command. One holder at most; it ends by itself, in bounded time, when its holder falls silent."""

from __future__ import annotations

from twodof.fcu.asked import Source
from twodof.flight.core import PERIOD

COMMANDING = round(2.0 / PERIOD)
"""Ticks after the holder's last command for which it keeps the lease while disarmed."""

HEARD = round(3.0 / PERIOD)
"""Ticks after the holder's last frame of any kind for which it keeps the lease while armed."""

LONGEST = round(30.0 / PERIOD)
"""Most ticks that a lease is asked for at once."""


class Lease:
    """Who holds the lease, and until when. Time is a tick that never goes back; `moved` takes a restart into account.

    `revision` counts the changes of holder. `orphaned`: it was lost in silence while armed, and nobody has taken it
    since: then nobody else's frames keep the link alive.
    """

    def __init__(self) -> None:
        self.holder: Source | None = None
        self.revision = 0
        self.orphaned = False
        self._until = 0
        self._heard = 0

    def end(self, armed: bool) -> int:
        """First tick at which it is free, if nothing more is heard; only meaningful while it is held."""
        return max(self._until, self._heard + HEARD) if armed else self._until

    def left(self, tick: int, armed: bool) -> int:
        """Ticks for which it is still held at `tick`; 0 if it is free."""
        return max(0, self.end(armed) - tick) if self.holder is not None else 0

    def ask(self, source: Source, tick: int, ticks: int) -> bool:
        """Takes it, or renews it for `ticks` from now (at most LONGEST); False while another holds it."""
        if not self._taken(source, tick):
            return False
        self._until = tick + min(max(ticks, 1), LONGEST)
        return True

    def command(self, source: Source, tick: int) -> bool:
        """Whether `source` may command: it holds the lease, or it takes a free one by commanding. Renews it."""
        if not self._taken(source, tick):
            return False
        self._until = max(self._until, tick + COMMANDING)
        return True

    def give_up(self, source: Source) -> bool:
        """Frees it; False if `source` does not hold it."""
        if self.holder != source:
            return False
        self._free()
        return True

    def hear(self, source: Source, tick: int) -> bool:
        """Notes a frame of any kind; whether it is the holder's."""
        if self.holder != source:
            return False
        self._heard = tick
        return True

    def expire(self, tick: int, armed: bool) -> bool:
        """Frees it if its time is over; whether it did."""
        if self.holder is None or tick < self.end(armed):
            return False
        self._free()
        self.orphaned = armed
        return True

    def moved(self, ticks: int) -> None:
        """The count of ticks was changed by `ticks`: what is left stays the same."""
        self._until += ticks
        self._heard += ticks

    def _taken(self, source: Source, tick: int) -> bool:
        if self.holder is None:
            self.holder = source
            self.revision += 1
            self.orphaned = False
            self._until = tick
        elif self.holder != source:
            return False
        self._heard = tick
        return True

    def _free(self) -> None:
        self.holder = None
        self.revision += 1
