"""AsyncDrone: one drone, flown from an asyncio program. Every call ends in a value or a typed error, in time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractAsyncContextManager, suppress
from math import ceil
from pathlib import Path
from typing import Any, Self

from twodof.errors import LinkLost, ParameterError, Rejected, Timeout, TwodofError
from twodof.excitation import Excitation
from twodof.gcs import setpoints
from twodof.gcs.batches import Batches, Rows
from twodof.gcs.clock import TICK_S, Clock
from twodof.gcs.commands import Commands, number_of
from twodof.gcs.deadline import Deadline
from twodof.gcs.exciting import Exciter, Playback
from twodof.gcs.files import Files
from twodof.gcs.lease import Lease
from twodof.gcs.log_download import Logs
from twodof.gcs.parameters import AsyncParameters
from twodof.gcs.recording import Recording, Recordings
from twodof.gcs.session import Session
from twodof.gcs.setpoints import Setpoint, Setpoints
from twodof.gcs.state import Battery, State, Watcher
from twodof.gcs.telemetry import Telemetry
from twodof.gcs.texts import Text, Texts
from twodof.link import dialect
from twodof.link.connection import Connection
from twodof.link.key import Key, read_key
from twodof.link.messages import message
from twodof.link.modes import custom_mode
from twodof.link.opening import open_transport
from twodof.link.signing import Signing
from twodof.link.stamps import Stamps
from twodof.link.statistics import LinkStatistics

DEFAULT_URL = "udpin://127.0.0.1:14540"
TIMEOUT_S = 5.0
HOVER = "THRUST_BAR"
LEAVING_S = 3.0
# Offboard is refused until set-points have come for a while; they are sent meanwhile.
_MODE_RETRY_S = 0.1
_KILL_RETRY_S = 0.05
_FORCE = 21196
_REFUSED = 16
_GROUND_COMPONENT = 190
_TICKS_FOR_AN_ANSWER = 250


class AsyncDrone:
    """A drone, real or virtual, over one link; made by `connect`, for `async with`: leaving disarms it.

    Times are in seconds, angles in radians. Calls that wait raise LinkLost if the drone falls silent for 3 s, Rejected
    with the drone's reason, Timeout at their deadline.
    """

    def __init__(self, session: Session, commanding: bool) -> None:
        self.session = session
        self.commanding = commanding
        self.texts = Texts(session)
        self.watcher = Watcher(session)
        self.clock = Clock(session)
        self.lease = Lease(session)
        self.commands = Commands(session, self.texts)
        self.parameters = AsyncParameters(session)
        self.telemetry = Telemetry(session)
        self.setpoints = Setpoints(session, self.clock)
        self.exciter = Exciter(session, self.clock)
        self.batches = Batches(session, self.commands)
        self.recordings = Recordings(session, self.commands, self.batches, self.texts, self.clock)
        self.logs = Logs(session)
        self.files = Files(session, self.texts)
        self.commands.on_progress = self._one_tick
        self._last_thrust: float | None = None
        self.ours = False  # one of ours, not somebody else's PX4
        self._closed = False

    @classmethod
    async def connect(
        cls,
        url: str = DEFAULT_URL,
        timeout: float = 10.0,
        system: int | None = 250,
        key: Key | str | Path | None = None,
        take_lease: bool = True,
        drone: int | None = None,
        component: int = _GROUND_COMPONENT,
    ) -> Self:
        """Find the drone at `url` and, with `take_lease`, become the one who commands it.

        `system` and `component` are what we call ourselves: two clients need two; None is the drone's own system, for
        a program on board. `drone` is the system id to look for
        if several may be heard. `key` (or its file) signs everything; what is not signed with it is ignored. Raises
        LinkError, LinkLost if no drone is heard within `timeout` [s], Rejected if somebody else has the lease.
        """
        deadline = Deadline(timeout, "connecting", url)
        transport = await open_transport(url, timeout)
        session: Session | None = None
        made: Self | None = None
        try:
            connection = Connection(transport, system or 0, component, _signing(key, system or 0))
            session = Session(connection, on_board=component != _GROUND_COMPONENT)
            made = cls(session, take_lease)
            await session.find(drone, deadline.left)
            connection.system = system or session.system
            session.beat()
            await made._greet(deadline, take_lease)
        except BaseException:
            if made is not None:
                made.lease.stop()
            await (transport.close() if session is None else session.close())
            raise
        return made

    async def _greet(self, deadline: Deadline, take_lease: bool) -> None:
        """Learn whether it is one of ours, and if so how its time passes; take the lease."""
        spoken = self.watcher.heartbeats
        try:
            number = dialect.message_id("TWODOF_RIG")
            await self.commands.run("REQUEST_MESSAGE", [number], min(2.0, deadline.left), "asking what it is")
            with self.session.listen("TWODOF_RIG") as heard:
                rig = self.watcher.state.rig
                self.ours = bool(rig.name) or await heard.next(self.session.now + 0.5) is not None
        except Rejected:
            self.ours = False
        except Timeout:
            if self.watcher.heartbeats == spoken and deadline.left <= 0.0:
                raise
            self.ours = False
        self.parameters.transactions = self.ours
        if self.ours and take_lease:
            await self.lease.take(deadline.left)
            if self.session.lockstep:
                await self.clock.begin_granting(deadline.left)

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
        try:
            if self.commanding and self.state.armed:
                try:
                    await self.disarm(timeout=timeout / 3)
                except (Rejected, Timeout):
                    await self.kill(timeout=timeout / 3)
            if self.lease.wanted:
                with suppress(Timeout, LinkLost):  # it ends by itself
                    await self.lease.give_up(timeout / 3)
        finally:
            self.lease.stop()
            await self.session.close()

    @property
    def state(self) -> State:
        """How it stands, as last heard."""
        return self.watcher.state

    @property
    def tick(self) -> int:
        """Its control period, 4 ms each; in lockstep the first that has not been run."""
        return self.clock.tick

    @property
    def messages(self) -> list[Text]:
        """What it said in words, the last 1000 lines."""
        return list(self.texts.lines)

    async def command(self, command: str, *values: float, timeout: float = TIMEOUT_S) -> Any:
        """Any MAV_CMD by its name ("PREFLIGHT_STORAGE") with up to seven values; returns its COMMAND_ACK."""
        return await self.commands.run(command, values, timeout, command)

    async def arm(self, timeout: float = TIMEOUT_S) -> None:
        """Arm it, and see that it is. Raises Rejected with what speaks against it."""
        deadline = self._deadline(timeout, "arming")
        await self.commands.run("COMPONENT_ARM_DISARM", [1.0], timeout, "arming")
        await self._see(lambda: self.state.armed, deadline)

    async def disarm(self, timeout: float = TIMEOUT_S) -> None:
        """Disarm it, and see that it is; set-points are sent no more. Needs no lease."""
        deadline = self._deadline(timeout, "disarming")
        self.setpoints.stop()
        self._last_thrust = None
        await self.commands.run("COMPONENT_ARM_DISARM", [0.0], timeout, "disarming")
        await self._see(lambda: not self.state.armed, deadline)

    async def kill(self, timeout: float = TIMEOUT_S) -> None:
        """Motors off, now, whoever has the lease and whatever it does; said again until it is seen.

        Raises Timeout, LinkLost if it is not seen: the drone's own failsafe then acts on the lost link.
        """
        deadline = self._deadline(timeout, "killing")
        self.setpoints.stop()
        number = number_of("COMPONENT_ARM_DISARM")
        beats, attempt = self.watcher.heartbeats, 0
        with self.session.listen("HEARTBEAT", "COMMAND_ACK") as heard:
            while True:
                self.session.send_anyway(self.commands.long(number, [0.0, _FORCE], attempt))
                attempt += 1
                until = min(deadline.end, self.session.now + _KILL_RETRY_S)
                while (got := await heard.next(until)) is not None:
                    accepted = got.get_type() == "COMMAND_ACK" and (got.command, got.result) == (number, 0)
                    if accepted or (self.watcher.heartbeats > beats and not self.state.armed):
                        return
                    deadline.check()
                deadline.check()

    async def set_mode(self, mode: str, timeout: float = TIMEOUT_S) -> None:
        """Change the mode (manual, rate, attitude, position, hold, offboard), and see that it is changed."""
        deadline = self._deadline(timeout, f"changing to the mode {mode}")
        number = custom_mode(mode)
        await self._switch(number, deadline)
        await self._see(lambda: self.state.mode == mode, deadline)

    async def _switch(self, number: int, deadline: Deadline) -> None:
        values = [1.0, float(number >> 16 & 0xFF), float(number >> 24 & 0xFF)]
        await self.commands.run("DO_SET_MODE", values, max(0.01, deadline.left), deadline.doing)

    async def level_hold(self, timeout: float = TIMEOUT_S) -> None:
        """Let it hold itself level, at the thrust THRUST_BAR; needs no set-points."""
        await self.set_mode("hold", timeout)
        self.setpoints.stop()

    async def set_moment(self, M: float, thrust: float | None = None, timeout: float = TIMEOUT_S) -> None:
        """Fly a normalised pitch moment (-1 to 1) about the trim, no loop closed; `thrust` 0 to 1, None: as it is."""
        await self._follow(setpoints.moment(M, thrust), timeout)

    async def set_pitch(self, theta: float, thrust: float | None = None, timeout: float = TIMEOUT_S) -> None:
        """Follow a pitch [rad]; `thrust` 0 to 1, None: the last one given, at first the parameter THRUST_BAR."""
        await self._follow(setpoints.pitch(theta, await self._thrust(thrust, timeout)), timeout)

    async def set_pitch_rate(self, q: float, thrust: float | None = None, timeout: float = TIMEOUT_S) -> None:
        """Follow a pitch rate [rad/s]; `thrust` as in `set_pitch`."""
        await self._follow(setpoints.pitch_rate(q, await self._thrust(thrust, timeout)), timeout)

    async def set_velocity(self, v: float, acceleration: float | None = None, timeout: float = TIMEOUT_S) -> None:
        """Follow a velocity along the rail [m/s], with an acceleration [m/s^2] fed forward."""
        await self._follow(setpoints.velocity(v, acceleration), timeout)

    async def set_position(self, x: float, acceleration: float | None = None, timeout: float = TIMEOUT_S) -> None:
        """Follow a position along the rail [m], with an acceleration [m/s^2] fed forward."""
        await self._follow(setpoints.position(x, acceleration), timeout)

    def stop_setpoints(self) -> None:
        """Send no more set-points: after .5 s the drone levels itself."""
        self.setpoints.stop()

    async def _thrust(self, thrust: float | None, timeout: float) -> float:
        if thrust is not None:
            self._last_thrust = thrust
        elif self._last_thrust is None and self.ours:
            return await self.parameters.read(HOVER, timeout)
        elif self._last_thrust is None:
            raise ParameterError("nothing says which thrust lets it hover", "set-point", "give thrust=")
        else:
            return self._last_thrust
        return thrust

    async def _follow(self, setpoint: Setpoint, timeout: float) -> None:
        """Stream it, and switch to a mode in which it is followed; refusals are tried again while it streams."""
        mode = setpoint.modes[0]
        deadline = self._deadline(timeout, f"changing to the mode {mode}")
        self.setpoints.hold(setpoint)
        if self.state.mode in setpoint.modes:
            return
        # Offboard wants to see that they keep coming.
        if self.clock.granting:
            self.setpoints.hold(setpoint)
        else:
            await asyncio.sleep(2.5 * setpoints.PERIOD_S)
        while self.state.mode not in setpoint.modes:
            try:
                await self._switch(custom_mode(mode), deadline)
                await self._see(lambda: self.state.mode in setpoint.modes, deadline)
            except Rejected:
                if deadline.left < _MODE_RETRY_S:
                    raise
                await self.run(_MODE_RETRY_S)

    async def run(self, seconds: float) -> None:
        """Let the drone's time pass. Raises LinkLost; Timeout if it stands still."""
        await self.run_until(self.tick + max(0, ceil(seconds / TICK_S - 1e-9)))

    async def run_until(self, tick: int) -> None:
        """Let the drone's time pass up to a tick, which is the first not run. Raises as `run`."""
        await self.clock.run_until(tick)

    async def wait_until(self, condition: Callable[[], bool], timeout: float) -> None:
        """Let the drone's time pass until `condition()`, asked each 20 ms of it; Timeout after `timeout` [s] of it."""
        await self.clock.run_until(self.tick + ceil(timeout / TICK_S), condition)
        if not condition():
            raise Timeout(f"the condition did not come within {timeout:g} s", f"drone {self.session.system}")

    async def _see(self, condition: Callable[[], bool], deadline: Deadline) -> None:
        """Wait until the drone's heartbeat says so; in lockstep its time passes meanwhile, tick by tick."""
        last = self.tick + _TICKS_FOR_AN_ANSWER
        with self.session.listen("HEARTBEAT") as heard:
            while not condition():
                if self.clock.granting and self.tick < last:
                    await self.run_until(self.tick + 1)
                elif await heard.next(deadline.end) is None:
                    raise deadline.error("it acknowledged, but its heartbeat says otherwise")

    async def excite(
        self,
        excitation: Excitation,
        loop: str | None = None,
        thrust: float | None = None,
        at: int | None = None,
        wait: bool = True,
        timeout: float = TIMEOUT_S,
    ) -> Playback:
        """Play an excitation on board, added to what `loop` ("M", "q", "theta", "v", "x") follows.

        `loop` None is that of the excitation's unit; `thrust` 0 to 1, None: as it is; `at` is the tick at which it
        starts, None: at once. With `wait` the drone's time passes until it is over. Raises ExperimentError for a loop
        of another unit, Rejected with the drone's reason.
        """
        playback = await self.exciter.start(excitation, loop, thrust, at, timeout)
        return await self.exciter.finish(playback) if wait else playback

    def stop_excitation(self) -> None:
        """Stop what plays; the set-point before it is held."""
        self.exciter.stop()

    def batch(self, columns: Iterable[str]) -> AbstractAsyncContextManager[Rows]:
        """Every sample of these columns of signals.TOPICS (`imu.gyro_y`) at the full rate, for `async with`."""
        return self.batches.rows(columns)

    def record(
        self,
        path: str | Path,
        topics: Iterable[str] | None = None,
        provenance: Mapping[str, object] | None = None,
    ) -> AbstractAsyncContextManager[Recording]:
        """Record topics (None: all) at the full rate into a new MCAP file, for `async with`. See gcs.recording."""
        rig = self.state.rig
        about = {"rig": rig.name, "controller": rig.controller, "diagram": f"{rig.diagram:016x}", "seed": rig.seed}
        link = {"url": self.session.url, "system": self.session.system, "lockstep": rig.lockstep}
        return self.recordings.to(path, topics, self.state, {"drone": {**about, **link}, **(provenance or {})})

    async def reset(
        self, seed: int = 1, x: float = 0.0, noise: float = 1.0, rings: bool = False, timeout: float = TIMEOUT_S
    ) -> None:
        """Start a virtual drone anew: tick 0, at rest at `x` [m], `rings` locked or not, the noise of `seed` scaled.

        Raises Rejected for a real one, while armed, or where the drone says so.
        """
        deadline = self._deadline(timeout, "resetting the rig")
        self.setpoints.stop()
        spoken = self.texts.count
        asked = message(
            "TWODOF_RIG_RESET",
            seed=seed,
            x=x,
            noise=noise,
            rings=int(rings),
            target_system=self.session.system,
            target_component=self.session.component,
        )
        got = await self.session.ask(lambda _: asked, ("TWODOF_RIG",), _reset_answer, deadline)
        if got.flags & _REFUSED:
            said = await self.commands.words(spoken, deadline)
            raise Rejected(said or "the rig is not reset", deadline.where, "disarm it first; a real rig has no reset")
        self.clock.restart()
        self.telemetry.clear()

    async def fly_controller(self, template: str, diagram: str | bytes, timeout: float = 120.0) -> None:
        """Send a controller, a diagram's JSON, and have it fly in the place of the one of that template, in a sandbox.

        A stock controller's own diagram brings the stock one back. Raises Rejected where the drone is armed or finds a
        fault in it; then what flew before flies on.
        """
        path = f"/controllers/{template}.json"
        content = diagram.encode() if isinstance(diagram, str) else diagram
        deadline = self._deadline(timeout, "sending a controller")
        if self.state.armed:
            raise Rejected("it is armed", deadline.where, "disarm it first")
        await self.files.write(path, content, deadline.left)
        await self.commands.run("USER_1", [], deadline.left, "flying another controller")

    async def stream(self, name: str, rate: float, timeout: float = TIMEOUT_S) -> None:
        """Have a message (such as "ACTUATOR_CONTROL_TARGET") sent `rate` times a second; 0: as by default, < 0: not."""
        interval = 1e6 / rate if rate > 0.0 else -1.0 if rate < 0.0 else 0.0
        values = [dialect.message_id(name), interval]
        await self.commands.run("SET_MESSAGE_INTERVAL", values, timeout, f"setting the rate of {name}")

    async def _one_tick(self) -> None:
        if self.clock.granting:
            await self.run_until(self.tick + 1)

    @property
    def battery(self) -> Battery:
        """Voltage [V] and charge, 0 to 1; NaN while unknown."""
        return self.state.battery

    @property
    def statistics(self) -> LinkStatistics:
        """What the link is worth: loss, round trips, rates."""
        return self.session.connection.statistics

    def _deadline(self, timeout: float, doing: str) -> Deadline:
        return Deadline(timeout, doing, f"drone {self.session.system}")


def _reset_answer(got: Any) -> Any | None:
    """The answer to a reset: a refusal, or the rig at its tick 0."""
    return got if got.flags & _REFUSED or got.tick == 0 else None


def _signing(key: Key | str | Path | None, system: int) -> Signing | None:
    """Signing with a key; a key's file has its time stamps beside it, for each system id its own."""
    if key is None:
        return None
    if isinstance(key, Key):
        return Signing(key, Stamps(None))
    return Signing(read_key(key), Stamps(f"{key}.{system}.stamps"))
