"""The commander: who may command, and whether what is commanded is done. No I/O, and no clock but the ticks it is told.

Every command is answered by a Verdict. The rules of lease, modes, set-points and excitation are in
docs/reference/protocol.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from twodof.fcu.command.arming import ArmingState
from twodof.fcu.command.authority import DONE, CommandAuthority
from twodof.fcu.command.checks import RigSwitches, against_arming, against_playing
from twodof.fcu.command.excitation_player import LOOPS, REFUSED, STOPPED, OnboardPlayer, SampledExcitation
from twodof.fcu.command.lease import LeaseState
from twodof.fcu.command.manual_control import manual_setpoint
from twodof.fcu.command.result import DENIED, TEMPORARILY_REJECTED, UNSUPPORTED, CommandResult, Source
from twodof.fcu.command.setpoint_manager import SetpointManager
from twodof.fcu.command.setpoint_queue import HORIZON
from twodof.fcu.command.setpoints import (
    ATTITUDE,
    OPEN_LOOP,
    OPENLOOP,
    STICKS,
    TARGET,
    VELOCITY,
    OpenLoopState,
    SetPoint,
)
from twodof.fcu.control.control_input import ControlInput
from twodof.fcu.control.flight_code import ControlStep
from twodof.flight.failsafe.causes import BIT, named_causes
from twodof.flight.failsafe.state_machine import BRAKE, DESCEND, DISARMED, FLYING, LEVEL, STATES
from twodof.link.mavlink import modes

ACTING = (LEVEL, BRAKE, DESCEND)
"""States in which the failsafe flies."""

MOST_REMARKS = 64
"""Remarks that are kept if nobody drains them."""


class Commander:
    """Decides over one drone.

    `rig` says whether rings and safety switch are set; `level_thrust` gives the thrust of a level hold (THRUST_BAR).
    With `lockstep` the time that passes was granted by a client, so the link counts as alive in every tick.
    `unfit` says what else speaks against arming, "" if nothing. `remarks` are (MAV_SEVERITY, text) to be told to the
    clients, for whoever drains it; `refused` counts set-points that did not act, by reason.
    """

    def __init__(self, rig: RigSwitches, level_thrust: Callable[[], float], lockstep: bool) -> None:
        self.rig = rig
        self.lockstep = lockstep
        self.unfit: Callable[[], str] = lambda: ""
        self.remarks: list[tuple[int, str]] = []
        self.refused: Counter[str] = Counter()
        self.step: ControlStep | None = None
        self._level_thrust = level_thrust
        self._pilot = CommandAuthority(granted=lockstep)
        self._served = self._pilot.changes  # the holder of the lease whose words are at the helm
        self._helm = SetpointManager()
        self._arming = ArmingState()
        self._now = 0  # the first tick that was not asked for yet: what is commanded acts there
        self._state = DISARMED
        self._armed = False
        self._asked = ControlInput()

    @property
    def armed(self) -> bool:
        """Whether the motors may turn, as the failsafe last said."""
        return self._armed

    @property
    def killed(self) -> bool:
        """Whether a kill holds it disarmed."""
        return self._arming.killed_by is not None

    @property
    def killed_by(self) -> Source | None:
        """Who killed it last, None: no kill holds it."""
        return self._arming.killed_by

    @property
    def arming(self) -> CommandResult:
        """What became of the last `arm`; IN_PROGRESS until the failsafe has answered, some ticks at most."""
        return self._arming.answer

    @property
    def lease(self) -> LeaseState:
        """Who may command, for how many ticks still, and a count of the changes."""
        return self._pilot.lease(self._now, self._armed)

    @property
    def player(self) -> OnboardPlayer:
        """The excitation, to be read only: state, transfer, start, end, reason, revision."""
        return self._helm.player

    @property
    def openloop(self) -> OpenLoopState:
        """The open-loop message in use."""
        return self._helm.openloop

    @property
    def modes(self) -> tuple[modes.FlightMode, ...]:
        """What `set_mode` knows."""
        return modes.MODES

    @property
    def custom_mode(self) -> int:
        """The mode, for HEARTBEAT."""
        return self._helm.custom_mode

    @property
    def base_mode(self) -> int:
        """MAV_MODE_FLAG, for HEARTBEAT, as PX4 sets it."""
        return modes.base_mode(self._helm.custom_mode, self._armed)

    @property
    def system_status(self) -> int:
        """MAV_STATE, for HEARTBEAT: active, critical while the failsafe acts, standby, or 0 where it would not arm."""
        if self.killed:
            return modes.TERMINATED
        if self.step is None:
            return modes.UNREADY
        if self._armed:
            return modes.CRITICAL if self.step.action else modes.ACTIVE
        return modes.UNREADY if self._missing(self.step) else modes.STANDBY

    def asked(self, tick: int) -> ControlInput:
        """What the flight code is asked at `tick`; once a tick, before its step."""
        self._now = tick + 1
        helm, pilot, link = self._helm, self._pilot, self._pilot.heard
        if not self.rig.safety_off and (self._arming.word or self._arming.pending):
            self._stand("safety switch: motors off", tick)
        if self._arming.pending:
            self._arming.speak(tick)
            helm.changed = True
        if helm.schedule.next <= tick:
            self._act_due(tick)
        if helm.player.begins <= tick:
            self._begin_play(tick)
        pilot.passes(self._now, self._armed)
        if pilot.changes != self._served:
            self._remark(4 if pilot.orphaned else 6, "nobody holds the lease any more")
            self._hand_over()
        if helm.changed or link is not self._asked.link_new:
            self._asked = helm.asked(tick, self._arming.word, link)
        return self._asked

    def seen(self, step: ControlStep) -> None:
        """Takes note of a step of the flight code; once a tick, after it."""
        self.step = step
        if self._arming.pending:
            self._arming.seen(step)
            self._helm.changed = True
        if step.state != self._state:
            self._changed(step)

    def restart(self) -> None:
        """Rig and flight code start again at tick 0: disarmed, manual, nothing asked for.

        The lease stays as it is, and so does a kill: a reset is the first that many a program asks for.
        """
        self._pilot.restart(self._now)
        revision = self.openloop.revision + 1
        self._helm, self._arming = SetpointManager(), ArmingState(self._arming.killed_by)
        self._helm.openloop = OpenLoopState(revision=revision)
        self._now, self._state, self._armed, self.step = 0, DISARMED, False, None

    def heard(self, source: Source, is_client: bool) -> None:
        """Notes a frame of any kind; `is_client`: of a ground station or companion, not of a vehicle."""
        self._pilot.hear(source, is_client, self._now)

    def stands(self, ticks: int) -> None:
        """So much real time, in ticks, has passed in lockstep while none was granted."""
        self._pilot.stands(ticks)

    def take(self, source: Source, what: str = "command") -> CommandResult:
        """Whether `source` may command; takes a free lease for it. `what` it wanted is named in a refusal."""
        verdict = self._pilot.take(source, what, self._now)
        self._hand_over()
        return verdict

    @property
    def tuning_withheld(self) -> bool:
        """Whether nobody but the holder of the lease may change parameters."""
        return self._pilot.tuning_withheld

    def may_tune(self, source: Source, what: str = "parameters") -> CommandResult:
        """Whether `source` may change parameters: anybody, unless the holder of the lease withholds it."""
        return self._pilot.may_tune(source, what, self._now)

    def ask_lease(self, source: Source, duration_ms: int = 0, withhold_tuning: bool = False) -> CommandResult:
        """Takes the lease, or renews it, for a time of 30 s at most (0: 2 s); refused while another holds it.

        `withhold_tuning`: nobody else may change parameters meanwhile.
        """
        verdict = self._pilot.ask(source, duration_ms, self._now, withhold_tuning)
        self._hand_over()
        return verdict

    def give_up_lease(self, source: Source) -> CommandResult:
        """Frees the lease; refused to all but its holder."""
        verdict = self._pilot.give_up(source, self._armed)
        self._hand_over()
        return verdict

    def arm(self, source: Source, force: bool = False) -> CommandResult:
        """Arms; IN_PROGRESS if nothing speaks against it: then `arming` tells what the failsafe said in the next tick.

        `force` is understood and changes nothing: neither the failsafe nor a check here is skipped.
        """
        verdict = self.take(source, "arming")
        if not verdict.accepted:
            return verdict
        if self._arming.pending:
            return self._arming.answer
        if self._flies:
            return DONE
        moves_cart, asks = modes.BY_NUMBER[self.custom_mode].moves_cart, self._helm.asks(self._now)
        missing = None if self.step is None else self._missing(self.step)
        against = against_arming(self._arming, self.rig, missing, moves_cart, asks) or self.unfit()
        if against:
            return CommandResult(TEMPORARILY_REJECTED, f"not armed: {against}")
        # The failsafe arms on an edge: where it has not seen the last disarming yet, a tick later.
        return self._arming.pull(self._now + (self._state != DISARMED))

    def disarm(self, source: Source, force: bool = False) -> CommandResult:
        """Stops the motors in the next tick, whoever asks: on this rig that is the safe state. `force` is a kill."""
        if force:
            return self.kill(source)
        if self._pilot.holder == source:
            self.take(source)  # which renews it
        self._arming.release()
        self._helm.rest("disarmed", self._now)
        return DONE

    def kill(self, source: Source) -> CommandResult:
        """Stops the motors in the next tick, whoever asks, and holds the drone disarmed until `release`."""
        self._arming.release()
        self._arming.killed_by = source
        self._helm.rest("killed", self._now)
        self._remark(2, f"killed by system {source[0]}, component {source[1]}")
        return DONE

    def release(self, source: Source) -> CommandResult:
        """Takes a kill back, which a disarming does not: it is what a program does that ends. Nothing arms by it."""
        verdict = self.take(source, "release")
        if verdict.accepted and self.killed:
            self._arming.killed_by = None
            self._remark(4, f"released by system {source[0]}, component {source[1]}")
        return verdict

    def set_mode(self, source: Source, custom_mode: int) -> CommandResult:
        """Changes the mode; offboard wants set-points above 2 Hz before."""
        verdict = self.take(source, "mode")
        if not verdict.accepted:
            return verdict
        if custom_mode not in modes.BY_NUMBER:
            return CommandResult(UNSUPPORTED, f"there is no mode {modes.mode_name(custom_mode)}")
        if modes.BY_NUMBER[custom_mode].moves_cart and self.rig.rings:
            return CommandResult(DENIED, f"mode {modes.mode_name(custom_mode)} moves the cart, and the rings lock it")
        if custom_mode == modes.OFFBOARD and not self._helm.streamed(self._now):
            return CommandResult(TEMPORARILY_REJECTED, "mode offboard wants set-points above 2 Hz first")
        self._helm.enter(custom_mode, self._level_thrust(), self._now, self._flies)
        return DONE

    def setpoint(
        self,
        source: Source,
        setpoint: SetPoint,
        at_tick: int = 0,
        kind: str = TARGET,
        said: OpenLoopState | None = None,
    ) -> CommandResult:
        """A set-point, which acts in the next tick or, if that is later, at `at_tick`.

        It is refused, and counted, where it holds a number that is not finite, moves a locked cart, comes from who may
        not command, or too many wait. In a mode that does not fly it, it is kept for when offboard is entered.

        `said` is the open-loop message that it came of.
        """
        if not setpoint.sound:
            return self._refuse("invalid", "a number is not finite")
        if setpoint.loop is not None and setpoint.loop >= VELOCITY and self.rig.rings:
            return self._refuse("rings", "it moves the cart, and the rings lock it")
        verdict = self.take(source, "set-point")
        if not verdict.accepted:
            self.refused["lease"] += 1
        elif at_tick <= self._now:
            self._helm.take(setpoint, kind, self._now, self._flies, said)
        elif at_tick > self._now + HORIZON or not self._helm.schedule.add(at_tick, setpoint, kind, said):
            return self._refuse("queue", "too many wait, or it is more than a minute ahead")
        return verdict

    def open_loop(
        self, source: Source, M: float, T: float, openloop: bool, enableM: bool, enableT: bool, at_tick: int = 0
    ) -> CommandResult:
        """TWODOF_OPENLOOP: M about the trim moment, or that alone; T, or the thrust in use; or no open loop any more.

        Then the attitude loop holds the pitch level, but in manual mode, which closes no loop, M is 0.
        """
        if enableM and not abs(M) <= 1.0:  # nor does NaN pass
            return self._refuse("invalid", f"M = {M:g} is outside -1 to 1")
        if enableT and not 0.0 <= T <= 1.0:
            return self._refuse("invalid", f"T = {T:g} is outside 0 to 1")
        thrust = T if enableT else None
        if openloop or self.custom_mode == modes.MANUAL:
            setpoint = SetPoint(OPEN_LOOP, M_open=M if openloop and enableM else 0.0, thrust=thrust)
        else:
            setpoint = SetPoint(ATTITUDE, theta0=0.0, thrust=thrust)
        used = M if enableM else 0.0, T if enableT else 0.0
        said = OpenLoopState(0, *used, openloop, enableM, enableT) if openloop else None
        return self.setpoint(source, setpoint, at_tick, OPENLOOP, said)

    def sticks(self, source: Source, pitch: float, thrust: float) -> CommandResult:
        """MANUAL_CONTROL: pitch stick, forward 1 and back -1, and thrust 0 to 1; the mode decides what they give."""
        if not (abs(pitch) <= 1.0 and 0.0 <= thrust <= 1.0):  # nor does NaN pass
            return self._refuse("invalid", "a stick is beyond its end")
        x = self.step.x if self.step is not None else 0.0
        setpoint = manual_setpoint(self.custom_mode, pitch, thrust, self._helm.values, x)
        verdict = self.setpoint(source, setpoint, kind=STICKS)
        if verdict.accepted:
            self._helm.hold_stick(pitch, thrust, self._now)
        return verdict

    def define_excitation(self, source: Source, transfer: int, prepared: SampledExcitation) -> CommandResult:
        """Takes a definition, whole and written out; refused while another plays. Nothing is played yet."""
        verdict = self.take(source, "excitation")
        if verdict.accepted and self.player.playing:
            return CommandResult(TEMPORARILY_REJECTED, "excitation refused: another plays")
        if verdict.accepted:
            self.player.define(transfer, prepared)
        return verdict

    def start_excitation(
        self, source: Source, transfer: int, loop: int, thrust: float | None = None, at_tick: int = 0
    ) -> CommandResult:
        """Plays the definition `transfer` in the loop TWODOF_LOOP from `at_tick` on (0: from the next tick).

        `thrust` flies with it; None: that in use, or that of a level hold if there is none.
        """
        verdict = self.take(source, "excitation")
        player = self.player
        if not verdict.accepted or (player.playing and player.transfer == transfer):
            return verdict  # a start that comes twice is done once
        why = against_playing(player, self.rig, transfer, loop, thrust, at_tick, self._now)
        if not why and not at_tick:
            why = self._against_beginning()
        if not why:
            player.wait(max(at_tick, self._now), LOOPS[loop], thrust)
            return DONE
        if player.unit and player.transfer == transfer:
            player.finish(REFUSED, why)
        return CommandResult(TEMPORARILY_REJECTED, f"excitation refused: {why}")

    def stop_excitation(self, source: Source) -> CommandResult:
        """Stops it, playing or not, and forgets it; its base is held."""
        verdict = self.take(source, "excitation")
        if verdict.accepted and self.player.unit:
            self.player.finish(STOPPED, "by command")
        return verdict

    @property
    def _flies(self) -> bool:
        """Armed, and not asked to disarm: only then what is commanded acts."""
        return self._armed and self._arming.word

    def _hand_over(self) -> None:
        """Where the lease has changed hands what was sent ahead is forgotten, and an arming that waits ends."""
        if self._pilot.changes == self._served:
            return
        self._served = self._pilot.changes
        if waiting := len(self._helm.schedule):
            self.refused["lease"] += waiting
        self._helm.forget_ahead("who started it has lost the lease")
        if self._arming.pending:
            self._arming.release()

    def _stand(self, why: str, tick: int) -> None:
        """The motors stop, not by a command."""
        self._arming.release()
        self._helm.rest(why, tick)
        self._remark(2, why)

    def _refuse(self, reason: str, text: str) -> CommandResult:
        self.refused[reason] += 1
        return CommandResult(DENIED, f"set-point refused: {text}")

    def _remark(self, severity: int, text: str) -> None:
        if len(self.remarks) < MOST_REMARKS:
            self.remarks.append((severity, text))

    def _missing(self, step: ControlStep) -> int:
        """The causes that speak against arming, but for the one that hearing this command has cured."""
        return step.causes & ~BIT["link_lost"] if self._pilot.heard else step.causes

    def _act_due(self, tick: int) -> None:
        helm = self._helm
        while (due := helm.schedule.due(tick)) is not None:
            helm.take(due.setpoint, due.kind, tick, self._flies, due.said)

    def _against_beginning(self) -> str:
        """What speaks against it that an excitation begins in this tick."""
        if not self._flies:
            return "not armed"
        # It would go on in its middle when the failsafe lets go.
        return f"the failsafe acts: {STATES[self._state]}" if self._state in ACTING else ""

    def _begin_play(self, tick: int) -> None:
        why = self._against_beginning()
        if why:
            self.player.finish(REFUSED, why)
        else:
            self._helm.begin_play(self._level_thrust(), tick)

    def _changed(self, step: ControlStep) -> None:
        """The failsafe's state is another one."""
        acted, self._state = self._state in ACTING, step.state
        reasons = ", ".join(named_causes(step.reason))
        if step.state in ACTING:
            self._remark(4, f"failsafe: {STATES[step.state]} ({reasons})")
            if self.player.playing:
                self.player.finish(STOPPED, f"{STATES[step.state]}: {reasons}")
        elif acted and step.state == FLYING:
            self._remark(6, "failsafe: over, it flies what is asked again")
        if self._armed and not step.armed:
            self._pilot.landed()
            if self._arming.word:  # else a command has disarmed it, and what came since is for the next flight
                self._helm.rest(f"the motors were stopped: {reasons}", self._now)
                self._remark(2, f"failsafe: motors off ({reasons})")
        elif step.armed and not self._armed:
            self._helm.armed(self._now)
        self._armed = step.armed
