"""The report of health and arming checks: what keeps from arming, in which modes, and what it is about.

Source: MAVLink's libevents, protocol "health_and_arming_check": a summary, an event for each check that fails, another
summary. As in PX4 it is sent when it has changed, every two seconds at most, and at once when somebody asks for it.
"""

from types import MappingProxyType
from typing import NamedTuple

from twodof.fcu.command.commander import Commander
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.loop import FlightController
from twodof.fcu.mavlink.telemetry.encoders import hindering
from twodof.fcu.px4_compat.event_enumerations import ABOUT, COMPONENT_INDEX, OBSTACLE_BIT
from twodof.fcu.px4_compat.event_table import ARMING_SUMMARY, CHECKS, HEALTH_SUMMARY, EventType
from twodof.flight.failsafe import state_machine
from twodof.flight.failsafe.causes_and_actions import BIT
from twodof.link.mavlink.modes import MODES

ALL_MODES = (1 << len(MODES)) - 1
_MODE_BITS = MappingProxyType({mode.custom_mode: 1 << place for place, mode in enumerate(MODES)})
MOVING_CART = sum(_MODE_BITS[mode.custom_mode] for mode in MODES if mode.moves_cart)
"""What the rings forbid."""

PRESENT = sum(1 << place for name, place in COMPONENT_INDEX.items() if name != "none")
_BITS = MappingProxyType({**BIT, **OBSTACLE_BIT})


class ReportedEvent(NamedTuple):
    """An event with its arguments."""

    event: EventType
    values: tuple[int, ...]


class ArmingReport:
    """Looks at what the commander looks at before it arms."""

    def __init__(self, controller: FlightController, commander: Commander) -> None:
        self._controller = controller
        self._commander = commander

    def obstacles(self, step: ControlStep | None) -> int:
        """Mask of what keeps from arming now (`obstacle_t`), in any mode; `step` is the last, None: none was yet."""
        commander = self._commander
        found = OBSTACLE_BIT["killed"] if commander.arming.killed_by is not None else 0
        if step is None:
            found |= OBSTACLE_BIT["unheard"]
        else:
            found |= hindering(step) | (OBSTACLE_BIT["stopped"] if step.state == state_machine.OFF else 0)
        if not self._controller.hardware.safety_off:
            found |= OBSTACLE_BIT["safety_switch"]
        if self._controller.hardware.rings and _MODE_BITS[commander.custom_mode] & MOVING_CART:
            found |= BIT["rings_wrong"]
        if not commander.armed and commander.unfit():
            found |= OBSTACLE_BIT["controller"]
        return found

    def events(self, obstacles: int) -> list[ReportedEvent]:
        """The report of these obstacles."""
        locked = MOVING_CART if self._controller.hardware.rings else 0
        if obstacles & BIT["rings_wrong"]:  # set-points that move the cart, in whatever mode this is
            locked |= _MODE_BITS.get(self._commander.custom_mode, 0)
        others = obstacles & ~BIT["rings_wrong"]
        failed = [(name, ALL_MODES) for name, bit in _BITS.items() if others & bit]
        if locked:
            failed.append(("rings_wrong", locked))
        wrong = {"arming_check": 0, "health": 0}
        checks = []
        for name, modes in failed:
            event, place = CHECKS[name], COMPONENT_INDEX[ABOUT[name]]
            if obstacles & _BITS[name]:  # rings that lock a cart which nobody wants to move are no fault
                wrong[event.group] |= 1 << place
            checks.append(ReportedEvent(event, (modes, place)))
        runs = ALL_MODES & ~locked
        return [
            ReportedEvent(ARMING_SUMMARY, (0, wrong["arming_check"], 0, 0 if others else runs, runs)),
            *checks,
            ReportedEvent(HEALTH_SUMMARY, (0, PRESENT, wrong["health"], 0)),
        ]
