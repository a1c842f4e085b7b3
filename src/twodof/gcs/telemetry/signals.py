"""What the drone measures, estimates and does, as signals of TOPICS: latest values, bounded streams, callbacks.

A slow consumer loses the oldest samples, which are counted, and holds up nobody else.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any, NamedTuple

from twodof.errors import Timeout
from twodof.gcs.mavlink.deadline import Deadline
from twodof.gcs.mavlink.session import DroneSession, MessageListener
from twodof.gcs.telemetry.decoding import DECODERS, Decoded
from twodof.signals import TOPICS, topic

QUEUE = 1024
Value = float | tuple[float, ...]
Callback = Callable[["TelemetrySample"], None]


class TelemetrySample(NamedTuple):
    """One sample of a signal: the drone's time [s] and the value, in the topic's unit; a tuple where it has fields."""

    time: float
    value: Value


class SampleStream:
    """Samples as they come, for `async for`."""

    def __init__(self, session: DroneSession, name: str, size: int, timeout: float) -> None:
        self._session, self._name, self._timeout = session, name, timeout
        self.heard = MessageListener(session, size=size)

    @property
    def lost(self) -> int:
        """Samples that a slow reader missed."""
        return self.heard.lost

    async def next(self, timeout: float | None = None) -> TelemetrySample:
        """The next sample. Raises LinkLost, Timeout if none comes within `timeout` [s]."""
        limit = self._timeout if timeout is None else timeout
        deadline = Deadline(limit, f"waiting for {self._name}", self._session.url)
        self.heard.since = self._session.now
        sample: TelemetrySample | None = await self.heard.next(deadline.end)
        if sample is None:
            raise deadline.error("the drone does not send it, or its time stands still")
        return sample

    def __aiter__(self) -> AsyncIterator[TelemetrySample]:
        return self

    async def __anext__(self) -> TelemetrySample:
        return await self.next()


class AsyncSignal:
    """One signal of the drone: its latest sample, a stream of them, callbacks."""

    def __init__(self, session: DroneSession, name: str) -> None:
        self.row = topic(name)
        self.name = self.row.name
        self.latest: TelemetrySample | None = None
        self._session = session
        self._streams: list[SampleStream] = []
        self._callbacks: list[Callback] = []

    def __repr__(self) -> str:
        return f"<{self.name} [{self.row.unit}]: {self.latest}>"

    @property
    def value(self) -> Value:
        """The latest value. Raises LinkLost where no newer one will come, Timeout if none has come yet."""
        self._session.must_stand()
        if self.latest is None:
            raise Timeout(f"no {self.name} has come yet", self._session.url, "wait for it with `next`")
        return self.latest.value

    async def next(self, timeout: float = 2.0) -> TelemetrySample:
        """The next sample. Raises LinkLost, Timeout."""
        with self.stream(size=1, timeout=timeout) as stream:
            return await stream.next()

    @contextmanager
    def stream(self, size: int = QUEUE, timeout: float = 2.0) -> Iterator[SampleStream]:
        """Samples from now on, `size` of them waiting at most; Timeout after `timeout` [s] without one."""
        stream = SampleStream(self._session, self.name, size, timeout)
        self._streams.append(stream)
        try:
            yield stream
        finally:
            self._streams.remove(stream)

    def on(self, callback: Callback) -> Callable[[], None]:
        """Call `callback` with each sample, in the drone's thread, quickly; what is returned ends that.

        What it raises goes to the event loop's exception handler.
        """
        self._callbacks.append(callback)
        return lambda: self._callbacks.remove(callback) if callback in self._callbacks else None

    def take(self, sample: TelemetrySample) -> None:
        """One more sample."""
        self.latest = sample
        for stream in self._streams:
            stream.heard.take(sample)
        for callback in self._callbacks:
            # One that raises is reported by the event loop and harms nobody else.
            self._session.call_soon(callback, sample)


class Telemetry:
    """All signals of one drone."""

    def __init__(self, session: DroneSession) -> None:
        self._signals = {row.name: AsyncSignal(session, row.name) for row in TOPICS}
        self._listening = ExitStack()
        for name, decode in DECODERS.items():
            self._listening.enter_context(session.handling(partial(self._take, decode), name))

    def __call__(self, name: str) -> AsyncSignal:
        """The signal of that name (`estimate.q`) or .mat channel (`q`). Raises LogError if there is none."""
        return self._signals[topic(name).name]

    def stop(self) -> None:
        """Take in nothing more: for who gets all samples by `batch`, and looks at no signal."""
        self._listening.close()

    def clear(self) -> None:
        """Forget what was said before the drone began anew."""
        for signal in self._signals.values():
            signal.latest = None

    def _take(self, decode: Callable[[Any], Decoded], got: Any) -> None:
        for name, time, value in decode(got):
            self._signals[name].take(TelemetrySample(time, value))


class LatestEstimates:
    """The newest estimates of the state of a drone, of which `telemetry(name)` gives the signals.

    Raises LinkLost, and Timeout where none has come: `Drone` waits a while for the first, `AsyncDrone` does not.
    """

    telemetry: Any

    @property
    def theta(self) -> float:
        """The latest estimate of the pitch [rad]."""
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
        return float(self.telemetry(name).value)
