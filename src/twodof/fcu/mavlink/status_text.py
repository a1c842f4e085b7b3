"""Remarks: what the vehicle has to say in words goes to everybody as STATUSTEXT."""

from __future__ import annotations

from collections.abc import Callable

from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.service import Link
from twodof.fcu.px4_compat.event_table import marked
from twodof.link.connection import Received
from twodof.link.mavlink.messages import statustext


class StatusTextService:
    """Drains lists of (MAV_SEVERITY, text) that others fill; each of `listeners` gets what is told, too."""

    def __init__(self, link: Link, *sources: list[tuple[int, str]]) -> None:
        self.listeners: list[Callable[[int, str], None]] = []
        self._link = link
        self._sources = sources
        self._number = 0

    def handle(self, received: Received) -> bool:
        """Takes what others say in words: it is not for us."""
        return bool(received.message.get_type() == "STATUSTEXT")

    def after(self, step: ControlStep) -> None:
        """Tells what there is to tell."""
        for source in self._sources:
            if source:
                self._tell(source)

    def _tell(self, source: list[tuple[int, str]]) -> None:
        told = source[:]
        source.clear()
        for severity, text in told:
            for listener in self.listeners:
                listener(severity, text)
            self._number = self._number % 0xFFFF + 1
            for piece in statustext(marked(text), severity, self._number):
                self._link.send(piece)
