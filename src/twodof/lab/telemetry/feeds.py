"""Feeds of one drone: what clients subscribed to, computed once for all who want the same."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twodof.lab.telemetry.decimation import FULL_RATE, Decimation
from twodof.lab.telemetry.frame import body
from twodof.lab.telemetry.outbox import Outbox, Rows, StreamState
from twodof.lab.telemetry.tick_rows import PLACES, TRUTH


class FeedKey(NamedTuple):
    """What is wanted: columns, rows a second."""

    columns: tuple[str, ...]
    rate: float

    @property
    def truth(self) -> bool:
        """Whether it wants the truth of a virtual rig."""
        return any(column in TRUTH for column in self.columns)


class _Feed:
    def __init__(self, key: FeedKey) -> None:
        self.places = np.array([PLACES[column] for column in key.columns], dtype=np.intp)
        self.decimation = Decimation(key.rate)
        self.to: dict[StreamState, Outbox] = {}


class Feeds:
    """The feeds of one drone, by what they give."""

    def __init__(self) -> None:
        self._feeds: dict[FeedKey, _Feed] = {}

    @property
    def wanted(self) -> bool:
        """Whether anybody wants anything."""
        return bool(self._feeds)

    @property
    def truth_wanted(self) -> bool:
        """Whether anybody wants the truth."""
        return any(key.truth for key in self._feeds)

    def add(self, key: FeedKey, stream: StreamState, outbox: Outbox) -> None:
        """Give it to one more; the full rate is one, whatever larger number was asked for."""
        key = key._replace(rate=min(key.rate, float(FULL_RATE)))
        if key not in self._feeds:
            self._feeds[key] = _Feed(key)
        self._feeds[key].to[stream] = outbox

    def remove(self, stream: StreamState) -> None:
        """Give it to one less."""
        for key, feed in [*self._feeds.items()]:
            if feed.to.pop(stream, None) is not None and not feed.to:
                del self._feeds[key]

    def give(self, ticks: NDArray[np.int64], values: NDArray[np.float32]) -> None:
        """Further rows: (n,) and (n, COLUMNS)."""
        for feed in self._feeds.values():
            times, rows = feed.decimation.take(ticks, values[:, feed.places])
            if len(times):
                packed = body(times, rows)
                for stream, outbox in feed.to.items():
                    outbox.put(Rows(stream, packed, len(times)))
