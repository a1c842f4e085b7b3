"""Causes for which the failsafe acts, one row each with the requested action; a bit mask tells which hold."""

from functools import reduce
from operator import or_
from types import MappingProxyType
from typing import Any, NamedTuple

from twodof.blocks import Block, Port, int32, where

ACTIONS = ("none", "level", "brake", "descend", "off")
"""Actions of the failsafe, by number, from the weakest to the strongest.

none: mode and set-points pass unchanged. level: pitch set-point 0, the last thrust. brake: a pitch that stops the cart
and brings it back from the rail's end. descend: level, the thrust fades to 0, then off. off: the motors are stopped
until the drone is disarmed.
"""

NONE, LEVEL, BRAKE, DESCEND, OFF = range(len(ACTIONS))


class Cause(NamedTuple):
    """A cause: name, the action that it asks for (NONE: it only keeps the drone from arming), and its meaning.

    An `inner` cause is found behind the controllers in the same tick; the others are known before.
    """

    name: str
    action: int
    text: str
    inner: bool = False


CAUSES: tuple[Cause, ...] = (
    Cause("setpoint_lost", LEVEL, "no set-point came for a while, in a mode that flies one"),
    Cause("setpoint_invalid", LEVEL, "a set-point is infinite or NaN"),
    Cause("pitch_near", LEVEL, "the pitch is, or will be in a moment, near its stop"),
    Cause("rings_wrong", LEVEL, "the mode moves the cart, which is locked"),
    Cause(
        "user_failed",
        LEVEL,
        "the user's controller gave NaN or infinity, ran out of time, or its commands were stuck",
        inner=True,
    ),
    Cause("rail_near", BRAKE, "the cart is near the rail's end, or too fast to stop before it"),
    Cause("link_lost", DESCEND, "nothing came over the link for a while"),
    Cause("battery_critical", DESCEND, "the voltage is critical, or impossible for this battery"),
    Cause("range_lost", DESCEND, "the cart is free and its range silent, stuck or far from the motion expected"),
    Cause("imu_lost", OFF, "the IMU is silent or gives NaN or infinity, or one of its axes repeats the same bits"),
    Cause("estimate_lost", OFF, "an estimate is NaN or infinite, or beyond what the rig can do"),
    Cause("pitch_stop", OFF, "the pitch is at its stop"),
    Cause("rail_end", OFF, "the cart is at the rail's end"),
    Cause("brake_failed", OFF, "braking lasts too long and does not bring the cart away from the rail's end"),
    Cause("step_late", OFF, "the flight controller's step ran out of its time"),
    Cause("command_stuck", OFF, "the stock controller's commands stay the same in a closed loop", inner=True),
    Cause("command_lost", OFF, "a command for the motors is infinite or NaN", inner=True),
    Cause("battery_low", NONE, "the voltage is low, or impossible for this battery"),
    Cause("not_idle", NONE, "the set-points ask for thrust or moment"),
    Cause("tilted", NONE, "the pitch is far from level"),
    Cause(
        "force_disagrees", OFF, "the IMU feels what pitch and thrust do not explain: it has failed, or a stop is met"
    ),
    Cause("rate_disagrees", OFF, "the pitch rate does not answer the moment: gyro or rotor failed, or a stop is met"),
)
"""All causes; the index is the number of the bit in a mask."""

BIT = MappingProxyType({cause.name: 1 << place for place, cause in enumerate(CAUSES)})
"""The mask of each cause, a number with one bit set, by name."""


def named_causes(mask: int) -> tuple[str, ...]:
    """Return the names of the causes whose bits are set in `mask`."""
    return tuple(name for name, bit in BIT.items() if mask & bit)


class RequestedActions(Block):
    """Flags of the actions that the causes ask for, and the mask of the causes.

    `ready` is true if no cause holds, including those that only keep the drone from arming.
    """

    inputs = tuple(Port(cause.name, "bool") for cause in CAUSES if not cause.inner)
    outputs = (
        *(Port(ACTIONS[action], "bool") for action in (LEVEL, BRAKE, DESCEND, OFF)),
        Port("ready", "bool"),
        Port("mask", "int32"),
    )

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        outer = [cause for cause in CAUSES if not cause.inner]
        classes = {
            ACTIONS[action]: reduce(or_, [u[cause.name] for cause in outer if cause.action == action])
            for action in (LEVEL, BRAKE, DESCEND, OFF)
        }
        mask = reduce(or_, [where(u[cause.name], int32(BIT[cause.name]), int32(0)) for cause in outer])
        return {**classes, "ready": mask == int32(0), "mask": mask}
