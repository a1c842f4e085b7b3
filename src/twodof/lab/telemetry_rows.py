"""Rows of telemetry: joined by tick, decimated once for all clients of the same feed, packed for sending."""

import asyncio
import struct
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import ceil
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twodof.flightlog.steps import BOOT
from twodof.lab.access import Role
from twodof.lab.answers import dumps
from twodof.link.mavlink.messages import channel_bits
from twodof.signals import PERIOD, TOPICS

_SENT = frozenset(channel_bits())
ONBOARD = tuple(column for row in TOPICS for column in row.columns if column.replace(".", "_").upper() in _SENT)
TRUTH = tuple(column for row in TOPICS if not row.onboard for column in row.columns)
ACTION = "safety.action"
COLUMNS = (*ONBOARD, *TRUTH, ACTION)
"""Columns for subscriptions: every column that a drone sends at the full rate, the truth of a virtual rig, and the
number of the failsafe's action (0: none)."""
PLACES = MappingProxyType({column: place for place, column in enumerate(COLUMNS)})
_TRUTH_PLACES = np.arange(len(ONBOARD), len(ONBOARD) + len(TRUTH), dtype=np.intp)
BACK_TICKS = 250
"""A tick older by this much shows a restart of the drone; a less old tick came too late."""
PATIENCE_TICKS = 12
"""Ticks for which a row waits for other messages, such as the truth."""


class TickRows:
    """Rows, by tick, that wait until all their messages have come; `take` returns the complete ones."""

    def __init__(self) -> None:
        self._waiting: dict[int, NDArray[np.float32]] = {}
        self._given = -1
        self._newest = [-1, -1]  # tick on board, of the truth
        self._actions: deque[tuple[int, int]] = deque([(-1, 0)], maxlen=100)  # since which tick, number

    def action(self, since: int, number: int) -> None:
        """Note the failsafe's action, which has the `number` since a tick."""
        while self._actions and self._actions[-1][0] >= since:  # told again, or the drone has restarted
            self._actions.pop()
        self._actions.append((since, number))

    def onboard(self, ticks: NDArray[np.uint32], values: NDArray[np.float32], places: NDArray[np.intp]) -> None:
        """Add the rows of a batch, whose columns have the indices `places` in COLUMNS."""
        for tick, row in zip(ticks.tolist(), values, strict=True):
            self._put(tick, places, row, 0)

    def truth(self, tick: int, values: tuple[float, float, float, float]) -> None:
        """Add the true state of a tick."""
        self._put(tick, _TRUTH_PLACES, np.array(values, dtype=np.float32), 1)

    def _put(self, tick: int, places: NDArray[np.intp], values: NDArray[np.float32], source: int) -> None:
        if tick <= self._given:
            if tick > self._given - BACK_TICKS:
                return  # too late
            self._waiting.clear()
            self._given, self._newest = tick - 1, [-1, -1]
        self._newest[source] = max(self._newest[source], tick)
        row = self._waiting.get(tick)
        if row is None:
            row = self._waiting[tick] = np.full(len(COLUMNS), np.nan, dtype=np.float32)
        row[places] = values

    def take(self) -> tuple[NDArray[np.int64], NDArray[np.float32]] | None:
        """Return rising ticks (n,) and values (n, COLUMNS) of the complete rows, or None."""
        newest = max(self._newest)
        heard = [tick for tick in self._newest if tick > max(-1, newest - PATIENCE_TICKS)]
        whole = sorted(tick for tick in self._waiting if tick <= min(heard, default=-1))
        if not whole:
            return None
        values = np.stack([self._waiting.pop(tick) for tick in whole])
        since, numbers = zip(*self._actions, strict=True)
        at = np.searchsorted(since, whole, side="right") - 1
        values[:, PLACES[ACTION]] = np.where(at < 0, 0, np.array(numbers)[at])
        self._given = whole[-1]
        return np.array(whole, dtype=np.int64), values


FULL_RATE = round(1.0 / PERIOD)
"""Rate [rows/s] at which every row is sent."""


class Decimation:
    """Decimation to at most `rate` rows a second: two per bucket of ticks, with each column's lowest and highest value.

    A column without a sample in a bucket is NaN. A peak of one tick is kept at any rate.
    """

    def __init__(self, rate: float) -> None:
        self.ticks = 1 if rate >= FULL_RATE else max(2, ceil(2 * FULL_RATE / rate))
        self._begun: tuple[NDArray[np.int64], NDArray[np.float32]] | None = None

    def take(
        self, ticks: NDArray[np.int64], values: NDArray[np.float32]
    ) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Add rows with rising ticks; return the rows of complete buckets: times (n,) [s] and values (n, columns).

        The times are those of the drone's logs.
        """
        if self.ticks == 1:
            return np.asarray(BOOT + ticks * PERIOD), values
        if self._begun is not None:
            ticks, values = np.concatenate([self._begun[0], ticks]), np.concatenate([self._begun[1], values])
        begins = np.diff(ticks // self.ticks, prepend=-1) > 0
        first, bucket = np.flatnonzero(begins), np.cumsum(begins) - 1
        whole = first[-1]  # the last bucket is whole once another begins
        self._begun = ticks[whole:], values[whole:]
        if not whole:
            return np.empty(0), values[:0]
        ends = np.stack([first[:-1], first[1:] - 1], axis=1).reshape(-1)
        inside = np.full((len(first) - 1, int(np.diff(first).max()), values.shape[1]), np.nan, dtype=np.float32)
        inside[bucket[:whole], np.arange(whole) - first[bucket[:whole]]] = values[:whole]
        absent = np.isnan(inside)
        least = np.where(absent, np.inf, inside).argmin(axis=1)
        most = np.where(absent, -np.inf, inside).argmax(axis=1)
        rows = np.take_along_axis(inside, np.sort(np.stack([least, most], axis=1), axis=1), axis=1)
        return np.asarray(BOOT + ticks[ends] * PERIOD), rows.reshape(len(ends), values.shape[1])


ROWS = 1
"""First byte of rows; clients skip messages with another one."""
_HEADER = struct.Struct("<BBHIIId")


def header(number: int, count: int, dropped: int) -> bytes:
    """Return the header of a message with rows: kind, 0, subscription, rows, rows dropped so far, 0, unix time [s].

    It has 24 bytes, so that the times after it are aligned.
    """
    return _HEADER.pack(ROWS, 0, number, count, dropped & 0xFFFFFFFF, 0, time.time())


def body(times: NDArray[np.float64], values: NDArray[np.float32]) -> bytes:
    """Return the bytes of the drone's times (n,) [s] and the values (n, columns), column by column."""
    columns = np.ascontiguousarray(values.T, dtype="<f4")
    return np.asarray(times, dtype="<f8").tobytes() + columns.tobytes()


MOST_BYTES = 128 * 1024
"""Most bytes waiting for one client: 7 s of 15 columns at the full rate."""
MOST_EVENTS = 500


@dataclass(eq=False)
class StreamState:
    """Subscription of one client: its number, and the number of its dropped rows."""

    number: int
    dropped: int = 0
    ended: bool = False


@dataclass
class Rows:
    """Waiting rows of one subscription: their bytes, `body`, and their number, `count`."""

    stream: StreamState
    body: bytes
    count: int


MOST_UNANSWERED = 4
"""A client with more unanswered `alive` counts as frozen, although its browser keeps the socket open."""


@dataclass(eq=False)
class Outbox:
    """Bounded queue of rows and events for one client, that of `person`; the oldest ones are dropped.

    `answers` is True if the client ever answered an `alive`, `unanswered` counts its missing answers since.
    """

    role: Role = Role.WATCH
    person: str = ""
    answers: bool = False
    unanswered: int = 0
    _ended: bool = False
    _rows: deque[Rows] = field(default_factory=deque)
    _bytes: int = 0
    _events: deque[str] = field(default_factory=deque)
    _filled: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def frozen(self) -> bool:
        """True for a client that has answered `alive` before, but not the last times."""
        return self.unanswered > MOST_UNANSWERED

    def put(self, rows: Rows) -> None:
        """Add rows; the oldest rows of any subscription are dropped if too much waits."""
        self._rows.append(rows)
        self._bytes += len(rows.body)
        while self._bytes > MOST_BYTES and len(self._rows) > 1:
            oldest = self._rows.popleft()
            self._bytes -= len(oldest.body)
            oldest.stream.dropped += oldest.count
        self._filled.set()

    def tell(self, text: str) -> None:
        """Add an event; the oldest one is dropped if too many wait."""
        if len(self._events) >= MOST_EVENTS:
            self._events.popleft()
        self._events.append(text)
        self._filled.set()

    def end(self) -> None:
        """Send nothing more."""
        self._ended = True
        self._filled.set()

    async def next(self) -> str | Rows | None:
        """Wait for the next message, and return events before rows; None after `end`."""
        while True:
            if self._ended:
                return None
            if self._events:
                return self._events.popleft()
            if self._rows:
                rows = self._rows.popleft()
                self._bytes -= len(rows.body)
                if not rows.stream.ended:
                    return rows
                continue
            self._filled.clear()
            await self._filled.wait()


class Allowance:
    """Messages to watching clients, for all drones together: `WATCHERS_MESSAGES` a second, so that others are heard."""

    def __init__(self) -> None:
        self._left, self._at = 0.0, time.monotonic()

    @property
    def left(self) -> bool:
        """True if a message may be sent now."""
        now = time.monotonic()
        self._left = min(MOST_AT_ONCE, self._left + WATCHERS_MESSAGES * (now - self._at))
        self._at = now
        return self._left > 0.0

    def spend(self, messages: int, size: int, read: int) -> None:
        """Count messages of `size` bytes each, made of rows of `read` bytes."""
        self._left -= messages * (1.0 + size / MESSAGE_BYTES) + read / MESSAGE_BYTES


class FeedKey(NamedTuple):
    """Key of a feed: its columns, its rate [rows/s], and the role of its clients."""

    columns: tuple[str, ...]
    rate: float
    role: Role = Role.COMMAND

    @property
    def truth(self) -> bool:
        """True for a feed with the true state of a virtual rig."""
        return any(column in TRUTH for column in self.columns)


class _Feed:
    """Rows of one key for the subscriptions `to`. `waiting` are those of the last times, at most `MOST_TIMES`."""

    def __init__(self, key: FeedKey) -> None:
        self._places = np.array([PLACES[column] for column in key.columns], dtype=np.intp)
        self._decimation = Decimation(key.rate)
        self.to: dict[StreamState, Outbox] = {}
        self.waiting: deque[tuple[NDArray[np.int64], NDArray[np.float32]]] = deque()

    def add(self, ticks: NDArray[np.int64], values: NDArray[np.float32]) -> None:
        """Add rows; the oldest ones are dropped if too many wait."""
        self.waiting.append((ticks, values))
        if len(self.waiting) > MOST_TIMES:
            lost, _ = self.waiting.popleft()
            for stream in self.to:
                stream.dropped += len(lost)

    def send(self) -> tuple[int, int]:
        """Send the waiting rows to all subscriptions; return the bytes of one message, and those of the rows read."""
        ticks = np.concatenate([one for one, _ in self.waiting])
        values = np.concatenate([one for _, one in self.waiting])[:, self._places]
        self.waiting.clear()
        times, rows = self._decimation.take(ticks, values)
        if not len(times):
            return 0, values.nbytes
        packed = body(times, rows)
        for stream, outbox in self.to.items():
            outbox.put(Rows(stream, packed, len(times)))
        return len(packed), values.nbytes


WATCHERS_MESSAGES, MOST_AT_ONCE, MESSAGE_BYTES = 1500.0, 32.0, 16 * 1024
"""Messages a second, those that may be sent at once, and the bytes that cost as much as a message."""
MOST_TIMES = 128


class Feeds:
    """Feeds of one drone, by columns, rate and role; those of watching clients share an allowance, in turns."""

    def __init__(self, allowance: Allowance) -> None:
        self._feeds: dict[FeedKey, _Feed] = {}
        self._allowance = allowance

    @property
    def wanted(self) -> bool:
        """True if there is a feed."""
        return bool(self._feeds)

    @property
    def truth_wanted(self) -> bool:
        """True if a feed has the true state of a virtual rig."""
        return any(key.truth for key in self._feeds)

    def add(self, key: FeedKey, stream: StreamState, outbox: Outbox) -> None:
        """Add a subscription to the feed `key`; a rate above the full rate counts as the full rate."""
        key = key._replace(rate=min(key.rate, float(FULL_RATE)))
        if key not in self._feeds:
            self._feeds[key] = _Feed(key)
        self._feeds[key].to[stream] = outbox

    def remove(self, stream: StreamState) -> None:
        """Remove a subscription."""
        for key, feed in [*self._feeds.items()]:
            if feed.to.pop(stream, None) is not None and not feed.to:
                del self._feeds[key]

    def give(self, ticks: NDArray[np.int64], values: NDArray[np.float32]) -> None:
        """Send rows to subscriptions: ticks (n,) and values (n, COLUMNS). Watching clients may get them later."""
        for key, feed in self._feeds.items():
            feed.add(ticks, values)
            if key.role is Role.COMMAND:
                feed.send()
        for key in [key for key in self._feeds if key.role is Role.WATCH]:
            if not self._allowance.left:
                return
            feed = self._feeds.pop(key)
            self._feeds[key] = feed  # after all others
            self._allowance.spend(len(feed.to), *feed.send())


class Audience(set[Outbox]):
    """Outboxes of all clients; `allowance` is that of watching ones."""

    def __init__(self) -> None:
        self.allowance = Allowance()

    @property
    def commanding(self) -> int:
        """Number of connected clients that may command, without frozen ones.

        A program that never answers counts while its socket is open, which closes with the program.
        """
        return sum(one.role is Role.COMMAND and not one.frozen for one in self)

    def tell(self, event: Mapping[str, Any]) -> None:
        """Send an event to all clients, see docs/reference."""
        if self:
            text = dumps(event)
            for outbox in self:
                outbox.tell(text)
