"""Remarks: what the vehicle has to say in words goes to everybody as STATUSTEXT."""

from __future__ import annotations

from typing import NamedTuple

from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.event_bus import OnboardEventBus
from twodof.fcu.mavlink.service import Link, Service
from twodof.fcu.px4_compat.event_table import marked
from twodof.link.connection import Received
from twodof.link.mavlink.messages import statustext


class TextSent(NamedTuple):
    """The vehicle has said something in words: MAV_SEVERITY and text."""

    severity: int
    text: str


class StatusTextService(Service):
    """Sends the (MAV_SEVERITY, text) pairs that others put into `remarks`, and publishes TextSent for each."""

    def __init__(self, link: Link, bus: OnboardEventBus, remarks: list[tuple[int, str]]) -> None:
        self._link = link
        self._bus = bus
        self._remarks = remarks
        self._number = 0

    def handle(self, received: Received) -> bool:
        """Takes what others say in words: it is not for us."""
        return bool(received.message.get_type() == "STATUSTEXT")

    def after(self, step: ControlStep) -> None:
        """Tells what there is to tell."""
        if not self._remarks:
            return
        told = self._remarks[:]
        self._remarks.clear()
        for severity, text in told:
            self._bus.publish(TextSent(severity, text))
            self._number = self._number % 0xFFFF + 1
            for piece in statustext(marked(text), severity, self._number):
                self._link.send(piece)
