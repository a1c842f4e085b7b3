"""Set-points: what each verb sends, and the stream that keeps the latest one alive until another takes its place.

50 times a second, as the real ground station; in lockstep at every fifth tick of the drone, each stamped with its tick.
The stream ends with its process: then the drone's failsafe acts, which is what it is for.
"""

import asyncio
from contextlib import suppress
from math import degrees, isfinite, pi

from twodof.errors import LinkLost, ParameterError, shown
from twodof.gcs.clock import SETPOINT_TICKS, DroneClock, SliceStarts
from twodof.gcs.session import DroneSession
from twodof.link.mavlink.setpoints import (
    SetPoint,
    setpoint_message,
)
from twodof.signals import ATTITUDE, OPEN_LOOP, POSITION, RATE, VELOCITY

PERIOD_S = 0.02
MOST_PITCH, MOST_RATE = pi / 2, 60.0
"""[rad], [rad/s]: beyond them degrees were meant; 60 rad/s is more than the gyro measures."""
MOST_WAY, MOST_SPEED = 1.0, 5.0
"""[m], [m/s]: beyond them millimetres were meant; the rail is shorter."""


def modes(setpoint: SetPoint) -> tuple[str, ...]:
    """Return the modes in which a set-point is followed, the best one first."""
    return ("manual", "offboard") if setpoint.loop == OPEN_LOOP else ("offboard",)


def moment(M: float, thrust: float | None) -> SetPoint:
    """Normalised pitch moment without a loop; thrust None leaves the thrust as it is."""
    return SetPoint(OPEN_LOOP, M_open=_fraction("M", M, -1.0), thrust=None if thrust is None else _thrust(thrust))


def pitch(theta: float, thrust: float) -> SetPoint:
    """Pitch [rad]; thrust 0 to 1."""
    return SetPoint(ATTITUDE, theta0=_within("theta", theta, MOST_PITCH, "rad"), thrust=_thrust(thrust))


def pitch_rate(q: float, thrust: float) -> SetPoint:
    """Pitch rate [rad/s]; thrust 0 to 1."""
    return SetPoint(RATE, q0=_within("q", q, MOST_RATE, "rad/s"), thrust=_thrust(thrust))


def velocity(v: float, acceleration: float | None) -> SetPoint:
    """Velocity along the rail [m/s], with an acceleration [m/s^2] fed forward if it is given."""
    return SetPoint(VELOCITY, v0=_within("v", v, MOST_SPEED, "m/s"), ax0=_acceleration(acceleration))


def position(x: float, acceleration: float | None) -> SetPoint:
    """Position along the rail [m], with an acceleration [m/s^2] fed forward if it is given."""
    return SetPoint(POSITION, x0=_within("x", x, MOST_WAY, "m"), ax0=_acceleration(acceleration))


def _acceleration(acceleration: float | None) -> float | None:
    return None if acceleration is None else _number("acceleration", acceleration)


def _thrust(thrust: float) -> float:
    return _fraction("thrust", thrust, 0.0)


def _fraction(name: str, value: float, least: float) -> float:
    found = _number(name, value)
    if not least <= found <= 1.0:
        raise ParameterError(f"{name} = {found:g} is outside {least:g} to 1", "set-point", "nothing was sent")
    return found


def _within(name: str, value: float, most: float, unit: str) -> float:
    found = _number(name, value)
    if abs(found) <= most:
        return found
    what, remedy = f"{name} = {found:g} {unit} is beyond {most:g} {unit}", f"it is in {unit}"
    if unit.startswith("rad"):
        in_degrees = f"{degrees(found):.0f} {unit.replace('rad', 'deg')}, beyond {degrees(most):.0f}"
        what = f"angles are in radians: {name} = {found:g} {unit} is {in_degrees}"
        remedy = f"write radians({found:g}) if that was meant"
    raise ParameterError(what, "set-point", f"{remedy}; nothing was sent")


def _number(name: str, value: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise ParameterError(f"{name} = {shown(value)} is not a finite number", "set-point", "nothing was sent")
    return float(value)


class SetpointStream:
    """The stream of the latest set-point, one for each drone."""

    def __init__(self, session: DroneSession, clock: DroneClock) -> None:
        self._session, self._clock = session, clock
        self.current: SetPoint | None = None
        self.sent = 0
        self._next_tick = 0
        self._streaming: asyncio.Task[None] | None = None
        session.on(self._slice, SliceStarts)

    def hold(self, setpoint: SetPoint) -> None:
        """Send it now and keep sending it. Raises LinkLost."""
        self.current = setpoint
        self._next_tick = self._clock.tick
        if self._clock.granting:
            self._send(self._clock.tick)
        elif self._streaming is None or self._streaming.done():
            self._send(0)
            self._streaming = asyncio.get_running_loop().create_task(self._stream())
        else:
            self._send(0)

    def back_to(self, setpoint: SetPoint | None) -> None:
        """Keep this one alive instead of the latest, or none."""
        if setpoint is None:
            self.stop()
        else:
            self.current = setpoint

    def stop(self) -> None:
        """Send no more."""
        self.current = None
        if self._streaming is not None:
            self._streaming.cancel()
            self._streaming = None

    async def _stream(self) -> None:
        loop = asyncio.get_running_loop()
        due = loop.time()
        with suppress(LinkLost):  # the next call says so
            while self.current is not None:
                # After a pause of the machine it goes on from now: set-points of the past are worth nothing.
                due = max(due + PERIOD_S, loop.time())
                await asyncio.sleep(due - loop.time())
                self._send(0)

    def _slice(self, granted: SliceStarts) -> None:
        """Send those that belong to these ticks, before they are granted."""
        self._next_tick = max(self._next_tick, granted.tick)
        while self.current is not None and self._next_tick < granted.until:
            self._send(self._next_tick)

    def _send(self, tick: int) -> None:
        if self.current is None:
            return
        self._session.send(setpoint_message(self.current, tick, **self._session.target))
        self.sent += 1
        self._next_tick = tick + SETPOINT_TICKS
