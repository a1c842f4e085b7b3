"""How a drone is flown: armed, in a mode, after set-points, while its time passes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from math import ceil, inf

from twodof.errors import ParameterError, RefusalReason, Rejected, Timeout, shown
from twodof.gcs import setpoints
from twodof.gcs.drone_base import TIMEOUT_S, DroneBase
from twodof.gcs.session import Deadline
from twodof.link.mavlink.modes import custom_mode
from twodof.link.mavlink.setpoints import SetPoint
from twodof.signals import TICK_S

HOVER = "THRUST_BAR"
# Offboard is refused until set-points have come for a while; they are sent meanwhile.
_MODE_RETRY_S = 0.1
_SETPOINTS = ("SET_ATTITUDE_TARGET", "SET_POSITION_TARGET_LOCAL_NED", "TWODOF_OPENLOOP")
_REASONS = {
    RefusalReason.LEASE: "another client holds the lease",
    RefusalReason.RINGS: "it moves the cart, and the rings lock it",
    RefusalReason.INVALID: "a number is not finite or outside its bounds",
    RefusalReason.QUEUE: "too many wait, or it is more than a minute ahead",
    RefusalReason.NOTHING: "it asks for nothing that is flown here",
}
_FOLLOWING = "changing to a mode in which set-points are followed"


class FlyingDrone(DroneBase):
    """A drone that follows set-points; what is refused raises Rejected, and is not flown later either."""

    async def arm(self, timeout: float = TIMEOUT_S) -> None:
        """Arm it, and see that it is. Raises Rejected with what speaks against it."""
        deadline = self.session.deadline(timeout, "arming")
        self.session.check(self.session.now)
        self._may_be_armed = True
        await self.commands.run("COMPONENT_ARM_DISARM", [1.0], timeout, "arming")
        await self._see(lambda: self.state.armed, deadline)

    async def set_mode(self, mode: str, timeout: float = TIMEOUT_S) -> None:
        """Change the mode (manual, rate, attitude, position, hold, offboard), and see that it is changed."""
        deadline = self.session.deadline(timeout, f"changing to the mode {mode}")
        number = custom_mode(mode)
        await self._switch(number, deadline)
        remedy = (
            "offboard wants set-points: set_pitch and the like enter it by themselves" if mode == "offboard" else ""
        )
        await self._see(lambda: self.state.mode == mode, deadline, remedy)

    async def _switch(self, number: int, deadline: Deadline) -> None:
        values = [1.0, float(number >> 16 & 0xFF), float(number >> 24 & 0xFF)]
        await self.commands.run("DO_SET_MODE", values, max(0.01, deadline.left), deadline.doing)

    async def level_hold(self, timeout: float = TIMEOUT_S) -> None:
        """Let it hold itself level, at the thrust THRUST_BAR; needs no set-points."""
        await self.set_mode("hold", timeout)
        self.setpoints.stop()

    async def set_moment(self, M: float, thrust: float | None = None, timeout: float = TIMEOUT_S) -> None:
        """Fly a normalised pitch moment (-1 to 1) about the trim, no loop closed; `thrust` 0 to 1, None: as it is."""
        setpoint = setpoints.moment(M, thrust)
        self._needs_ours("a moment without a loop", "TWODOF_OPENLOOP")
        await self._follow(setpoint, self.session.deadline(timeout, _FOLLOWING))

    async def set_pitch(self, theta: float, thrust: float | None = None, timeout: float = TIMEOUT_S) -> None:
        """Follow a pitch [rad]; `thrust` 0 to 1, None: the last one given, at first the parameter THRUST_BAR."""
        deadline = self.session.deadline(timeout, _FOLLOWING)
        await self._follow(setpoints.pitch(theta, await self._thrust(thrust, deadline)), deadline)

    async def set_pitch_rate(self, q: float, thrust: float | None = None, timeout: float = TIMEOUT_S) -> None:
        """Follow a pitch rate [rad/s]; `thrust` as in `set_pitch`."""
        deadline = self.session.deadline(timeout, _FOLLOWING)
        await self._follow(setpoints.pitch_rate(q, await self._thrust(thrust, deadline)), deadline)

    async def set_velocity(self, v: float, acceleration: float | None = None, timeout: float = TIMEOUT_S) -> None:
        """Follow a velocity along the rail [m/s], with an acceleration [m/s^2] fed forward."""
        await self._follow(setpoints.velocity(v, acceleration), self.session.deadline(timeout, _FOLLOWING))

    async def set_position(self, x: float, acceleration: float | None = None, timeout: float = TIMEOUT_S) -> None:
        """Follow a position along the rail [m], with an acceleration [m/s^2] fed forward."""
        await self._follow(setpoints.position(x, acceleration), self.session.deadline(timeout, _FOLLOWING))

    async def withhold_tuning(self, withhold: bool = True, timeout: float = TIMEOUT_S) -> None:
        """Let nobody else change parameters while we command, or (`withhold` False) let them again, as at first.

        Raises Rejected where somebody else commands, or nobody does.
        """
        self._needs_ours("withholding tuning", "TWODOF_LEASE")
        await self.lease.withhold_tuning(withhold, timeout)

    def stop_setpoints(self) -> None:
        """Send no more set-points: after .5 s the drone levels itself."""
        self.setpoints.stop()

    async def _thrust(self, thrust: float | None, deadline: Deadline) -> float:
        if thrust is not None:
            self._last_thrust = thrust
        if self._last_thrust is not None:
            return self._last_thrust
        if not self.ours:
            raise ParameterError("nothing says which thrust lets it hover", "set-point", "give thrust=")
        return await self.parameters.read(HOVER, deadline.left)

    async def _follow(self, setpoint: SetPoint, deadline: Deadline) -> None:
        """Stream it, and switch to a mode in which it is followed; refusals are tried again while it streams."""
        if setpoint.moves_cart and self.ours and self.state.rig.rings_locked:
            # In words the drone says so once a second at most, and where offboard flies already there is no answer.
            raise self._not_taken(RefusalReason.RINGS, deadline)
        self._not_killed(deadline)
        before = self.setpoints.current
        self.commands.refusals.clear()
        self.setpoints.hold(setpoint)
        try:
            await self._enter(setpoint, deadline)
        except BaseException:
            self.setpoints.back_to(before)  # what a call that failed has asked for is not to fly later
            raise

    async def _enter(self, setpoint: SetPoint, deadline: Deadline) -> None:
        """Switch to the first mode of a set-point that is streamed, unless one in which it is followed flies."""
        modes = setpoints.modes(setpoint)
        if self.state.mode in modes:
            self._must_command(deadline)
            return
        # Offboard wants to see that they keep coming.
        if self.clock.granting:
            self.setpoints.hold(setpoint)
        else:
            await asyncio.sleep(2.5 * setpoints.PERIOD_S)
        while self.state.mode not in modes:
            try:
                await self._switch(custom_mode(modes[0]), deadline)
                await self._see(lambda: self.state.mode in modes, deadline)
            except Rejected:
                for code in [self.commands.refusals[name] for name in _SETPOINTS if name in self.commands.refusals]:
                    # No waiting lets offboard be entered.
                    raise self._not_taken(code, deadline) from None
                if deadline.left < _MODE_RETRY_S:
                    raise
                await self._pass(self.tick + ceil(_MODE_RETRY_S / TICK_S), None, deadline)

    def _not_killed(self, deadline: Deadline) -> None:
        """A drone that was killed takes set-points and flies none: raise Rejected."""
        if self.state.killed:
            by = self.state.safety.killed_by
            who = f" by system {by[0]}, component {by[1]}" if by is not None else ""
            raise Rejected(f"it was killed{who}", deadline.where, "see why, then drone.release(), and arm it again")

    def _not_taken(self, code: RefusalReason, deadline: Deadline) -> Rejected:
        remedy = "put right what it says and try again"
        if code is RefusalReason.RINGS:
            virtual = self.state.rig.virtual
            remedy = "disarm and drone.reset(rings=False)" if virtual else "take the rings off"
        reason = _REASONS.get(code, "drone.messages has its reason")
        return Rejected(f"set-point refused: {reason}", deadline.where, remedy, code)

    def _must_command(self, deadline: Deadline) -> None:
        """Set-points have no answer: raise Rejected where the drone is known to listen to somebody else."""
        holder = self.lease.holder
        if holder is not None and not self.lease.ours:
            self.setpoints.stop()
            raise Rejected(
                f"system {holder[0]}, component {holder[1]} holds the lease",
                deadline.where,
                "wait until it is given up",
            )

    async def run(self, seconds: float) -> None:
        """Let the drone's time pass.

        Raises ParameterError for a time that is negative or infinite, LinkLost, Timeout if its time stands still,
        Rejected if a kill ends a flight.
        """
        if not 0.0 <= seconds < inf:
            raise ParameterError(f"run({shown(seconds)}): time passes forwards", "drone", "give 0 or more seconds")
        await self.run_until(self.tick + ceil(max(0.0, seconds / TICK_S - 1e-9)))

    async def run_until(self, tick: int) -> None:
        """Let the drone's time pass up to a tick, which is the first not run. Raises as `run`."""
        await self._pass(tick, None)

    async def wait_until(self, condition: Callable[[], bool], timeout: float) -> None:
        """Let the drone's time pass until `condition()`, asked each 20 ms of it; Timeout after `timeout` [s] of it.

        Where its time stands still that is after as much of ours, but after 2 s at the soonest and 5 s at the latest.
        `condition` looks at what has come, and asks nothing.
        """
        await self._pass(self.tick + ceil(timeout / TICK_S), condition, patience=timeout)
        if not condition():
            raise Timeout(f"the condition did not come within {timeout:g} s", f"drone {self.session.system}")

    async def _pass(
        self,
        tick: int,
        condition: Callable[[], bool] | None,
        within: Deadline | None = None,
        patience: float | None = None,
    ) -> None:
        """Let its time pass up to a tick or until `condition()`; what is streamed to a drone that was killed ends."""

        def killed() -> bool:
            return self.state.killed and self.setpoints.current is not None

        def done() -> bool:
            return killed() or (condition is not None and condition())

        await self.clock.run_until(tick, condition if self.clock.granting else done, within, patience)
        if killed():
            self.setpoints.stop()
            self._not_killed(self.session.deadline(0.0, "flying"))
