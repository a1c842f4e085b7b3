"""AsyncDrone: one drone, flown from an asyncio program. Every call ends in a value or a typed error, in time."""

from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractAsyncContextManager, suppress
from functools import partial
from math import ceil, inf
from pathlib import Path
from typing import Any, Self

from twodof.errors import (
    ExperimentError,
    LinkLost,
    LogError,
    ParameterError,
    RefusalReason,
    Rejected,
    Timeout,
    TwodofError,
    shown,
)
from twodof.excitation import Excitation
from twodof.gcs.active_controller import ActiveController, read_active_controller
from twodof.gcs.arming import ArmingClient
from twodof.gcs.clock import DroneClock, DroneRestarted
from twodof.gcs.commands import CommandSender
from twodof.gcs.discovery import open_link
from twodof.gcs.drone_state import DroneVersion, DroneView, StateTracker, StatusTexts, version_of
from twodof.gcs.excitation_player import ExcitationPlayback, ExcitationPlayer
from twodof.gcs.files import AsyncFiles, AsyncLogs
from twodof.gcs.full_rate import BATCH, TRUTH, BatchRows, FullRateSubscription, TruthRows
from twodof.gcs.lease import LeaseClient
from twodof.gcs.parameters import AsyncParameters
from twodof.gcs.recording import Recording, record
from twodof.gcs.session import SILENT_S, Deadline, DroneSession, ProgramPaused, drawn, give_back, identity
from twodof.gcs.setpoints import SetpointStream, setpoint
from twodof.gcs.telemetry import Telemetry
from twodof.link.connection import Connection
from twodof.link.mavlink import dialect
from twodof.link.mavlink.dialect import GROUND_STATION
from twodof.link.mavlink.messages import channel_mask, message
from twodof.link.signing import Key, read_key
from twodof.link.transport.base import Transport
from twodof.link.transport.url import Ports
from twodof.signals import TICK_S

DEFAULT_URL = f"udpin://127.0.0.1:{Ports.ONBOARD}"
TIMEOUT_S = 5.0
LEAVING_S = 3.0
HOVER = "THRUST_BAR"
BUILDS = "the drone builds it"
"""Text with which `fly_controller` reports that it cannot be cancelled any more."""
_REFUSED = 16
_GREETING_S, _GREETING_RETRY_S = 4.0, 0.3
_WORTH_SAYING_S = 0.5
_FOLLOWING = "changing to a mode in which set-points are followed"


class AsyncDrone(DroneView):
    """A drone, real or virtual, over one link; made by `connect`, for `async with`: leaving disarms it.

    Times are in seconds, angles in radians. Calls that wait raise LinkLost if the drone falls silent for 3 s, Rejected
    with the drone's reason, Timeout at their deadline.
    """

    def __init__(self, session: DroneSession, commanding: bool) -> None:
        clock = DroneClock(session)
        super().__init__(session, StateTracker(session, clock), StatusTexts(session), clock)
        self.telemetry = Telemetry(session)
        self.commanding = commanding  # this client is to have the lease
        self.commands = CommandSender(session, self.texts, clock)
        self.lease = LeaseClient(session, self.commands)
        self.files = AsyncFiles(session, self.texts)
        self.logs = AsyncLogs(session)
        self.parameters = AsyncParameters(session, self.files, self.texts)
        self.setpoints = SetpointStream(session, clock, self.watcher, self.commands, self.lease)
        self.arming = ArmingClient(session, self.watcher, self.commands, clock, self.setpoints)
        self.exciter = ExcitationPlayer(session, clock)
        self.batches = FullRateSubscription(session, self.commands, BATCH)
        self.rig_truth = FullRateSubscription(session, self.commands, TRUTH)
        self._last_thrust: float | None = None
        self._closed = False
        session.on(self._restarted, DroneRestarted)
        session.on(self._stood_still, ProgramPaused)

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
        """Find the drone at `url` and, with `take_lease`, take its lease.

        `system` and `component` are this client's MAVLink ids; two clients need different ones. `system` None draws one
        (200 to 244, see gcs.session). A program on board, which has another `component`, gets the drone's own system.
        `drone` is the system id to look for if several may be heard. `key` (or its file) signs every message; messages
        not signed with it are ignored. Raises LinkError, LinkLost if no drone is heard within `timeout` [s], Rejected
        if another client has the lease.
        """
        deadline = Deadline(timeout, "connecting", url)
        if key is not None and not isinstance(key, Key):
            read_key(key)  # raises before anything is opened
        transport, taken = await open_link(url, timeout)
        try:
            return await cls.over(transport, deadline.left, system, key, take_lease, drone, component)
        except LinkLost as lost:
            if taken is None:
                raise
            what = f"{taken.what}; called at {lost.where}: {lost.what}"
            raise LinkLost(what, taken.where, taken.remedy or lost.remedy) from taken

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
        """Connect, as `connect` does, over an open transport. It is closed with the drone or if connecting fails."""
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
            await made._greet(deadline, drawn_id=system is None and not on_board)
        except BaseException:  # cancelled too: nothing is left open
            if made is not None:
                made.lease.stop()
            await (transport.close() if session is None else session.close())
            raise
        return made

    async def command(self, command: str, *values: float, timeout: float = TIMEOUT_S) -> Any:
        """Send a MAV_CMD by its name ("PREFLIGHT_STORAGE") with up to seven values; return its COMMAND_ACK."""
        return await self.commands.run(command, values, timeout, command)

    async def excite(
        self,
        excitation: Excitation,
        loop: str | None = None,
        thrust: float | None = None,
        at: int | None = None,
        wait: bool = True,
        timeout: float = TIMEOUT_S,
    ) -> ExcitationPlayback:
        """Play an excitation on board, added to the set-point of `loop` ("q", "theta", "v", "x") or the moment ("M").

        `loop` None stands for the loop with the excitation's unit. `thrust` is 0 to 1, None leaves it unchanged. `at`
        is the tick at which the excitation starts, None: at once. With `wait` the call lets the drone's time pass until
        the excitation is over. Raises ExperimentError for a loop of another unit, Rejected with the drone's reason.
        """
        self._needs_ours("excitations on board", "TWODOF_EXCITE")
        if not isinstance(excitation, Excitation):
            what = f"{shown(excitation)} is not an excitation"
            raise ExperimentError(what, "excite", "give one of twodof.excitation, such as Doublet(0.03, 0.6)")
        self.watcher.check_not_killed()
        playback = await self.exciter.start(excitation, loop, thrust, at, timeout)
        return await self.exciter.finish(playback) if wait else playback

    async def stop_excitation(self, timeout: float = TIMEOUT_S) -> None:
        """Stop the excitation and wait until it is over; the drone holds the set-point before it. Raises Rejected."""
        self._needs_ours("excitations on board", "TWODOF_EXCITE")
        await self.exciter.stop(timeout)

    def batch(self, columns: Iterable[str]) -> AbstractAsyncContextManager[BatchRows]:
        """Collect every sample of these columns of signals.TOPICS (`imu.gyro_y`) at the full rate, for `async with`.

        Raises LinkError for an unknown column.
        """
        self._needs_ours("samples at full rate", "TWODOF_BATCH")
        names = tuple(columns)
        return self.batches.rows(BatchRows(names), channel_mask(names))

    def truth(self) -> AbstractAsyncContextManager[TruthRows]:
        """Collect the true state of a virtual rig at the full rate, for `async with`.

        Raises Rejected for a real drone and for a program on board.
        """
        self._needs_ours("the rig's true state", "TWODOF_TRUTH")
        if self.session.on_board or not self.state.rig.virtual:
            why = "is never sent to a program on board" if self.session.on_board else "is unknown for a real drone"
            raise Rejected(f"the rig's true state {why}", self.session.where, "use the estimates")
        return self.rig_truth.rows(TruthRows())

    async def active_controller(self, timeout: float = TIMEOUT_S) -> ActiveController:
        """Read the parameters that are not at their defaults, and the diagrams that replace stock controllers.

        Raises LinkLost, Timeout.
        """
        self._needs_ours("reading the active controller", "folder of controllers")
        return await read_active_controller(
            self.parameters, self.files, self.session.deadline(timeout, "reading the active controller")
        )

    def record(
        self,
        path: str | Path,
        topics: Iterable[str] | None = None,
        provenance: Mapping[str, object] | None = None,
        overwrite: bool = False,
    ) -> AbstractAsyncContextManager[Recording]:
        """Record topics (None: all) at the full rate into a new MCAP file, for `async with`.

        Raises LogError for an existing file, unless `overwrite`: then the file is kept until the new one has begun in
        its place. `flightlog.numbered` gives new names for repeated recordings.

        The file also holds the tuned parameters and, as attachments, the diagrams of the user's controllers.

        Messages of a plain PX4 are recorded as they come; `stream` asks for more of them.
        """
        if Path(path).suffix.lower() != ".mcap":
            raise LogError("a recording is an MCAP file", str(path), "name it .mcap; write_log converts it")
        flying = self.active_controller if self.ours else None
        return record(self, path, topics, provenance or {}, flying, overwrite)

    async def reset(
        self, seed: int = 1, x: float = 0.0, noise: float = 1.0, rings: bool = False, timeout: float = TIMEOUT_S
    ) -> None:
        """Restart a virtual drone at tick 0, at rest at `x` [m], with `rings` locked or not.

        `seed` is that of its sensors' noise, `noise` scales it. Raises Rejected for a real drone, while the drone is
        armed, or with the drone's reason.
        """
        self._needs_ours("a reset", "TWODOF_RIG_RESET")
        deadline = self.session.deadline(timeout, "resetting the rig")
        self.setpoints.stop()
        spoken = self.texts.count
        self.commands.refusals.clear()
        asked = message("TWODOF_RIG_RESET", seed=seed, x=x, noise=noise, rings=int(rings), **self.session.target)
        with self.clock.resetting():
            got = await self.session.ask(asked, ("TWODOF_RIG",), _reset_answer, deadline)
            if got.flags & _REFUSED:
                said = await self.commands.words(spoken, deadline)
                code = self.commands.refusals.get("TWODOF_RIG_RESET", RefusalReason.OTHER)
                armed = self.state.armed or code is RefusalReason.ARMED
                remedy = "disarm it first" if armed else "remove this cause and try again; a real rig has no reset"
                raise Rejected(said or "the rig is not reset", deadline.where, remedy, code)
            self.clock.restart()
        self.telemetry.clear()

    async def fly_controller(
        self,
        template: str,
        diagram: str | bytes,
        timeout: float = 120.0,
        progress: Callable[[str, float], None] | None = None,
    ) -> None:
        """Send a controller, the JSON of its `diagram`, and fly it in a sandbox in place of that of `template`.

        The stock controller's diagram restores the stock one. Raises Rejected if the drone is armed, cannot build
        controllers, or finds a fault in the diagram; the controller before then stays active. `progress` is called with
        the current step and the share done. The call can be cancelled until `progress` gets `BUILDS`: from then on the
        drone goes on by itself.
        """
        report = progress or (lambda text, share: None)
        self._needs_ours("flying a controller of your own", "folder of controllers")
        path = f"/controllers/{template}.json"
        content = diagram.encode() if isinstance(diagram, str) else diagram
        deadline = self.session.deadline(timeout, "sending a controller")
        self.session.check(self.session.now)  # the last state of a lost drone says nothing
        if self.state.armed:
            raise Rejected("the drone is armed", deadline.where, "disarm it first")
        report("asks the drone", 0.0)
        await self.commands.run("USER_1", [1.0], deadline.left, "asking whether it can build controllers")
        sending = partial(_sending, report)
        sending(0.0)
        await self.files.write(path, content, deadline.left, sending)
        await self.commands.run("USER_1", [], deadline.left, "flying another controller")
        self.parameters.forget()

    async def stream(self, name: str, rate: float, timeout: float = TIMEOUT_S) -> None:
        """Request the message `name`, such as "ACTUATOR_CONTROL_TARGET", at `rate` [Hz]; 0: its default, < 0: never."""
        interval = 1e6 / rate if rate > 0.0 else -1.0 if rate < 0.0 else 0.0
        values = [dialect.message_id(name), interval]
        if name.startswith("TWODOF_"):
            self._needs_ours("a message of twodof", name)
        await self.commands.run("SET_MESSAGE_INTERVAL", values, timeout, f"setting the rate of {name}")

    async def version(self, timeout: float = TIMEOUT_S) -> DroneVersion:
        """Return the kind and version of the drone's program, and the number of its computer.

        Raises Rejected if the drone does not report them, LinkLost, Timeout.
        """
        deadline = self.session.deadline(timeout, "asking for its version")
        got = await self.commands.request("AUTOPILOT_VERSION", deadline)
        if got is None:
            what = "the drone does not report its version"
            raise Rejected(what, deadline.where, "see `state.autopilot` for its kind")
        return version_of(got, self.state.autopilot)

    async def arm(self, timeout: float = TIMEOUT_S) -> None:
        """Arm the drone and wait until it confirms that. Raises Rejected with the reason against it."""
        await self.arming.arm(timeout)

    async def disarm(self, timeout: float = TIMEOUT_S) -> None:
        """Stop the set-points, disarm the drone and wait until it confirms that. Needs no lease."""
        self._last_thrust = None
        await self.arming.disarm(timeout)

    async def kill(self, timeout: float = TIMEOUT_S) -> None:
        """Stop the motors now, in any state and without the lease; repeat the order until the drone confirms it.

        The kill keeps the drone disarmed until `release`. Raises Timeout, LinkLost if the drone does not confirm it:
        the drone's own failsafe then acts on the lost link.
        """
        await self.arming.kill(timeout)

    async def release(self, timeout: float = TIMEOUT_S) -> None:
        """Allow arming again after a kill by any client. Raises Rejected if another client has the lease."""
        await self.arming.release(timeout)

    async def set_mode(self, mode: str, timeout: float = TIMEOUT_S) -> None:
        """Change the mode (manual, rate, attitude, position, hold, offboard) and wait until the drone confirms it."""
        deadline = self.session.deadline(timeout, f"changing to the mode {mode}")
        await self.setpoints.switch(mode, deadline)
        offboard = "offboard needs set-points: set_pitch and the like enter it by themselves"
        await self.watcher.wait_until(
            lambda state: state.mode == mode, deadline, offboard if mode == "offboard" else ""
        )

    async def level_hold(self, timeout: float = TIMEOUT_S) -> None:
        """Let the drone hold itself level at the thrust THRUST_BAR, without set-points."""
        await self.set_mode("hold", timeout)
        self.setpoints.stop()

    async def set_moment(self, M: float, thrust: float | None = None, timeout: float = TIMEOUT_S) -> None:
        """Fly a normalised pitch moment (-1 to 1) about the trim in open loop; `thrust` 0 to 1, None: unchanged."""
        asked = setpoint("M", M, thrust)
        self._needs_ours("a moment without a loop", "TWODOF_OPENLOOP")
        await self.setpoints.follow(asked, self.session.deadline(timeout, _FOLLOWING))

    async def set_pitch(self, theta: float, thrust: float | None = None, timeout: float = TIMEOUT_S) -> None:
        """Follow a pitch [rad]; `thrust` 0 to 1, None: the last one given, at first the parameter THRUST_BAR."""
        await self._follow("theta", theta, timeout, thrust)

    async def set_pitch_rate(self, q: float, thrust: float | None = None, timeout: float = TIMEOUT_S) -> None:
        """Follow a pitch rate [rad/s]; `thrust` as in `set_pitch`."""
        await self._follow("q", q, timeout, thrust)

    async def set_velocity(self, v: float, acceleration: float | None = None, timeout: float = TIMEOUT_S) -> None:
        """Follow a velocity along the rail [m/s], with an acceleration [m/s^2] fed forward."""
        asked = setpoint("v", v, acceleration=acceleration)
        await self.setpoints.follow(asked, self.session.deadline(timeout, _FOLLOWING))

    async def set_position(self, x: float, acceleration: float | None = None, timeout: float = TIMEOUT_S) -> None:
        """Follow a position along the rail [m], with an acceleration [m/s^2] fed forward."""
        asked = setpoint("x", x, acceleration=acceleration)
        await self.setpoints.follow(asked, self.session.deadline(timeout, _FOLLOWING))

    def stop_setpoints(self) -> None:
        """Stop sending set-points: after .5 s the drone levels itself."""
        self.setpoints.stop()

    async def withhold_tuning(self, withhold: bool = True, timeout: float = TIMEOUT_S) -> None:
        """Forbid other clients to change parameters while this one has the lease, or (`withhold` False) allow it again.

        Raises Rejected unless this client has the lease.
        """
        self._needs_ours("withholding tuning", "TWODOF_LEASE")
        await self.lease.withhold_tuning(withhold, timeout)

    async def run(self, seconds: float) -> None:
        """Let `seconds` of the drone's time pass.

        Raises ParameterError for a time that is negative or infinite, LinkLost, Timeout if the drone's time stands
        still, Rejected if a kill ends a flight.
        """
        if not 0.0 <= seconds < inf:
            raise ParameterError(f"run({shown(seconds)}): time passes forwards", "drone", "give 0 or more seconds")
        await self.run_until(self.tick + ceil(max(0.0, seconds / TICK_S - 1e-9)))

    async def run_until(self, tick: int) -> None:
        """Let the drone's time pass up to `tick`, which is not run yet. Raises as `run`."""
        await self.setpoints.pass_time(tick)

    async def wait_until(self, condition: Callable[[], bool], timeout: float) -> None:
        """Let the drone's time pass until `condition()` is true; it is called every 20 ms of the drone's time.

        Raises Timeout after `timeout` [s] of the drone's time. If that stands still, Timeout comes after as much of
        this computer's time, but not before 2 s and not after 5 s. `condition` reads values that have come, and asks
        the drone nothing.
        """
        await self.setpoints.pass_time(self.tick + ceil(timeout / TICK_S), condition, patience=timeout)
        if not condition():
            what = f"the condition did not become true within {timeout:g} s"
            raise Timeout(what, self.session.where, "check the condition, or allow more time")

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            await self.close()
        except TwodofError:
            if kind is None:  # the error in the block says more
                raise

    async def close(self, timeout: float = LEAVING_S) -> None:
        """Disarm the drone if this client commands it, give up the lease and close the link.

        Raises Timeout, LinkLost if the drone does not confirm that it is disarmed.
        """
        if self._closed:
            return
        self._closed = True
        self.setpoints.stop()
        deadline = self.session.deadline(timeout, "leaving")
        try:
            others = self.lease.holder is not None and not self.lease.ours  # then the holder disarms it
            if self.commanding and not others:
                await self.arming.leave(timeout)
            if self.lease.wanted:
                with suppress(Timeout, LinkLost):  # it ends by itself
                    # The time that disarming left, but some in any case: the first message may get lost.
                    await self.lease.give_up(max(timeout / 6, deadline.left))
        finally:
            self.lease.stop()
            await self.session.close()

    async def _follow(self, axis: str, value: float, timeout: float, thrust: float | None) -> None:
        """Follow a set-point that needs a thrust: the one given, the last one, or the parameter for hovering."""
        deadline = self.session.deadline(timeout, _FOLLOWING)
        self._last_thrust = thrust = self._last_thrust if thrust is None else thrust
        if thrust is None and not self.ours:
            raise ParameterError("the thrust for hovering is unknown on this drone", "set-point", "give thrust=")
        if thrust is None:
            thrust = await self.parameters.read(HOVER, deadline.left)
        await self.setpoints.follow(setpoint(axis, value, thrust), deadline)

    def _needs_ours(self, what: str, name: str) -> None:
        """Raise Rejected at once if the drone is a plain PX4, which does not know the message `name`."""
        if not self.ours:
            self.session.check_lost()
            missing = f"{what}: this is not a twodof drone but {self.state.autopilot}, which has no {name}"
            remedy = "docs/how-to/connect-clients.md says what works there"
            raise Rejected(missing, self.session.where, remedy)

    def _restarted(self, _: DroneRestarted) -> None:
        """End the session after a restart; a client that only watches goes on."""
        what = f"the drone has restarted, after tick {self.tick}"
        self.texts.note("critical", what)
        if self.commanding:
            self.arming.may_be_armed = False
            self.session.end(LinkLost(what, self.session.url, "connect again"))
        else:
            self.clock.restart()
            # The drone sends messages of our own kind only to clients that have sent one.
            self.session.send_anyway(self.commands.request_of("TWODOF_RIG"))

    def _stood_still(self, pause: ProgramPaused) -> None:
        """Say that this program stood still; after a long pause in flight, end the session of the pilot."""
        if self.session.lockstep:  # the drone's time stood still too
            return
        what = f"this computer is too slow, or slept: this program stood still for {pause.seconds:.1f} s"
        self.texts.note("warning", what)
        if self.commanding and self.state.armed and pause.seconds > SILENT_S:
            what = f"{what}, and the drone was without its pilot"
            self.session.end(LinkLost(what, self.session.url, "connect again"))

    async def _greet(self, deadline: Deadline, drawn_id: bool) -> None:
        """Find out whether this is a twodof drone and how its time passes; take the lease if commanding.

        `drawn_id`: this client's system id was drawn, so another one may be drawn. Raises LinkLost, Rejected, Timeout.
        """
        session = self.session
        try:
            session.ours = await self._answers("TWODOF_RIG", "asking what it is", deadline)
        except Timeout:  # another's PX4 does not know the question; a drone with a key lets only signed frames in
            signed = session.signed_frames
            if signed and session.connection.signing is None:
                what = f"drone {session.system} does not answer: its {signed} frames are signed, and we have no key"
                raise LinkLost(what, session.url, "connect with its key: key=FILE") from None
        if self.ours and drawn_id:
            await self._draw_another_id(deadline)
        if self.ours and self.commanding:
            waited = await self.lease.take(deadline.left)
            if waited > _WORTH_SAYING_S:
                self.texts.note("notice", f"waited {waited:.1f} s for the lease of somebody who is not heard any more")
            if session.lockstep:
                await self.clock.begin_granting(deadline.left)

    async def _draw_another_id(self, deadline: Deadline) -> None:
        """Draw another system id if the lease's holder has the same one: this client would share its lease."""
        with suppress(Timeout):
            await self._answers("TWODOF_LEASE", "asking who has the lease", deadline)
        connection, holder = self.session.connection, self.lease.holder
        if holder is not None and holder[0] == connection.system:
            before, connection.system = connection.system, drawn(besides=(connection.system,))
            give_back(before)
            self.session.beat()

    async def _answers(self, name: str, doing: str, deadline: Deadline) -> bool:
        """Ask for a message; return False if the drone refuses. Raises Timeout, LinkLost."""
        asking = self.session.deadline(min(_GREETING_S, deadline.left), doing)
        return await self.commands.request(name, asking, _GREETING_RETRY_S) is not None


def _sending(report: Callable[[str, float], None], share: float) -> None:
    report("sends it" if share < 1.0 else BUILDS, 0.05 + 0.35 * share)


def _reset_answer(got: Any) -> Any | None:
    """Return the answer to a reset (a refusal, or the rig at tick 0); None for any other message."""
    return got if got.flags & _REFUSED or got.tick == 0 else None
