"""Synchronous faces of a drone's parts: parameters as a mapping, signals, rows, logs on board."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, MutableMapping
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from twodof.errors import ParameterError
from twodof.gcs.control.parameter_entry import ParameterDescription, ParameterEntry
from twodof.gcs.control.parameters import AsyncParameters
from twodof.gcs.loop_thread import LoopThread
from twodof.gcs.telemetry.sample_rows import Kind, SampleRows
from twodof.gcs.telemetry.signals import QUEUE, AsyncSignal, Callback, SampleStream, TelemetrySample, Value

TIMEOUT_S = 5.0
T = TypeVar("T")


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


class DroneRows(Generic[Kind]):
    """`SampleRows` in the drone's thread: `ticks` (n,) uint32, `values` (n, columns)."""

    def __init__(self, there: SampleRows[Kind], runner: LoopThread) -> None:
        self._there: SampleRows[Kind] = there
        self._runner = runner
        self.columns = there.columns

    def __len__(self) -> int:
        return len(self.ticks)

    # Rows come in the drone's thread, so that is where they are put together.

    @property
    def ticks(self) -> NDArray[np.uint32]:
        """Tick of each row."""
        return self._ask(lambda: self._there.ticks)

    @property
    def values(self) -> NDArray[Kind]:
        """The samples, a column for each of `columns`, in their units."""
        return self._ask(lambda: self._there.values)

    @property
    def time(self) -> NDArray[np.float64]:
        """The drone's time of each row [s]."""
        return self._ask(lambda: self._there.time)

    @property
    def lost(self) -> int:
        """Rows that are missing between the first and the last."""
        return self._ask(lambda: self._there.lost)

    def _ask(self, work: Callable[[], T]) -> T:
        return self._runner.call(work) if self._runner.alive else work()
