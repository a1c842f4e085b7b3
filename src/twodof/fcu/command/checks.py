"""Checks before arming and before an excitation is played: what speaks against it, in words; "" if nothing does."""

from __future__ import annotations

from typing import Protocol

from twodof.fcu.command.arming import ArmingState
from twodof.fcu.command.excitation_player import LOOPS, OnboardPlayer
from twodof.fcu.command.setpoint_queue import HORIZON
from twodof.fcu.command.setpoints import OPEN_LOOP, VELOCITY
from twodof.flight.failsafe.causes import named_causes


class RigSwitches(Protocol):
    """What is asked of the hardware."""

    @property
    def rings(self) -> bool:
        """Whether the rings lock the cart."""

    @property
    def safety_off(self) -> bool:
        """Whether the safety switch was pressed."""


def against_arming(arming: ArmingState, rig: RigSwitches, causes: int | None, moves_cart: bool, asks: bool) -> str:
    """What speaks against arming a drone that is not armed.

    `causes` is what the failsafe misses (None: none was heard yet); `moves_cart`: the mode does; `asks`: set-points ask
    for thrust or moment.
    """
    if arming.killed_by is not None:
        system, component = arming.killed_by
        return f"killed by system {system}, component {component}: release it first (twodof kill --release)"
    if arming.word:  # it is asked to be armed, and is not
        return "the failsafe has stopped the motors, disarm first"
    if causes is None:
        return "no sensor was heard yet"
    if not rig.safety_off:
        return "safety switch, press it"
    names = dict.fromkeys(named_causes(causes))
    if rig.rings and moves_cart:
        names["rings_wrong"] = None
    if asks:
        names["not_idle"] = None
    return ", ".join(names)


def against_playing(
    player: OnboardPlayer, rig: RigSwitches, transfer: int, loop: int, thrust: float | None, at_tick: int, now: int
) -> str:
    """What speaks against playing the definition `transfer` in the loop TWODOF_LOOP from `at_tick` on (0: now)."""
    if player.playing:
        return "another plays"
    if not player.unit or player.transfer != transfer:
        return f"there is no definition {transfer}, whole and not yet played"
    if not 0 <= loop < len(LOOPS):
        return f"there is no loop {loop}"
    where = LOOPS[loop]
    if player.unit != where.unit:
        return f"it is in {player.unit!r}, the loop in {where.unit!r}"
    if where.loop >= VELOCITY and rig.rings:
        return "the loop moves the cart, and the rings lock it"
    if thrust is not None and not 0.0 <= thrust <= 1.0:
        return "thrust is not within 0 to 1"
    if thrust == 0.0 and where.loop != OPEN_LOOP:
        return "a closed loop without thrust"
    if at_tick and not now <= at_tick <= now + HORIZON:
        return f"tick {at_tick} is past or more than a minute ahead, the next is {now}"
    return ""
