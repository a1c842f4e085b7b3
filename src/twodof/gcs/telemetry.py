"""Telemetry of a drone as signals of TOPICS: latest values, bounded streams, callbacks.

A slow reader loses the oldest samples, which are counted, and delays no other reader.
"""

import asyncio
import re
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import lru_cache, partial
from math import asin, isfinite, nan
from types import MappingProxyType
from typing import Any, NamedTuple

from twodof.errors import Timeout
from twodof.gcs.session import Deadline, DroneSession, MessageListener
from twodof.link.mavlink.messages import BATCH_VALUES, channel_bits, fields_of
from twodof.signals import TICK_S, TOPICS, topic

Decoded = Iterator[tuple[str, float, float | tuple[float, ...]]]
"""Topic, the drone's time [s], value."""


def _pitch(q: Sequence[float]) -> float:
    """Return the pitch of a quaternion (w, x, y, z)."""
    w, x, y, z = q
    return asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))


def volts(cells: Sequence[int]) -> float:
    """Return a pack's voltage [V] from its cells [mV]; NaN if none is known."""
    known = [one for one in cells if one != 0xFFFF]
    return sum(known) / 1000.0 if known else nan


def share(percent: int) -> float:
    """Return a percentage as a share of 1; NaN for -1, unknown."""
    return percent / 100.0 if percent >= 0 else nan


_FUNCTIONS: Mapping[str, Callable[[Any], float]] = {"pitch": _pitch, "volts": volts, "share": share}
"""Functions of a message's field, by their names in `signals.TOPICS`."""
_STAMPS: Mapping[str, Callable[[Any], float]] = {
    "time_usec": lambda got: got.time_usec * 1e-6,
    "time_boot_ms": lambda got: got.time_boot_ms / 1000,
    "tick": lambda got: got.tick * TICK_S,
}
_PLACE = re.compile(r"(-?)(?:(\w+)\()?(\w+)(?:\[(\d+)\])?\)?")


def _reader(place: str) -> Callable[[Any], float]:
    """Return a reader of one number of a message: `pitch`, `-thrust`, `controls[1]`, `pitch(q)`."""
    match = _PLACE.fullmatch(place)
    assert match is not None, place
    sign, function, field, index = match.groups()
    if function:
        return lambda got: _FUNCTIONS[function](getattr(got, field))
    if index:
        return lambda got: float(getattr(got, field)[int(index)])
    if sign:
        return lambda got: float(-getattr(got, field))
    return lambda got: float(getattr(got, field))


def _decoder(message: str) -> Callable[[Any], Decoded]:
    """Return a decoder of a message's signals; values that are not finite are left out."""
    rows = [row for row in TOPICS if row.mavlink == message]
    readers = [(row.name, [_reader(place) for place in row.places], bool(row.fields)) for row in rows]
    stamp = next((read for field, read in _STAMPS.items() if field in fields_of(message)), lambda _got: nan)

    def decode(got: Any) -> Decoded:
        if not getattr(got, "valid", True):
            return
        time = stamp(got)
        for name, reads, several in readers:
            sample = [read(got) for read in reads]
            if all(map(isfinite, sample)):
                yield name, time, tuple(sample) if several else sample[0]

    return decode


def _batch(got: Any) -> Decoded:
    """Yield the newest sample of each topic in a batch; recordings take all rows."""
    width = int(got.channels).bit_count()
    rows = min(got.rows, BATCH_VALUES // width) if width else 0
    values, ticks = got.values, [(got.tick + got.every * k) & 0xFFFFFFFF for k in range(rows)]
    for name, places, several in _layout(got.channels):
        for k in range(rows - 1, -1, -1):
            sample = [values[k * width + place] for place in places]
            if all(map(isfinite, sample)):
                yield name, ticks[k] * TICK_S, tuple(sample) if several else sample[0]
                break


@lru_cache(maxsize=64)
def columns_of(mask: int) -> Mapping[str, int]:
    """Return the index of each column of TOPICS in the rows of a batch whose channels are `mask`."""
    bits = channel_bits()
    named = {column: bits.get(column.replace(".", "_").upper(), 0) for row in TOPICS for column in row.columns}
    places = {bit: place for place, bit in enumerate(1 << k for k in range(64) if mask >> k & 1)}
    return MappingProxyType({column: places[bit] for column, bit in named.items() if bit & mask})


@lru_cache(maxsize=64)
def _layout(mask: int) -> tuple[tuple[str, tuple[int, ...], bool], ...]:
    """Return the topics that are whole in a batch: name, places of its numbers in a row, True if it has fields."""
    columns = columns_of(mask)
    return tuple(
        (row.name, tuple(columns[column] for column in row.columns), bool(row.fields))
        for row in TOPICS
        if all(column in columns for column in row.columns)
    )


DECODERS: Mapping[str, Callable[[Any], Decoded]] = MappingProxyType(
    {
        **{name: _decoder(name) for name in dict.fromkeys(row.mavlink for row in TOPICS if row.places)},
        "TWODOF_BATCH": _batch,
    }
)
"""Decoder of each message."""


QUEUE = 1024
Value = float | tuple[float, ...]
Callback = Callable[["TelemetrySample"], None]


class TelemetrySample(NamedTuple):
    """Sample of a signal: the drone's time [s] and the value in the topic's unit; a tuple for a topic with fields."""

    time: float
    value: Value


class SampleStream:
    """Stream of samples, for `async for`."""

    def __init__(self, session: DroneSession, name: str, size: int, timeout: float) -> None:
        self._session, self._name, self._timeout = session, name, timeout
        self.heard = MessageListener(session, size=size)

    @property
    def lost(self) -> int:
        """Number of samples that a slow reader missed."""
        return self.heard.lost

    async def next(self) -> TelemetrySample:
        """Wait for the next sample. Raises LinkLost, Timeout if none comes within the stream's time."""
        deadline = Deadline(self._timeout, f"waiting for {self._name}", self._session.url)
        self.heard.since = self._session.now
        sample: TelemetrySample | None = await self.heard.next(deadline.end)
        if sample is None:
            raise deadline.error("make the drone send it, and let the drone's time pass")
        return sample

    def __aiter__(self) -> AsyncIterator[TelemetrySample]:
        return self

    async def __anext__(self) -> TelemetrySample:
        return await self.next()


class AsyncSignal:
    """Signal of the drone: latest sample, streams, callbacks."""

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
        """The latest value. Raises LinkLost if no newer one will come, Timeout if none has come yet."""
        self._session.check_lost()
        if self.latest is None:
            raise Timeout(f"no {self.name} has come yet", self._session.url, "wait for it with `next`")
        return self.latest.value

    async def next(self, timeout: float = 2.0) -> TelemetrySample:
        """Wait for the next sample. Raises LinkLost, Timeout."""
        with self.stream(size=1, timeout=timeout) as stream:
            return await stream.next()

    @contextmanager
    def stream(self, size: int = QUEUE, timeout: float = 2.0) -> Iterator[SampleStream]:
        """Stream samples from now on, at most `size` waiting; Timeout after `timeout` [s] without one."""
        stream = SampleStream(self._session, self.name, size, timeout)
        self._streams.append(stream)
        try:
            yield stream
        finally:
            self._streams.remove(stream)

    def on(self, callback: Callback) -> Callable[[], None]:
        """Call `callback` with each sample, in the drone's thread; return a function that ends this.

        The callback must be quick. Its exceptions go to the event loop's exception handler.
        """
        self._callbacks.append(callback)
        return lambda: self._callbacks.remove(callback) if callback in self._callbacks else None

    def take(self, sample: TelemetrySample) -> None:
        """Add a sample."""
        self.latest = sample
        for stream in self._streams:
            stream.heard.take(sample)
        for callback in self._callbacks:
            # The event loop reports exceptions, so that one callback does not harm another.
            asyncio.get_running_loop().call_soon(callback, sample)


class Telemetry:
    """Signals of one drone."""

    def __init__(self, session: DroneSession) -> None:
        self._signals = {row.name: AsyncSignal(session, row.name) for row in TOPICS}
        self._listening = ExitStack()
        for name, decode in DECODERS.items():
            self._listening.enter_context(session.handling(partial(self._take, decode), name))

    def __call__(self, name: str) -> AsyncSignal:
        """Return the signal of that name (`estimate.q`) or .mat channel (`q`). Raises LogError if there is none."""
        return self._signals[topic(name).name]

    def stop(self) -> None:
        """Stop updating, for clients that read batches only."""
        self._listening.close()

    def clear(self) -> None:
        """Forget the latest samples, after a restart."""
        for signal in self._signals.values():
            signal.latest = None

    def _take(self, decode: Callable[[Any], Decoded], got: Any) -> None:
        for name, time, value in decode(got):
            self._signals[name].take(TelemetrySample(time, value))
