"""A log of columns that somebody saw: the rows of a plot, as its page sends them to be kept."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LogError, listed, nearest
from twodof.flightlog.log import Channel, FlightLog
from twodof.signals import TOPICS, Topic

_BY_COLUMN: Mapping[str, Topic] = MappingProxyType({row.columns[0]: row for row in TOPICS if row.width == 1})


def log_of_rows(data: bytes, columns: Sequence[str], provenance: Mapping[str, Any]) -> FlightLog:
    """A log of `columns` of signals.TOPICS that are one number each, by their .mat names.

    `data` is little-endian: float64[n] times [s], rising, then float32[n] of each column, NaN where it has no value.
    Raises LogError for a column that is none or is named twice, for bytes that are not whole rows, and for times that
    do not rise.
    """
    unknown = [name for name in columns if name not in _BY_COLUMN]
    if unknown:
        raise LogError(f"no column {unknown[0]!r:.80}", "export", f"there are {nearest(unknown[0], _BY_COLUMN)}")
    if not columns or len(set(columns)) < len(columns):
        raise LogError(f"columns: {listed(columns)}", "export", "give one or more, each once")
    row = 8 + 4 * len(columns)
    count, rest = divmod(len(data), row)
    if rest or not count:
        raise LogError(f"{len(data)} bytes are not whole rows of {row}", "export", "send times, then column by column")
    time = np.frombuffer(data, "<f8", count)
    if not np.isfinite(time).all() or np.any(np.diff(time) <= 0.0):
        raise LogError("a time is not finite or does not rise", "export", "send rows in the order of their times")
    values = np.frombuffer(data, "<f4", count * len(columns), 8 * count).reshape(len(columns), count)
    channels = dict(_channel(name, time, one) for name, one in zip(columns, values, strict=True))
    return FlightLog(channels, dict(provenance))


def _channel(column: str, time: NDArray[np.float64], values: NDArray[np.float32]) -> tuple[str, Channel]:
    topic = _BY_COLUMN[column]
    there = ~np.isnan(values)
    return topic.mat, Channel(time[there], values[there].astype(np.float64), unit=topic.unit, name=topic.mat)
