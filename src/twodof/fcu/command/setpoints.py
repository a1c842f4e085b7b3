"""Set-points of messages and sticks: which ones act in which mode, and which one flies in each tick."""

from bisect import insort
from collections.abc import Mapping
from operator import itemgetter
from types import MappingProxyType
from typing import NamedTuple

from twodof.fcu.command.excitation_player import REFUSED, STOPPED, OnboardPlayer
from twodof.fcu.control.hardware import ControlInput
from twodof.link.mavlink import modes
from twodof.link.mavlink.setpoints import NOTHING, SetPoint
from twodof.signals import ATTITUDE, OFF, OPEN_LOOP, PERIOD, POSITION, RATE, VELOCITY

HORIZON = round(60.0 / PERIOD)
"""Most ticks that a set-point or a start may lie ahead: a minute."""

TARGET, OPENLOOP, STICKS = "target", "open loop", "sticks"
"""Kinds of set-points by their message: SET_ATTITUDE_TARGET and the like, TWODOF_OPENLOOP, MANUAL_CONTROL."""


class OpenLoopState(NamedTuple):
    """Fields of the TWODOF_OPENLOOP in use; `tick` is when it began to act, `revision` counts the messages."""

    tick: int = 0
    M: float = 0.0
    T: float = 0.0
    openloop: bool = False
    enableM: bool = False
    enableT: bool = False
    revision: int = 0


RATE_AT_FULL = 1.75
"""Pitch rate at full stick [rad/s] (100 deg/s)."""

PITCH_AT_FULL = 0.35
"""Pitch at full stick [rad] (20 deg)."""

VELOCITY_AT_FULL = 0.3
"""Velocity at full stick [m/s]."""


def manual_setpoint(custom_mode: int, pitch: float, thrust: float, held: ControlInput, x: float) -> SetPoint:
    """Return the set-point of the sticks `pitch` (-1 to 1, forward: nose down, towards +x) and `thrust` (0 to 1).

    In position mode a centred stick holds the position: that of `held` if it is one, else `x` [m].
    """
    if custom_mode == modes.RATE:
        return SetPoint(RATE, q0=-RATE_AT_FULL * pitch, thrust=thrust)
    if custom_mode == modes.ATTITUDE:
        return SetPoint(ATTITUDE, theta0=-PITCH_AT_FULL * pitch, thrust=thrust)
    if custom_mode != modes.POSITION:
        return SetPoint(OPEN_LOOP, M_open=-pitch, thrust=thrust)
    if pitch != 0.0:
        return SetPoint(VELOCITY, v0=VELOCITY_AT_FULL * pitch, ax0=0.0)
    return SetPoint(POSITION, x0=held.x0 if held.mode == POSITION else x, ax0=0.0)


FRESH = round(0.5 / PERIOD)
"""Ticks for which a set-point is fresh: they must come above 2 Hz, as in PX4."""


class ModeRule(NamedTuple):
    """Rule of a mode: the kinds of set-points that act in it, and whether they must be streamed before it is entered.

    In a streamed mode a set-point may ask for thrust while the drone arms, as in PX4: mode and stream are two
    deliberate acts. In the other modes a set-point that asks something of the motors keeps the drone from arming.
    """

    acts: tuple[str, ...] = ()
    streamed: bool = False


RULES: Mapping[int, ModeRule] = MappingProxyType(
    {
        **{mode.custom_mode: ModeRule((STICKS,) if mode.sticks else ()) for mode in modes.MODES},
        modes.MANUAL: ModeRule((OPENLOOP, STICKS)),
        modes.OFFBOARD: ModeRule((TARGET, OPENLOOP), streamed=True),
    }
)
"""Rule of each mode, by custom_mode."""

CAPACITY = 256
"""Most set-points that wait for their tick."""

_LONG_AGO = -10 * FRESH


class SetpointManager:
    """Mode and set-points of the drone: the one in use, the target kept for offboard, and the queue of later ones.

    `player` plays an excitation. `changed` is True if `control_input` may return another value than the last time.
    """

    def __init__(self, openloop_revision: int = 0) -> None:
        self.custom_mode = modes.MANUAL
        self.player = OnboardPlayer()
        self.values = ControlInput()  # set-point in use; empty while disarmed, so an old one never flies
        self.openloop = OpenLoopState(revision=openloop_revision)
        self.changed = True
        # Set-points that wait for a tick, in its order, with their kinds; those of one tick as they came.
        self._queue: list[tuple[int, SetPoint, str, OpenLoopState | None]] = []
        self._on_board = False  # level hold or an excitation gives set-points, at every tick
        self._fresh = False  # a set-point came for the next tick
        self._target = NOTHING  # of all messages since the mode was entered, for offboard
        self._target_tick = _LONG_AGO
        self._target_message: OpenLoopState | None = None  # the open-loop message from which the target was made
        self._latest = ControlInput()  # set-point that would fly in this mode if the drone were armed
        self._latest_at = _LONG_AGO
        self._stick = 0.0, 0.0  # where pitch and thrust were held last
        self._stick_at = _LONG_AGO

    @property
    def rule(self) -> ModeRule:
        """Return the rule of the present mode."""
        return RULES[self.custom_mode]

    def streamed(self, tick: int) -> bool:
        """Return whether set-points have been coming above 2 Hz."""
        return tick - self._target_tick <= FRESH

    def asks(self, tick: int) -> bool:
        """Return whether fresh set-points ask something of the motors, in a mode in which that prevents arming."""
        fresh = not self.rule.streamed and tick - self._latest_at <= FRESH
        return fresh and not self._latest.idle

    def armed(self, tick: int) -> None:
        """Begin to fly the streamed set-point after the drone has armed in offboard."""
        if self.rule.streamed and self.streamed(tick):
            self._use(self.values.with_setpoint(self._target), tick, self._target_message)

    def take(self, setpoint: SetPoint, kind: str, tick: int, armed: bool, message: OpenLoopState | None = None) -> None:
        """Let a set-point act now, or keep it for offboard. `message` is the open-loop message that it comes from."""
        if kind != STICKS:
            self._target_tick, self._target_message = tick, message
            self._target = setpoint.after(self._target)
        if kind not in self.rule.acts:
            return
        self._latest, self._latest_at = self._latest.with_setpoint(setpoint), tick
        if armed and not self.player.playing:
            self._use(self.values.with_setpoint(setpoint), tick, message)

    def queue(self, tick: int, setpoint: SetPoint, kind: str, message: OpenLoopState | None = None) -> bool:
        """Keep a set-point until `tick`; return False if too many wait."""
        if len(self._queue) >= CAPACITY:
            return False
        insort(self._queue, (tick, setpoint, kind, message), key=itemgetter(0))
        return True

    def take_due(self, tick: int, armed: bool) -> None:
        """Let the set-points act that waited for `tick` or an earlier one."""
        while self._queue and self._queue[0][0] <= tick:
            _, setpoint, kind, message = self._queue.pop(0)
            self.take(setpoint, kind, tick, armed, message)

    def enter(self, custom_mode: int, level_thrust: float, tick: int, armed: bool) -> None:
        """Change the mode. If armed, the next tick flies level hold or, in offboard, the set-point kept for it."""
        if self.player.playing:
            self.player.finish(STOPPED, f"mode {modes.mode_name(custom_mode)} was chosen")
        self.custom_mode = custom_mode
        streams = self.rule.streamed
        self._on_board, self.changed = False, True
        self._forget_latest()
        if armed and custom_mode == modes.HOLD:
            self._use(self.values._replace(mode=ATTITUDE, theta0=0.0, thrust=level_thrust), tick, on_board=True)
        elif armed and streams:
            self._use(self.values.with_setpoint(self._target), tick, self._target_message)
        if not streams:
            self._target = NOTHING  # a target of an earlier offboard must not fly now

    def hold_stick(self, pitch: float, thrust: float, tick: int) -> None:
        """Note the stick's position at `tick`."""
        self._stick, self._stick_at = (pitch, thrust), tick

    def drop_waiting(self, why: str) -> int:
        """Forget set-points that wait or are kept for offboard, as another client steers; the one in use flies on.

        Return the number that waited. A waiting excitation is refused with the reason `why`.
        """
        waited = len(self._queue)
        self._queue.clear()
        self._target, self._target_message, self._target_tick = NOTHING, None, _LONG_AGO
        self._latest, self._latest_at, self._stick_at = ControlInput(), _LONG_AGO, _LONG_AGO
        if self.player.waiting:
            self.player.finish(REFUSED, why)
        return waited

    def begin_play(self, level_thrust: float, tick: int) -> None:
        """Begin the waiting excitation: about the set-point in use if its loop flies, else about 0."""
        player, values = self.player, self.values
        name = player.loop.name
        about = values
        if values.flown != player.loop.loop:
            about = values._replace(ax0=0.0).with_number(name, 0.0)
        thrust = player.thrust if player.thrust is not None else values.thrust or level_thrust
        self.custom_mode = modes.OFFBOARD
        flown = about._replace(mode=player.loop.loop, thrust=thrust)
        self._use(flown, tick, on_board=True)
        player.begin()

    def clear(self, why: str, tick: int) -> None:
        """Clear set-points, queue and excitation because the motors have stopped; `why` is for the excitation."""
        if self.player.playing or self.player.waiting:
            self.player.finish(STOPPED, why)
        self.values = ControlInput()
        self._forget_latest()
        self._target = NOTHING
        self._on_board, self._fresh, self.changed = False, False, True
        self._queue.clear()
        self._note_openloop(None, tick)

    def control_input(self, tick: int, arm: bool, link_new: bool) -> ControlInput:
        """Return the input of the flight code at `tick`."""
        values = self.values
        if self.player.playing:
            name = self.player.loop.name
            values = values.with_number(name, getattr(values, name) + self.player.value(tick))
        mode = values.flown if arm else OFF
        use_trim = mode == OPEN_LOOP and values.thrust > 0.0
        new = self._fresh or self._on_board
        # After a fresh input comes one without news; a player changes it at every tick, and once more at its end.
        self.changed, self._fresh = self._fresh or self.player.playing, False
        return values._replace(mode=mode, arm=arm, use_trim=use_trim, setpoint_new=new, link_new=link_new)

    def _forget_latest(self) -> None:
        """Clear the latest set-point in a new mode; a held stick gives it again with its next message."""
        self._latest, self._latest_at = ControlInput(), _LONG_AGO
        if STICKS in self.rule.acts:
            held = manual_setpoint(self.custom_mode, *self._stick, self.values, 0.0)
            self._latest = self._latest.with_setpoint(held)
            self._latest_at = self._stick_at

    def _use(
        self, values: ControlInput, tick: int, message: OpenLoopState | None = None, on_board: bool = False
    ) -> None:
        self.values, self._on_board = values, on_board
        self._fresh = self.changed = True
        self._note_openloop(message, tick)

    def _note_openloop(self, message: OpenLoopState | None, tick: int) -> None:
        """Note the open-loop message in use; None for a closed loop."""
        before = self.openloop
        now = (message or OpenLoopState())._replace(tick=before.tick, revision=before.revision)
        if now != before:
            self.openloop = now._replace(tick=tick, revision=before.revision + 1)
