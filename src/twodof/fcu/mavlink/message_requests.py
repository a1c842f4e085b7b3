"""Requests for one message, by command 512 and older commands; versions; missions, which are refused."""

import hashlib
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import twodof
from twodof.fcu.command.command_lease import DONE, CommandResult, denied, rejected, unsupported
from twodof.fcu.mavlink.command_service import CommandService, ReceivedCommand
from twodof.fcu.mavlink.encoders import TelemetryEncoders
from twodof.fcu.mavlink.service import Service, Vehicle, source, target, whole
from twodof.link.connection import Received
from twodof.link.mavlink import dialect
from twodof.link.mavlink.dialect import MavCmd, message_id
from twodof.link.mavlink.messages import message

OLD_FORMS = {
    MavCmd.GET_HOME_POSITION: "HOME_POSITION",
    MavCmd.REQUEST_PROTOCOL_VERSION: "PROTOCOL_VERSION",
    MavCmd.REQUEST_AUTOPILOT_CAPABILITIES: "AUTOPILOT_VERSION",
}

Builder = Callable[[ReceivedCommand], Iterable[Any] | None]


class MessageRequests:
    """Answers to requests for a message: from its registered builder, or the telemetry message with present values."""

    def __init__(self, vehicle: Vehicle, commands: CommandService, telemetry: TelemetryEncoders) -> None:
        self._vehicle = vehicle
        self._telemetry = telemetry
        self._builders: dict[int, Builder] = {}
        commands.on(MavCmd.REQUEST_MESSAGE, lambda command: self._send(whole(command.params[0], -1), command))
        for command, name in OLD_FORMS.items():
            commands.on(command, partial(self._send_old, message_id(name)))

    def on(self, name: str, builder: Builder) -> None:
        """Register the builder of a message; a builder returns None for invalid parameters of the command."""
        self._builders[message_id(name)] = builder

    @property
    def supported(self) -> tuple[int, ...]:
        """Return the ids of the messages that can be requested."""
        return tuple(sorted({*self._builders, *self._telemetry.messages}))

    def _send_old(self, number: int, command: ReceivedCommand) -> CommandResult:
        # Their first parameter is 1 or left out; the others, which a builder may read, do not exist.
        return self._send(number, command._replace(params=(float(number), *(0.0,) * 6)))

    def _send(self, number: int, command: ReceivedCommand) -> CommandResult:
        builder = self._builders.get(number)
        built: Iterable[Any] | None
        if builder is not None:
            built = builder(command)
        elif number in self._telemetry.messages:
            now = self._telemetry.message(number)
            if now is None:
                return rejected("nothing was measured yet: let time run")
            built = [now]
        else:
            return unsupported()
        if built is None:
            return denied()
        for one in built:
            self._vehicle.send(one, command.peer)
        return DONE


CAPABILITIES = (
    *("MISSION_INT", "PARAM_FLOAT", "COMMAND_INT", "PARAM_ENCODE_BYTEWISE", "FTP", "MAVLINK2"),
    *("SET_ATTITUDE_TARGET", "SET_POSITION_TARGET_LOCAL_NED", "FLIGHT_TERMINATION"),
)
"""MAV_PROTOCOL_CAPABILITY of this vehicle."""
PX4_VERSION = (1, 16, 1)
"""The PX4 whose protocol is spoken: clients of PX4 choose what they do by this number."""
OFFICIAL = 255
"""FIRMWARE_VERSION_TYPE_OFFICIAL."""


def packed_version(major: int, minor: int, patch: int) -> int:
    """Pack a version as MAVLink does."""
    return major << 24 | minor << 16 | patch << 8 | OFFICIAL


def answer_versions(requests: MessageRequests, system: int, name: str) -> None:
    """Answer requests for versions; `system` and `name` make the unique number of this vehicle."""
    digest = hashlib.sha256(f"twodof {system} {name}".encode()).digest()
    own = (int(part) for part in twodof.__version__.split(".")[:3])
    version = message(
        "AUTOPILOT_VERSION",
        capabilities=sum(getattr(dialect.load(), f"MAV_PROTOCOL_CAPABILITY_{name}") for name in CAPABILITIES),
        flight_sw_version=packed_version(*PX4_VERSION),
        middleware_sw_version=packed_version(*own),
        flight_custom_version=b"twodof\0\0",
        uid=int.from_bytes(digest[:8], "little") | 1,  # 0 means that there is none
        uid2=digest[:18],
    )
    requests.on("AUTOPILOT_VERSION", lambda _: [version])
    # MAVLink 2 alone is sent; of the specification and of the library there is no hash to give.
    speaks = message("PROTOCOL_VERSION", version=200, min_version=200, max_version=200)
    requests.on("PROTOCOL_VERSION", lambda _: [speaks])


UNSUPPORTED = 3
"""MAV_MISSION_RESULT."""
TYPES = (0, 1, 2)
"""MAV_MISSION_TYPE: mission, fence, rally points."""

ANSWERED = (
    *("MISSION_REQUEST_LIST", "MISSION_COUNT", "MISSION_CLEAR_ALL", "MISSION_SET_CURRENT"),
    *("MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ITEM_INT"),
)


class MissionService(Service):
    """Service for missions, fences and rally points, which the drone lacks: empty lists, and a refusal of all else."""

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle, dict.fromkeys(ANSWERED, self._answer) | {"MISSION_ACK": None})

    def _answer(self, received: Received) -> None:
        got = received.message
        there = {**target(source(received)), "mission_type": getattr(got, "mission_type", 0)}
        listed = got.get_type() == "MISSION_REQUEST_LIST" and got.mission_type in TYPES
        answer = message("MISSION_COUNT", **there) if listed else message("MISSION_ACK", type=UNSUPPORTED, **there)
        self._vehicle.send(answer, received.peer)
