"""Missions, fences and rally points: the vehicle does not have them, and answers every question so."""

from typing import Any

from twodof.fcu.command.result import denied
from twodof.fcu.mavlink.addressing import VehicleAddress, source, target
from twodof.fcu.mavlink.commands.command_service import CommandService
from twodof.fcu.mavlink.commands.message_requests import MessageRequests
from twodof.fcu.mavlink.service import Link, Service
from twodof.link.connection import Received
from twodof.link.mavlink.enums import MavCmd
from twodof.link.mavlink.messages import message

ACCEPTED, UNSUPPORTED, NO_SPACE, INVALID_SEQUENCE = 0, 3, 4, 13
"""MAV_MISSION_RESULT."""
TYPES, ALL = (0, 1, 2), 255
"""MAV_MISSION_TYPE: mission, fence, rally points; and all of these."""
NO_MISSION = 1
"""MISSION_STATE."""

ANSWERED = frozenset(
    {
        *("MISSION_REQUEST_LIST", "MISSION_COUNT", "MISSION_CLEAR_ALL", "MISSION_SET_CURRENT", "MISSION_ACK"),
        *("MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ITEM_INT"),
    }
)


class MissionService(Service):
    """An empty mission, fence and list of rally points; a client that wants to store one is told of no space."""

    def __init__(self, link: Link, us: VehicleAddress, commands: CommandService, requests: MessageRequests) -> None:
        self._link = link
        self._us = us
        self._current = message("MISSION_CURRENT", seq=0, total=0, mission_state=NO_MISSION)
        commands.on(MavCmd.MISSION_START, lambda _command: denied("there is no mission"))
        requests.on("MISSION_CURRENT", lambda _command: [self._current])

    def handle(self, received: Received) -> bool:
        """Answers every message about missions, but the end of a transfer."""
        name = received.message.get_type()
        if name in ANSWERED and name != "MISSION_ACK" and self._us.addressed(received.message):
            self._link.send(self._answer(name, received), received.peer)
        return name in ANSWERED

    def _answer(self, name: str, received: Received) -> Any:
        if name == "MISSION_SET_CURRENT":
            return self._current
        got = received.message
        there = {**target(source(received)), "mission_type": got.mission_type}
        known = got.mission_type in TYPES or (name == "MISSION_CLEAR_ALL" and got.mission_type == ALL)
        if name == "MISSION_REQUEST_LIST" and known:
            return message("MISSION_COUNT", count=0, **there)
        result = INVALID_SEQUENCE  # there is no item to be read or written
        if not known:
            result = UNSUPPORTED
        elif name == "MISSION_CLEAR_ALL" or (name == "MISSION_COUNT" and not got.count):  # storing nothing is possible
            result = ACCEPTED
        elif name == "MISSION_COUNT":
            result = NO_SPACE
        return message("MISSION_ACK", type=result, **there)
