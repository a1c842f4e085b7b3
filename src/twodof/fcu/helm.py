"""The helm: the mode, and the set-points that are flown in each tick. Who may turn it is not its affair."""

from __future__ import annotations

from typing import NamedTuple

from twodof.fcu.asked import Asked
from twodof.fcu.excitation_player import STOPPED, Player
from twodof.fcu.schedule import Schedule
from twodof.fcu.setpoints import ATTITUDE, IDLE, OFF, OPEN_LOOP, SetPoint, flown, idle
from twodof.flight.core import PERIOD
from twodof.link import modes

FRESH = round(0.5 / PERIOD)
"""Set-points must come above 2 Hz, as PX4 asks: at most so many ticks apart."""

TARGET, OPENLOOP, STICKS = "target", "open loop", "sticks"
"""Where a set-point comes from: SET_ATTITUDE_TARGET and the like, TWODOF_OPENLOOP, MANUAL_CONTROL."""

HEARD_IN = {
    modes.MANUAL: (OPENLOOP, STICKS),
    modes.RATE: (STICKS,),
    modes.ATTITUDE: (STICKS,),
    modes.POSITION: (STICKS,),
    modes.HOLD: (),
    modes.OFFBOARD: (TARGET, OPENLOOP),
}
"""Which set-points act in which mode."""


class OpenLoop(NamedTuple):
    """The open-loop message in use, as TWODOF_OPENLOOP has it; `revision` counts its changes."""

    tick: int = 0
    M: float = 0.0
    T: float = 0.0
    openloop: bool = False
    enableM: bool = False
    enableT: bool = False
    revision: int = 0


class Helm:
    """Mode, set-points in use, those on offer, those that wait, and the player of excitations."""

    def __init__(self) -> None:
        self.custom_mode = modes.MANUAL
        self.player = Player()
        self.schedule = Schedule()
        self.values = IDLE
        self.live = False  # something was asked for since it was armed
        self.on_board = False  # level hold or an excitation gives set-points at every tick
        self.fresh = False  # a set-point acted for the next tick
        self.changed = True
        self.offer = IDLE  # the latest of the messages, whether they act or not
        self._offered = self._before = self._latest_at = -10 * FRESH
        self._latest = IDLE  # the latest that acts in this mode, or would if the drone were armed

    def streamed(self, tick: int) -> bool:
        """Whether set-points have been coming above 2 Hz."""
        return tick - self._offered <= FRESH and self._offered - self._before <= FRESH

    def asks(self, tick: int) -> bool:
        """Whether set-points that are fresh ask the motors for something in this mode."""
        return tick - self._latest_at <= FRESH and not idle(self._latest)

    def heard(self, kind: str) -> bool:
        """Whether set-points of this kind act in the present mode."""
        return kind in HEARD_IN[self.custom_mode]

    def take(self, setpoint: SetPoint, kind: str, tick: int, armed: bool) -> None:
        """A set-point's tick has come: it acts, or is kept as an offer for when offboard is entered."""
        if kind != STICKS:
            self._before, self._offered = self._offered, tick
            self.offer = setpoint.over(self.offer)
        if not self.heard(kind):
            return
        self._latest, self._latest_at = setpoint.over(self._latest), tick
        if armed and not self.player.playing:
            self._use(setpoint.over(self.values))
            self.on_board = False

    def enter(self, custom_mode: int, level_thrust: float, armed: bool) -> None:
        """Changes the mode. Level hold flies from the next tick on if armed; offboard takes what is on offer."""
        if self.player.playing:
            self.player.finish(STOPPED, f"mode {modes.mode_name(custom_mode)} was chosen")
        self.custom_mode = custom_mode
        self.on_board = False
        offboard = custom_mode == modes.OFFBOARD
        self._latest, self._latest_at = (self.offer, self._offered) if offboard else (IDLE, -10 * FRESH)
        if not armed:
            return
        if custom_mode == modes.HOLD:
            self._use(self.values._replace(loop=ATTITUDE, theta0=0.0, thrust=level_thrust))
            self.on_board = True
        elif offboard:
            self._use(self.offer.over(self.values))

    def begin_play(self, level_thrust: float) -> None:
        """The excitation that waits begins: its loop is flown about the set-point in use, or about 0."""
        player, values = self.player, self.values
        loop = player.loop
        base = (getattr(values, loop.name) or 0.0) if self.live and flown(values) == loop.loop else 0.0
        thrust = player.thrust if player.thrust is not None else values.thrust or level_thrust
        self.values = values._replace(**{"loop": loop.loop, "thrust": thrust, loop.name: base})
        self.custom_mode = modes.OFFBOARD
        self.live = self.on_board = self.changed = True
        player.begin()

    def rest(self) -> None:
        """The motors are off, or were never on: nothing is asked for."""
        self.values, self.live, self.on_board, self.fresh = IDLE, False, False, False
        self.schedule.clear()
        self.changed = True

    def moved(self, ticks: int) -> None:
        """The count of ticks was changed by `ticks`."""
        self._offered += ticks
        self._before += ticks
        self._latest_at += ticks

    def asked(self, tick: int, arm: bool, link_new: bool) -> Asked:
        """What the flight code is asked at `tick`."""
        values = self.values
        mode = flown(values) if self.live and arm else OFF
        numbers = dict(zip(SetPoint._fields[1:], values[1:], strict=True))
        if self.player.playing:
            added = self.player.value(tick)
            if added is not None:
                name = self.player.loop.name
                numbers[name] = numbers[name] + added
        thrust = numbers["thrust"] or 0.0
        return Asked(
            mode,
            arm,
            numbers["x0"] or 0.0,
            numbers["v0"] or 0.0,
            numbers["ax0"] or 0.0,
            numbers["theta0"] or 0.0,
            numbers["q0"] or 0.0,
            thrust,
            numbers["M_open"] or 0.0,
            mode == OPEN_LOOP and thrust > 0.0,
            False,
            self.fresh or self.on_board,
            link_new,
        )

    def _use(self, values: SetPoint) -> None:
        self.values = values
        self.live = self.fresh = self.changed = True
