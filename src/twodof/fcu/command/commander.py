"""The commander: it decides whether a command of a client is carried out. No I/O, and no clock but the ticks.

Every command is answered by a CommandResult. The rules are in docs/reference/protocol.md: lease, modes, set-points,
excitation.
"""

from collections import Counter
from collections.abc import Callable

from twodof.errors import RefusalReason
from twodof.fcu.command.arming import ArmingControl
from twodof.fcu.command.command_lease import (
    ACTING,
    DONE,
    CommandLease,
    CommandResult,
    Source,
    VehicleState,
    denied,
    rejected,
    unsupported,
)
from twodof.fcu.command.excitation_player import LOOPS, REFUSED, STOPPED, OnboardPlayer, SampledExcitation
from twodof.fcu.command.setpoints import (
    HORIZON,
    OPENLOOP,
    RULES,
    STICKS,
    TARGET,
    OpenLoopState,
    SetpointManager,
    manual_setpoint,
)
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.hardware import ControlInput, Hardware
from twodof.flight.failsafe.causes_and_actions import named_causes
from twodof.flight.failsafe.state_machine import FLYING, STATES
from twodof.link.mavlink import modes
from twodof.link.mavlink.dialect import MavSeverity
from twodof.link.mavlink.setpoints import SetPoint
from twodof.signals import ATTITUDE, OPEN_LOOP, VELOCITY


class ExcitationControl:
    """Control of the excitation on board: definition, start and stop by clients.

    `level_thrust` returns the thrust of a level hold, with which an excitation flies if no thrust is in use.
    """

    def __init__(self, vehicle: VehicleState, arming: ArmingControl, level_thrust: Callable[[], float]) -> None:
        self._vehicle = vehicle
        self._arming = arming
        self._setpoints, self._lease = arming.setpoints, arming.lease
        self._level_thrust = level_thrust

    @property
    def player(self) -> OnboardPlayer:
        """Return the player of the excitation, to be read only: state, transfer, start, end, reason, revision."""
        return self._setpoints.player

    def define(self, source: Source, transfer: int, prepared: SampledExcitation) -> CommandResult:
        """Store a sampled excitation as the definition `transfer`; refuse it while another one plays."""
        result = self._lease.take(source, "excitation")
        if result.accepted and self.player.playing:
            return rejected("excitation refused: another one plays")
        if result.accepted:
            self.player.define(transfer, prepared)
        return result

    def start(
        self, source: Source, transfer: int, loop: int, thrust: float | None = None, at_tick: int = 0
    ) -> CommandResult:
        """Play the definition `transfer` in the loop `loop` (TWODOF_LOOP) from `at_tick` on (0: from the next tick).

        `thrust` is that during the excitation; None: the thrust in use, or that of a level hold if there is none.
        """
        result = self._lease.take(source, "excitation")
        player = self.player
        if not result.accepted or (player.playing and player.transfer == transfer):
            return result  # a start that comes twice is done once
        why = self._against_playing(transfer, loop, thrust, at_tick)
        if not why and not at_tick:
            why = self._against_beginning()
        if not why:
            player.wait(max(at_tick, self._vehicle.now), LOOPS[loop], thrust)
            return DONE
        if player.unit and player.transfer == transfer:
            player.finish(REFUSED, why)
        return rejected(f"excitation refused: {why}")

    def stop(self, source: Source) -> CommandResult:
        """Stop and forget the excitation; the set-point on which it was added is held."""
        result = self._lease.take(source, "excitation")
        if result.accepted and self.player.unit:
            self.player.finish(STOPPED, "by command")
        return result

    def begin(self, tick: int) -> None:
        """Begin the excitation whose tick has come."""
        why = self._against_beginning()
        if why:
            self.player.finish(REFUSED, why)
        else:
            self._setpoints.begin_play(self._level_thrust(), tick)

    def _against_beginning(self) -> str:
        """Return the reason against an excitation that begins in this tick, "" if there is none."""
        if not self._arming.flies:
            return "not armed"
        # It would go on in its middle when the failsafe lets go.
        return f"the failsafe acts: {STATES[self._vehicle.failsafe]}" if self._vehicle.failsafe_acts else ""

    def _against_playing(self, transfer: int, loop: int, thrust: float | None, at_tick: int) -> str:
        """Return the reason against the definition `transfer` in the loop `loop` from `at_tick` on (0: now), or ""."""
        player, now = self.player, self._vehicle.now
        if player.playing:
            return "another one plays"
        if not player.unit or player.transfer != transfer:
            return f"definition {transfer} is missing, incomplete or already played"
        if not 0 <= loop < len(LOOPS):
            return f"unknown loop {loop}"
        where = LOOPS[loop]
        if player.unit != where.unit:
            return f"it is in {player.unit!r}, the loop in {where.unit!r}"
        if where.loop >= VELOCITY and self._vehicle.rig.rings:
            return "the loop moves the cart, and the rings lock it"
        if thrust is not None and not 0.0 <= thrust <= 1.0:
            return "thrust is not within 0 to 1"
        if thrust == 0.0 and where.loop != OPEN_LOOP:
            return "a closed loop without thrust"
        if at_tick and not now <= at_tick <= now + HORIZON:
            return f"tick {at_tick} is past or more than a minute ahead, the next is {now}"
        return ""


class Commander:
    """Commander of one drone: modes and set-points here; `lease`, `arming` and `excitation` for the rest.

    `rig` has the state of rings and safety switch; `level_thrust` returns the thrust of a level hold (THRUST_BAR). With
    `lockstep` the time that passes was granted by a client, so the link counts as alive in every tick. `unfit` returns
    a further reason against arming, "" if there is none. `remarks` are (MAV_SEVERITY, text) pairs for the clients,
    which the service that sends them removes. `refused` counts set-points that did not act, by reason.
    """

    def __init__(self, rig: Hardware, level_thrust: Callable[[], float], lockstep: bool) -> None:
        self.lockstep = lockstep
        self.unfit: Callable[[], str] = lambda: ""
        self.refused: Counter[RefusalReason] = Counter()
        self._level_thrust = level_thrust
        self._vehicle = VehicleState(rig)
        self.remarks = self._vehicle.remarks
        self.lease = CommandLease(self._vehicle, lockstep, self._hand_over)
        self._begin()

    def _begin(self, killed_by: Source | None = None, openloop_revision: int = 0) -> None:
        vehicle, lease = self._vehicle, self.lease
        self._setpoints = setpoints = SetpointManager(openloop_revision)
        self.arming = ArmingControl(vehicle, setpoints, lease, lambda: self.unfit(), killed_by)
        self.excitation = ExcitationControl(vehicle, self.arming, self._level_thrust)
        self._input = ControlInput()

    @property
    def armed(self) -> bool:
        """Return whether the motors may turn, by the failsafe's last step."""
        return self._vehicle.armed

    @property
    def openloop(self) -> OpenLoopState:
        """Return the open-loop message in use."""
        return self._setpoints.openloop

    @property
    def custom_mode(self) -> int:
        """Return HEARTBEAT.custom_mode: the mode."""
        return self._setpoints.custom_mode

    @property
    def base_mode(self) -> int:
        """Return HEARTBEAT.base_mode: MAV_MODE_FLAG as PX4 sets it."""
        return modes.base_mode(self.custom_mode, self.armed)

    @property
    def system_status(self) -> int:
        """Return HEARTBEAT.system_status: active, critical while the failsafe acts, standby, or 0 if it cannot arm."""
        if self.arming.killed_by is not None:
            return modes.TERMINATED
        if self._vehicle.step is None:
            return modes.UNREADY
        if self.armed:
            return modes.CRITICAL if self._vehicle.step.action else modes.ACTIVE
        return modes.UNREADY if self.arming.causes_against else modes.STANDBY

    def control_input(self, tick: int) -> ControlInput:
        """Return the input of the flight code at `tick`; to be called once a tick, before its step."""
        vehicle, setpoints, arming = self._vehicle, self._setpoints, self.arming
        vehicle.now = tick + 1
        link = self.lease.link_alive
        if not vehicle.rig.safety_off and (arming.arm_input or arming.pending):
            arming.stop_motors("safety switch: motors off", tick)
        if arming.pending:
            arming.update_input(tick)
            setpoints.changed = True
        setpoints.take_due(tick, arming.flies)
        if setpoints.player.begins <= tick:
            self.excitation.begin(tick)
        self.lease.begin_tick()
        if setpoints.changed or link is not self._input.link_new:
            self._input = setpoints.control_input(tick, arming.arm_input, link)
        return self._input

    def after_step(self, step: ControlStep) -> None:
        """Note a step of the flight code; to be called once a tick, after the step."""
        self._vehicle.step = step
        if self.arming.pending:
            self.arming.read_answer(step)
            self._setpoints.changed = True
        if step.state != self._vehicle.failsafe:
            self._failsafe_changed(step)

    def restart(self) -> None:
        """Restart at tick 0: disarmed, in manual mode, without set-points.

        Lease and kill stay as they are: many a program begins with a reset.
        """
        self.lease.restart()
        self._vehicle.restart()
        self._begin(self.arming.killed_by, self.openloop.revision + 1)

    def set_mode(self, source: Source, custom_mode: int) -> CommandResult:
        """Change the mode; offboard needs set-points above 2 Hz before."""
        result = self.lease.take(source, "mode")
        if not result.accepted:
            return result
        if custom_mode not in modes.BY_NUMBER:
            return unsupported(f"unknown mode {modes.mode_name(custom_mode)}")
        if modes.BY_NUMBER[custom_mode].moves_cart and self._vehicle.rig.rings:
            return denied(
                f"mode {modes.mode_name(custom_mode)} moves the cart, and the rings lock it", RefusalReason.RINGS
            )
        if RULES[custom_mode].streamed and not self._setpoints.streamed(self._vehicle.now):
            return rejected(f"mode {modes.mode_name(custom_mode)} needs set-points above 2 Hz first")
        self._setpoints.enter(custom_mode, self._level_thrust(), self._vehicle.now, self.arming.flies)
        return DONE

    def setpoint(
        self,
        source: Source,
        setpoint: SetPoint,
        at_tick: int = 0,
        kind: str = TARGET,
        message: OpenLoopState | None = None,
    ) -> CommandResult:
        """Accept a set-point, which acts in the next tick or, if that is later, at `at_tick`.

        It is refused and counted if a number is not finite, if it moves a locked cart, if too many wait, or if `source`
        may not command. In a mode that does not fly it, it is kept for offboard.

        `message` is the open-loop message from which it was made.
        """
        if not setpoint.sound:
            return self.refuse(RefusalReason.INVALID, "a number is not finite")
        if setpoint.moves_cart and self._vehicle.rig.rings:
            return self.refuse(RefusalReason.RINGS, "it moves the cart, and the rings lock it")
        result = self.lease.take(source, "set-point")
        if not result.accepted:
            self.refused[result.reason] += 1
        elif at_tick <= self._vehicle.now:
            self._setpoints.take(setpoint, kind, self._vehicle.now, self.arming.flies, message)
        elif at_tick > self._vehicle.now + HORIZON or not self._setpoints.queue(at_tick, setpoint, kind, message):
            return self.refuse(RefusalReason.QUEUE, "too many wait, or its time is more than a minute ahead")
        return result

    def open_loop(
        self, source: Source, M: float, T: float, openloop: bool, enableM: bool, enableT: bool, at_tick: int = 0
    ) -> CommandResult:
        """Carry out TWODOF_OPENLOOP: fly M about the trim moment (0 without `enableM`), with the thrust T if `enableT`.

        Without `openloop` the open loop ends: the attitude loop holds the pitch level. In manual mode, which closes no
        loop, M is 0 instead.
        """
        if openloop and enableM and not abs(M) <= 1.0:  # nor does NaN pass
            return self.refuse(RefusalReason.INVALID, f"M = {M:g} is outside -1 to 1")
        if enableT and not 0.0 <= T <= 1.0:
            return self.refuse(RefusalReason.INVALID, f"T = {T:g} is outside 0 to 1")
        thrust = T if enableT else None
        if openloop or self.custom_mode == modes.MANUAL:
            setpoint = SetPoint(OPEN_LOOP, M_open=M if openloop and enableM else 0.0, thrust=thrust)
        else:
            setpoint = SetPoint(ATTITUDE, theta0=0.0, thrust=thrust)
        used = M if enableM else 0.0, T if enableT else 0.0
        message = OpenLoopState(0, *used, openloop, enableM, enableT) if openloop else None
        return self.setpoint(source, setpoint, at_tick, OPENLOOP, message)

    def sticks(self, source: Source, pitch: float, thrust: float) -> CommandResult:
        """Carry out MANUAL_CONTROL: pitch stick, forward 1 and back -1, and thrust 0 to 1, as the mode reads them."""
        if not (abs(pitch) <= 1.0 and 0.0 <= thrust <= 1.0):  # nor does NaN pass
            return self.refuse(RefusalReason.INVALID, "a stick is beyond its end")
        x = self._vehicle.step.x if self._vehicle.step is not None else 0.0
        setpoint = manual_setpoint(self.custom_mode, pitch, thrust, self._setpoints.values, x)
        result = self.setpoint(source, setpoint, kind=STICKS)
        if result.accepted:
            self._setpoints.hold_stick(pitch, thrust, self._vehicle.now)
        return result

    def _hand_over(self) -> None:
        """Forget set-points sent ahead and a pending arming, as the lease has changed hands."""
        if waited := self._setpoints.drop_waiting("who started it has lost the lease"):
            self.refused[RefusalReason.LEASE] += waited
        if self.arming.pending:
            self.arming.cancel()

    def refuse(self, reason: RefusalReason, text: str) -> CommandResult:
        """Count a refused set-point, and return the answer."""
        self.refused[reason] += 1
        return denied(f"set-point refused: {text}", reason)

    def _failsafe_changed(self, step: ControlStep) -> None:
        vehicle, player = self._vehicle, self._setpoints.player
        acted, vehicle.failsafe = vehicle.failsafe_acts, step.state
        reasons = ", ".join(named_causes(step.reason))
        if step.state in ACTING:
            vehicle.remark(MavSeverity.WARNING, f"failsafe: {STATES[step.state]} ({reasons})")
            if player.playing:
                player.finish(STOPPED, f"{STATES[step.state]}: {reasons}")
        elif acted and step.state == FLYING:
            vehicle.remark(MavSeverity.INFO, "failsafe: over, it flies what is asked again")
        if vehicle.armed and not step.armed:
            self.lease.orphaned = False  # the motors stand: nobody is missed any more
            if self.arming.arm_input:  # else a command has disarmed it, and what came since is for the next flight
                self._setpoints.clear(f"the motors were stopped: {reasons}", vehicle.now)
                vehicle.remark(MavSeverity.CRITICAL, f"failsafe: motors off ({reasons})")
        elif step.armed and not vehicle.armed:
            self._setpoints.armed(vehicle.now)
        vehicle.armed = step.armed
