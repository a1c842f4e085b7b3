"""Set-points: their bounds, the mode that follows each, and the stream that repeats the latest one.

The stream sends at 50 Hz, as the real ground station, and in lockstep at every fifth tick, stamped with that tick. It
ends with its process: then the drone's failsafe acts.
"""

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress
from math import ceil, degrees, pi
from types import MappingProxyType
from typing import Any

from twodof.errors import LinkLost, ParameterError, RefusalReason, Rejected, is_number, shown
from twodof.gcs.clock import SETPOINT_TICKS, DroneClock, SliceStarts
from twodof.gcs.commands import CommandSender
from twodof.gcs.drone_state import StateTracker
from twodof.gcs.lease import LeaseClient
from twodof.gcs.session import SILENT_S, Deadline, DroneSession, ProgramPaused
from twodof.link.mavlink.modes import custom_mode
from twodof.link.mavlink.setpoints import SetPoint, setpoint_message
from twodof.signals import ATTITUDE, OPEN_LOOP, POSITION, RATE, TICK_S, VELOCITY

PERIOD_S = 0.02
LATE_S = 0.4
"""Delay of a set-point [s] after which the failsafe soon levels the drone (SAFE_SP_T)."""
AXES: Mapping[str, tuple[int, str, float, str]] = MappingProxyType(
    {
        "M": (OPEN_LOOP, "M_open", 1.0, ""),
        "theta": (ATTITUDE, "theta0", pi / 2, "rad"),
        "q": (RATE, "q0", 60.0, "rad/s"),
        "v": (VELOCITY, "v0", 5.0, "m/s"),
        "x": (POSITION, "x0", 1.0, "m"),
    }
)
"""Loop, field of SetPoint, largest value and unit of each set-point.

A larger angle was probably meant in degrees, a larger way in millimetres; 60 rad/s is more than the gyro measures.
"""
# Offboard is refused until set-points have come for a while; they are sent meanwhile.
_MODE_RETRY_S = 0.1
_MESSAGES = ("SET_ATTITUDE_TARGET", "SET_POSITION_TARGET_LOCAL_NED", "TWODOF_OPENLOOP")
_REASONS = {
    RefusalReason.LEASE: "another client holds the lease",
    RefusalReason.RINGS: "it moves the cart, and the rings lock it",
    RefusalReason.INVALID: "a number is not finite or outside its bounds",
    RefusalReason.QUEUE: "too many wait, or its time is more than a minute ahead",
    RefusalReason.NOTHING: "it asks for nothing that this drone can fly",
}


def modes(setpoint: SetPoint) -> tuple[str, ...]:
    """Return the modes in which a set-point is followed, the best one first."""
    return ("manual", "offboard") if setpoint.loop == OPEN_LOOP else ("offboard",)


def setpoint(axis: str, value: float, thrust: float | None = None, acceleration: float | None = None) -> SetPoint:
    """Return a set-point of one of AXES.

    `thrust` is 0 to 1, None leaves it unchanged; `acceleration` [m/s^2] along the rail is fed forward. Raises
    ParameterError for a number that is not finite or beyond its bounds.
    """
    loop, field, most, unit = AXES[axis]
    given: dict[str, Any] = {field: _within(axis, value, -most, most, unit)}
    if thrust is not None:
        given["thrust"] = _within("thrust", thrust, 0.0, 1.0)
    if acceleration is not None:
        given["ax0"] = _number("acceleration", acceleration)
    return SetPoint(loop, **given)


def _within(name: str, value: float, least: float, most: float, unit: str = "") -> float:
    found = _number(name, value)
    if least <= found <= most:
        return found
    what, remedy = f"{name} = {found:g} is outside {least:g} to {most:g}", "give a value within"
    if unit:
        what, remedy = f"{name} = {found:g} {unit} is beyond {most:g} {unit}", f"give it in {unit}"
    if unit.startswith("rad"):
        in_degrees = f"{degrees(found):.0f} {unit.replace('rad', 'deg')}, beyond {degrees(most):.0f}"
        what = f"angles are in radians: {name} = {found:g} {unit} is {in_degrees}"
        remedy = f"write radians({found:g}) if that was meant"
    raise ParameterError(what, "set-point", f"{remedy}; nothing was sent")


def _number(name: str, value: float) -> float:
    if not is_number(value):
        remedy = "give a finite number; nothing was sent"
        raise ParameterError(f"{name} = {shown(value)} is not a finite number", "set-point", remedy)
    return float(value)


class SetpointStream:
    """Stream that repeats the latest set-point to one drone, and enters a mode that follows it."""

    def __init__(
        self,
        session: DroneSession,
        clock: DroneClock,
        watcher: StateTracker,
        commands: CommandSender,
        lease: LeaseClient,
    ) -> None:
        self._session, self._clock, self._watcher = session, clock, watcher
        self._commands, self._lease = commands, lease
        self.current: SetPoint | None = None
        self.sent = 0
        self._next_tick = 0
        self._streaming: asyncio.Task[None] | None = None
        session.on(self._slice, SliceStarts)

    async def follow(self, setpoint: SetPoint, deadline: Deadline) -> None:
        """Stream a set-point and enter a mode in which it is followed. Raises Rejected, LinkLost, Timeout.

        A refusal of the mode is tried again while the set-point streams. If the call fails, the stream goes on with the
        set-point before.
        """
        if setpoint.moves_cart and self._session.ours and self._watcher.state.rig.rings_locked:
            # The drone's own refusal comes once a second at most, and in offboard not at all.
            raise self._refusal(RefusalReason.RINGS, deadline)
        self._watcher.check_not_killed()
        before = self.current
        self._commands.refusals.clear()
        self.hold(setpoint)
        try:
            await self._enter(setpoint, deadline)
        except BaseException:
            if before is None:
                self.stop()
            else:
                self.current = before
            raise

    async def switch(self, mode: str, deadline: Deadline) -> None:
        """Ask for a mode by its name. Raises ParameterError for an unknown one, Rejected, LinkLost, Timeout."""
        number = custom_mode(mode)
        values = [1.0, float(number >> 16 & 0xFF), float(number >> 24 & 0xFF)]
        await self._commands.run("DO_SET_MODE", values, max(0.01, deadline.left), deadline.doing)

    async def pass_time(
        self,
        tick: int,
        condition: Callable[[], bool] | None = None,
        within: Deadline | None = None,
        patience: float | None = None,
    ) -> None:
        """Let the drone's time pass up to a tick or until `condition()`. Raises as DroneClock.run_until.

        A kill ends the stream and raises Rejected.
        """

        def killed() -> bool:
            return self._watcher.state.killed and self.current is not None

        def done() -> bool:
            return killed() or (condition is not None and condition())

        await self._clock.run_until(tick, condition if self._clock.granting else done, within, patience)
        if killed():
            self.stop()
            self._watcher.check_not_killed()

    def hold(self, setpoint: SetPoint) -> None:
        """Send a set-point now and keep sending it. Raises LinkLost."""
        self.current = setpoint
        self._next_tick = self._clock.tick
        self._send(self._clock.tick if self._clock.granting else 0)
        if not self._clock.granting and (self._streaming is None or self._streaming.done()):
            self._streaming = asyncio.get_running_loop().create_task(self._stream())

    def stop(self) -> None:
        """End the stream."""
        self.current = None
        if self._streaming is not None:
            self._streaming.cancel()
            self._streaming = None

    async def _enter(self, setpoint: SetPoint, deadline: Deadline) -> None:
        """Enter the first mode of a set-point that streams, unless a mode in which it is followed flies already."""
        good = modes(setpoint)
        if self._watcher.state.mode in good:
            self._check_lease(deadline)
            return
        # Offboard needs set-points that keep coming.
        if self._clock.granting:
            self.hold(setpoint)
        else:
            await asyncio.sleep(2.5 * PERIOD_S)
        while self._watcher.state.mode not in good:
            try:
                await self.switch(good[0], deadline)
                await self._watcher.wait_until(lambda state: state.mode in good, deadline)
            except Rejected:
                for name in _MESSAGES:
                    if name in self._commands.refusals:  # waiting does not change such a refusal
                        raise self._refusal(self._commands.refusals[name], deadline) from None
                if deadline.left < _MODE_RETRY_S:
                    raise
                await self.pass_time(self._clock.tick + ceil(_MODE_RETRY_S / TICK_S), within=deadline)

    def _refusal(self, code: RefusalReason, deadline: Deadline) -> Rejected:
        remedy = "remove this cause and try again"
        if code is RefusalReason.RINGS:
            virtual = self._watcher.state.rig.virtual
            remedy = "disarm and drone.reset(rings=False)" if virtual else "take the rings off"
        reason = _REASONS.get(code, "see drone.messages for the drone's reason")
        return Rejected(f"set-point refused: {reason}", deadline.where, remedy, code)

    def _check_lease(self, deadline: Deadline) -> None:
        """Raise Rejected if another client is known to hold the lease: set-points have no answer."""
        holder = self._lease.holder
        if holder is not None and not self._lease.ours:
            self.stop()
            what = f"system {holder[0]}, component {holder[1]} holds the lease"
            raise Rejected(what, deadline.where, "wait until it is given up")

    async def _stream(self) -> None:
        loop = asyncio.get_running_loop()
        due = loop.time()
        with suppress(LinkLost):  # the next call raises it
            while self.current is not None:
                # After a pause of the machine it goes on from now: set-points of the past are worth nothing.
                due = max(due + PERIOD_S, loop.time())
                await asyncio.sleep(due - loop.time())
                self._send(0)
                if LATE_S < loop.time() - due <= SILENT_S:  # after a longer pause the session ends
                    self._session.emit(ProgramPaused(loop.time() - due))

    def _slice(self, granted: SliceStarts) -> None:
        """Send the set-points of these ticks before the ticks are granted."""
        self._next_tick = max(self._next_tick, granted.tick)
        while self.current is not None and self._next_tick < granted.until:
            self._send(self._next_tick)

    def _send(self, tick: int) -> None:
        if self.current is None:
            return
        self._session.send(setpoint_message(self.current, tick, **self._session.target))
        self.sent += 1
        self._next_tick = tick + SETPOINT_TICKS
