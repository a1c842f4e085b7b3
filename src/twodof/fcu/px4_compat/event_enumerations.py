"""The enumerations that arguments of events take: causes, actions, modes and obstacles, from where each of them lives.

Source: the event definitions of MAVLink's libevents, version 2. An entry's description is what a client shows.
"""

from types import MappingProxyType
from typing import NamedTuple

from twodof.flight.failsafe.causes_and_actions import ACTIONS, CAUSES
from twodof.link.mavlink.modes import MODES


class EventEnumeration(NamedTuple):
    """An enumeration; `kind` is the unsigned integer that carries it.

    An entry is a value (of a bit field, `bits`, the bit itself), a name, and a text for people.
    """

    kind: str
    text: str
    entries: tuple[tuple[int, str, str], ...]
    bits: bool = False


class Obstacle(NamedTuple):
    """What keeps from arming beside the failsafe's causes: its name, its text, and the component that it is about."""

    name: str
    text: str
    component: str


FIRST_OBSTACLE = 24
"""The causes are the bits below, the other obstacles those from here on."""

OBSTACLES = (
    Obstacle("killed", "it was killed, release it first", "system"),
    Obstacle("stopped", "the failsafe has stopped the motors, disarm first", "system"),
    Obstacle("unheard", "no sensor was heard yet", "system"),
    Obstacle("safety_switch", "safety switch, press it", "motors_escs"),
    Obstacle("controller", "the controller has stopped, or is being built", "attitude_controller"),
)
"""What else the commander looks at before it arms."""

OBSTACLE_BIT = MappingProxyType({one.name: 1 << FIRST_OBSTACLE + place for place, one in enumerate(OBSTACLES)})

LEASE_BIT, OTHER_BIT = (1 << FIRST_OBSTACLE + len(OBSTACLES) + place for place in range(2))
"""In a refusal alone: somebody else commands, which speaks against who asks; and what is none of these."""

# Names and bits are PX4's, since clients know them; the causes that are about each.
_COMPONENTS: tuple[tuple[str, int, str, tuple[str, ...]], ...] = (
    ("none", 0, "None", ("not_idle", "setpoint_invalid", "setpoint_lost")),
    ("distance_sensor", 6, "Distance sensor", ("range_lost",)),
    ("motors_escs", 8, "Motors", ()),
    ("battery", 11, "Battery", ("battery_low", "battery_critical")),
    ("communication_links", 12, "Communication", ("link_lost",)),
    ("attitude_controller", 14, "Controller", ("own_failed", "command_stuck", "command_lost")),
    ("position_controller", 15, "Place on the rail", ("rail_near", "rail_end", "brake_failed", "rings_wrong")),
    ("attitude_estimate", 16, "Estimate", ("estimate_lost",)),
    ("system", 20, "System", ("step_late", "pitch_near", "pitch_stop", "tilted")),
    ("accel", 28, "Accelerometer", ("imu_lost", "force_disagrees")),
    ("gyro", 29, "Gyroscope", ("rate_disagrees",)),
)

COMPONENT_INDEX = MappingProxyType({name: place for name, place, _, _ in _COMPONENTS})
"""Name of a health component -> its place, as a check names it; its bit is 1 << place."""

ABOUT = MappingProxyType(
    {cause: name for name, _, _, causes in _COMPONENTS for cause in causes}
    | {one.name: one.component for one in OBSTACLES}
)
"""Name of a cause or an obstacle -> the health component it is about."""

COMMANDED, KILLED, FAILED = range(3)
"""Why it was disarmed."""

_CAUSE_ENTRIES = tuple((1 << place, cause.name, cause.text) for place, cause in enumerate(CAUSES))

ENUMERATIONS = MappingProxyType(
    {
        "cause_t": EventEnumeration("uint32_t", "What the failsafe sees.", _CAUSE_ENTRIES, True),
        "obstacle_t": EventEnumeration(
            "uint32_t",
            "What keeps from arming: causes of the failsafe, and more.",
            (
                *_CAUSE_ENTRIES,
                *((OBSTACLE_BIT[one.name], one.name, one.text) for one in OBSTACLES),
                (LEASE_BIT, "lease", "somebody else commands"),
                (OTHER_BIT, "other", "it did not come to it"),
            ),
            True,
        ),
        "action_t": EventEnumeration(
            "uint8_t",
            "What the failsafe does.",
            tuple((place, name, name) for place, name in enumerate(ACTIONS)),
        ),
        "disarmed_by_t": EventEnumeration(
            "uint8_t",
            "Who or what disarmed it.",
            (
                (COMMANDED, "command", "by command"),
                (KILLED, "kill", "by a kill"),
                (FAILED, "failsafe", "by the failsafe"),
            ),
        ),
        "mode_t": EventEnumeration(
            "uint32_t",
            "The modes, as HEARTBEAT.custom_mode.",
            tuple((mode.custom_mode, mode.name, mode.name) for mode in MODES),
        ),
        "navigation_mode_group_t": EventEnumeration(
            "uint32_t",
            "The modes again, a bit each: which of them a check is about.",
            tuple((1 << place, mode.name, mode.text) for place, mode in enumerate(MODES)),
            True,
        ),
        "health_component_t": EventEnumeration(
            "uint32_t",
            "What a check is about.",
            tuple((1 << place, name, text) for name, place, text, _ in _COMPONENTS),
            True,
        ),
    }
)
"""Name -> enumeration."""
