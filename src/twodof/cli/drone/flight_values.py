"""What stands behind the progress bar of `twodof fly`: where the drone is, and what its failsafe does."""

from collections.abc import Mapping
from math import degrees
from types import MappingProxyType

from twodof.gcs.drone import Drone

IN_WORDS: Mapping[str, str] = MappingProxyType(
    {"arm": "arms", "hold": "holds still", "excite": "is excited", "disarm": "disarms"}
)
"""What a flight reports as done, in words for people."""

_SHOWN = (
    ("theta", "estimate.theta", degrees(1.0), "+5.1f", " deg"),
    ("x", "estimate.x", 1.0, "+.3f", " m"),
    ("M", "command.M", 1.0, "+.3f", ""),
)


class FlightValues:
    """The latest values of `drone`, in a line; "" before there is one."""

    def __init__(self) -> None:
        self.drone: Drone | None = None

    def __call__(self) -> str:
        if self.drone is None:
            return ""
        if words := self.drone.state.safety.in_words():
            return f"FAILSAFE {words}"
        said = []
        for name, signal, scale, how, unit in _SHOWN:
            latest = self.drone.telemetry(signal).latest
            if latest is not None and isinstance(latest.value, float):
                said.append(f"{name} {scale * latest.value:{how}}{unit}")
        return "  ".join(said)
