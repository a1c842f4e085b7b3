"""Set-points that wait for their tick."""

from __future__ import annotations

import heapq
from itertools import count

from twodof.fcu.asked import Source
from twodof.fcu.setpoints import SetPoint

CAPACITY = 256
"""Most set-points that wait."""

HORIZON = 250 * 60
"""Most ticks that a set-point may lie ahead: a minute."""

_NEVER = 1 << 62


class Schedule:
    """A bounded queue by tick; those of one tick come out in the order in which they went in."""

    def __init__(self) -> None:
        self._waiting: list[tuple[int, int, Source, SetPoint, str]] = []
        self._number = count()
        self.next = _NEVER

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, tick: int, source: Source, setpoint: SetPoint, kind: str) -> bool:
        """Keeps it until `tick`; False if too many wait."""
        if len(self._waiting) >= CAPACITY:
            return False
        heapq.heappush(self._waiting, (tick, next(self._number), source, setpoint, kind))
        self.next = self._waiting[0][0]
        return True

    def due(self, tick: int) -> tuple[Source, SetPoint, str] | None:
        """Takes out the next one whose tick has come."""
        if self.next > tick:
            return None
        _, _, source, setpoint, kind = heapq.heappop(self._waiting)
        self.next = self._waiting[0][0] if self._waiting else _NEVER
        return source, setpoint, kind

    def clear(self) -> None:
        """Forgets all."""
        self._waiting.clear()
        self.next = _NEVER
