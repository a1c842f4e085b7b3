"""What flies the drone: its autopilot, the version of its program, and the number of the machine."""

from __future__ import annotations

from typing import Any, NamedTuple

_KINDS = ((255, "release"), (192, "rc"), (128, "beta"), (64, "alpha"), (0, "dev"))
"""FIRMWARE_VERSION_TYPE: from which number on a version is called so; what is between counts them."""
_OURS = b"twodof"


class DroneVersion(NamedTuple):
    """The program of a drone, as AUTOPILOT_VERSION tells it.

    `firmware` is the PX4 whose protocol it speaks ("1.16.1 rc 2"). `build` names its sources (hexadecimal, or
    "twodof"). `twodof` is its own version if it is one of ours, else "". `uid` tells machines apart; 0 is unknown.
    """

    autopilot: str
    firmware: str
    build: str
    twodof: str
    uid: int

    def __str__(self) -> str:
        if self.twodof:
            return f"twodof {self.twodof}, speaks as {self.autopilot} {self.firmware}"
        return f"{self.autopilot} {self.firmware} ({self.build})"


def version_of(got: Any, autopilot: str) -> DroneVersion:
    """An AUTOPILOT_VERSION in words."""
    custom = bytes(got.flight_custom_version)
    ours = custom.startswith(_OURS)
    # PX4 gives the first digits of its commit, sixteen at most, the last byte first.
    build = custom.rstrip(b"\0").decode("ascii", "replace") if ours else custom[::-1].hex().rstrip("0")
    own = _number(got.middleware_sw_version).removesuffix(" release") if ours else ""
    uid2 = bytes(got.uid2)
    uid = int(got.uid) or int.from_bytes(uid2, "big")
    return DroneVersion(autopilot, _number(got.flight_sw_version), build, own, uid)


def _number(packed: int) -> str:
    kind = packed & 0xFF
    start, name = next((row for row in _KINDS if kind >= row[0]), _KINDS[-1])
    count = f" {kind - start}" if kind > start else ""
    return f"{packed >> 24 & 0xFF}.{packed >> 16 & 0xFF}.{packed >> 8 & 0xFF} {name}{count}"
