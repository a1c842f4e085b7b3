"""What is known of a drone over one link: the parts that talk to it, how it stands, how it is stopped and left."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import Self

from twodof.errors import LinkLost, Rejected, Timeout, TwodofError
from twodof.gcs.clock import DroneClock, DroneRestarted
from twodof.gcs.commands import ACCEPTED, CommandSender, number_of
from twodof.gcs.drone_state import (
    BatteryState,
    DroneState,
    DroneVersion,
    StateTracker,
    StatusText,
    StatusTexts,
    version_of,
)
from twodof.gcs.excitation_player import ExcitationPlayer
from twodof.gcs.files import AsyncFiles, AsyncLogs
from twodof.gcs.full_rate import BATCH, TRUTH, FullRateSubscription
from twodof.gcs.lease import LeaseClient
from twodof.gcs.parameters import AsyncParameters
from twodof.gcs.session import Deadline, DroneSession, ProgramPaused
from twodof.gcs.setpoints import SetpointStream
from twodof.gcs.telemetry import LatestEstimates, Telemetry
from twodof.link.statistics import LinkStatistics

TIMEOUT_S = 5.0
LEAVING_S = 3.0
_RETRY_S = 0.05
# So often it is said at once where leaving is broken off: there is no time to see whether it arrives.
_LAST_WORDS = 3
_FORCE = 21196
_TICKS_FOR_AN_ANSWER = 250


class DroneBase(LatestEstimates):
    """The parts that talk to one drone, and what they have heard; for `async with`, as it is always left disarmed.

    `commanding`: we are to have the lease. `ours`: the drone is one of ours, not somebody else's PX4.
    """

    def __init__(self, session: DroneSession, commanding: bool) -> None:
        self.session = session
        self.commanding = commanding
        self.ours = False
        self.texts = StatusTexts(session)
        self.watcher = StateTracker(session)
        self.clock = DroneClock(session)
        self.commands = CommandSender(session, self.texts, self._one_tick)
        self.lease = LeaseClient(session, self.commands)
        self.files = AsyncFiles(session, self.texts)
        self.parameters = AsyncParameters(session, self.files, self.texts)
        self.telemetry = Telemetry(session)
        self.setpoints = SetpointStream(session, self.clock)
        self.exciter = ExcitationPlayer(session, self.clock)
        self.batches = FullRateSubscription(session, self.commands, BATCH)
        self.rig_truth = FullRateSubscription(session, self.commands, TRUTH)
        self.logs = AsyncLogs(session)
        session.on(self._restarted, DroneRestarted)
        session.on(self._stood_still, ProgramPaused)
        self._last_thrust: float | None = None
        self._may_be_armed = False  # by us: asked for, seen or not
        self._closed = False

    def __repr__(self) -> str:
        state = self.state
        stands = f"{state.mode}, {'armed' if state.armed else 'disarmed'}"
        return f"<drone {self.session.system} at {self.session.url}: {'closed' if self._closed else stands}>"

    @property
    def state(self) -> DroneState:
        """How it stands, as last heard: mode, armed, failsafe, rig, battery."""
        return self.watcher.state

    @property
    def tick(self) -> int:
        """Its control period, 4 ms each; in lockstep the first that has not been run."""
        return self.clock.tick

    @property
    def messages(self) -> list[StatusText]:
        """What it said in words, the last 1000 lines."""
        return list(self.texts.lines)

    @property
    def battery(self) -> BatteryState:
        """Voltage [V] and charge, 0 to 1; NaN while unknown."""
        return self.state.battery

    @property
    def statistics(self) -> LinkStatistics:
        """What the link is worth: loss, round trips, rates."""
        return self.session.connection.statistics

    @property
    def url(self) -> str:
        """Where the link leads."""
        return self.session.url

    async def version(self, timeout: float = TIMEOUT_S) -> DroneVersion:
        """What flies it: autopilot, version of its program, the machine's number.

        Raises Rejected where it does not tell, LinkLost, Timeout.
        """
        deadline = self.session.deadline(timeout, "asking for its version")
        got = await self.commands.request("AUTOPILOT_VERSION", deadline)
        if got is None:
            raise Rejected("it does not tell its version", deadline.where, "look at its state for what it is")
        return version_of(got, self.state.autopilot)

    def _restarted(self, _: DroneRestarted) -> None:
        """Not by a reset of ours: what was agreed is gone, for all but those who only watch."""
        what = f"the drone has restarted, after tick {self.tick}"
        self.texts.note("critical", what)
        if self.commanding:
            self._may_be_armed = False
            self.session.end(LinkLost(what, self.session.url, "connect again"))
        else:
            self.clock.restart()
            # It sends messages of our own kind to those only that have shown it that they know them.
            self.session.send_anyway(self.commands.request_of("TWODOF_RIG"))

    def _stood_still(self, pause: ProgramPaused) -> None:
        """A drone that this program flew has made itself safe in that time: it must not be surprised now."""
        if self.session.lockstep:  # the drone's time stood still too
            return
        what = f"this program stood still for {pause.seconds:.1f} s"
        self.texts.note("warning", what)
        if self.commanding and self.state.armed:
            self.session.end(
                LinkLost(f"{what}, and the drone was without its pilot", self.session.url, "connect again")
            )

    async def _see(self, condition: Callable[[], bool], deadline: Deadline, remedy: str = "") -> None:
        """Wait until the drone's heartbeat says so; in lockstep its time passes tick by tick."""
        last = self.tick + _TICKS_FOR_AN_ANSWER
        with self.session.listen("HEARTBEAT") as heard:
            while not condition():
                if self.clock.granting and self.tick < last:
                    await self._one_tick(deadline)
                elif await heard.next(deadline.end) is None:
                    raise deadline.error(remedy or "it acknowledged, but its heartbeat says otherwise")

    async def _one_tick(self, deadline: Deadline) -> None:
        if self.clock.granting:
            await self.clock.run_until(self.tick + 1, within=deadline)

    def _needs_ours(self, what: str, name: str) -> None:
        """Raise Rejected, at once, where the drone does not know the message `name`, since it is not one of ours."""
        if not self.ours:
            self.session.must_stand()
            missing = f"{what}: it is not one of ours but {self.state.autopilot}, which has no {name}"
            raise Rejected(
                missing, f"drone {self.session.system}", "docs/how-to/connect-clients.md says what works there"
            )

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
        deadline = self.session.deadline(timeout, "leaving")
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
        deadline = self.session.deadline(timeout, "disarming")
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
        await self._insist(_FORCE, self.session.deadline(timeout, "killing"))

    async def release(self, timeout: float = TIMEOUT_S) -> None:
        """Let it be armed again after a kill, by us or by others. Raises Rejected where somebody else has the lease."""
        deadline = self.session.deadline(timeout, "releasing a kill")
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
                await self._insist(force, self.session.deadline(timeout / 2, "disarming"))
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
