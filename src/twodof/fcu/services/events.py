"""Events: EVENT numbers what happens on board, so that a client sees a gap and asks for what it missed."""

from __future__ import annotations

import struct
from collections import deque
from typing import Any

from twodof.fcu.flight_code import Step
from twodof.fcu.service import Link
from twodof.fcu.services.addressing import Us, source
from twodof.fcu.services.flight_telemetry import MASK_32
from twodof.fcu.services.telemetry import Telemetry
from twodof.fcu.services.vehicle import Commander
from twodof.flight import failsafe_machine
from twodof.link.connection import Received
from twodof.link.messages import message
from twodof.link.tick import TICK_MS

CURRENT_EVENT_SEQUENCE = 411
KEPT = 64
"""Events that can be asked for again."""
MOST_AGAIN = 16
"""Of those at most so many for one request; the client asks again for the rest."""

ARMED, DISARMED, ACTION, MODE = (1 << 24 | number for number in range(1, 5))
"""Ids: component 1, and a number. Arguments: none; none; action (uint8) and mask of causes (uint32); custom_mode."""

# Motors that stand because nobody armed them are no failure.
_AT_REST = (failsafe_machine.DISARMED, failsafe_machine.REFUSED)
# Levels of the log on board and of the display: the words for all this come as STATUSTEXT, so nothing is shown twice.
INFO_FOR_MACHINES = 6 << 4 | 8
WARNING_FOR_MACHINES = 4 << 4 | 8


class Events:
    """Arming, disarming, actions of the failsafe and changes of mode as EVENT, kept and sent again on request."""

    def __init__(self, link: Link, us: Us, telemetry: Telemetry, commander: Commander) -> None:
        self._link = link
        self._us = us
        self._commander = commander
        self._kept: deque[tuple[int, Any]] = deque(maxlen=KEPT)
        self._sequence = 0
        self._armed = False
        self._action = 0
        self._mode = commander.custom_mode
        telemetry.add(CURRENT_EVENT_SEQUENCE, lambda: message("CURRENT_EVENT_SEQUENCE", sequence=self._sequence))

    def handle(self, received: Received) -> bool:
        """Takes REQUEST_EVENT."""
        if received.message.get_type() != "REQUEST_EVENT":
            return False
        if self._us.addressed(received.message):
            self._again(received)
        return True

    def after(self, step: Step) -> None:
        """Tells of what has changed."""
        if step.armed != self._armed:
            self._armed = step.armed
            self._tell(step.tick, ARMED if step.armed else DISARMED, INFO_FOR_MACHINES)
        action = 0 if step.state in _AT_REST else step.action
        if action != self._action:
            self._action = action
            level = WARNING_FOR_MACHINES if action else INFO_FOR_MACHINES
            self._tell(step.tick, ACTION, level, struct.pack("<BI", action & 0xFF, step.reason & MASK_32))
        mode = self._commander.custom_mode
        if mode != self._mode:
            self._mode = mode
            self._tell(step.tick, MODE, INFO_FOR_MACHINES, struct.pack("<I", mode))

    def _tell(self, tick: int, number: int, levels: int, arguments: bytes = b"") -> None:
        self._sequence = self._sequence + 1 & 0xFFFF
        event = message(
            "EVENT",
            id=number,
            event_time_boot_ms=tick * TICK_MS & MASK_32,
            sequence=self._sequence,
            log_levels=levels,
            arguments=arguments,
        )
        self._kept.append((self._sequence, event))
        self._link.send(event)

    def _again(self, received: Received) -> None:
        first, last = received.message.first_sequence, received.message.last_sequence
        kept = dict(self._kept)
        system, component = source(received)
        for ahead in range(min((last - first & 0xFFFF) + 1, MOST_AGAIN)):
            sequence = first + ahead & 0xFFFF
            event = kept.get(sequence)
            if event is None:
                event = message(
                    "RESPONSE_EVENT_ERROR",
                    target_system=system,
                    target_component=component,
                    sequence=sequence,
                    sequence_oldest_available=self._kept[0][0] if self._kept else self._sequence,
                )
            self._link.send(event, received.peer)
