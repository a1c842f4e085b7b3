"""twodof's own messages of state: failsafe, rig, timing, lease, truth."""

from __future__ import annotations

from collections.abc import Callable

from twodof.fcu.command.commander import Commander
from twodof.fcu.control.controllers import ControllerIdentity
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.loop import FlightController
from twodof.fcu.mavlink.telemetry.flight_messages import MASK_32, Encoder
from twodof.flight.failsafe.causes_and_actions import CAUSES
from twodof.link.control_period import TICK_MS, TICK_US
from twodof.link.mavlink.packing import Packed, Packer

RINGS, SAFETY_OFF, VIRTUAL, LOCKSTEP = 1, 2, 4, 8
"""TWODOF_RIG_FLAG."""
SEED_MASK = 0xFFFFFFFFFFFFFFFF
NOBODY = (0, 0)


def deciding(reason: int) -> int:
    """Which cause of a mask decides: the place of the one that asks for the strongest action, -1 if there is none."""
    places = [place for place in range(len(CAUSES)) if reason >> place & 1]
    return max(places, key=lambda place: (CAUSES[place].action, -place), default=-1)


def safety(since: Callable[[], int], commander: Commander) -> Encoder:
    """TWODOF_SAFETY; `since` says from which tick on the action is taken."""
    pack = Packer("TWODOF_SAFETY")

    def encode(s: ControlStep) -> Packed:
        killed_by = commander.arming.killed_by
        killed = (0, 0, 0) if killed_by is None else (1, *killed_by)
        sees = s.causes & MASK_32
        return pack(s.tick & MASK_32, since() & MASK_32, sees, s.action, deciding(s.reason), *killed)

    return encode


def rig(controller: FlightController, flown: Callable[[], ControllerIdentity]) -> Callable[..., Packed]:
    """TWODOF_RIG; called with flags that come on top."""
    pack = Packer("TWODOF_RIG")

    def encode(on_top: int = 0) -> Packed:
        hardware, what = controller.hardware, flown()
        flags = (RINGS if hardware.rings else 0) | (SAFETY_OFF if hardware.safety_off else 0)
        flags |= on_top | (VIRTUAL if hardware.virtual else 0) | (LOCKSTEP if controller.lockstep else 0)
        names = hardware.name.encode()[:16], what.controller.encode()[:24]
        tick = controller.tick & MASK_32
        return pack(
            hardware.seed & SEED_MASK, what.diagram, tick, TICK_US, flags, *names, controller.started_as, what.changed
        )

    return encode


def timing(controller: FlightController, lost: Callable[[], int]) -> Callable[[], Packed]:
    """TWODOF_TIMING; `lost` counts messages that clients did not take."""
    pack = Packer("TWODOF_TIMING")

    def encode() -> Packed:
        now = controller.timing
        times = now.step_mean, now.step_worst, now.late_worst
        return pack(controller.tick & MASK_32, now.overruns, now.missed, lost() & MASK_32, *times)

    return encode


def lease(commander: Commander) -> Callable[[], Packed]:
    """TWODOF_LEASE: who may command, and whether others may tune."""
    pack = Packer("TWODOF_LEASE")

    def encode() -> Packed:
        now = commander.lease
        holder = now.holder or NOBODY
        return pack(min(max(now.left, 0) * TICK_MS, MASK_32), 0, 0, 0, *holder, int(commander.tuning_withheld))

    return encode


def openloop(commander: Commander) -> Callable[[], Packed]:
    """TWODOF_OPENLOOP: what is in use."""
    pack = Packer("TWODOF_OPENLOOP")

    def encode() -> Packed:
        now = commander.openloop
        flags = int(now.openloop), int(now.enableM), int(now.enableT)
        return pack(now.tick & MASK_32, now.M, now.T, 0, 0, *flags)

    return encode


def truth(state: Callable[[], tuple[float, float, float, float]], controller: FlightController) -> Callable[[], Packed]:
    """TWODOF_TRUTH: theta, q, x, v of the virtual rig, from the rig itself."""
    pack = Packer("TWODOF_TRUTH")
    return lambda: pack(controller.tick * TICK_US, *state(), controller.tick & MASK_32)
