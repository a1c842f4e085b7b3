"""How a drone is stopped and left: disarmed, killed, given to others."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Self

from twodof.errors import LinkLost, Rejected, Timeout, TwodofError
from twodof.gcs.drone_base import TIMEOUT_S, DroneBase
from twodof.gcs.mavlink.commands import ACCEPTED, number_of
from twodof.gcs.mavlink.deadline import Deadline

LEAVING_S = 3.0
_RETRY_S = 0.05
# So often it is said at once where leaving is broken off: there is no time to see whether it arrives.
_LAST_WORDS = 3
_FORCE = 21196


class StoppableDrone(DroneBase):
    """A drone that is always left disarmed: for `async with`."""

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            await self.close()
        except TwodofError:
            if kind is None:  # what went wrong in the block says more
                raise

    async def close(self, timeout: float = LEAVING_S) -> None:
        """Disarm it if we commanded, give the lease up, close the link. Raises if it cannot be seen to be disarmed."""
        if self._closed:
            return
        self._closed = True
        self.setpoints.stop()
        deadline = self._deadline(timeout, "leaving")
        try:
            others = self.lease.holder is not None and not self.lease.ours  # it is theirs to disarm
            if self.commanding and not others and (self.state.armed or self._may_be_armed):
                await self._stand(timeout)
            if self.lease.wanted:
                with suppress(Timeout, LinkLost):  # it ends by itself
                    # All that disarming has left, as the first word may get lost; some, if it has left nothing.
                    await self.lease.give_up(max(timeout / 6, deadline.left))
        finally:
            self.lease.stop()
            await self.session.close()

    async def disarm(self, timeout: float = TIMEOUT_S) -> None:
        """Disarm it, and see that it is; set-points are sent no more. Needs no lease."""
        deadline = self._deadline(timeout, "disarming")
        self.setpoints.stop()
        self._last_thrust = None
        await self.commands.run("COMPONENT_ARM_DISARM", [0.0], timeout, "disarming")
        await self._see(lambda: not self.state.armed, deadline)
        self._may_be_armed = False

    async def kill(self, timeout: float = TIMEOUT_S) -> None:
        """Motors off, now, in any state and without the lease; said again until it is seen.

        It holds the drone disarmed until `release`. Raises Timeout, LinkLost if it is not seen: the drone's own
        failsafe then acts on the lost link.
        """
        await self._insist(_FORCE, self._deadline(timeout, "killing"))

    async def release(self, timeout: float = TIMEOUT_S) -> None:
        """Let it be armed again after a kill, by us or by others. Raises Rejected where somebody else has the lease."""
        deadline = self._deadline(timeout, "releasing a kill")
        await self.commands.run("DO_FLIGHTTERMINATION", [0.0], timeout, deadline.doing)
        await self._see(lambda: not self.state.killed, deadline)

    async def _stand(self, timeout: float) -> None:
        """Disarm it. Insist where that is not seen, and say it even without the time to look.

        What is silent may still hear. One of ours is always disarmed by the ordinary command, which holds nothing
        afterwards; another's PX4 in flight by a kill only.
        """
        force = 0.0 if self.ours else _FORCE
        try:
            try:
                await self.disarm(timeout=timeout / 3)
            except (Rejected, Timeout, LinkLost):
                # Its heartbeat comes once a second.
                await self._insist(force, self._deadline(timeout / 2, "disarming"))
        except asyncio.CancelledError:
            with suppress(LinkLost):
                for attempt in range(_LAST_WORDS):
                    command = number_of("COMPONENT_ARM_DISARM")
                    self.session.send_anyway(self.commands.long(command, [0.0, force], attempt))
            raise

    async def _insist(self, force: float, deadline: Deadline) -> None:
        """Say that it is to disarm until it is seen to be, though the link may seem lost. Raises Timeout, LinkLost.

        A kill of one of ours is seen where it is said to hold: one that stood anyhow may have sent a heartbeat before.
        """
        self.setpoints.stop()
        number = number_of("COMPONENT_ARM_DISARM")
        beats, attempt, acknowledged = self.watcher.heartbeats, 0, False
        holds = self.ours and force == _FORCE
        with self.session.listen("HEARTBEAT", "COMMAND_ACK") as heard:
            while True:
                self.session.send_anyway(self.commands.long(number, [0.0, force], attempt))
                attempt += 1
                until = min(deadline.end, self.session.now + _RETRY_S)
                while (got := await heard.next(until, though_lost=True)) is not None:
                    acknowledged |= got.get_type() == "COMMAND_ACK" and (got.command, got.result) == (number, ACCEPTED)
                    stands = not self.state.armed and (self.state.killed or not holds)
                    seen = self.watcher.heartbeats > beats and stands
                    if acknowledged and not seen and self.clock.granting and self.session.lost is None:
                        await self._one_tick(deadline)
                    elif seen or (acknowledged and self.session.lockstep and (self.state.killed or not holds)):
                        return  # there nothing turns while time stands
                    if deadline.left <= 0.0:
                        break
                if deadline.left <= 0.0:
                    if acknowledged:
                        return
                    self.session.check(deadline.end)
                    raise deadline.error()
