"""Arming, disarming and the kill on board: requests to the failsafe, and its answers."""

from collections.abc import Callable

from twodof.fcu.command.command_lease import DONE, CommandLease, CommandResult, Source, VehicleState, failed, rejected
from twodof.fcu.command.setpoints import SetpointManager
from twodof.fcu.control.flight_code import ControlStep
from twodof.flight.failsafe.causes_and_actions import BIT, named_causes
from twodof.flight.failsafe.state_machine import DISARMED, MAY_TURN, REFUSED
from twodof.link.mavlink import modes
from twodof.link.mavlink.dialect import MavResult, MavSeverity

PATIENCE = 25
"""Ticks to wait for the failsafe's answer, which comes in the tick of the request."""


class ArmingControl:
    """Arming of the drone under conditions, and its disarming and kill by any sender.

    `arm_input` is the arm input of the flight code, `answer` the result of the last request to arm. `killed_by` is the
    sender of a kill, None without one. A kill keeps the drone disarmed, over disarmings and resets, until it is
    released. `unfit` returns a further reason against arming, "" if there is none.
    """

    def __init__(
        self,
        vehicle: VehicleState,
        setpoints: SetpointManager,
        lease: CommandLease,
        unfit: Callable[[], str],
        killed_by: Source | None = None,
    ) -> None:
        self.arm_input = False
        self.killed_by = killed_by
        self.answer = DONE
        self._vehicle = vehicle
        self.setpoints = setpoints
        self.lease = lease
        self._unfit = unfit
        self._request_tick = 0

    @property
    def pending(self) -> bool:
        """Return whether a request to arm still waits for the answer of the failsafe."""
        return self.answer.in_progress

    @property
    def flies(self) -> bool:
        """Return whether the drone is armed and no disarming is requested: only then a set-point acts."""
        return self._vehicle.armed and self.arm_input

    @property
    def causes_against(self) -> int | None:
        """Return the mask of causes against arming (`link_lost` only if the link is silent); None before a step."""
        step = self._vehicle.step
        if step is None:
            return None
        return step.causes & ~BIT["link_lost"] if self.lease.link_alive else step.causes

    def arm(self, source: Source, repeated: bool = False) -> CommandResult:
        """Ask the failsafe to arm. Return IN_PROGRESS if nothing is against it; a tick later `answer` has the result.

        A new request acknowledges an earlier stop by the failsafe. A `repeated` one, sent again for want of an answer,
        may be older than the stop and does not.
        """
        result = self.lease.take(source, "arming")
        if not result.accepted:
            return result
        if self.pending:
            return self.answer
        if self.flies:
            return DONE
        if self.arm_input and repeated:
            return rejected("not armed: the failsafe has stopped the motors, arm again")
        if against := self.obstacles():
            return rejected(f"not armed: {against}")
        # The failsafe arms on an edge: where it has not seen the last disarming yet, a tick later.
        return self.request(self._vehicle.now + (self._vehicle.failsafe != DISARMED))

    def disarm(self, source: Source) -> CommandResult:
        """Stop the motors in the next tick, on request of any source: on this rig that is the safe state."""
        if self.lease.holder == source:
            self.lease.take(source)  # which renews it
        self.cancel()
        self.setpoints.clear("disarmed", self._vehicle.now)
        return DONE

    def kill(self, source: Source) -> CommandResult:
        """Stop the motors in the next tick, on request of any source, and keep the drone disarmed until `release`."""
        self.killed_by = source
        self.cancel()
        self.setpoints.clear("killed", self._vehicle.now)
        self._vehicle.remark(MavSeverity.CRITICAL, f"killed by system {source[0]}, component {source[1]}")
        return DONE

    def release(self, source: Source) -> CommandResult:
        """End a kill, without arming; a disarming does not end it, since every program disarms at its end."""
        result = self.lease.take(source, "release")
        if result.accepted and self.killed_by is not None:
            self.killed_by = None
            self._vehicle.remark(MavSeverity.WARNING, f"released by system {source[0]}, component {source[1]}")
        return result

    def stop_motors(self, why: str, tick: int) -> None:
        """Stop the motors at `tick` without a command, and tell the clients `why`."""
        self.cancel()
        self.setpoints.clear(why, tick)
        self._vehicle.remark(MavSeverity.CRITICAL, why)

    def request(self, tick: int) -> CommandResult:
        """Ask the failsafe to arm at `tick`. It acts on a rising edge of `arm_input`, which is False until then."""
        self._request_tick = tick
        self.arm_input = False
        self.answer = CommandResult(MavResult.IN_PROGRESS)
        return self.answer

    def update_input(self, tick: int) -> None:
        """Set `arm_input` once its tick has come; called before each tick while an answer is pending."""
        self.arm_input = tick >= self._request_tick

    def cancel(self) -> None:
        """Clear `arm_input`; a pending arming fails."""
        self.arm_input = False
        if self.pending:
            self.answer = failed("disarmed before it had armed")

    def read_answer(self, step: ControlStep) -> None:
        """Read the failsafe's answer from a step; called after each tick while one is pending."""
        if step.tick < self._request_tick:
            return
        if step.state in MAY_TURN:
            self.answer = DONE
        elif step.state == REFUSED:
            self.arm_input = False
            # Without a cause the failsafe refuses since `level_lasts` or `brake_lasts` is not over.
            causes = ", ".join(named_causes(step.reason or step.causes)) or "it levelled or braked a moment ago"
            self.answer = rejected(f"not armed: {causes}")
        elif step.tick >= self._request_tick + PATIENCE:
            self.arm_input = False
            self.answer = failed("not armed: the flight code did not answer")

    def obstacles(self) -> str:
        """Return the reasons against arming a drone that is disarmed, "" if there are none."""
        return self._against_arming() or self._unfit()

    def _against_arming(self) -> str:
        rig, mode = self._vehicle.rig, self.setpoints.custom_mode
        if self.killed_by is not None:
            system, component = self.killed_by
            return f"killed by system {system}, component {component}: release it first (twodof kill --release)"
        # After a stop some causes last until the drone is disarmed, and a request to arm disarms it first.
        causes = 0 if self.arm_input else self.causes_against
        if causes is None:
            return "no sensor has sent a sample yet"
        if not rig.safety_off:
            return "safety switch, press it"
        names = dict.fromkeys(named_causes(causes))
        if rig.rings and modes.BY_NUMBER[mode].moves_cart:
            names["rings_wrong"] = None
        if self.setpoints.asks(self._vehicle.now):
            names["not_idle"] = None
        return ", ".join(names)
