"""Missions, fences and rally points: the vehicle does not have them, and answers every question so."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from twodof.fcu.command.result import DENIED, CommandResult
from twodof.fcu.mavlink.addressing import VehicleAddress, source
from twodof.fcu.mavlink.commands.command_service import CommandService
from twodof.fcu.mavlink.commands.message_requests import MessageRequests
from twodof.fcu.mavlink.service import Link, Service
from twodof.link.connection import Received
from twodof.link.mavlink.messages import message

ACCEPTED, NO_SPACE, INVALID_SEQUENCE = 0, 4, 13
"""MAV_MISSION_RESULT."""
TYPES = (0, 1, 2)
"""MAV_MISSION_TYPE: mission, fence, rally points."""
ALL, UNSUPPORTED = 255, 3
NO_MISSION = 1
"""MISSION_STATE."""
MISSION_START = 300


class MissionService(Service):
    """An empty mission, fence and list of rally points; a client that wants to store one is told of no space."""

    def __init__(self, link: Link, us: VehicleAddress, commands: CommandService, requests: MessageRequests) -> None:
        self._link = link
        self._us = us
        self._answers: dict[str, Callable[[Received], None]] = {
            "MISSION_REQUEST_LIST": self._count,
            "MISSION_COUNT": self._offered,
            "MISSION_CLEAR_ALL": self._cleared,
            "MISSION_REQUEST": self._item,
            "MISSION_REQUEST_INT": self._item,
            "MISSION_SET_CURRENT": self._chosen,
            "MISSION_ITEM_INT": self._item,
            "MISSION_ACK": self._nothing,
        }
        commands.on(MISSION_START, lambda _command: CommandResult(DENIED, "there is no mission"))
        requests.on(42, lambda _command: [self._current()])

    def handle(self, received: Received) -> bool:
        """Answers every message about missions."""
        answer = self._answers.get(received.message.get_type())
        if answer is None:
            return False
        if self._us.addressed(received.message):
            answer(received)
        return True

    def _nothing(self, received: Received) -> None:
        """The end of a transfer wants no answer."""

    def _current(self) -> Any:
        return message("MISSION_CURRENT", seq=0, total=0, mission_state=NO_MISSION)

    def _send(self, received: Received, name: str, **fields: int) -> None:
        system, component = source(received)
        there = {"target_system": system, "target_component": component}
        kind = getattr(received.message, "mission_type", 0)
        self._link.send(message(name, mission_type=kind, **there, **fields), received.peer)

    def _known(self, received: Received) -> bool:
        known = received.message.mission_type in TYPES
        if not known:
            self._send(received, "MISSION_ACK", type=UNSUPPORTED)
        return known

    def _count(self, received: Received) -> None:
        if self._known(received):
            self._send(received, "MISSION_COUNT", count=0)

    def _offered(self, received: Received) -> None:
        # Storing nothing is possible.
        if self._known(received):
            self._send(received, "MISSION_ACK", type=NO_SPACE if received.message.count else ACCEPTED)

    def _cleared(self, received: Received) -> None:
        if received.message.mission_type == ALL or self._known(received):
            self._send(received, "MISSION_ACK", type=ACCEPTED)

    def _item(self, received: Received) -> None:
        if self._known(received):
            self._send(received, "MISSION_ACK", type=INVALID_SEQUENCE)

    def _chosen(self, received: Received) -> None:
        self._link.send(self._current(), received.peer)
