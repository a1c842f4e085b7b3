"""Which excitation is played on board, and when: its definition, its start and its stop."""

from collections.abc import Callable

from twodof.fcu.command.arming import ArmingControl
from twodof.fcu.command.command_lease import CommandLease
from twodof.fcu.command.excitation_player import LOOPS, REFUSED, STOPPED, OnboardPlayer, SampledExcitation
from twodof.fcu.command.result import DONE, CommandResult, Source, rejected
from twodof.fcu.command.setpoint_manager import SetpointManager
from twodof.fcu.command.setpoints import HORIZON
from twodof.fcu.command.vehicle_state import VehicleState
from twodof.flight.failsafe.state_machine import STATES
from twodof.signals import OPEN_LOOP, VELOCITY


class ExcitationControl:
    """Decides over the excitation of `setpoints.player`.

    `level_thrust` gives the thrust of a level hold, with which an excitation flies where none is in use.
    """

    def __init__(
        self,
        vehicle: VehicleState,
        setpoints: SetpointManager,
        arming: ArmingControl,
        lease: CommandLease,
        level_thrust: Callable[[], float],
    ) -> None:
        self._vehicle = vehicle
        self._setpoints = setpoints
        self._arming = arming
        self._lease = lease
        self._level_thrust = level_thrust

    @property
    def player(self) -> OnboardPlayer:
        """The excitation, to be read only: state, transfer, start, end, reason, revision."""
        return self._setpoints.player

    def define(self, source: Source, transfer: int, prepared: SampledExcitation) -> CommandResult:
        """Takes a definition, whole and written out; refused while another plays. Nothing is played yet."""
        result = self._lease.take(source, "excitation")
        if result.accepted and self.player.playing:
            return rejected("excitation refused: another plays")
        if result.accepted:
            self.player.define(transfer, prepared)
        return result

    def start(
        self, source: Source, transfer: int, loop: int, thrust: float | None = None, at_tick: int = 0
    ) -> CommandResult:
        """Plays the definition `transfer` in the loop TWODOF_LOOP from `at_tick` on (0: from the next tick).

        `thrust` flies with it; None: that in use, or that of a level hold if there is none.
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
        """Stops it, playing or not, and forgets it; its base is held."""
        result = self._lease.take(source, "excitation")
        if result.accepted and self.player.unit:
            self.player.finish(STOPPED, "by command")
        return result

    def begin(self, tick: int) -> None:
        """The tick of the excitation that waits has come."""
        why = self._against_beginning()
        if why:
            self.player.finish(REFUSED, why)
        else:
            self._setpoints.begin_play(self._level_thrust(), tick)

    def _against_beginning(self) -> str:
        """What speaks against an excitation that begins in this tick, "" if nothing does."""
        if not self._arming.flies:
            return "not armed"
        # It would go on in its middle when the failsafe lets go.
        return f"the failsafe acts: {STATES[self._vehicle.failsafe]}" if self._vehicle.failsafe_acts else ""

    def _against_playing(self, transfer: int, loop: int, thrust: float | None, at_tick: int) -> str:
        """What speaks against the definition `transfer` in the loop TWODOF_LOOP from `at_tick` on (0: now)."""
        player, now = self.player, self._vehicle.now
        if player.playing:
            return "another plays"
        if not player.unit or player.transfer != transfer:
            return f"there is no definition {transfer}, whole and not yet played"
        if not 0 <= loop < len(LOOPS):
            return f"there is no loop {loop}"
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
