"""Set-points: what each verb sends, and the stream that keeps the latest one alive until another takes its place.

50 times a second, as the real ground station; in lockstep at every fifth tick of the drone, each stamped with its tick.
The stream ends with its process: then the drone's failsafe acts, which is what it is for.
"""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from math import degrees, isfinite, nan, pi
from typing import Any

from twodof.errors import LinkLost, ParameterError, shown
from twodof.gcs.clock import SETPOINT_TICKS, DroneClock, SliceStarts
from twodof.gcs.session import DroneSession
from twodof.link.mavlink.messages import message
from twodof.link.mavlink.setpoints import attitude_target, position_target, rate_target, velocity_target
from twodof.signals import TICK_MS

PERIOD_S = 0.02
_MASK = 0xFFFFFFFF  # ticks and milliseconds begin anew where a uint32 does
MOST_PITCH, MOST_RATE = pi / 2, 60.0
"""[rad], [rad/s]: beyond them degrees were meant; 60 rad/s is more than the gyro measures."""
MOST_WAY, MOST_SPEED = 1.0, 5.0
"""[m], [m/s]: beyond them millimetres were meant; the rail is shorter."""


@dataclass(frozen=True)
class Setpoint:
    """What the drone shall follow, in one of its `modes`, the first is best: `make(tick, place)` is its message."""

    modes: tuple[str, ...]
    make: Callable[[int, dict[str, int]], Any]
    moves_cart: bool = False


def moment(M: float, thrust: float | None) -> Setpoint:
    """Normalised pitch moment without a loop; thrust None leaves the thrust as it is."""
    fields = {
        "M": _fraction("M", M, -1.0),
        "T": _thrust(thrust),
        "openloop": 1,
        "enableM": 1,
        "enableT": int(thrust is not None),
    }
    return Setpoint(
        ("manual", "offboard"), lambda tick, place: message("TWODOF_OPENLOOP", tick=tick & _MASK, **place, **fields)
    )


def pitch(theta: float, thrust: float) -> Setpoint:
    """Pitch [rad]; thrust 0 to 1."""
    return _attitude(attitude_target, _within("theta", theta, MOST_PITCH, "rad"), thrust)


def pitch_rate(q: float, thrust: float) -> Setpoint:
    """Pitch rate [rad/s]; thrust 0 to 1."""
    return _attitude(rate_target, _within("q", q, MOST_RATE, "rad/s"), thrust)


def velocity(v: float, acceleration: float | None) -> Setpoint:
    """Velocity along the rail [m/s], with an acceleration [m/s^2] fed forward if it is given."""
    return _along_rail(velocity_target, _within("v", v, MOST_SPEED, "m/s"), acceleration)


def position(x: float, acceleration: float | None) -> Setpoint:
    """Position along the rail [m], with an acceleration [m/s^2] fed forward if it is given."""
    return _along_rail(position_target, _within("x", x, MOST_WAY, "m"), acceleration)


def _attitude(make: Callable[..., Any], value: float, thrust: float) -> Setpoint:
    power = _thrust(thrust)
    return Setpoint(("offboard",), lambda tick, place: make(value, power, time_boot_ms=tick * TICK_MS & _MASK, **place))


def _along_rail(make: Callable[..., Any], value: float, acceleration: float | None) -> Setpoint:
    forward = nan if acceleration is None else _number("acceleration", acceleration)
    return Setpoint(
        ("offboard",), lambda tick, place: make(value, forward, time_boot_ms=tick * TICK_MS & _MASK, **place), True
    )


def _thrust(thrust: float | None) -> float:
    return _fraction("thrust", 0.0 if thrust is None else thrust, 0.0)


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
        self.current: Setpoint | None = None
        self.sent = 0
        self._next_tick = 0
        self._streaming: asyncio.Task[None] | None = None
        session.on(self._slice, SliceStarts)

    def hold(self, setpoint: Setpoint) -> None:
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

    def back_to(self, setpoint: Setpoint | None) -> None:
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
        self._session.send(self.current.make(tick, self._session.target))
        self.sent += 1
        self._next_tick = tick + SETPOINT_TICKS
