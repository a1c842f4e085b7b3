"""The commander: who may command, and whether what is commanded is done. No I/O, and no clock but the ticks it is told.

Every command is answered by a Verdict. The rules are in docs/protocol.md: lease, modes, set-points, excitation.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from math import isfinite
from typing import Protocol

from twodof.fcu.arming import Arming
from twodof.fcu.asked import ACCEPTED, DENIED, TEMPORARILY_REJECTED, UNSUPPORTED, Asked, Source, Verdict
from twodof.fcu.excitation_player import LOOPS, READY, REFUSED, STOPPED, Player, Prepared
from twodof.fcu.flight_code import Step
from twodof.fcu.helm import STICKS, TARGET, Helm, OpenLoop
from twodof.fcu.lease import Lease
from twodof.fcu.schedule import HORIZON
from twodof.fcu.setpoints import ATTITUDE, OPEN_LOOP, POSITION, RATE, VELOCITY, SetPoint
from twodof.flight.causes import ACTIONS, BIT, named_causes
from twodof.flight.core import PERIOD
from twodof.flight.failsafe_machine import DISARMED, OFF
from twodof.link import modes

_DONE = Verdict(ACCEPTED)


class Rig(Protocol):
    """What the commander asks of the hardware."""

    @property
    def rings(self) -> bool:
        """Whether the rings lock the cart."""

    @property
    def safety_off(self) -> bool:
        """Whether the safety switch was pressed."""


class Commander:
    """Decides over one drone.

    `rig` says whether rings and safety switch are set; `level_thrust` gives the thrust of a level hold (THRUST_BAR).
    With `lockstep` the time that passes was granted by a client, so the link counts as alive in every tick.
    `remarks` are (MAV_SEVERITY, text) to be told to the clients, for whoever drains it; `refused` counts set-points
    that did not act, by reason.
    """

    def __init__(self, rig: Rig, level_thrust: Callable[[], float] = lambda: 0.4, lockstep: bool = False) -> None:
        self.rig = rig
        self.lockstep = lockstep
        self.lease = Lease()
        self.openloop = OpenLoop()
        self.remarks: list[tuple[int, str]] = []
        self.refused: Counter[str] = Counter()
        self.step: Step | None = None
        self._level_thrust = level_thrust
        self._helm = Helm()
        self._arming = Arming()
        self._now = 0  # the first tick that was not asked for yet: what is commanded acts there
        self._link = False
        self._state = DISARMED
        self._armed = False
        self._asked = Asked()

    # What it says of itself.

    @property
    def armed(self) -> bool:
        """Whether the motors may turn, as the failsafe last said."""
        return self._armed

    @property
    def killed(self) -> bool:
        """Whether a kill holds it disarmed."""
        return self._arming.killed

    @property
    def custom_mode(self) -> int:
        """The mode as HEARTBEAT carries it."""
        return self._helm.custom_mode

    @property
    def base_mode(self) -> int:
        """MAV_MODE_FLAG, as PX4 sets it."""
        mode = self._helm.custom_mode
        flags = _CUSTOM | (_ARMED if self._armed else 0)
        if mode in (modes.MANUAL, modes.RATE, modes.ATTITUDE, modes.POSITION):
            flags |= _MANUAL
        if mode not in (modes.MANUAL, modes.RATE):
            flags |= _STABILIZE
        return flags | (_AUTO | _GUIDED if mode == modes.HOLD else 0)

    @property
    def system_status(self) -> int:
        """MAV_STATE: active, critical while the failsafe acts, standby or, where it would not arm, 0."""
        if self._arming.killed:
            return _TERMINATED
        if self._armed and self.step is not None:
            return _CRITICAL if self.step.action else _ACTIVE
        return _STANDBY if self.step is not None and not self._missing() else 0

    @property
    def modes(self) -> tuple[modes.Mode, ...]:
        """What `set_mode` knows."""
        return modes.MODES

    @property
    def arming(self) -> Verdict:
        """What became of the last `arm`; IN_PROGRESS until the failsafe has answered, some ticks at most."""
        return self._arming.answer

    @property
    def player(self) -> Player:
        """The excitation: state, transfer, start, end, reason, revision. To be read only."""
        return self._helm.player

    @property
    def lease_left(self) -> int:
        """Ticks for which the lease is still held if nothing more is heard; 0 if nobody holds it."""
        return self.lease.left(self._now, self._held_armed)

    # Each tick.

    def asked(self, tick: int) -> Asked:
        """What the flight code is asked at `tick`; once a tick, before its step."""
        self._now = tick + 1
        helm = self._helm
        if helm.schedule.next <= tick:
            self._act_due(tick)
        if helm.player.begins <= tick:
            self._begin_play()
        lease = self.lease
        if lease.holder is not None:
            if self.lockstep:
                lease.hear(lease.holder, tick)
            if lease.expire(tick, self._held_armed):
                self.remarks.append((5, "the lease has ended"))
        link = self._link or self.lockstep
        if helm.changed or helm.on_board or helm.fresh or link is not self._asked.link_new:
            # Once set-points and link are quiet again the same tuple is given at every tick.
            self._asked = helm.asked(tick, self._arming.word, link)
            helm.changed = helm.fresh
            helm.fresh = False
        self._link = False
        return self._asked

    def seen(self, step: Step) -> None:
        """Takes note of a step of the flight code; once a tick, after it."""
        self.step = step
        if self._arming.pending:
            self._arming.seen(step)
            self._helm.changed = True
        if step.state != self._state:
            self._changed(step)

    def restarted(self) -> None:
        """Rig and flight code start again at tick 0: disarmed, manual, nothing asked for. The lease stays as it is."""
        self.lease.moved(-self._now)
        self._helm = Helm()
        self._arming = Arming()
        self.openloop = OpenLoop(revision=self.openloop.revision + 1)
        self._now, self._link, self._state, self._armed, self.step = 0, False, DISARMED, False, None

    # Who may command.

    def heard(self, source: Source, is_gcs: bool) -> None:
        """Notes a frame of any kind; `is_gcs` says that it is of a ground station or companion.

        It keeps the link alive if it comes from the holder of the lease, or from any of these while nobody holds it.
        """
        if self.lease.holder is None:
            self._link |= is_gcs and not self.lease.orphaned
        elif self.lease.hear(source, self._now):
            self._link = True

    def take(self, source: Source, what: str = "") -> Verdict:
        """Whether `source` may command; takes a free lease for it. `what` it wanted is named in the refusal."""
        if source[0] == 0 or source[1] == 0:
            return Verdict(DENIED, f"{what or 'command'} refused: system {source[0]} is nobody")
        if self.lease.command(source, self._now):
            self._link = True
            return _DONE
        return Verdict(TEMPORARILY_REJECTED, f"{what or 'command'} refused: {self._holder()} holds the lease")

    def ask_lease(self, source: Source, duration_ms: int) -> Verdict:
        """Takes the lease, or renews it, for a time of 30 s at most; refused while another holds it."""
        if source[0] == 0 or source[1] == 0:
            return Verdict(DENIED, f"lease refused: system {source[0]} is nobody")
        if self.lease.ask(source, self._now, round(duration_ms * 1e-3 / PERIOD)):
            self._link = True
            return _DONE
        return Verdict(TEMPORARILY_REJECTED, f"lease refused: {self._holder()} holds it")

    def give_up_lease(self, source: Source) -> Verdict:
        """Frees the lease; refused to all but its holder."""
        if self.lease.give_up(source):
            return _DONE
        return Verdict(TEMPORARILY_REJECTED, f"{self._holder()} holds the lease, not you")

    # Commands.

    def arm(self, source: Source, force: bool = False) -> Verdict:
        """Arms; IN_PROGRESS if nothing speaks against it: then `arming` tells what the failsafe said in the next tick.

        `force` is taken and changes nothing: neither the failsafe nor a check here is skipped.
        """
        verdict = self.take(source, "arming")
        if not verdict.accepted or self._armed:
            return verdict
        if self._arming.pending:
            return self._arming.answer
        against = self._against()
        if against:
            return Verdict(TEMPORARILY_REJECTED, f"not armed: {against}")
        self._helm.changed = True
        return self._arming.pull(self._now)

    def disarm(self, source: Source, force: bool = False) -> Verdict:
        """Stops the motors in the next tick, whoever asks: on this rig that is the safe state. `force` is a kill."""
        if force:
            return self.kill(source)
        if self.lease.holder == source:
            self.lease.command(source, self._now)
        self._disarm("disarmed")
        return _DONE

    def kill(self, source: Source) -> Verdict:
        """Stops the motors in the next tick, whoever asks, and holds the drone disarmed until it is disarmed."""
        self._disarm("killed", killed=True)
        self.remarks.append((2, f"killed by system {source[0]}"))
        return _DONE

    def set_mode(self, source: Source, custom_mode: int) -> Verdict:
        """Changes the mode; offboard wants set-points above 2 Hz before."""
        verdict = self.take(source, "mode")
        if not verdict.accepted:
            return verdict
        if custom_mode not in modes.BY_NUMBER:
            return Verdict(UNSUPPORTED, f"no mode {modes.mode_name(custom_mode)}")
        if custom_mode == modes.POSITION and self.rig.rings:
            return Verdict(DENIED, "mode position moves the cart, and the rings lock it")
        if custom_mode == modes.OFFBOARD and not self._helm.streamed(self._now):
            return Verdict(TEMPORARILY_REJECTED, "offboard wants set-points above 2 Hz first")
        self._helm.enter(custom_mode, self._level_thrust(), self._arming.word)
        return _DONE

    def setpoint(self, source: Source, setpoint: SetPoint, at_tick: int = 0, kind: str = TARGET) -> Verdict:
        """A set-point, which acts in the next tick or, if that is later, at `at_tick`.

        It is refused, and counted, where it holds a number that is not finite, moves a locked cart, comes from who may
        not command, or too many wait. In a mode that does not fly it, it is kept for when offboard is entered.
        """
        why = self._wrong(setpoint)
        if not why:
            if not self.take(source, "set-point").accepted:
                why = "lease"
            elif at_tick > self._now:
                return self._wait(source, setpoint, at_tick, kind)
        if why:
            self.refused[why] += 1
            return Verdict(TEMPORARILY_REJECTED, f"set-point refused: {why}")
        self._helm.take(setpoint, kind, self._now, self._arming.word)
        return _DONE

    def open_loop(
        self, source: Source, M: float, T: float, openloop: bool, enableM: bool, enableT: bool, at_tick: int = 0
    ) -> Verdict:
        """TWODOF_OPENLOOP: M about the trim moment (at thrust), T or the thrust in use; or back to a level attitude."""
        thrust = min(max(T, 0.0), 1.0) if enableT and isfinite(T) else None
        moment = M if enableM else 0.0
        setpoint = SetPoint(OPEN_LOOP, M_open=moment, thrust=T if enableT else None)
        if not openloop:
            setpoint = SetPoint(ATTITUDE, theta0=0.0, thrust=thrust)
        verdict = self.setpoint(source, setpoint, at_tick, "open loop")
        if verdict.accepted:
            revision = self.openloop.revision + 1
            self.openloop = OpenLoop(max(at_tick, self._now), M, T, openloop, enableM, enableT, revision)
        return verdict

    def sticks(self, source: Source, pitch: float, thrust: float) -> Verdict:
        """MANUAL_CONTROL: pitch stick, forward 1 and back -1, and thrust 0 to 1; what they give the mode decides."""
        if not (isfinite(pitch) and isfinite(thrust) and abs(pitch) <= 1.0 and 0.0 <= thrust <= 1.0):
            self.refused["invalid"] += 1
            return Verdict(DENIED, "sticks refused: invalid")
        mode = self._helm.custom_mode
        if mode == modes.MANUAL:
            setpoint = SetPoint(OPEN_LOOP, M_open=-pitch, thrust=thrust)
        elif mode == modes.RATE:
            setpoint = SetPoint(RATE, q0=-STICK_RATE * pitch, thrust=thrust)
        elif mode == modes.ATTITUDE:
            setpoint = SetPoint(ATTITUDE, theta0=-STICK_PITCH * pitch, thrust=thrust)
        elif pitch == 0.0:
            held = self._helm.values
            x0 = held.x0 if held.loop == POSITION else self.step.x if self.step is not None else 0.0
            setpoint = SetPoint(POSITION, x0=x0)
        else:
            setpoint = SetPoint(VELOCITY, v0=STICK_VELOCITY * pitch)
        return self.setpoint(source, setpoint, kind=STICKS)

    # Excitation.

    def define_excitation(self, source: Source, transfer: int, prepared: Prepared) -> Verdict:
        """Takes a definition, whole and written out; refused while another plays."""
        verdict = self.take(source, "excitation")
        if not verdict.accepted:
            return verdict
        if self.player.playing:
            return Verdict(TEMPORARILY_REJECTED, "an excitation plays")
        self.player.define(transfer, prepared)
        return _DONE

    def start_excitation(
        self, source: Source, transfer: int, loop: int, thrust: float | None = None, at_tick: int = 0
    ) -> Verdict:
        """Plays the definition `transfer` in the loop TWODOF_LOOP from `at_tick` on (0: from the next tick)."""
        verdict = self.take(source, "excitation")
        if not verdict.accepted:
            return verdict
        why = self._against_playing(transfer, loop, thrust, at_tick)
        if why:
            if self.player.transfer == transfer and not self.player.playing:
                self.player.finish(REFUSED, why)
            return Verdict(TEMPORARILY_REJECTED, f"excitation refused: {why}")
        self.player.wait(max(at_tick, self._now), LOOPS[loop], thrust)
        return _DONE

    def stop_excitation(self, source: Source) -> Verdict:
        """Stops it, playing or not, and forgets it; its base is held."""
        verdict = self.take(source, "excitation")
        if verdict.accepted:
            if self.player.playing:
                self.player.finish(STOPPED, "stopped")
                self._helm.changed = True
            self.player.prepared = None
        return verdict

    # Inside.

    @property
    def _held_armed(self) -> bool:
        return self._armed or self._arming.word

    def _holder(self) -> str:
        holder = self.lease.holder
        return f"system {holder[0]}, component {holder[1]}" if holder is not None else "nobody"

    def _missing(self) -> int:
        """The causes that speak against arming, but for what this very command has cured."""
        causes = self.step.causes if self.step is not None else 0
        return causes & ~(BIT["link_lost"] if self._link or self.lockstep else 0)

    def _against(self) -> str:
        """What speaks against arming, "" if nothing."""
        if self._arming.killed:
            return "it was killed, disarm first"
        if self._state == OFF:
            return "the failsafe stopped the motors, disarm first"
        if self.step is None:
            return "no sensor was heard yet"
        if not self.rig.safety_off:
            return "safety switch: press it"
        names = list(named_causes(self._missing()))
        if self.rig.rings and self._helm.custom_mode == modes.POSITION:
            names.append("rings_wrong")
        if self._helm.asks(self._now):
            names.append("not_idle")
        return ", ".join(dict.fromkeys(names))

    def _against_playing(self, transfer: int, loop: int, thrust: float | None, at_tick: int) -> str:
        player = self.player
        if player.playing:
            return "another plays"
        if player.prepared is None or player.transfer != transfer or player.state not in (READY, STOPPED, REFUSED, 4):
            return f"transfer {transfer} is not whole yet"
        if not 0 <= loop < len(LOOPS):
            return f"no loop {loop}"
        if player.prepared.unit != LOOPS[loop].unit:
            return f"it is in {player.prepared.unit!r}, the loop in {LOOPS[loop].unit!r}"
        if LOOPS[loop].loop >= VELOCITY and self.rig.rings:
            return "the loop moves the cart, and the rings lock it"
        if thrust is not None and not 0.0 <= thrust <= 1.0:
            return "thrust is not within 0 to 1"
        if at_tick and not self._now <= at_tick <= self._now + HORIZON:
            return f"tick {at_tick} is past, or more than a minute ahead of {self._now}"
        if not at_tick and not self._armed:
            return "not armed"
        return ""

    def _wrong(self, setpoint: SetPoint) -> str:
        if not setpoint.sound:
            return "invalid"
        if setpoint.loop is not None and setpoint.loop >= VELOCITY and self.rig.rings:
            return "rings"
        return ""

    def _wait(self, source: Source, setpoint: SetPoint, at_tick: int, kind: str) -> Verdict:
        if at_tick - self._now <= HORIZON and self._helm.schedule.add(at_tick, source, setpoint, kind):
            return _DONE
        self.refused["queue"] += 1
        return Verdict(TEMPORARILY_REJECTED, "set-point refused: too many wait, or too far ahead")

    def _act_due(self, tick: int) -> None:
        while (due := self._helm.schedule.due(tick)) is not None:
            source, setpoint, kind = due
            if self.lease.command(source, tick):
                self._helm.take(setpoint, kind, tick, self._arming.word)
            else:
                self.refused["lease"] += 1

    def _begin_play(self) -> None:
        if self._armed:
            self._helm.begin_play(self._level_thrust())
        else:
            self.player.finish(REFUSED, "not armed")

    def _disarm(self, why: str, killed: bool = False) -> None:
        self._arming.release(killed)
        self._to_rest(why)

    def _to_rest(self, why: str) -> None:
        if self.player.playing or self.player.waiting:
            self.player.finish(STOPPED, why)
        self._helm.rest()

    def _changed(self, step: Step) -> None:
        """The failsafe's state is another one."""
        self._state = step.state
        self._arming.seen(step)
        self._helm.changed = True
        if self.player.playing and step.action:
            self.player.finish(STOPPED, f"{ACTIONS[step.action]}: {', '.join(named_causes(step.reason))}")
        if self._armed and not step.armed:
            self.lease.orphaned = False
            self._to_rest("the motors were stopped")
        self._armed = step.armed


STICK_RATE = 1.75
"""Pitch rate at full stick [rad/s] (100 deg/s)."""

STICK_PITCH = 0.35
"""Pitch at full stick [rad] (20 deg)."""

STICK_VELOCITY = 0.3
"""Velocity at full stick [m/s]."""

_CUSTOM, _AUTO, _GUIDED, _STABILIZE, _MANUAL, _ARMED = 1, 4, 8, 16, 64, 128
_STANDBY, _ACTIVE, _CRITICAL, _TERMINATED = 3, 4, 5, 8
