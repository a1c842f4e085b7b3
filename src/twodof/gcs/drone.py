"""Drone: the drone for scripts and notebooks, the same class as AsyncDrone with a synchronous face.

Each verb of the face is made of the asynchronous one by `waits`, `within` or `calls`, with its parameters, defaults and
words. The types of these three show editors and type checkers the synchronous signature.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Coroutine, Iterable, Iterator, MutableMapping
from contextlib import AbstractAsyncContextManager, AbstractContextManager, contextmanager, suppress
from functools import wraps
from pathlib import Path
from typing import Any, ClassVar, Concatenate, ParamSpec, Protocol, Self, TypeVar, overload
from weakref import WeakSet, finalize

from twodof.errors import ParameterError, Rejected, TwodofError
from twodof.gcs.async_drone import DEFAULT_URL, LEAVING_S, AsyncDrone
from twodof.gcs.discovery import FoundDrone, discover
from twodof.gcs.drone_state import DroneView
from twodof.gcs.files import AsyncFiles, AsyncLogs
from twodof.gcs.loop_thread import LoopThread
from twodof.gcs.parameters import AsyncParameters
from twodof.gcs.telemetry import QUEUE, AsyncSignal, Callback, SampleStream, TelemetrySample, Value
from twodof.link.signing import Key

P = ParamSpec("P")
R = TypeVar("R")
R_co = TypeVar("R_co", covariant=True)
There = TypeVar("There")


class SyncFace:
    """Synchronous face of `there`, which lives in the event loop of `runner`."""

    def __init__(self, there: Any, runner: LoopThread) -> None:
        self.there = there
        self._runner = runner

    @contextmanager
    def _within(self, manager: AbstractAsyncContextManager[R]) -> Iterator[R]:
        """Enter an asynchronous context for `with`."""
        entered = self._runner.run(manager.__aenter__())
        try:
            yield entered
        except BaseException as error:
            with suppress(TwodofError):  # the error in the block says more
                self._runner.run(manager.__aexit__(type(error), error, error.__traceback__))
            raise
        self._runner.run(manager.__aexit__(None, None, None))


class Verb(Protocol[P, R_co]):
    """Type of a method of a face: called on an instance, it takes the parameters of the asynchronous method."""

    @overload
    def __get__(self, face: None, kind: Any = None) -> Callable[Concatenate[Any, P], R_co]: ...

    @overload
    def __get__(self, face: object, kind: Any = None) -> Callable[P, R_co]: ...


def waits(method: Callable[Concatenate[There, P], Coroutine[Any, Any, R]]) -> Verb[P, R]:
    """Make a method that runs a coroutine in the drone's thread and waits for its result."""
    made: Verb[P, R] = _verb(method, lambda face, work: face._runner.run(work()))
    return made


def within(
    method: Callable[Concatenate[There, P], AbstractAsyncContextManager[R]],
) -> Verb[P, AbstractContextManager[R]]:
    """Make a method for `with` of one for `async with`."""
    made: Verb[P, AbstractContextManager[R]] = _verb(method, lambda face, work: face._within(work()))
    return made


def calls(method: Callable[Concatenate[There, P], R]) -> Verb[P, R]:
    """Make a method that calls a plain one in the drone's thread."""
    made: Verb[P, R] = _verb(method, lambda face, work: face._runner.call(work))
    return made


def _verb(method: Callable[..., Any], run: Callable[[SyncFace, Callable[[], Any]], Any]) -> Any:
    @wraps(method)
    def verb(self: SyncFace, *args: Any, **named: Any) -> Any:
        return run(self, lambda: method(self.there, *args, **named))

    signature = inspect.signature(method)
    returned = str(signature.return_annotation).replace("AbstractAsync", "Abstract")
    verb.__doc__ = (method.__doc__ or "").replace("`async with`", "`with`")
    verb.__signature__ = signature.replace(return_annotation=returned)  # type: ignore[attr-defined]
    return verb


class DroneFiles(SyncFace):
    """Files on board: descriptions, logs, controllers. Calls raise Rejected, LinkLost and Timeout."""

    list = waits(AsyncFiles.list)
    read = waits(AsyncFiles.read)
    remove = waits(AsyncFiles.remove)
    write = waits(AsyncFiles.write)


class DroneLogs(SyncFace):
    """The logs on board."""

    download = waits(AsyncLogs.download)
    list = waits(AsyncLogs.list)


class DroneParameters(SyncFace, MutableMapping[str, float]):
    """The drone's parameters as a mapping, by its own names or the package's; each access asks the drone.

    Parameters of a user's controller that flies are also found by their paths: `["attitude_control.k_q"]`.
    """

    there: AsyncParameters
    all = waits(AsyncParameters.all)
    change = waits(AsyncParameters.update)
    describe = waits(AsyncParameters.describe)
    undo = waits(AsyncParameters.undo)

    def __repr__(self) -> str:
        return f"<parameters of drone {self.there.system}: [name] asks for one, all() for all>"

    def __contains__(self, name: object) -> bool:
        """Return whether the drone has a parameter. Raises LinkLost, Timeout."""
        return isinstance(name, str) and self.get(name) is not None

    def get(self, name: str, default: Any = None) -> Any:
        """Return the value, or `default` if the drone lacks the parameter. Raises LinkLost, Timeout."""
        try:
            return self[name]
        except ParameterError:
            return default

    def __getitem__(self, name: str) -> float:
        """Read a value. Raises ParameterError if the drone lacks the parameter, LinkLost, Timeout."""
        return self._runner.run(self.there.read(name))

    def __setitem__(self, name: str, value: float) -> None:
        """Set a value. Raises ParameterError, Rejected, LinkLost, Timeout; then nothing was changed."""
        self.change({name: value})

    def __delitem__(self, name: str) -> None:
        raise TypeError("a drone's parameter cannot be removed")

    def __iter__(self) -> Iterator[str]:
        return iter(self.all())

    def __len__(self) -> int:
        return len(self.all())

    def update(self, changes: Any = (), /, **more: float) -> None:
        """Set several parameters as `change` does, with the arguments of dict.update."""
        self.change({**dict(changes), **more})


class DroneSignal(SyncFace):
    """One signal of the drone: latest value, next samples, callbacks."""

    there: AsyncSignal
    next = waits(AsyncSignal.next)

    def __repr__(self) -> str:
        return repr(self.there)

    @property
    def name(self) -> str:
        """Name in `signals.TOPICS`."""
        return self.there.name

    @property
    def unit(self) -> str:
        """Unit of the value."""
        return self.there.row.unit

    @property
    def latest(self) -> TelemetrySample | None:
        """The latest sample, None if none has come."""
        return self.there.latest

    @property
    def value(self) -> Value:
        """The latest value; waits for the first one. Raises LinkLost if no newer one will come, Timeout."""
        return self.there.value if self.latest is not None else self.next().value

    def on(self, callback: Callback) -> Callable[[], None]:
        """Call `callback`, which must be quick, with each sample in the drone's thread; return a function to end it."""
        return self.there.on(callback)

    @contextmanager
    def samples(self, timeout: float = 2.0, size: int = QUEUE) -> Iterator[Iterator[TelemetrySample]]:
        """Iterate over samples from now on; Timeout after `timeout` [s] without one. At most `size` wait."""
        manager = self.there.stream(size, timeout)
        stream = self._runner.call(manager.__enter__)
        try:
            yield self._each(stream)
        finally:
            self._runner.call(lambda: manager.__exit__(None, None, None))

    def _each(self, stream: SampleStream) -> Iterator[TelemetrySample]:
        while True:
            yield self._runner.run(stream.next())


class Drone(DroneView, SyncFace):
    """A drone, real or virtual: `with Drone.connect(url) as drone:`; leaving disarms it and lets others command.

    Times are in seconds, angles in radians. Calls that wait raise LinkLost if the drone falls silent for 3 s, Rejected
    with the drone's reason, Timeout at their deadline.
    """

    there: AsyncDrone
    _open: ClassVar[WeakSet[Drone]] = WeakSet()

    def __init__(self, there: AsyncDrone, runner: LoopThread) -> None:
        DroneView.__init__(self, there.session, there.watcher, there.texts, there.clock)
        SyncFace.__init__(self, there, runner)
        self.parameters = DroneParameters(there.parameters, runner)
        self.logs = DroneLogs(there.logs, runner)
        self.files = DroneFiles(there.files, runner)

    arm = waits(AsyncDrone.arm)
    disarm = waits(AsyncDrone.disarm)
    kill = waits(AsyncDrone.kill)
    release = waits(AsyncDrone.release)
    set_mode = waits(AsyncDrone.set_mode)
    level_hold = waits(AsyncDrone.level_hold)
    set_moment = waits(AsyncDrone.set_moment)
    set_pitch = waits(AsyncDrone.set_pitch)
    set_pitch_rate = waits(AsyncDrone.set_pitch_rate)
    set_velocity = waits(AsyncDrone.set_velocity)
    set_position = waits(AsyncDrone.set_position)
    stop_setpoints = calls(AsyncDrone.stop_setpoints)
    run = waits(AsyncDrone.run)
    run_until = waits(AsyncDrone.run_until)
    wait_until = waits(AsyncDrone.wait_until)
    excite = waits(AsyncDrone.excite)
    stop_excitation = waits(AsyncDrone.stop_excitation)
    withhold_tuning = waits(AsyncDrone.withhold_tuning)
    fly_controller = waits(AsyncDrone.fly_controller)
    active_controller = waits(AsyncDrone.active_controller)
    record = within(AsyncDrone.record)
    batch = within(AsyncDrone.batch)
    truth = within(AsyncDrone.truth)
    stream = waits(AsyncDrone.stream)
    command = waits(AsyncDrone.command)
    reset = waits(AsyncDrone.reset)
    version = waits(AsyncDrone.version)

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
        """Find the drone at `url` and, with `take_lease`, take its lease; arguments as in AsyncDrone.connect."""
        runner = LoopThread(url)
        try:
            there = runner.run(AsyncDrone.connect(url, timeout, system, key, take_lease, drone))
        except Rejected as refusal:
            runner.close()
            if any(other.has_lease(refusal) for other in cls._open):
                remedy = "another Drone of this program has it: close() that one, or go on with it"
                raise Rejected(refusal.what, refusal.where, remedy, refusal.code) from refusal
            raise
        except BaseException:
            runner.close()
            raise
        made = cls(there, runner)
        runner.at_exit(made.close)
        # A drone without a name, after a notebook's cell was run again, must not fly on.
        finalize(made, runner.leave_behind, there.close).atexit = False
        cls._open.add(made)
        return made

    def has_lease(self, refusal: Rejected) -> bool:
        """Return whether this drone has the lease that a refusal is about."""
        holder = self.there.lease.holder
        return self.there.lease.ours and holder is not None and f"{holder[0]}/{holder[1]} holds" in refusal.what

    @staticmethod
    def discover(timeout: float = 3.0, hosts: Iterable[str] = ()) -> list[FoundDrone]:
        """Find the drones that are heard at the usual ports of this machine, and answer at those of `hosts`.

        Listens for `timeout` [s]; each has the `url` to connect to. Raises LinkError for a host that is unknown.
        """
        runner = LoopThread("discovery")
        try:
            return runner.run(discover(timeout, hosts))
        finally:
            runner.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            self.close()
        except TwodofError:
            if kind is None:
                raise

    def close(self, timeout: float = LEAVING_S) -> None:
        """Disarm the drone if this client commands it, give up the lease and close the link.

        Raises Timeout, LinkLost if the drone does not confirm that it is disarmed.
        """
        try:
            if self._runner.alive:
                self._runner.run(self.there.close(timeout), finish=True)  # Ctrl-C must not keep it from disarming
        finally:
            self._open.discard(self)
            self._runner.close()

    def telemetry(self, name: str) -> DroneSignal:
        """Return a signal by its name (`estimate.q`) or .mat channel (`q`). Raises LogError if there is none."""
        return DroneSignal(self.there.telemetry(name), self._runner)
