"""Modes by name and as PX4's number in HEARTBEAT.custom_mode: main << 16 | sub << 24."""

from __future__ import annotations

from types import MappingProxyType
from typing import NamedTuple

from twodof.errors import LinkError, listed, shown


class Mode(NamedTuple):
    """What a client may choose. `name` is ours, `main` and `sub` are PX4's, `standard` is MAV_STANDARD_MODE's."""

    name: str
    main: int
    sub: int
    standard: int
    text: str

    @property
    def custom_mode(self) -> int:
        """As HEARTBEAT carries it."""
        return self.main << 16 | self.sub << 24


MODES: tuple[Mode, ...] = (
    Mode("manual", 1, 0, 0, "open loop: sticks or TWODOF_OPENLOOP give moment and thrust"),
    Mode("rate", 5, 0, 0, "sticks give the pitch rate and the thrust (PX4's acro)"),
    Mode("attitude", 7, 0, 0, "sticks give the pitch and the thrust (PX4's stabilised)"),
    Mode("position", 3, 0, 1, "the stick gives the velocity along the rail, centred it holds the position"),
    Mode("hold", 4, 3, 0, "level hold on board: pitch 0 at the thrust THRUST_BAR"),
    Mode("offboard", 6, 0, 0, "set-points by message or an excitation on board; the last valid one decides which loop"),
)
"""The modes, in the order in which they are listed to clients."""

BY_NAME = MappingProxyType({mode.name: mode for mode in MODES})
BY_NUMBER = MappingProxyType({mode.custom_mode: mode for mode in MODES})

MANUAL, RATE, ATTITUDE, POSITION, HOLD, OFFBOARD = (mode.custom_mode for mode in MODES)
"""The modes as custom_mode."""


def custom_mode(name: str) -> int:
    """custom_mode of the mode `name`. Raises LinkError for a name that is none."""
    mode = BY_NAME.get(name)
    if mode is None:
        raise LinkError(f"no mode called {shown(name)}", "custom_mode", f"there are {listed(BY_NAME)}")
    return mode.custom_mode


def mode_name(number: int) -> str:
    """Name of a custom_mode, as text where it is none of ours."""
    mode = BY_NUMBER.get(number)
    return mode.name if mode is not None else f"main {number >> 16 & 0xFF}, sub {number >> 24 & 0xFF}"
