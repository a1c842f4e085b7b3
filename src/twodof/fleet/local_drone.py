"""A drone on this computer: its ports, its folder, its key, and what its flight controller says that it flies."""

import asyncio
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from twodof.errors import LinkError, printable
from twodof.link.connection import Connection
from twodof.link.mavlink.dialect import message_id
from twodof.link.mavlink.enums import AUTOPILOT
from twodof.link.mavlink.messages import message
from twodof.link.signing import Key, Signing, Stamps
from twodof.link.transport import open_transport, ports

REQUEST_MESSAGE = 512

_PROBE = 240  # system of who only listens whether a drone is there; none of those that clients use


STOCK = "stock"
FLIES = "flies "


class ControllerReport(NamedTuple):
    """What a drone flies: its controller, and how many parameters differ from their defaults."""

    controller: str = STOCK
    changed: int = 0


def controller_in_words(controller: str, changed: int) -> str:
    """`flies my_attitude; 3 parameters differ from their defaults`; `controller` as TWODOF_RIG names it.

    Somebody else may have left a controller on the drone, or other parameters.
    """
    what = "the stock controllers" if controller == STOCK else printable(controller)
    if not changed:
        return f"{FLIES}{what}; all parameters are at their defaults"
    differ = (
        "1 parameter differs from its default" if changed == 1 else f"{changed} parameters differ from their defaults"
    )
    return f"{FLIES}{what}; {differ}"


@dataclass(frozen=True)
class LocalDrone:
    """The drone `index`: its ports (docs/reference/protocol.md), seed, folder of its state and file of its key."""

    index: int
    seed: int = 1
    state: Path = Path()
    key: Path | None = None

    @property
    def options(self) -> list[str]:
        """What both its programs are told."""
        return ["--index", str(self.index), *(() if self.key is None else ("--key", str(self.key)))]

    @property
    def own(self) -> list[str]:
        """The arguments that only its own flight controller gets."""
        return ["--seed", str(self.seed), "--state", str(self.state)]

    @property
    def system(self) -> int:
        """Its MAVLink system."""
        return self.index + 1

    @property
    def fcu(self) -> str:
        """The flight controller itself."""
        return f"tcp://127.0.0.1:{ports.FLIGHT_CONTROLLER + self.index}"

    @property
    def companion(self) -> str:
        """The companion, for who opens a connection."""
        return f"tcp://127.0.0.1:{ports.COMPANION_TCP + self.index}"

    def described(self, lockstep: bool) -> dict[str, Any]:
        """Where to connect with what."""
        return {
            "index": self.index,
            "system": self.system,
            "seed": self.seed,
            "state": str(self.state.absolute()),
            "key": None if self.key is None else str(self.key.absolute()),
            "fcu": self.fcu,
            "companion": self.companion,
            # Time that is granted by one client: straight to the flight controller, as nobody else is to be there.
            "drone": self.fcu if lockstep else f"udp://127.0.0.1:{ports.COMPANION_ONBOARD + self.index}",
            "mavsdk": f"udpin://127.0.0.1:{ports.ONBOARD + self.index}",
            "mavproxy": f"tcp:127.0.0.1:{ports.COMPANION_TCP + self.index}",
            "qgroundcontrol": f"udp://127.0.0.1:{ports.GROUND_STATION}",
        }


async def wait_until_heard(url: str, system: int, timeout: float, key: Key | None = None) -> ControllerReport:
    """What the flight controller `system` at `url` says that it flies, all signed with `key` if there is one.

    Raises LinkError if none comes within `timeout` [s].
    """
    try:
        async with asyncio.timeout(timeout):
            signing = None if key is None else Signing(key, Stamps(None))
            async with Connection(await open_transport(url, timeout), _PROBE, 1, signing) as connection:
                while True:
                    got = await connection.receive(1.0)
                    if got is None or (got.frame.system, got.frame.component) != (system, AUTOPILOT):
                        continue
                    if got.message.get_type() == "HEARTBEAT":
                        asked = {"command": REQUEST_MESSAGE, "param1": float(message_id("TWODOF_RIG"))}
                        connection.send(message("COMMAND_LONG", target_system=system, target_component=1, **asked))
                    elif got.message.get_type() == "TWODOF_RIG":
                        return ControllerReport(got.message.controller, got.message.changed)
    except TimeoutError:
        raise LinkError(f"no heartbeat of system {system} within {timeout:g} s", url, "see what it says") from None
