"""Events: EVENT numbers what happens on board, so that a client sees a gap and asks for what it missed."""

from collections import deque
from typing import Any

from twodof.fcu.command.commander import Commander
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.loop import FlightController
from twodof.fcu.event_bus import OnboardEventBus
from twodof.fcu.mavlink.addressing import VehicleAddress, source, target
from twodof.fcu.mavlink.clients import ClientJoined
from twodof.fcu.mavlink.commands.arming import ArmingDenied, ChecksRequested, MotorsKilled
from twodof.fcu.mavlink.service import Link, Service
from twodof.fcu.mavlink.telemetry.encoders import TelemetryEncoders
from twodof.fcu.mavlink.wire_tick import MASK_32
from twodof.fcu.px4_compat import event_table
from twodof.fcu.px4_compat.arming_report import ArmingReport, ReportedEvent
from twodof.fcu.px4_compat.event_enumerations import COMMANDED, FAILED, KILLED, LEASE_BIT, OTHER_BIT
from twodof.fcu.px4_compat.event_table import EventType
from twodof.flight.failsafe import state_machine
from twodof.flight.failsafe.causes_and_actions import OFF
from twodof.link.connection import Received
from twodof.link.mavlink.messages import message
from twodof.signals import TICK_MS

KEPT = 128
"""Events that can be asked for again."""
MOST_AGAIN = 16
"""Of those at most so many for one request; the client asks again for the rest."""

LOOK_TICKS, REPORT_TICKS = 25, 500
"""What keeps from arming is looked at ten times a second, and told every two seconds at most, as in PX4."""

_RESET = 1  # MAV_EVENT_CURRENT_SEQUENCE_FLAGS_RESET: what was numbered before counts no more
# Motors that stand because nobody armed them are no failure.
_AT_REST = (state_machine.DISARMED, state_machine.REFUSED)


class EventService(Service):
    """What is in `event_table`, told when it happens, kept, and sent again on request."""

    def __init__(
        self,
        link: Link,
        us: VehicleAddress,
        telemetry: TelemetryEncoders,
        controller: FlightController,
        commander: Commander,
        bus: OnboardEventBus,
    ) -> None:
        self._link = link
        self._us = us
        self._commander = commander
        self._report = ArmingReport(controller, commander)
        self._kept: deque[tuple[int, Any]] = deque(maxlen=KEPT)
        self.sequence = 0
        self._tick = 0
        self._step: ControlStep | None = None
        self._armed = False
        self._action = 0
        self._mode = commander.custom_mode
        self._killed = commander.arming.killed_by is not None
        self._answered: tuple[EventType | None, tuple[int, ...], int] = None, (), 0
        self._reported: list[ReportedEvent] = []
        self._reported_at = -REPORT_TICKS
        telemetry.add("CURRENT_EVENT_SEQUENCE", self._current)
        bus.subscribe(ClientJoined, self._welcome)
        bus.subscribe(ArmingDenied, self._denied)
        bus.subscribe(MotorsKilled, lambda killed: self._answer(event_table.KILL, *killed.source))
        bus.subscribe(ChecksRequested, lambda _: self.report())

    def handle(self, received: Received) -> bool:
        """Takes REQUEST_EVENT."""
        if received.message.get_type() != "REQUEST_EVENT":
            return False
        if self._us.addressed(received.message):
            self._again(received)
        return True

    def after(self, step: ControlStep) -> None:
        self._step, self._tick = step, step.tick
        action = 0 if step.state in _AT_REST else step.action
        if action != self._action:
            self._acts(action, step)
        if step.armed != self._armed:
            self._armed = step.armed
            if step.armed:
                self._tell(event_table.ARMED, *(self._commander.lease.holder or (0, 0)))
            else:
                self._tell(event_table.DISARMED, self._disarmed_by(step))
        killed = self._commander.arming.killed_by is not None
        if killed != self._killed:
            self._killed = killed
            if not killed:
                self._tell(event_table.RELEASED, *(self._commander.lease.holder or (0, 0)))
        mode = self._commander.custom_mode
        if mode != self._mode:
            self._mode = mode
            self._tell(event_table.MODE, mode)
        if step.tick % LOOK_TICKS == 0 and not 0 <= step.tick - self._reported_at < REPORT_TICKS:
            self.report(again=False)

    def restart(self) -> None:
        self._step, self._tick, self._armed, self._action = None, 0, False, 0

    def _denied(self, denied: ArmingDenied) -> None:
        """Somebody was not let arm: what keeps from it, then the refusal."""
        self.report(again=False)
        against = LEASE_BIT if denied.by_lease else self._report.obstacles(self._step)
        self._answer(event_table.DENIED, against or OTHER_BIT)

    def report(self, again: bool = True) -> None:
        """Tells what keeps from arming; not `again`: only if it is not what was told last."""
        told = self._report.events(self._report.obstacles(self._step))
        if again or told != self._reported:
            self._reported, self._reported_at = told, self._tick
            for one in told:
                self._tell(one.event, *one.values)

    def _answer(self, what: EventType, *values: int) -> None:
        """Tells all what one client's command came to, unless the very same was told a moment ago."""
        same = (what, values) == self._answered[:2]
        if not (same and 0 <= self._tick - self._answered[2] < LOOK_TICKS):
            self._answered = what, values, self._tick
            self._tell(what, *values)

    def _acts(self, action: int, step: ControlStep) -> None:
        self._action = action
        if action == OFF:
            self._tell(event_table.OFF, step.reason & MASK_32)
        elif action:
            self._tell(event_table.ACTION, action, step.reason & MASK_32)
        elif step.state == state_machine.FLYING:
            self._tell(event_table.OVER)

    def _disarmed_by(self, step: ControlStep) -> int:
        if self._commander.arming.killed_by is not None:
            return KILLED
        return FAILED if step.state == state_machine.OFF else COMMANDED

    def _tell(self, what: EventType, *values: int) -> None:
        self.sequence = self.sequence + 1 & 0xFFFF
        event = message(
            "EVENT",
            id=what.id,
            event_time_boot_ms=self._tick * TICK_MS & MASK_32,
            sequence=self.sequence,
            log_levels=what.levels,
            arguments=what.pack(*values),
        )
        self._kept.append((self.sequence, event))
        self._link.send(event)

    def _current(self) -> Any:
        flags = 0 if self._kept else _RESET
        return message("CURRENT_EVENT_SEQUENCE", sequence=self.sequence, flags=flags)

    def _welcome(self, joined: ClientJoined) -> None:
        # To who comes anew the numbers begin here: it may remember those of a program that ran before.
        self._link.send(message("CURRENT_EVENT_SEQUENCE", sequence=self.sequence, flags=_RESET), joined.client.peer)

    def _again(self, received: Received) -> None:
        first, last = received.message.first_sequence, received.message.last_sequence
        kept = dict(self._kept)
        for ahead in range(min((last - first & 0xFFFF) + 1, MOST_AGAIN)):
            sequence = first + ahead & 0xFFFF
            event = kept.get(sequence)
            if event is None:
                event = message(
                    "RESPONSE_EVENT_ERROR",
                    **target(source(received)),
                    sequence=sequence,
                    sequence_oldest_available=self._kept[0][0] if self._kept else self.sequence,
                )
            self._link.send(event, received.peer)
