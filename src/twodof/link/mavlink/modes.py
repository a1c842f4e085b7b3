"""Modes by name and as PX4's number in HEARTBEAT.custom_mode: main << 16 | sub << 24."""

from types import MappingProxyType
from typing import NamedTuple

from twodof.errors import LinkError, listed, shown


class FlightMode(NamedTuple):
    """Mode that a client may choose: `name` is twodof's, `main` and `sub` are the numbers of PX4.

    `standard_mode` is MAV_STANDARD_MODE, `properties` are MAV_MODE_PROPERTY. `sticks`: MANUAL_CONTROL steers the drone.
    `moves_cart`: the mode moves the cart, which the rings may lock. `levels`: a loop on board keeps the pitch.
    """

    name: str
    main: int
    sub: int
    standard_mode: int
    properties: int
    text: str
    sticks: bool = False
    moves_cart: bool = False
    levels: bool = True

    @property
    def custom_mode(self) -> int:
        """The mode as HEARTBEAT.custom_mode."""
        return self.main << 16 | self.sub << 24


_AUTO_MODE = 4  # MAV_MODE_PROPERTY_AUTO_MODE: it flies by itself

MODES: tuple[FlightMode, ...] = (
    FlightMode(
        "manual", 1, 0, 0, 0, "open loop: sticks or TWODOF_OPENLOOP give moment and thrust", sticks=True, levels=False
    ),
    FlightMode("rate", 5, 0, 0, 0, "sticks give the pitch rate and the thrust (PX4's acro)", sticks=True, levels=False),
    FlightMode("attitude", 7, 0, 0, 0, "sticks give the pitch and the thrust (PX4's stabilised)", sticks=True),
    FlightMode(
        "position",
        3,
        0,
        1,
        0,
        "the stick gives the velocity along the rail, centred it holds the position",
        sticks=True,
        moves_cart=True,
    ),
    FlightMode("hold", 4, 3, 0, _AUTO_MODE, "level hold on board: pitch 0 at the thrust THRUST_BAR"),
    FlightMode(
        "offboard",
        6,
        0,
        0,
        _AUTO_MODE,
        "set-points by message or an excitation on board; the last valid one decides which loop",
    ),
)
"""The modes, in the order in which they are listed to clients."""

BY_NAME = MappingProxyType({mode.name: mode for mode in MODES})
BY_NUMBER = MappingProxyType({mode.custom_mode: mode for mode in MODES})

MANUAL, RATE, ATTITUDE, POSITION, HOLD, OFFBOARD = (mode.custom_mode for mode in MODES[:6])
"""The modes as custom_mode."""


def custom_mode(name: str) -> int:
    """Return HEARTBEAT.custom_mode of the mode `name`. Raises LinkError for an unknown name."""
    mode = BY_NAME.get(name)
    if mode is None:
        raise LinkError(f"no mode called {shown(name)}", "custom_mode", f"choose one of {listed(BY_NAME)}")
    return mode.custom_mode


def mode_name(number: int) -> str:
    """Return the name of a custom_mode, or its numbers as text if it is not in `MODES`."""
    mode = BY_NUMBER.get(number)
    return mode.name if mode is not None else f"main {number >> 16 & 0xFF}, sub {number >> 24 & 0xFF}"


_CUSTOM, _AUTO, _GUIDED, _STABILIZE, _MANUAL, _ARMED = 1, 4, 8, 16, 64, 128  # MAV_MODE_FLAG

UNREADY, STANDBY, ACTIVE, CRITICAL, TERMINATED = 0, 3, 4, 5, 8
"""MAV_STATE, as PX4 uses them."""


def base_mode(number: int, armed: bool) -> int:
    """Return HEARTBEAT.base_mode of the custom_mode `number` in `MODES`, with the flags that PX4 sets."""
    mode = BY_NUMBER[number]
    flags = _CUSTOM | (_ARMED if armed else 0)
    flags |= (_MANUAL if mode.sticks else 0) | (_STABILIZE if mode.levels else 0)
    return flags | (_AUTO | _GUIDED if number == HOLD else 0)
