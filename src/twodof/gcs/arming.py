"""Arming, disarming and the kill from the ground: MAVLink commands, each confirmed by the drone's heartbeat."""

import asyncio
from contextlib import suppress

from twodof.errors import LinkLost, Rejected, Timeout
from twodof.gcs.clock import DroneClock
from twodof.gcs.commands import ACCEPTED, CommandSender, number_of
from twodof.gcs.drone_state import StateTracker
from twodof.gcs.session import Deadline, DroneSession
from twodof.gcs.setpoints import SetpointStream

_RETRY_S = 0.05
_LAST_WORDS = 3
"""Copies of the last order to disarm if leaving is cancelled: no time is left to wait for a confirmation."""
_FORCE = 21196


class ArmingClient:
    """Client that arms, disarms and kills one drone by MAVLink commands.

    `may_be_armed` is True from the first order to arm until a heartbeat confirms that the drone is disarmed.
    """

    def __init__(
        self,
        session: DroneSession,
        watcher: StateTracker,
        commands: CommandSender,
        clock: DroneClock,
        setpoints: SetpointStream,
    ) -> None:
        self._session, self._watcher, self._commands = session, watcher, commands
        self._clock, self._setpoints = clock, setpoints
        self._number = number_of("COMPONENT_ARM_DISARM")
        self.may_be_armed = False

    async def arm(self, timeout: float) -> None:
        """Arm the drone and wait for a heartbeat that confirms it. Raises Rejected, LinkLost, Timeout."""
        deadline = self._session.deadline(timeout, "arming")
        self._session.check(self._session.now)
        self.may_be_armed = True
        await self._commands.run("COMPONENT_ARM_DISARM", [1.0], timeout, deadline.doing)
        await self._watcher.wait_until(lambda state: state.armed, deadline)

    async def disarm(self, timeout: float) -> None:
        """Stop the set-points, disarm the drone and wait for its confirmation. Raises Rejected, LinkLost, Timeout."""
        deadline = self._session.deadline(timeout, "disarming")
        self._setpoints.stop()
        await self._commands.run("COMPONENT_ARM_DISARM", [0.0], timeout, deadline.doing)
        await self._watcher.wait_until(lambda state: not state.armed, deadline)
        self.may_be_armed = False

    async def kill(self, timeout: float) -> None:
        """Stop the motors; repeat the order until a heartbeat confirms it. Raises Timeout, LinkLost."""
        await self._insist(_FORCE, self._session.deadline(timeout, "killing"))

    async def release(self, timeout: float) -> None:
        """End a kill and wait for a heartbeat that confirms it. Raises Rejected, LinkLost, Timeout."""
        deadline = self._session.deadline(timeout, "releasing a kill")
        await self._commands.run("DO_FLIGHTTERMINATION", [0.0], timeout, deadline.doing)
        await self._watcher.wait_until(lambda state: not state.killed, deadline)

    async def leave(self, timeout: float) -> None:
        """Leave the drone disarmed. Raises Timeout, LinkLost if no heartbeat confirms it.

        The order is repeated although the link seems lost, since a silent drone may still hear. A twodof drone is
        always disarmed by the ordinary command; a plain PX4 in flight only by a kill.
        """
        if not (self._watcher.state.armed or self.may_be_armed):
            return
        force = 0.0 if self._session.ours else _FORCE
        try:
            try:
                await self.disarm(timeout / 3)
            except (Rejected, Timeout, LinkLost):
                # Its heartbeat comes once a second.
                await self._insist(force, self._session.deadline(timeout / 2, "disarming"))
        except asyncio.CancelledError:
            with suppress(LinkLost):
                for attempt in range(_LAST_WORDS):
                    self._session.send_anyway(self._commands.long(self._number, [0.0, force], attempt))
            raise

    async def _insist(self, force: float, deadline: Deadline) -> None:
        """Repeat the order to disarm until a heartbeat confirms it, on a lost link too. Raises Timeout, LinkLost.

        The heartbeat of a twodof drone must show that a kill holds: that of a disarmed drone may have been sent before
        the kill came.
        """
        session, watcher, attempt, acknowledged = self._session, self._watcher, 0, False
        self._setpoints.stop()
        beats = watcher.heartbeats
        holds = session.ours and force == _FORCE
        with session.listen("HEARTBEAT", "COMMAND_ACK") as heard:
            while True:
                session.send_anyway(self._commands.long(self._number, [0.0, force], attempt))
                attempt += 1
                until = min(deadline.end, session.now + _RETRY_S)
                while (got := await heard.next(until, though_lost=True)) is not None:
                    if got.get_type() == "COMMAND_ACK":
                        acknowledged |= (got.command, got.result) == (self._number, ACCEPTED)
                    kill_seen = watcher.state.killed or not holds
                    seen = watcher.heartbeats > beats and not watcher.state.armed and kill_seen
                    if acknowledged and not seen and self._clock.granting and session.lost is None:
                        await self._clock.one_tick(deadline)
                    elif seen or (acknowledged and session.lockstep and kill_seen):
                        return  # in lockstep nothing turns while time stands
                    if deadline.left <= 0.0:
                        break
                if deadline.left <= 0.0:
                    if acknowledged:
                        return
                    session.check(deadline.end)
                    raise deadline.error()
