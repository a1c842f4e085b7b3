"""Version: what this autopilot is and can do: AUTOPILOT_VERSION and PROTOCOL_VERSION."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import Any, NamedTuple

import twodof
from twodof.fcu.mavlink.commands.message_requests import MessageRequests
from twodof.link.mavlink.messages import message

# MAV_PROTOCOL_CAPABILITY: only what there is.
PARAM_ENCODE_BYTEWISE, COMMAND_INT, FTP, ATTITUDE_TARGET, POSITION_TARGET, TERMINATION, MAVLINK2 = (
    16,
    8,
    32,
    64,
    128,
    2048,
    8192,
)
MISSION_INT, PARAM_FLOAT = 4, 2
CAPABILITIES = (
    MISSION_INT
    | PARAM_FLOAT
    | COMMAND_INT
    | PARAM_ENCODE_BYTEWISE
    | ATTITUDE_TARGET
    | POSITION_TARGET
    | TERMINATION
    | MAVLINK2
)
AUTOPILOT_VERSION, PROTOCOL_VERSION = 148, 300
PX4_VERSION = (1, 16, 1)
"""The PX4 whose protocol is spoken: clients of PX4 choose what they do by this number."""
OFFICIAL = 255
"""FIRMWARE_VERSION_TYPE_OFFICIAL."""


class PackedVersion(NamedTuple):
    """A version as MAVLink packs it."""

    major: int
    minor: int
    patch: int
    kind: int = OFFICIAL

    @property
    def number(self) -> int:
        """major << 24 | minor << 16 | patch << 8 | kind."""
        return self.major << 24 | self.minor << 16 | self.patch << 8 | self.kind


class VersionService:
    """Answers requests for the two messages; `system` and `name` make the unique number of this vehicle."""

    def __init__(self, requests: MessageRequests, system: int, name: str, capabilities: int = 0) -> None:
        self._capabilities = CAPABILITIES | capabilities
        digest = hashlib.sha256(f"twodof {system} {name}".encode()).digest()
        self.uid2 = digest[:18]
        self.uid = int.from_bytes(digest[:8], "little") | 1  # 0 means that there is none
        requests.on(AUTOPILOT_VERSION, self._autopilot)
        requests.on(PROTOCOL_VERSION, self._protocol)

    def _autopilot(self, _command: object) -> Iterable[Any]:
        own = [int(part) for part in twodof.__version__.split(".")[:3]]
        return [
            message(
                "AUTOPILOT_VERSION",
                capabilities=self._capabilities,
                flight_sw_version=PackedVersion(*PX4_VERSION).number,
                middleware_sw_version=PackedVersion(*own).number,
                flight_custom_version=b"twodof\0\0",
                uid=self.uid,
                uid2=self.uid2,
            )
        ]

    def _protocol(self, _command: object) -> Iterable[Any]:
        # MAVLink 2 alone is sent; of the specification and of the library there is no hash to give.
        return [message("PROTOCOL_VERSION", version=200, min_version=200, max_version=200)]
