"""Version: what this autopilot is and can do: AUTOPILOT_VERSION and PROTOCOL_VERSION."""

import hashlib
from collections.abc import Iterable
from typing import Any

import twodof
from twodof.fcu.mavlink.commands.message_requests import MessageRequests
from twodof.link.mavlink import dialect
from twodof.link.mavlink.messages import message

CAPABILITIES = (
    *("MISSION_INT", "PARAM_FLOAT", "COMMAND_INT", "PARAM_ENCODE_BYTEWISE", "FTP", "MAVLINK2"),
    *("SET_ATTITUDE_TARGET", "SET_POSITION_TARGET_LOCAL_NED", "FLIGHT_TERMINATION"),
)
"""MAV_PROTOCOL_CAPABILITY: only what there is."""
PX4_VERSION = (1, 16, 1)
"""The PX4 whose protocol is spoken: clients of PX4 choose what they do by this number."""
OFFICIAL = 255
"""FIRMWARE_VERSION_TYPE_OFFICIAL."""


def packed_version(major: int, minor: int, patch: int) -> int:
    """A version as MAVLink packs it."""
    return major << 24 | minor << 16 | patch << 8 | OFFICIAL


class VersionService:
    """Answers requests for the two messages; `system` and `name` make the unique number of this vehicle."""

    def __init__(self, requests: MessageRequests, system: int, name: str) -> None:
        digest = hashlib.sha256(f"twodof {system} {name}".encode()).digest()
        self.uid2 = digest[:18]
        self.uid = int.from_bytes(digest[:8], "little") | 1  # 0 means that there is none
        requests.on("AUTOPILOT_VERSION", self._autopilot)
        # MAVLink 2 alone is sent; of the specification and of the library there is no hash to give.
        speaks = message("PROTOCOL_VERSION", version=200, min_version=200, max_version=200)
        requests.on("PROTOCOL_VERSION", lambda _: [speaks])

    def _autopilot(self, _command: object) -> Iterable[Any]:
        own = (int(part) for part in twodof.__version__.split(".")[:3])
        return [
            message(
                "AUTOPILOT_VERSION",
                capabilities=sum(getattr(dialect.load(), f"MAV_PROTOCOL_CAPABILITY_{name}") for name in CAPABILITIES),
                flight_sw_version=packed_version(*PX4_VERSION),
                middleware_sw_version=packed_version(*own),
                flight_custom_version=b"twodof\0\0",
                uid=self.uid,
                uid2=self.uid2,
            )
        ]
