"""Telemetry: every message that can be streamed or asked for, as of now."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from twodof.fcu.command.commander import Commander
from twodof.fcu.control.controllers import ControllerIdentity
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.loop import FlightController
from twodof.fcu.mavlink.telemetry import flight_messages, system_messages, twodof_messages
from twodof.fcu.mavlink.telemetry.flight_messages import Encoder
from twodof.fcu.mavlink.telemetry.sensor_messages import SensorMessages
from twodof.link.control_period import TICK_US

HEARTBEAT = 0
OPENLOOP, TRUTH, RIG, LEASE, SAFETY, TIMING = 54200, 54205, 54206, 54209, 54210, 54211


def _nobody() -> int:
    return 0


class TelemetryEncoders:
    """The latest step, and encoders of it by message id.

    `flying` are encoders that take a step, `standing` those that need none. `news` has the tick of the last sample of
    the messages that carry one of a sensor, so that none is sent twice. `truth` is the virtual rig's state, None for a
    real one: it comes from the rig, past everything on board. A service of its own turn: it takes no message, and must
    come before those that send.
    """

    def __init__(
        self,
        controller: FlightController,
        commander: Commander,
        identity: Callable[[], ControllerIdentity] = ControllerIdentity,
        lost: Callable[[], int] = _nobody,
        truth: Callable[[], tuple[float, float, float, float]] | None = None,
    ) -> None:
        self.controller = controller
        self.step: ControlStep | None = None
        self.sensors = SensorMessages()
        self.news = self.sensors.news
        self.since = 0
        self._action = -1
        system, own = system_messages, twodof_messages
        self.rig = own.rig(controller, identity)
        self.flying: dict[int, Encoder] = {
            **{number: make() for number, make in flight_messages.ENCODERS.items()},
            1: system.sys_status(self.load),
            147: system.battery_status(),
            230: system.estimator_status(),
            245: system.extended_sys_state(),
            SAFETY: own.safety(lambda: self.since, commander),
        }
        self.standing: dict[int, Callable[[], Any]] = {
            HEARTBEAT: system.heartbeat(commander),
            2: system.system_time(controller),
            242: system.home_position(),
            OPENLOOP: own.openloop(commander),
            RIG: self.rig,
            LEASE: own.lease(commander),
            **self.sensors.messages,
            TIMING: own.timing(controller, lost),
        }
        if truth is not None:
            self.standing[TRUTH] = own.truth(truth, controller)
        self.messages = {*self.flying, *self.standing}

    def add(self, message_id: int, encode: Callable[[], Any]) -> None:
        """Another message that can be streamed and asked for."""
        self.standing[message_id] = encode
        self.messages.add(message_id)

    def load(self) -> float:
        """The part of a control period that a step takes, over the last second, 0 to 1."""
        return self.controller.timing.step_mean / TICK_US

    def message(self, message_id: int) -> Any | None:
        """A message of `messages` as of now; None if nothing of the kind was measured yet."""
        standing = self.standing.get(message_id)
        if standing is not None:
            return standing()
        return self.flying[message_id](self.step) if self.step is not None else None

    def observe(self, step: ControlStep) -> None:
        """Takes a step over."""
        self.step = step
        self.sensors.observe(step)
        if step.action != self._action:
            self._action, self.since = step.action, step.tick

    def restart(self) -> None:
        """Time begins anew."""
        self.step = None
        self.since, self._action = 0, -1
        self.sensors.restart()
