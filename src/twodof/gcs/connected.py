"""A drone that was found: all that talks to it, how it is connected to, and how it is left, disarmed."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from twodof.errors import LinkLost, Rejected, Timeout, TwodofError
from twodof.gcs.control.excitation_player import ExcitationPlayer
from twodof.gcs.control.parameters import AsyncParameters
from twodof.gcs.control.setpoints import SetpointStream
from twodof.gcs.discovery import open_link
from twodof.gcs.mavlink.clock import DroneClock
from twodof.gcs.mavlink.commands import ACCEPTED, IN_PROGRESS, CommandSender, number_of
from twodof.gcs.mavlink.deadline import Deadline
from twodof.gcs.mavlink.files import AsyncFiles
from twodof.gcs.mavlink.identity import drawn, identity
from twodof.gcs.mavlink.lease import LeaseClient
from twodof.gcs.mavlink.log_download import AsyncLogs
from twodof.gcs.mavlink.session import DroneSession
from twodof.gcs.mavlink.version import DroneVersion, version_of
from twodof.gcs.telemetry.drone_state import BatteryState, DroneState, StateTracker
from twodof.gcs.telemetry.full_rate import FullRateSubscription
from twodof.gcs.telemetry.recording import Recordings
from twodof.gcs.telemetry.signals import Telemetry
from twodof.gcs.telemetry.status_texts import StatusText, StatusTexts
from twodof.gcs.telemetry.truth import TruthSubscription
from twodof.link.connection import Connection
from twodof.link.mavlink import dialect
from twodof.link.mavlink.components import GROUND_STATION
from twodof.link.signing.key import Key, read_key
from twodof.link.statistics import LinkStatistics
from twodof.link.transport import ports
from twodof.link.transport.base import Transport

DEFAULT_URL = f"udpin://127.0.0.1:{ports.ONBOARD}"
TIMEOUT_S = 5.0
LEAVING_S = 3.0
_GREETING_S, _GREETING_RETRY_S = 4.0, 0.3
_KILL_RETRY_S = 0.05
# So often it is said at once where leaving is broken off: there is no time to see whether it arrives.
_LAST_WORDS = 3
_WORTH_SAYING_S = 0.5
_FORCE = 21196
_TICKS_FOR_AN_ANSWER = 250


class Connected:
    """A drone over one link; made by `connect` or `over`, for `async with`: leaving disarms it."""

    def __init__(self, session: DroneSession, commanding: bool) -> None:
        self.session = session
        self.commanding = commanding
        self.texts = StatusTexts(session)
        self.watcher = StateTracker(session)
        self.clock = DroneClock(session)
        self.commands = CommandSender(session, self.texts)
        self.lease = LeaseClient(session, self.commands)
        self.files = AsyncFiles(session, self.texts)
        self.parameters = AsyncParameters(session, self.files, self.texts)
        self.telemetry = Telemetry(session)
        self.setpoints = SetpointStream(session, self.clock)
        self.exciter = ExcitationPlayer(session, self.clock)
        self.batches = FullRateSubscription(session, self.commands)
        self.rig_truth = TruthSubscription(session, self.commands)
        self.recordings = Recordings(session, self.batches, self.rig_truth, self.texts, self.clock)
        self.logs = AsyncLogs(session)
        self.commands.on_progress = self._one_tick
        self.clock.on_restart = self._restarted
        session.on_pause = self._stood_still
        self._last_thrust: float | None = None
        self.ours = False  # one of ours, not somebody else's PX4
        self._may_be_armed = False  # by us: asked for, seen or not
        self._closed = False

    def __repr__(self) -> str:
        state = self.state
        stands = f"{state.mode}, {'armed' if state.armed else 'disarmed'}"
        return f"<drone {self.session.system} at {self.session.url}: {'closed' if self._closed else stands}>"

    @classmethod
    async def connect(
        cls,
        url: str = DEFAULT_URL,
        timeout: float = 10.0,
        system: int | None = None,
        key: Key | str | Path | None = None,
        take_lease: bool = True,
        drone: int | None = None,
        component: int = GROUND_STATION,
    ) -> Self:
        """Find the drone at `url` and, with `take_lease`, become the one who commands it.

        `system` and `component` are what we call ourselves: two clients need two. `system` None draws one (200 to 244,
        see gcs.identity); for a program on board, of another `component`, it is the drone's own. `drone` is the system
        id to look for if several may be heard. `key` (or its file) signs everything; what is not signed with it is
        ignored. Raises LinkError, LinkLost if no drone is heard within `timeout` [s], Rejected if somebody else has
        the lease.
        """
        deadline = Deadline(timeout, "connecting", url)
        if key is not None and not isinstance(key, Key):
            read_key(key)  # a key that is none is said before anything is opened
        transport = await open_link(url, timeout)
        return await cls.over(transport, deadline.left, system, key, take_lease, drone, component)

    @classmethod
    async def over(
        cls,
        transport: Transport,
        timeout: float = 10.0,
        system: int | None = None,
        key: Key | str | Path | None = None,
        take_lease: bool = True,
        drone: int | None = None,
        component: int = GROUND_STATION,
    ) -> Self:
        """As `connect`, over a transport that is open; it is closed with the drone, or where connecting fails."""
        deadline = Deadline(timeout, "connecting", transport.url)
        session: DroneSession | None = None
        made: Self | None = None
        try:
            on_board = component != GROUND_STATION
            number, signing = identity(system, on_board, key)
            connection = Connection(transport, number, component, signing)
            session = DroneSession(connection, on_board)
            made = cls(session, take_lease)
            await session.find(drone, deadline.left)
            connection.system = number or session.system
            session.beat()
            await made._greet(deadline, take_lease, system is None and not on_board)
        except BaseException:  # cancelled too: nothing is left open
            if made is not None:
                made.lease.stop()
            await (transport.close() if session is None else session.close())
            raise
        return made

    async def _greet(self, deadline: Deadline, take_lease: bool, drawn_id: bool) -> None:
        """Learn whether it is one of ours, and if so how its time passes; take the lease."""
        asking = Deadline(min(_GREETING_S, deadline.left), "asking what it is", f"drone {self.session.system}")
        try:
            self.ours = await self._request("TWODOF_RIG", asking)
        except Timeout:  # it is somebody else's, which does not know the question, or does not let us in
            signed = self.session.signed_frames
            if signed and self.session.connection.signing is None:
                what = f"drone {self.session.system} answers nothing: {signed} frames came signed, and we have no key"
                raise LinkLost(what, self.session.url, "connect with its key: key=FILE") from None
        self.parameters.transactions = self.commands.words_follow = self.ours
        if self.ours and drawn_id:
            await self._differ(deadline)
        if self.ours and take_lease:
            waited = await self.lease.take(deadline.left)
            if waited > _WORTH_SAYING_S:
                self.texts.note("notice", f"waited {waited:.1f} s for the lease of somebody who is not heard any more")
            if self.session.lockstep:
                await self.clock.begin_granting(deadline.left)

    async def _differ(self, deadline: Deadline) -> None:
        """Draw another id where somebody who has the lease drew the same: else we would have their lease."""
        asking = Deadline(min(_GREETING_S, deadline.left), "asking who has the lease", f"drone {self.session.system}")
        with suppress(Timeout):
            await self._request("TWODOF_LEASE", asking)
        connection, holder = self.session.connection, self.lease.holder
        if holder is not None and holder[0] == connection.system:
            connection.system = drawn(besides=(connection.system,))
            self.session.beat()

    async def _request(self, name: str, asking: Deadline) -> bool:
        """Ask for a message once; whether it came. Raises Timeout, LinkLost."""
        number, request = dialect.message_id(name), number_of("REQUEST_MESSAGE")

        def accept(got: Any) -> bool | None:
            if got.get_type() == name:
                return True
            refused = got.command == request and got.result not in (ACCEPTED, IN_PROGRESS)
            return False if refused else None

        return await self.session.ask(
            lambda attempt: self.commands.long(request, [number], attempt),
            (name, "COMMAND_ACK"),
            accept,
            asking,
            _GREETING_RETRY_S,
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

    async def _stand(self, timeout: float) -> None:
        """Disarm it; where that is not seen insist, and where there is no time to look say it all the same.

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

    @property
    def state(self) -> DroneState:
        """How it stands, as last heard."""
        return self.watcher.state

    async def version(self, timeout: float = TIMEOUT_S) -> DroneVersion:
        """What flies it: autopilot, version, the machine's number. Raises LinkLost, Timeout."""
        asking = self._deadline(timeout, "asking for its version")
        number, request = dialect.message_id("AUTOPILOT_VERSION"), number_of("REQUEST_MESSAGE")
        got = await self.session.ask(
            lambda attempt: self.commands.long(request, [number], attempt), ("AUTOPILOT_VERSION",), _itself, asking
        )
        return version_of(got, self.state.autopilot)

    @property
    def tick(self) -> int:
        """Its control period, 4 ms each; in lockstep the first that has not been run."""
        return self.clock.tick

    @property
    def theta(self) -> float:
        """The latest estimate of the pitch [rad]. Raises Timeout if none has come yet, LinkLost."""
        return self._scalar("estimate.theta")

    @property
    def q(self) -> float:
        """The latest estimate of the pitch rate [rad/s]; raises as `theta`."""
        return self._scalar("estimate.q")

    @property
    def x(self) -> float:
        """The latest estimate of the position along the rail [m]; raises as `theta`."""
        return self._scalar("estimate.x")

    @property
    def v(self) -> float:
        """The latest estimate of the velocity along the rail [m/s]; raises as `theta`."""
        return self._scalar("estimate.v")

    def _scalar(self, name: str) -> float:
        value = self.telemetry(name).value
        return value[0] if isinstance(value, tuple) else value

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

    async def disarm(self, timeout: float = TIMEOUT_S) -> None:
        """Disarm it, and see that it is; set-points are sent no more. Needs no lease."""
        deadline = self._deadline(timeout, "disarming")
        self.setpoints.stop()
        self._last_thrust = None
        await self.commands.run("COMPONENT_ARM_DISARM", [0.0], timeout, "disarming")
        await self._see(lambda: not self.state.armed, deadline)
        self._may_be_armed = False

    async def kill(self, timeout: float = TIMEOUT_S) -> None:
        """Motors off, now, whoever has the lease and whatever it does; said again until it is seen.

        It holds the drone disarmed until `release`. Raises Timeout, LinkLost if it is not seen: the drone's own
        failsafe then acts on the lost link.
        """
        await self._insist(_FORCE, self._deadline(timeout, "killing"))

    async def release(self, timeout: float = TIMEOUT_S) -> None:
        """Let it be armed again after a kill, whoever killed it. Raises Rejected where somebody else has the lease."""
        deadline = self._deadline(timeout, "releasing a kill")
        await self.commands.run("DO_FLIGHTTERMINATION", [0.0], timeout, deadline.doing)
        await self._see(lambda: not self.state.killed, deadline)

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
                until = min(deadline.end, self.session.now + _KILL_RETRY_S)
                while (got := await heard.next(until, though_lost=True)) is not None:
                    acknowledged |= got.get_type() == "COMMAND_ACK" and (got.command, got.result) == (number, ACCEPTED)
                    stands = not self.state.armed and (self.state.killed or not holds)
                    seen = self.watcher.heartbeats > beats and stands
                    if acknowledged and not seen and self.clock.granting and self.session.lost is None:
                        await self.clock.run_until(self.tick + 1, within=deadline)
                    elif seen or (acknowledged and self.session.lockstep and (self.state.killed or not holds)):
                        return  # there nothing turns while time stands
                    if deadline.left <= 0.0:
                        break
                if acknowledged and deadline.left <= 0.0:
                    return
                if deadline.left <= 0.0:
                    self.session.check(deadline.end)
                    raise deadline.error()

    def _restarted(self) -> None:
        """Not by a reset of ours: what was agreed is gone, for all but those who only watch."""
        self.texts.note("critical", f"the drone has restarted, after tick {self.tick}")
        if not self.commanding:
            self.clock.restart()
            # It sends messages of our own kind to those only that have shown it that they know them.
            self.session.send_anyway(
                self.commands.long(number_of("REQUEST_MESSAGE"), [dialect.message_id("TWODOF_RIG")])
            )
            return
        self._may_be_armed = False
        self.session.end(
            LinkLost(f"the drone has restarted, after tick {self.tick}", self.session.url, "connect again")
        )

    def _stood_still(self, seconds: float) -> None:
        """This program did: a drone that it flew has made itself safe meanwhile, and is not to be surprised now."""
        if self.session.lockstep:  # so did the drone's time
            return
        self.texts.note("warning", f"this program stood still for {seconds:.1f} s")
        if self.commanding and self.state.armed:
            gone = f"this program stood still for {seconds:.1f} s, and the drone was without its pilot"
            self.session.end(LinkLost(gone, self.session.url, "connect again"))

    async def _see(self, condition: Callable[[], bool], deadline: Deadline, remedy: str = "") -> None:
        """Wait until the drone's heartbeat says so; in lockstep its time passes meanwhile, tick by tick."""
        last = self.tick + _TICKS_FOR_AN_ANSWER
        with self.session.listen("HEARTBEAT") as heard:
            while not condition():
                if self.clock.granting and self.tick < last:
                    await self.clock.run_until(self.tick + 1, within=deadline)
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
            remedy = "docs/how-to/connect-clients.md says what works there"
            raise Rejected(missing, f"drone {self.session.system}", remedy)

    def _deadline(self, timeout: float, doing: str) -> Deadline:
        return Deadline(timeout, doing, f"drone {self.session.system}")


def _itself(got: Any) -> Any:
    return got
