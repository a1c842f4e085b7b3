"""Set-points: SET_ATTITUDE_TARGET, SET_POSITION_TARGET_LOCAL_NED, MANUAL_CONTROL and TWODOF_OPENLOOP."""

from collections import OrderedDict
from collections.abc import Callable
from typing import Any

from twodof.fcu.command.commander import Commander
from twodof.fcu.command.result import CommandResult, Source, denied
from twodof.fcu.command.setpoints import SetPoint
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.addressing import VehicleAddress, source
from twodof.fcu.mavlink.service import Explain, Service
from twodof.fcu.mavlink.wire_tick import acts_at, acts_at_ms
from twodof.link.connection import Received
from twodof.link.mavlink.setpoints import SetpointTarget, read_attitude, read_position
from twodof.signals import ATTITUDE, POSITION, RATE, VELOCITY

TOLD_TICKS = 250
"""A refusal is told in words once a second at most to each source; all are counted."""
MOST_TOLD = 16
"""Sources that are told in a second; a flood under ever new numbers costs no more words."""

FULL_STICK = 1000
"""MANUAL_CONTROL's largest value."""


class SetpointService(Service):
    """Hands set-points to the commander, and tells a client why one is refused.

    In lockstep `time_boot_ms` names the tick at which one acts; in real time it is a clock that nobody knows, and it
    acts at once.
    """

    def __init__(self, us: VehicleAddress, commander: Commander, tell: Explain) -> None:
        self._us = us
        self._commander = commander
        self._tell = tell
        self._tick = 0
        self._told: OrderedDict[Source, int] = OrderedDict()  # when each was told last, the oldest first
        self._readers: dict[str, Callable[[Any, Source], CommandResult]] = {
            "SET_ATTITUDE_TARGET": lambda got, sender: self._target(read_attitude(got), got, sender),
            "SET_POSITION_TARGET_LOCAL_NED": lambda got, sender: self._target(read_position(got), got, sender),
            "TWODOF_OPENLOOP": self._open_loop,
            "MANUAL_CONTROL": self._sticks,
        }

    def handle(self, received: Received) -> bool:
        """Takes a set-point."""
        got, sender = received.message, source(received)
        read = self._readers.get(got.get_type())
        if read is None:
            return False
        ours = got.target in (self._us.system, 0) if read == self._sticks else self._us.addressed(got, everybody=True)
        if ours and sender != tuple(self._us):
            result = read(got, sender)
            if not result.accepted and self._may_tell(sender):
                self._tell(received.peer, result.text)
        return True

    def after(self, step: ControlStep) -> None:
        self._tick = step.tick

    def restart(self) -> None:
        self._tick = 0
        self._told.clear()

    def _may_tell(self, sender: Source) -> bool:
        """Whether it was not told just now, and not too many others were."""
        while self._told and self._tick - next(iter(self._told.values())) >= TOLD_TICKS:
            self._told.popitem(last=False)
        if sender in self._told or len(self._told) >= MOST_TOLD:
            return False
        self._told[sender] = self._tick
        return True

    def _target(self, target: SetpointTarget | None, got: Any, sender: Source) -> CommandResult:
        if target is None:
            self._commander.refused["nothing"] += 1
            return denied("set-point refused: it asks for nothing that is flown here")
        thrust = target.thrust
        forward = 0.0 if target.feed_forward is None else target.feed_forward
        setpoint = SetPoint(None, thrust=thrust)
        if target.loop == "attitude":
            setpoint = SetPoint(ATTITUDE, theta0=target.value, thrust=thrust)
        elif target.loop == "rate":
            setpoint = SetPoint(RATE, q0=target.value, thrust=thrust)
        elif target.loop == "velocity":
            setpoint = SetPoint(VELOCITY, v0=target.value, ax0=forward)
        elif target.loop == "position":
            setpoint = SetPoint(POSITION, x0=target.value, ax0=forward)
        at_tick = acts_at_ms(got.time_boot_ms, self._tick) if self._commander.lockstep else 0
        return self._commander.setpoint(sender, setpoint, at_tick)

    def _open_loop(self, got: Any, sender: Source) -> CommandResult:
        flags = bool(got.openloop), bool(got.enableM), bool(got.enableT)
        return self._commander.open_loop(sender, got.M, got.T, *flags, at_tick=acts_at(got.tick, self._tick))

    def _sticks(self, got: Any, sender: Source) -> CommandResult:
        return self._commander.sticks(sender, got.x / FULL_STICK, got.z / FULL_STICK)
