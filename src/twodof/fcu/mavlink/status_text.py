"""Remarks: what the vehicle has to say in words goes to everybody as STATUSTEXT; and when the disk makes trouble."""

from typing import NamedTuple

from twodof.errors import TwodofError
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.event_bus import OnboardEventBus
from twodof.fcu.mavlink.service import Link, Service
from twodof.fcu.onboard_log.logger import OnboardLogger
from twodof.fcu.parameters.parameter_store import ParameterStore
from twodof.link.connection import Received
from twodof.link.mavlink.enums import MavSeverity
from twodof.link.mavlink.messages import statustext

LOOK_TICKS = 250


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
        """Take the texts of others, which are not for us."""
        return bool(received.message.get_type() == "STATUSTEXT")

    def after(self, step: ControlStep) -> None:
        if not self._remarks:
            return
        told = self._remarks[:]
        self._remarks.clear()
        for severity, text in told:
            self._bus.publish(TextSent(severity, text))
            self._number = self._number % 0xFFFF + 1
            for piece in statustext(text, severity, self._number):
                self._link.send(piece)


class StorageMonitor(Service):
    """Puts into `remarks` when parameters or logs cannot be written: looks once a second, tells each trouble once."""

    def __init__(self, store: ParameterStore, log: OnboardLogger | None, remarks: list[tuple[int, str]]) -> None:
        self._store, self._log, self._remarks = store, log, remarks
        self._said: dict[str, TwodofError | None] = {}
        self._dropped = 0

    def after(self, step: ControlStep) -> None:
        if step.tick % LOOK_TICKS:
            return
        self._look("parameters are not stored", self._store.failure)
        if self._log is not None:
            self._look("no on-board log", self._log.failure)
            if self._log.dropped != self._dropped:
                count, self._dropped = self._log.dropped - self._dropped, self._log.dropped
                self._remarks.append(
                    (MavSeverity.WARNING, f"on-board log: the disk is too slow, {count} steps are missing")
                )

    def _look(self, what: str, failure: TwodofError | None) -> None:
        said = self._said.get(what)
        if failure is not None and (said is None or str(said) != str(failure)):
            self._remarks.append((MavSeverity.ERROR, f"{what}: {failure}"))
        self._said[what] = failure
