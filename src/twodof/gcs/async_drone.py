"""AsyncDrone: one drone, flown from an asyncio program. Every call ends in a value or a typed error, in time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractAsyncContextManager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Self

from twodof.errors import ExperimentError, LinkLost, LogError, RefusalReason, Rejected, Timeout, shown
from twodof.excitation import Excitation
from twodof.gcs.active_controller import ActiveController, read_active_controller
from twodof.gcs.discovery import open_link
from twodof.gcs.drone_base import TIMEOUT_S, DroneBase
from twodof.gcs.excitation_player import ExcitationPlayback
from twodof.gcs.flying_drone import FlyingDrone
from twodof.gcs.full_rate import BatchRows, TruthRows
from twodof.gcs.identity import drawn, give_back, identity
from twodof.gcs.recording import Recording, record
from twodof.gcs.session import Deadline, DroneSession
from twodof.link.connection import Connection
from twodof.link.mavlink import dialect
from twodof.link.mavlink.dialect import GROUND_STATION
from twodof.link.mavlink.messages import channel_mask, message
from twodof.link.signing import Key, read_key
from twodof.link.transport.base import Transport
from twodof.link.transport.url import Port

DEFAULT_URL = f"udpin://127.0.0.1:{Port.ONBOARD}"
_REFUSED = 16
_GREETING_S, _GREETING_RETRY_S = 4.0, 0.3
_WORTH_SAYING_S = 0.5
BUILDS = "the drone builds it"
"""What `fly_controller` tells from when on it cannot be cancelled."""


class AsyncDrone(FlyingDrone):
    """A drone, real or virtual, over one link; made by `connect`, for `async with`: leaving disarms it.

    Times are in seconds, angles in radians. Calls that wait raise LinkLost if the drone falls silent for 3 s, Rejected
    with the drone's reason, Timeout at their deadline.
    """

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
        see gcs.identity); for a program on board, of another `component`, it is the drone's own. `drone` is the
        system id to look for if several may be heard. `key` (or its file) signs everything; what is not signed with it
        is ignored. Raises LinkError, LinkLost if no drone is heard within `timeout` [s], Rejected if somebody else has
        the lease.
        """
        deadline = Deadline(timeout, "connecting", url)
        if key is not None and not isinstance(key, Key):
            read_key(key)  # a key that is none is said before anything is opened
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
            await _greet(made, deadline, drawn_id=system is None and not on_board)
        except BaseException:  # cancelled too: nothing is left open
            if made is not None:
                made.lease.stop()
            await (transport.close() if session is None else session.close())
            raise
        return made

    async def command(self, command: str, *values: float, timeout: float = TIMEOUT_S) -> Any:
        """Any MAV_CMD by its name ("PREFLIGHT_STORAGE") with up to seven values; returns its COMMAND_ACK."""
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
        """Play an excitation on board, added to what `loop` ("M", "q", "theta", "v", "x") follows.

        `loop` None is that of the excitation's unit; `thrust` 0 to 1, None: as it is; `at` is the tick at which it
        starts, None: at once. With `wait` the drone's time passes until it is over. Raises ExperimentError for a loop
        of another unit, Rejected with the drone's reason.
        """
        self._needs_ours("excitations on board", "TWODOF_EXCITE")
        if not isinstance(excitation, Excitation):
            what = f"{shown(excitation)} is no excitation"
            raise ExperimentError(what, "excite", "give one of twodof.excitation, such as Doublet(0.03, 0.6)")
        self._not_killed(self.session.deadline(timeout, "excite"))
        playback = await self.exciter.start(excitation, loop, thrust, at, timeout)
        return await self.exciter.finish(playback) if wait else playback

    async def stop_excitation(self, timeout: float = TIMEOUT_S) -> None:
        """Stop what plays, and see that it is over; the set-point before it is held. Raises Rejected."""
        self._needs_ours("excitations on board", "TWODOF_EXCITE")
        await self.exciter.stop(timeout)

    def batch(self, columns: Iterable[str]) -> AbstractAsyncContextManager[BatchRows]:
        """Every sample of these columns of signals.TOPICS (`imu.gyro_y`) at the full rate, for `async with`.

        Raises LinkError for a column that is none.
        """
        self._needs_ours("samples at full rate", "TWODOF_BATCH")
        names = tuple(columns)
        return self.batches.rows(BatchRows(names), channel_mask(names))

    def truth(self) -> AbstractAsyncContextManager[TruthRows]:
        """The true state of a virtual rig at the full rate, for `async with`; what is on board never gets it.

        Raises Rejected by a real drone and for a program on board.
        """
        self._needs_ours("the rig's true state", "TWODOF_TRUTH")
        if self.session.on_board or not self.state.rig.virtual:
            why = "what is on board never gets it" if self.session.on_board else "nobody knows that of a real one"
            raise Rejected(f"the rig's true state: {why}", f"drone {self.session.system}", "go by the estimates")
        return self.rig_truth.rows(TruthRows())

    async def active_controller(self, timeout: float = TIMEOUT_S) -> ActiveController:
        """Which parameters are not at their defaults, and which diagrams fly in place of the stock controllers.

        Raises LinkLost, Timeout.
        """
        self._needs_ours("what flies", "folder of controllers")
        return await read_active_controller(
            self.parameters, self.files, self.session.deadline(timeout, "asking what flies")
        )

    def record(
        self,
        path: str | Path,
        topics: Iterable[str] | None = None,
        provenance: Mapping[str, object] | None = None,
        overwrite: bool = False,
    ) -> AbstractAsyncContextManager[Recording]:
        """Record topics (None: all) at the full rate into a new MCAP file, for `async with`.

        Raises LogError for a file that is there, unless `overwrite` says that it may be lost: it is kept until the new
        one has begun in its place. A session that repeats takes new names from `flightlog.numbered`.

        The file also holds what flies: tuned parameters and, as attachments, the diagrams of the user's controllers.

        Of a drone that is not ours what it sends is recorded as it comes: `stream` asks for more of it.
        """
        if Path(path).suffix.lower() != ".mcap":
            raise LogError("a recording is an MCAP file", str(path), "call it .mcap; write_log makes others of it")
        flying = self.active_controller if self.ours else None
        return record(self, path, topics, provenance or {}, flying, overwrite)

    async def reset(
        self, seed: int = 1, x: float = 0.0, noise: float = 1.0, rings: bool = False, timeout: float = TIMEOUT_S
    ) -> None:
        """Start a virtual drone anew: tick 0, at rest at `x` [m], `rings` locked or not, the noise of `seed` scaled.

        Raises Rejected for a real one, while armed, or where the drone says so.
        """
        self._needs_ours("a reset", "TWODOF_RIG_RESET")
        deadline = self.session.deadline(timeout, "resetting the rig")
        self.setpoints.stop()
        spoken = self.texts.count
        self.commands.refusals.clear()
        asked = message(
            "TWODOF_RIG_RESET",
            seed=seed,
            x=x,
            noise=noise,
            rings=int(rings),
            **self.session.target,
        )
        with self.clock.resetting():
            got = await self.session.ask(lambda _: asked, ("TWODOF_RIG",), _reset_answer, deadline)
            if got.flags & _REFUSED:
                said = await self.commands.words(spoken, deadline)
                code = self.commands.refusals.get("TWODOF_RIG_RESET", RefusalReason.OTHER)
                armed = self.state.armed or code is RefusalReason.ARMED
                remedy = "disarm it first" if armed else "put right what it says; a real rig has no reset"
                raise Rejected(said or "the rig is not reset", deadline.where, remedy, code)
            self.clock.restart()
        self.telemetry.clear()

    async def fly_controller(
        self,
        template: str,
        diagram: str | bytes,
        timeout: float = 120.0,
        said: Callable[[str, float], None] | None = None,
    ) -> None:
        """Send a controller, a diagram's JSON, and have it fly in the place of the one of that template, in a sandbox.

        A stock controller's own diagram brings the stock one back. Before anything is sent the drone is asked whether
        it has what the sandbox takes. Raises Rejected where it lacks that, is armed, or finds a fault in the diagram;
        then what flew before flies on. `said` is told what is done and the share done. It can be cancelled until it is
        told `BUILDS`: then the drone has all, and goes on by itself.
        """
        said = said or _silent
        self._needs_ours("controllers of one's own", "folder of controllers")
        path = f"/controllers/{template}.json"
        content = diagram.encode() if isinstance(diagram, str) else diagram
        deadline = self.session.deadline(timeout, "sending a controller")
        self.session.check(self.session.now)  # what is known of a drone that is lost says nothing
        if self.state.armed:
            raise Rejected("it is armed", deadline.where, "disarm it first")
        said("asks the drone", 0.0)
        await self.commands.run("USER_1", [1.0], deadline.left, "asking whether it can build controllers")
        sending = partial(_sending, said)
        sending(0.0)
        await self.files.write(path, content, deadline.left, sending)
        await self.commands.run("USER_1", [], deadline.left, "flying another controller")
        self.parameters.forget()

    async def stream(self, name: str, rate: float, timeout: float = TIMEOUT_S) -> None:
        """Have a message (such as "ACTUATOR_CONTROL_TARGET") sent `rate` times a second; 0: as by default, < 0: not."""
        interval = 1e6 / rate if rate > 0.0 else -1.0 if rate < 0.0 else 0.0
        values = [dialect.message_id(name), interval]
        if name.startswith("TWODOF_"):
            self._needs_ours("a message of our own", name)
        await self.commands.run("SET_MESSAGE_INTERVAL", values, timeout, f"setting the rate of {name}")


def _silent(text: str, share: float) -> None:
    """Tells nobody."""


def _sending(said: Callable[[str, float], None], share: float) -> None:
    """What is sent of a controller; once all is there the drone builds it."""
    said("sends it" if share < 1.0 else BUILDS, 0.05 + 0.35 * share)


def _reset_answer(got: Any) -> Any | None:
    """The answer to a reset: a refusal, or the rig at its tick 0."""
    return got if got.flags & _REFUSED or got.tick == 0 else None


async def _greet(drone: DroneBase, deadline: Deadline, drawn_id: bool) -> None:
    """Learn whether it is one of ours, and if so how its time passes; take the lease if it is to command.

    `drawn_id`: our system id was drawn, so another one may be drawn. Raises LinkLost, Rejected, Timeout.
    """
    session = drone.session
    try:
        drone.ours = await _answers(drone, "TWODOF_RIG", "asking what it is", deadline)
    except Timeout:  # it is somebody else's, which does not know the question, or does not let us in
        signed = session.signed_frames
        if signed and session.connection.signing is None:
            what = f"drone {session.system} answers nothing: {signed} frames came signed, and we have no key"
            raise LinkLost(what, session.url, "connect with its key: key=FILE") from None
    drone.parameters.transactions = drone.commands.words_follow = drone.ours
    if drone.ours and drawn_id:
        await _differ(drone, deadline)
    if drone.ours and drone.commanding:
        waited = await drone.lease.take(deadline.left)
        if waited > _WORTH_SAYING_S:
            drone.texts.note("notice", f"waited {waited:.1f} s for the lease of somebody who is not heard any more")
        if session.lockstep:
            await drone.clock.begin_granting(deadline.left)


async def _differ(drone: DroneBase, deadline: Deadline) -> None:
    """Draw another id where somebody who has the lease drew the same: else we would have their lease."""
    with suppress(Timeout):
        await _answers(drone, "TWODOF_LEASE", "asking who has the lease", deadline)
    connection, holder = drone.session.connection, drone.lease.holder
    if holder is not None and holder[0] == connection.system:
        before, connection.system = connection.system, drawn(besides=(connection.system,))
        give_back(before)
        drone.session.beat()


async def _answers(drone: DroneBase, name: str, doing: str, deadline: Deadline) -> bool:
    """Whether it sends this message when asked. Raises Timeout, LinkLost."""
    asking = drone.session.deadline(min(_GREETING_S, deadline.left), doing)
    return await drone.commands.request(name, asking, _GREETING_RETRY_S) is not None
