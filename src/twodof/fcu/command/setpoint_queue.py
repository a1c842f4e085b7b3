"""Set-points that wait for their tick."""

from __future__ import annotations

import heapq
from itertools import count
from typing import NamedTuple

from twodof.fcu.command.setpoints import OpenLoopState, SetPoint
from twodof.signals import PERIOD

CAPACITY = 256
"""Most set-points that wait."""

HORIZON = round(60.0 / PERIOD)
"""Most ticks that something may be asked for ahead: a minute."""

NEVER = 1 << 62
"""A tick that does not come."""


class QueuedSetpoint(NamedTuple):
    """One that waits; `number` keeps those of one tick in the order in which they came."""

    tick: int
    number: int
    setpoint: SetPoint
    kind: str
    said: OpenLoopState | None


class SetpointQueue:
    """A bounded queue by tick. `next` is the tick of the first, NEVER if there is none."""

    def __init__(self) -> None:
        self._waiting: list[QueuedSetpoint] = []
        self._number = count()
        self.next = NEVER

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, tick: int, setpoint: SetPoint, kind: str, said: OpenLoopState | None = None) -> bool:
        """Keeps it until `tick`, with the open-loop message that it came of; False if too many wait."""
        if len(self._waiting) >= CAPACITY:
            return False
        heapq.heappush(self._waiting, QueuedSetpoint(tick, next(self._number), setpoint, kind, said))
        self.next = self._waiting[0].tick
        return True

    def due(self, tick: int) -> QueuedSetpoint | None:
        """Takes out the next one whose tick has come."""
        if self.next > tick:
            return None
        first = heapq.heappop(self._waiting)
        self.next = self._waiting[0].tick if self._waiting else NEVER
        return first

    def clear(self) -> None:
        """Forgets all."""
        self._waiting.clear()
        self.next = NEVER
