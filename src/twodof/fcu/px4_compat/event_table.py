"""The events there are, one row each: what is sent, and what clients show for it, come from here alone.

Ids are component 1 << 24 | number; a number keeps its meaning and its arguments for ever, as logs outlive programs.
Source: MAVLink guide, "Events Interface"; levels and groups as PX4 uses them.
"""

import struct
from types import MappingProxyType
from typing import NamedTuple

from twodof.errors import LinkError
from twodof.fcu.px4_compat.event_enumerations import ENUMERATIONS, FIRST_OBSTACLE, OBSTACLES, Obstacle
from twodof.flight.failsafe.causes_and_actions import CAUSES, Cause

COMPONENT = 1
MOST_BYTES = 25
"""Bytes of arguments that libevents allows."""

CRITICAL, ERROR, WARNING, INFO, PROTOCOL = 2, 3, 4, 6, 8
"""Log levels: MAV_SEVERITY, and 8 for what is not shown to people."""

_FORMATS = MappingProxyType({"uint8_t": "B", "uint16_t": "H", "uint32_t": "I"})


class EventArgument(NamedTuple):
    """An argument; `kind` is a base type or the name of an enumeration."""

    name: str
    kind: str

    @property
    def format(self) -> str:
        """Of `struct`."""
        found = ENUMERATIONS.get(self.kind)
        return _FORMATS[self.kind if found is None else found.kind]


class EventType(NamedTuple):
    """A row. `message` is one line in which {1} stands for the first argument, `text` says more.

    `level` is that of the log; people see it at the same one if `shown`. `said` is how a STATUSTEXT begins that
    tells the same to clients without events.
    """

    number: int
    name: str
    message: str
    level: int
    arguments: tuple[EventArgument, ...] = ()
    shown: bool = True
    text: str = ""
    group: str = "default"
    kind: str = ""
    said: tuple[str, ...] = ()

    @property
    def id(self) -> int:
        """As EVENT carries it."""
        return COMPONENT << 24 | self.number

    @property
    def levels(self) -> int:
        """As EVENT carries them: that of the log in the upper four bits."""
        return self.level << 4 | (self.level if self.shown else PROTOCOL)

    def pack(self, *values: int) -> bytes:
        """The arguments as EVENT carries them. Raises LinkError if they are not the row's."""
        try:
            return struct.pack("<" + "".join(argument.format for argument in self.arguments), *values)
        except struct.error as reason:
            what = f"{values} do not fit its arguments: {reason}"
            raise LinkError(what, f"event {self.name}", "see event_table") from reason


_WHO = EventArgument("system", "uint8_t"), EventArgument("component", "uint8_t")
_CAUSES = EventArgument("causes", "cause_t")

ARMED = EventType(1, "armed", "Armed by system {1}, component {2}", INFO, _WHO)
DISARMED = EventType(2, "disarmed", "Disarmed {1}", INFO, (EventArgument("by", "disarmed_by_t"),))
ACTION = EventType(
    3,
    "failsafe_action",
    "Failsafe: {1} ({2})",
    WARNING,
    (EventArgument("action", "action_t"), _CAUSES),
    text="It flies by itself. level: pitch 0, the thrust of before. brake: a pitch that stops the cart and brings it "
    "back from the end of the rail. descend: level, and the thrust fades to 0.",
    said=("failsafe: ",),
)
MODE = EventType(4, "mode", "Mode: {1}", INFO, (EventArgument("mode", "mode_t"),), shown=False)
OVER = EventType(5, "failsafe_over", "Failsafe: over, it flies what is asked again", INFO, said=("failsafe: over",))
OFF = EventType(
    6,
    "failsafe_off",
    "Failsafe: motors off ({1})",
    CRITICAL,
    (_CAUSES,),
    text="They stay off until it is disarmed.",
    said=("failsafe: motors off",),
)
DENIED = EventType(
    7,
    "arming_denied",
    "Arming denied: {1}",
    CRITICAL,
    (EventArgument("obstacles", "obstacle_t"),),
    said=("not armed: ", "arming refused: "),
)
KILL = EventType(
    8,
    "killed",
    "Killed by system {1}, component {2}",
    CRITICAL,
    _WHO,
    text="It arms no more until it is released: by command 185 with 0, by `twodof kill --release`, or by a restart.",
    said=("killed by ",),
)
RELEASED = EventType(9, "released", "Released by system {1}, component {2}", WARNING, _WHO, said=("released by ",))

_UNHEALTHY = frozenset(
    {
        *("range_lost", "imu_lost", "force_disagrees", "rate_disagrees"),
        *("step_late", "own_failed", "command_stuck", "command_lost"),
    }
)
"""Causes that say that a part has failed; the others only keep from arming."""

_CHECKED = EventArgument("modes", "navigation_mode_group_t"), EventArgument("health_component_index", "uint8_t")


def _parts(*names: str) -> tuple[EventArgument, ...]:
    return tuple(EventArgument(name, "health_component_t") for name in names)


ARMING_SUMMARY = EventType(
    100,
    "arming_check_summary",
    "Arming checks",
    INFO,
    (
        EventArgument("chunk_idx", "uint8_t"),
        *_parts("error", "warning"),
        EventArgument("can_arm", "navigation_mode_group_t"),
        EventArgument("can_run", "navigation_mode_group_t"),
    ),
    shown=False,
    group="arming_check",
    kind="summary",
)
HEALTH_SUMMARY = EventType(
    101,
    "health_summary",
    "Health",
    INFO,
    (EventArgument("chunk_idx", "uint8_t"), *_parts("is_present", "error", "warning")),
    shown=False,
    group="health",
    kind="summary",
)
"""A report of the checks: the one, an event for each check that fails, the other."""


def _check(place: int, what: Cause | Obstacle) -> EventType:
    group = "health" if what.name in _UNHEALTHY else "arming_check"
    text = what.text[0].upper() + what.text[1:]
    return EventType(_FIRST_CHECK + place, f"check_{what.name}", text, ERROR, _CHECKED, group=group)


_FIRST_CHECK = 128
CHECKS = MappingProxyType(
    {cause.name: _check(place, cause) for place, cause in enumerate(CAUSES)}
    | {one.name: _check(place, one) for place, one in enumerate(OBSTACLES, start=FIRST_OBSTACLE)}
)
"""Name of a cause or an obstacle -> the check that fails with it; their numbers follow the bits."""

EVENTS: tuple[EventType, ...] = (
    *(ARMED, DISARMED, ACTION, MODE, OVER, OFF, DENIED, KILL, RELEASED),
    *(ARMING_SUMMARY, HEALTH_SUMMARY),
    *CHECKS.values(),
)

_SAID = tuple(begin for event in EVENTS for begin in event.said)


def marked(text: str) -> str:
    """A STATUSTEXT, with a tab at its end if an event says the same.

    That is PX4's sign, by which clients that show events (QGroundControl, pyulog) leave the text out.
    """
    return f"{text}\t" if text.startswith(_SAID) else text
