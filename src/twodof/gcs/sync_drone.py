"""What the synchronous drone does in its own way: connecting, leaving, its parameters, waiting for first values."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar, Self
from weakref import WeakSet, finalize

from twodof.errors import ParameterError, Rejected, TwodofError
from twodof.gcs.async_drone import DEFAULT_URL, AsyncDrone
from twodof.gcs.discovery import FoundDrone, discover
from twodof.gcs.drone_base import LEAVING_S
from twodof.gcs.loop_thread import LoopThread
from twodof.gcs.parameters import TIMEOUT_S, AsyncParameters, ParameterDescription, ParameterEntry
from twodof.gcs.sync_face import SyncFace
from twodof.gcs.telemetry import (
    QUEUE,
    AsyncSignal,
    Callback,
    LatestEstimates,
    SampleStream,
    TelemetrySample,
    Value,
)
from twodof.link.signing import Key


class DroneParameters(MutableMapping[str, float]):
    """The drone's parameters as a mapping, by its own names or the package's; each access asks the drone.

    Those of a user's controller that flies there are also found by their paths: `["attitude_control.k_q"]`.
    """

    def __init__(self, there: AsyncParameters, runner: LoopThread) -> None:
        self._there, self._runner = there, runner

    def __repr__(self) -> str:
        return f"<parameters of drone {self._there.system}: [name] asks for one, all() for all>"

    def __contains__(self, name: object) -> bool:
        """Whether the drone has it. Raises LinkLost, Timeout."""
        return isinstance(name, str) and self.get(name) is not None

    def get(self, name: str, default: Any = None) -> Any:
        """The value, `default` for one that the drone lacks. Raises LinkLost, Timeout."""
        try:
            return self[name]
        except ParameterError:
            return default

    def __getitem__(self, name: str) -> float:
        """Raises ParameterError for one that it lacks, LinkLost, Timeout."""
        return self._runner.run(self._there.read(name))

    def __setitem__(self, name: str, value: float) -> None:
        """Raises ParameterError, Rejected, LinkLost, Timeout; then nothing was changed."""
        self._runner.run(self._there.set(name, value))

    def __delitem__(self, name: str) -> None:
        raise TypeError("a drone's parameter cannot be removed")

    def __iter__(self) -> Iterator[str]:
        return iter(self.all())

    def __len__(self) -> int:
        return len(self.all())

    def all(self, timeout: float = 30.0) -> dict[str, ParameterEntry]:
        """Every parameter with its type and, where the package knows it, its row: bounds, unit, text."""
        return self._runner.run(self._there.all(timeout))

    def describe(self, timeout: float = 30.0) -> dict[str, ParameterDescription]:
        """Bounds, unit, text and path of each as the drone describes them. Raises Rejected, and what `all` raises."""
        return self._runner.run(self._there.describe(timeout))

    def change(self, changes: Mapping[str, float], timeout: float = TIMEOUT_S) -> None:
        """Set several, all or none. Raises ParameterError, Rejected, LinkLost, Timeout."""
        self._runner.run(self._there.update(changes, timeout))

    def update(self, changes: Any = (), /, **more: float) -> None:
        """As `change`; also takes what dict.update takes."""
        self.change({**dict(changes), **more})

    def undo(self, timeout: float = TIMEOUT_S) -> None:
        """Back to what was before the last change. Raises Rejected, LinkLost, Timeout."""
        self._runner.run(self._there.undo(timeout))


class DroneSignal:
    """One signal of the drone: latest value, next samples, callbacks."""

    def __init__(self, there: AsyncSignal, runner: LoopThread) -> None:
        self._there, self._runner = there, runner
        self.name = there.name
        self.unit = there.row.unit

    def __repr__(self) -> str:
        return repr(self._there)

    @property
    def latest(self) -> TelemetrySample | None:
        """The latest sample, None if none has come."""
        return self._there.latest

    @property
    def value(self) -> Value:
        """The latest value; the first one is waited for. Raises LinkLost where no newer one will come, Timeout."""
        return self._there.value if self._there.latest is not None else self._runner.run(self._there.next()).value

    def next(self, timeout: float = 2.0) -> TelemetrySample:
        """The next sample. Raises LinkLost, Timeout."""
        return self._runner.run(self._there.next(timeout))

    def on(self, callback: Callback) -> Callable[[], None]:
        """Call `callback` with each sample, in the drone's thread, quickly; what is returned ends that."""
        return self._there.on(callback)

    @contextmanager
    def samples(self, timeout: float = 2.0, size: int = QUEUE) -> Iterator[Iterator[TelemetrySample]]:
        """Samples from now on, as an iterator; Timeout after `timeout` [s] without one. `size` wait at most."""
        manager = self._there.stream(size, timeout)
        stream = self._runner.call(manager.__enter__)
        try:
            yield self._each(stream)
        finally:
            self._runner.call(lambda: manager.__exit__(None, None, None))

    def _each(self, stream: SampleStream) -> Iterator[TelemetrySample]:
        while True:
            yield self._runner.run(stream.next())


class SyncDrone(LatestEstimates, SyncFace):
    """A drone that a thread of its own flies for a script."""

    there: AsyncDrone
    _open: ClassVar[WeakSet[SyncDrone]] = WeakSet()

    def __init__(self, there: AsyncDrone, runner: LoopThread) -> None:
        super().__init__(there, runner)
        self.parameters = DroneParameters(there.parameters, runner)

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

    def telemetry(self, name: str) -> DroneSignal:
        """A signal by its name (`estimate.q`) or .mat channel (`q`). Raises LogError if there is none."""
        return DroneSignal(self.there.telemetry(name), self._runner)
