"""Changes: which messages tell of something that is not as it was a tick before."""

from __future__ import annotations

from typing import Any

from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.telemetry.encoders import LEASE, OPENLOOP, RIG, SAFETY
from twodof.fcu.mavlink.telemetry.sensor_messages import TOF
from twodof.fcu.mavlink.vehicle import CommanderView, ControllerView

FLAG_TICKS = 25
"""The failsafe's flags alone, which noise may flip, are told at most ten times a second."""


class ChangeDetector:
    """Compares each step with the one before."""

    def __init__(self, controller: ControllerView, commander: CommanderView) -> None:
        self._controller = controller
        self._commander = commander
        self._safety: tuple[Any, ...] = ()
        self._causes = 0
        self._told = -FLAG_TICKS
        self._slow: tuple[Any, ...] = ()

    def seen(self, step: ControlStep) -> list[int]:
        """Ids of the messages that have news in this step."""
        found = [TOF] if step.sample.dist_new else []
        safety = (step.action, step.state, step.armed, step.reason, self._commander.killed_by)
        if safety != self._safety or (step.causes != self._causes and abs(step.tick - self._told) >= FLAG_TICKS):
            self._safety, self._causes, self._told = safety, step.causes, step.tick
            found.append(SAFETY)
        hardware, commander = self._controller.hardware, self._commander
        lease = commander.lease.holder, commander.tuning_withheld
        slow = (hardware.rings, hardware.safety_off, hardware.seed, lease, commander.openloop.revision)
        if slow != self._slow:
            if slow[:3] != self._slow[:3]:
                found.append(RIG)
            if slow[3:4] != self._slow[3:4]:
                found.append(LEASE)
            if slow[4:] != self._slow[4:]:
                found.append(OPENLOOP)
            self._slow = slow
        return found
