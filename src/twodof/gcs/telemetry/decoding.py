"""Messages into samples of TOPICS: which signals a message carries, in which fields, with which stamp."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from math import asin, isfinite, nan
from types import MappingProxyType
from typing import Any

from twodof.link.mavlink.messages import BATCH_VALUES, channel_bits, fields_of
from twodof.signals import TICK_S, TOPICS

Decoded = Iterator[tuple[str, float, float | tuple[float, ...]]]
"""Topic, the drone's time [s], value."""


def _pitch(q: Sequence[float]) -> float:
    """Pitch of a quaternion (w, x, y, z)."""
    w, x, y, z = q
    return asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))


def volts(cells: Sequence[int]) -> float:
    """Voltage of a pack [V] of its cells' [mV]; NaN where none is known."""
    known = [one for one in cells if one != 0xFFFF]
    return sum(known) / 1000.0 if known else nan


def share(percent: int) -> float:
    """A percentage as a share of 1; NaN where it is unknown (-1)."""
    return percent / 100.0 if percent >= 0 else nan


_FUNCTIONS: Mapping[str, Callable[[Any], float]] = {"pitch": _pitch, "volts": volts, "share": share}
"""What `signals.TOPICS` calls a function of a message's field."""
_STAMPS: Mapping[str, Callable[[Any], float]] = {
    "time_usec": lambda got: got.time_usec * 1e-6,
    "time_boot_ms": lambda got: got.time_boot_ms / 1000,
    "tick": lambda got: got.tick * TICK_S,
}
_PLACE = re.compile(r"(-?)(?:(\w+)\()?(\w+)(?:\[(\d+)\])?\)?")


def _reader(place: str) -> Callable[[Any], float]:
    """Reads a number of a message: `pitch`, `-thrust`, `controls[1]`, `pitch(q)`."""
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
    """Reads the signals that the message carries; a value that is not finite is not a sample."""
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
    """The newest row in which a topic has a sample; recordings take all of them."""
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
    """Column of TOPICS -> its place in the rows of a batch with these channels."""
    bits = channel_bits()
    named = {column: bits.get(column.replace(".", "_").upper(), 0) for row in TOPICS for column in row.columns}
    places = {bit: place for place, bit in enumerate(1 << k for k in range(64) if mask >> k & 1)}
    return MappingProxyType({column: places[bit] for column, bit in named.items() if bit & mask})


@lru_cache(maxsize=64)
def _layout(mask: int) -> tuple[tuple[str, tuple[int, ...], bool], ...]:
    """Topics that are whole in a batch: name, places of its numbers in a row, whether it has fields."""
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
"""Message -> its samples."""
