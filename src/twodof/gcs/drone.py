"""Drone: the synchronous face of AsyncDrone, for scripts and notebooks. The work is done by a thread of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractAsyncContextManager, AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar
from weakref import WeakSet, finalize

import numpy as np

from twodof.errors import Rejected, TwodofError
from twodof.excitation import Excitation
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.connected import DEFAULT_URL, LEAVING_S, TIMEOUT_S
from twodof.gcs.control.active_controller import ActiveController
from twodof.gcs.control.excitation_player import ExcitationPlayback
from twodof.gcs.discovery import FoundDrone, discover
from twodof.gcs.loop_thread import LoopThread
from twodof.gcs.mavlink.version import DroneVersion
from twodof.gcs.sync_parts import DroneFiles, DroneLogs, DroneParameters, DroneRows, DroneSignal
from twodof.gcs.telemetry.drone_state import BatteryState, DroneState
from twodof.gcs.telemetry.recording import Recording
from twodof.gcs.telemetry.sample_rows import Kind, SampleRows
from twodof.gcs.telemetry.status_texts import StatusText
from twodof.link.signing.key import Key
from twodof.link.statistics import LinkStatistics

T = TypeVar("T")


class Drone:
    """A drone, real or virtual: `with Drone.connect(url) as drone:`; leaving disarms it and lets others command.

    Times are in seconds, angles in radians. Calls that wait raise LinkLost if the drone falls silent for 3 s, Rejected
    with the drone's reason, Timeout at their deadline.
    """

    _open: ClassVar[WeakSet[Drone]] = WeakSet()

    def __init__(self, there: AsyncDrone, runner: LoopThread) -> None:
        self.there = there
        self._runner = runner
        self.parameters = DroneParameters(there.parameters, runner)
        self.logs = DroneLogs(there.logs, runner)
        self.files = DroneFiles(there.files, runner)

    @classmethod
    def connect(
        cls,
        url: str = DEFAULT_URL,
        timeout: float = 10.0,
        system: int | None = None,
        key: Key | str | Path | None = None,
        take_lease: bool = True,
        drone: int | None = None,
    ) -> Self:
        """Find the drone at `url` and, with `take_lease`, become the one who commands it. As AsyncDrone.connect."""
        runner = LoopThread(url)
        try:
            there = runner.run(AsyncDrone.connect(url, timeout, system, key, take_lease, drone))
        except Rejected as refusal:
            runner.close()
            if any(other.has_lease(refusal) for other in cls._open):
                remedy = "this program has it: close() the Drone that it has, or go on with that"
                raise Rejected(refusal.what, refusal.where, remedy) from refusal
            raise
        except BaseException:
            runner.close()
            raise
        made = cls(there, runner)
        runner.at_exit(made.close)
        # One that nobody has any more, by a notebook's cell that was run again, is to fly no more either.
        finalize(made, runner.leave_behind, there.close).atexit = False
        cls._open.add(made)
        return made

    def has_lease(self, refusal: Rejected) -> bool:
        """Whether it is this one that has the lease which a refusal is about."""
        holder = self.there.lease.holder
        return self.there.lease.ours and holder is not None and f"{holder[0]}/{holder[1]} holds" in refusal.what

    @staticmethod
    def discover(timeout: float = 3.0, hosts: Iterable[str] = ()) -> list[FoundDrone]:
        """The drones that are heard at the usual ports of this machine, and answer at those of `hosts`.

        Listens for `timeout` [s]; each has the `url` to connect to. Raises LinkError for a host that is unknown.
        """
        runner = LoopThread("discovery")
        try:
            return runner.run(discover(timeout, hosts))
        finally:
            runner.close()

    def __repr__(self) -> str:
        return repr(self.there)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            self.close()
        except TwodofError:
            if kind is None:
                raise

    def close(self, timeout: float = LEAVING_S) -> None:
        """Disarm it if we commanded, give the lease up, close the link. Raises if it cannot be seen to be disarmed."""
        try:
            if self._runner.alive:
                self._runner.run(self.there.close(timeout), finish=True)  # Ctrl-C keeps nobody from disarming
        finally:
            self._open.discard(self)
            self._runner.close()

    @property
    def state(self) -> DroneState:
        """How it stands, as last heard: mode, armed, failsafe, rig, battery."""
        return self.there.state

    @property
    def tick(self) -> int:
        """Its control period, 4 ms each; in lockstep the first that has not been run."""
        return self.there.tick

    @property
    def messages(self) -> list[StatusText]:
        """What it said in words, the last 1000 lines."""
        return self.there.messages

    @property
    def url(self) -> str:
        """Where the link leads."""
        return self.there.session.url

    @property
    def battery(self) -> BatteryState:
        """Voltage [V] and charge, 0 to 1; NaN while unknown."""
        return self.state.battery

    @property
    def statistics(self) -> LinkStatistics:
        """What the link is worth: loss, round trips, rates."""
        return self.there.statistics

    def version(self, timeout: float = TIMEOUT_S) -> DroneVersion:
        """What flies it: autopilot, version of its program, the machine's number. Raises LinkLost, Timeout."""
        return self._runner.run(self.there.version(timeout))

    @property
    def theta(self) -> float:
        """The latest estimate of the pitch [rad]; the first one is waited for."""
        return self._scalar("estimate.theta")

    @property
    def q(self) -> float:
        """The latest estimate of the pitch rate [rad/s]."""
        return self._scalar("estimate.q")

    @property
    def x(self) -> float:
        """The latest estimate of the position along the rail [m]."""
        return self._scalar("estimate.x")

    @property
    def v(self) -> float:
        """The latest estimate of the velocity along the rail [m/s]."""
        return self._scalar("estimate.v")

    def _scalar(self, name: str) -> float:
        value = self.telemetry(name).value
        return value[0] if isinstance(value, tuple) else value

    def telemetry(self, name: str) -> DroneSignal:
        """A signal by its name (`estimate.q`) or .mat channel (`q`). Raises LogError if there is none."""
        return DroneSignal(self.there.telemetry(name), self._runner)

    def command(self, command: str, *values: float, timeout: float = TIMEOUT_S) -> Any:
        """Any MAV_CMD by its name, with up to seven values; returns its COMMAND_ACK."""
        return self._runner.run(self.there.command(command, *values, timeout=timeout))

    def fly_controller(self, template: str, diagram: str | bytes, timeout: float = 120.0) -> None:
        """Send a controller, a diagram's JSON, and have it fly in the place of the one of that template, in a sandbox.

        Raises Rejected where the drone is armed or finds a fault in it; then what flew before flies on.
        """
        self._runner.run(self.there.fly_controller(template, diagram, timeout))

    def arm(self, timeout: float = TIMEOUT_S) -> None:
        """Arm it, and see that it is. Raises Rejected with what speaks against it."""
        self._runner.run(self.there.arm(timeout))

    def disarm(self, timeout: float = TIMEOUT_S) -> None:
        """Disarm it, and see that it is; set-points are sent no more. Needs no lease."""
        self._runner.run(self.there.disarm(timeout))

    def kill(self, timeout: float = TIMEOUT_S) -> None:
        """Motors off, now, whoever has the lease and whatever it does; said until it is seen; it holds until `release`.

        Raises Timeout, LinkLost if it is not seen.
        """
        self._runner.run(self.there.kill(timeout))

    def release(self, timeout: float = TIMEOUT_S) -> None:
        """Let it be armed again after a kill, whoever killed it. Raises Rejected where somebody else has the lease."""
        self._runner.run(self.there.release(timeout))

    def set_mode(self, mode: str, timeout: float = TIMEOUT_S) -> None:
        """Change the mode (manual, rate, attitude, position, hold, offboard), and see that it is changed."""
        self._runner.run(self.there.set_mode(mode, timeout))

    def level_hold(self, timeout: float = TIMEOUT_S) -> None:
        """Let it hold itself level, at the thrust THRUST_BAR; needs no set-points."""
        self._runner.run(self.there.level_hold(timeout))

    def set_moment(self, M: float, thrust: float | None = None, timeout: float = TIMEOUT_S) -> None:
        """Fly a normalised pitch moment (-1 to 1) about the trim, no loop closed; `thrust` 0 to 1, None: as it is."""
        self._runner.run(self.there.set_moment(M, thrust, timeout))

    def set_pitch(self, theta: float, thrust: float | None = None, timeout: float = TIMEOUT_S) -> None:
        """Follow a pitch [rad]; `thrust` 0 to 1, None: the last one given, at first the parameter THRUST_BAR."""
        self._runner.run(self.there.set_pitch(theta, thrust, timeout))

    def set_pitch_rate(self, q: float, thrust: float | None = None, timeout: float = TIMEOUT_S) -> None:
        """Follow a pitch rate [rad/s]; `thrust` as in `set_pitch`."""
        self._runner.run(self.there.set_pitch_rate(q, thrust, timeout))

    def set_velocity(self, v: float, acceleration: float | None = None, timeout: float = TIMEOUT_S) -> None:
        """Follow a velocity along the rail [m/s], with an acceleration [m/s^2] fed forward."""
        self._runner.run(self.there.set_velocity(v, acceleration, timeout))

    def set_position(self, x: float, acceleration: float | None = None, timeout: float = TIMEOUT_S) -> None:
        """Follow a position along the rail [m], with an acceleration [m/s^2] fed forward."""
        self._runner.run(self.there.set_position(x, acceleration, timeout))

    def excite(
        self,
        excitation: Excitation,
        loop: str | None = None,
        thrust: float | None = None,
        at: int | None = None,
        wait: bool = True,
        timeout: float = TIMEOUT_S,
    ) -> ExcitationPlayback:
        """Play an excitation on board, added to what `loop` ("M", "q", "theta", "v", "x") follows.

        As AsyncDrone.excite: with `wait` the drone's time passes until it is over; `timeout` is until it begins.
        """
        return self._runner.run(self.there.excite(excitation, loop, thrust, at, wait, timeout))

    def stop_excitation(self, timeout: float = TIMEOUT_S) -> None:
        """Stop what plays, and see that it is over; the set-point before it is held."""
        self._runner.run(self.there.stop_excitation(timeout))

    def batch(self, columns: Iterable[str]) -> AbstractContextManager[DroneRows[np.float32]]:
        """Every sample of these columns of signals.TOPICS (`imu.gyro_y`) at the full rate, for `with`."""
        return self._rows(self.there.batch(columns))

    @contextmanager
    def _rows(self, manager: AbstractAsyncContextManager[SampleRows[Kind]]) -> Iterator[DroneRows[Kind]]:
        with self._within(manager) as rows:
            yield DroneRows(rows, self._runner)

    def active_controller(self, timeout: float = TIMEOUT_S) -> ActiveController:
        """Which parameters are not at their defaults, and which diagrams fly in place of the stock controllers."""
        return self._runner.run(self.there.active_controller(timeout))

    def truth(self) -> AbstractContextManager[DroneRows[np.float64]]:
        """The true theta, q, x, v of a virtual rig at the full rate, for `with`. Raises Rejected by a real drone."""
        return self._rows(self.there.truth())

    def record(
        self, path: str | Path, topics: Iterable[str] | None = None, provenance: Mapping[str, object] | None = None
    ) -> AbstractContextManager[Recording]:
        """Record topics (None: all) at the full rate into a new MCAP file, for `with`.

        Of a drone that is not ours what it sends is recorded as it comes: `stream` asks for more of it.
        """
        return self._within(self.there.record(path, topics, provenance))

    @contextmanager
    def _within(self, manager: AbstractAsyncContextManager[T]) -> Iterator[T]:
        """An asynchronous context as one for `with`."""

        async def enter() -> T:
            return await manager.__aenter__()

        async def leave(*reason: Any) -> None:
            await manager.__aexit__(*reason)

        entered = self._runner.run(enter())
        try:
            yield entered
        except BaseException as error:
            with suppress(TwodofError):  # what went wrong in the block says more
                self._runner.run(leave(type(error), error, error.__traceback__))
            raise
        self._runner.run(leave(None, None, None))

    def reset(
        self, seed: int = 1, x: float = 0.0, noise: float = 1.0, rings: bool = False, timeout: float = TIMEOUT_S
    ) -> None:
        """Start a virtual drone anew: tick 0, at rest at `x` [m], `rings` locked or not, the noise of `seed` scaled.

        Raises Rejected for a real one, while armed, or where the drone says so.
        """
        self._runner.run(self.there.reset(seed, x, noise, rings, timeout))

    def stream(self, name: str, rate: float, timeout: float = TIMEOUT_S) -> None:
        """Have a message (such as "ACTUATOR_CONTROL_TARGET") sent `rate` times a second; 0: as by default, < 0: not."""
        self._runner.run(self.there.stream(name, rate, timeout))

    def withhold_tuning(self, withhold: bool = True, timeout: float = TIMEOUT_S) -> None:
        """Let nobody else change parameters while we command, or (`withhold` False) let them again, as at first.

        Raises Rejected where somebody else commands, or nobody does.
        """
        self._runner.run(self.there.withhold_tuning(withhold, timeout))

    def stop_setpoints(self) -> None:
        """Send no more set-points: after .5 s the drone levels itself."""
        self._runner.call(self.there.stop_setpoints)

    def run(self, seconds: float) -> None:
        """Let the drone's time pass. Raises LinkLost, Timeout if it stands still, Rejected if a kill ends a flight."""
        self._runner.run(self.there.run(seconds))

    def run_until(self, tick: int) -> None:
        """Let the drone's time pass up to a tick, which is the first not run. Raises as `run`."""
        self._runner.run(self.there.run_until(tick))

    def wait_until(self, condition: Callable[[], bool], timeout: float) -> None:
        """Let the drone's time pass until `condition()`, asked each 20 ms of it; Timeout after `timeout` [s] of it.

        `condition` is called in the drone's thread: it may look at values that have come, and ask nothing.
        """
        self._runner.run(self.there.wait_until(condition, timeout))
