"""Flight logs: channels with their own time stamps, units and gaps, and the provenance of the whole."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.errors import LogError, listed, nearest, shown
from twodof.signals import BY_MAT, TOPICS, Topic

How = Literal["hold", "next"]

MAX_SAMPLES = 50_000_000
"""Longest channel accepted: more than two days at 250 Hz."""

MAX_NAME = 1000
"""Longest name of a channel or field, and longest unit."""
MAX_CHANNELS = 5000
FAR_S = 3600.0
"""Distance of a time stamp from all others of the log that cannot be [s]."""
RUN = 25
"""Fewest samples one after the other that prove a pause of `FAR_S` before them."""
MAX_STRETCHES = 10_000
"""Most stretches (armed, of one mode) in a log: a drone is not armed ten times a second for a quarter of an hour."""

# A sample is missing where an interval exceeds this many periods: half a period more than one, since the
# drone's own intervals stray by up to a third of a period (x and v) and a lost sample doubles one.
GAP_FACTOR = 1.5

_BY_COLUMN: Mapping[str, Topic] = MappingProxyType({row.columns[0]: row for row in TOPICS if row.width == 1})


@dataclass(frozen=True)
class Gap:
    """Missing samples of a channel, between the stamps `t0` and `t1` [s] of their neighbours."""

    channel: str
    t0: float
    t1: float
    missing: int
    armed: bool

    @property
    def duration(self) -> float:
        """Return the time without a sample [s]."""
        return self.t1 - self.t0


@dataclass(frozen=True, eq=False)
class Channel:
    """Samples of one signal.

    `time` (n,) [s] is strictly increasing. `value` (n,) or (n, k) is in `unit`. `fields` names the k columns, if they
    have names, and `name` is the channel's name in error messages. Arrays are copied and read-only. Raises LogError for
    time that does not increase, NaN, infinity, shapes that do not match, and more than MAX_SAMPLES samples.
    """

    time: NDArray[np.float64]
    value: NDArray[np.float64]
    unit: str = ""
    fields: tuple[str, ...] = ()
    name: str = ""

    def __post_init__(self) -> None:
        where = self.name or "channel"
        time, value = _floats(self.time, f"{where}.time"), _floats(self.value, f"{where}.value")
        if time.ndim != 1 or value.ndim not in (1, 2) or len(value) != len(time):
            what = f"shapes do not match: time {time.shape}, value {value.shape}"
            raise LogError(what, where, "time is (n,), value (n,) or (n, k)")
        if len(time) > MAX_SAMPLES:
            raise LogError(f"{len(time)} samples are too many", where, f"at most {MAX_SAMPLES} are accepted")
        if value.ndim == 2 and value.shape[1] == 1:
            value = value[:, 0]
        width = 1 if value.ndim == 1 else value.shape[1]
        if self.fields and len(self.fields) != width:
            what = f"there are {len(self.fields)} field names for {width} columns"
            raise LogError(what, where, "give a name for each column, or none")
        _check_finite(time, where, time, "time")
        _check_finite(value, where, time, "value")
        backward = np.flatnonzero(np.diff(time) <= 0.0)
        if backward.size:
            k = int(backward[0])
            what = f"time does not increase: sample {k + 1} at {time[k + 1]!s} s follows {time[k]!s} s"
            raise LogError(what, where, "sort the samples and remove repeated stamps; give two runs as two files")
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "value", value)
        object.__setattr__(self, "fields", tuple(self.fields))

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        span = f", {self.time[0]:.2f} to {self.time[-1]:.2f} s" if len(self) else ""
        return f"<Channel {self.name} [{self.unit or '-'}]: {len(self)} samples{span}>"

    def field(self, name: str) -> NDArray[np.float64]:
        """Return one named column (n,), such as `log["lmnf"].field("M")`. Raises LogError for an unknown name."""
        if name not in self.fields:
            what = f"no field {name!r}"
            raise LogError(what, self.name or "channel", f"there are: {', '.join(self.fields) or 'none'}")
        return self.value if self.value.ndim == 1 else self.value[:, self.fields.index(name)]

    def period(self) -> float:
        """Return the mean of the intervals without a lost sample [s]; NaN for fewer than two samples."""
        steps = np.diff(self.time)
        return float(np.mean(steps[steps <= GAP_FACTOR * np.median(steps)])) if steps.size else float("nan")

    def held(self, t: ArrayLike) -> NDArray[np.float64]:
        """Return the latest value at or before each time of `t` (m,) [s], NaN for none. Raises LogError."""
        place = self.index(t)
        return np.where(place >= 0, self.value[np.maximum(place, 0)], np.nan)

    def index(self, t: ArrayLike, how: How = "hold") -> NDArray[np.intp]:
        """Return the index of the sample that stands for each time of `t` (m,) [s], -1 for none. Raises LogError.

        `hold` is the latest sample at or before t, `next` the first at or after t.
        """
        at = _floats(t, "t")
        _check_finite(at, "t", at, "time")
        if how not in ("hold", "next"):
            raise LogError(f"no way {how!r} of choosing a sample", self.name or "channel", "give 'hold' or 'next'")
        if how == "hold":
            return np.searchsorted(self.time, at, side="right") - 1
        after = np.searchsorted(self.time, at, side="left")
        return np.where(after < len(self.time), after, -1)

    def renamed(self, name: str) -> "Channel":
        """Return the same samples under another name."""
        made = copy(self)  # its arrays are read-only, and checked
        object.__setattr__(made, "name", name)
        return made

    def slice(self, t0: float, t1: float) -> "Channel":
        """Return the samples with t0 <= time <= t1 [s]."""
        a, b = np.searchsorted(self.time, [t0, t1], side="left")
        b += int(b < len(self.time) and self.time[b] == t1)
        return replace(self, time=self.time[a:b], value=self.value[a:b])


@dataclass(frozen=True, eq=False)
class FlightLog:
    """Channels by the drone's .mat names (`theta`, `q`, `M`, ...), and their provenance.

    `provenance` holds JSON values: `file` (name, sha256, format), `history` (the files before it), `seed`, `versions`,
    and entries of the log's maker. Raises LogError without a channel.
    """

    channels: dict[str, Channel]
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.channels:
            raise LogError("a log needs at least one channel", "FlightLog", "give it a channel")
        named = {
            name: channel if channel.name == name else channel.renamed(name) for name, channel in self.channels.items()
        }
        if len(named) > MAX_CHANNELS:
            raise LogError(f"{len(named)} channels are too many", self.source, f"at most {MAX_CHANNELS} are accepted")
        for name, channel in named.items():
            for one in (name, channel.unit, *channel.fields):
                if len(one) > MAX_NAME or any("\ud800" <= letter <= "\udfff" for letter in one):
                    what = f"the name or unit {shown(one)} is too long, or not valid Unicode"
                    raise LogError(what, shown(name), f"give at most {MAX_NAME} letters")
        object.__setattr__(self, "channels", named)
        object.__setattr__(self, "provenance", dict(self.provenance))

    def __repr__(self) -> str:
        start, end = self.span if any(map(len, self.channels.values())) else (0.0, 0.0)
        names = f"{len(self.channels)} channels: {listed(self.channels)}"
        return f"<FlightLog {self.source}: {start:.2f} to {end:.2f} s, {names}>"

    def __getitem__(self, name: str) -> Channel:
        """Return a channel. Raises LogError, with the names of all channels, if the log lacks it."""
        try:
            return self.channels[name]
        except KeyError:
            raise LogError(f"no channel {name!r}", self.source, f"the log has: {', '.join(self.channels)}") from None

    def __contains__(self, name: object) -> bool:
        return name in self.channels

    def __iter__(self) -> Iterator[str]:
        return iter(self.channels)

    @property
    def source(self) -> str:
        """Return the name of the file that was read, for messages; "log" without a file."""
        file = self.provenance.get("file")
        return str(file.get("name", "log")) if isinstance(file, Mapping) else "log"

    @property
    def span(self) -> tuple[float, float]:
        """Return the first and last time stamp of any channel [s]. Raises LogError if every channel is empty."""
        filled = [channel.time for channel in self.channels.values() if len(channel)]
        if not filled:
            raise LogError("no channel holds a sample", self.source, "give a log with samples")
        return min(float(time[0]) for time in filled), max(float(time[-1]) for time in filled)

    def slice(self, t0: float, t1: float) -> "FlightLog":
        """Return the samples with t0 <= time <= t1 [s] of every channel; a channel may become empty.

        Raises LogError for an empty window and for a window without a sample.
        """
        start, end = self.span
        if not t0 < t1:
            raise LogError(f"window {t0!s} to {t1!s} s is empty", self.source, "give t0 < t1, in seconds")
        cut = {name: channel.slice(t0, t1) for name, channel in self.channels.items()}
        if not any(len(channel) for channel in cut.values()):
            what = f"no sample between {t0:g} and {t1:g} s"
            raise LogError(what, self.source, f"the log spans {start:g} to {end:g} s")
        return FlightLog(cut, {**self.provenance, "slice_s": [float(t0), float(t1)]})

    def resample(self, name: str, t: ArrayLike) -> NDArray[np.float64]:
        """Return the values of a channel at the times `t` (m,) [s], of shape (m,) or (m, k) for k columns.

        Each value is the latest sample at or before its time. Raises LogError for a time before the first sample.
        """
        channel = self[name]
        at = channel.index(t)
        unpaired = np.flatnonzero(at < 0)
        if unpaired.size:
            span = f"{channel.time[0]!s} to {channel.time[-1]!s} s" if len(channel) else "no time: it is empty"
            first = np.ravel(t)[unpaired[0]]
            what = f"no sample for t = {first!s} s ({unpaired.size} of {at.size} times)"
            raise LogError(what, f"{self.source}: {name}", f"the channel spans {span}")
        return channel.value[at]

    def gaps(self, name: str) -> list[Gap]:
        """Return the gaps of a channel: intervals over 1.5 periods. Raises LogError.

        A channel that is sent on events (`lmnf`), or is too irregular to have a period, has no gaps. `armed` is True
        for a gap that touches a stretch with thrust, False for a log without `T`.
        """
        t0, t1, missing, armed = self.gap_table(name)
        rows = zip(t0.tolist(), t1.tolist(), missing.tolist(), armed.tolist(), strict=True)
        return [Gap(name, *row) for row in rows]

    def gap_table(
        self, name: str
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.bool_]]:
        """Return `gaps` as arrays (n,): t0, t1, missing, armed."""
        channel = self[name]
        row = BY_MAT.get(name)
        none = np.empty(0), np.empty(0), np.empty(0, np.int64), np.empty(0, np.bool_)
        if len(channel) < 3 or (row is not None and row.rate_hz == 0.0):
            return none
        steps = np.diff(channel.time)
        period = channel.period()
        wide = np.flatnonzero(steps > GAP_FACTOR * period)
        # Messages on events come in bursts: a tenth of the intervals lost is no longer a stream with gaps.
        if row is None and wide.size > 0.1 * steps.size:
            return none
        t0, t1 = channel.time[wide], channel.time[wide + 1]
        lost = np.maximum(1.0, np.minimum(np.rint((t1 - t0) / period) - 1.0, 2.0**62)).astype(np.int64)
        bounds = np.array(self.armed() if "T" in self else []).reshape(-1, 2)
        # The stretches are in order: the first that ends behind the gap's start has begun before its end, or none has.
        first = np.searchsorted(bounds[:, 1], t0, side="right")
        starts = np.append(bounds[:, 0], np.inf)
        return t0, t1, lost, starts[first] < t1

    def armed(self) -> list[tuple[float, float]]:
        """Return the stretches with thrust: stamps [s] of the first and last sample with T > 0.

        The list is empty for an experiment with the rotors off, such as the free response. Raises LogError without `T`,
        and for more than MAX_STRETCHES stretches.
        """
        return list(self._armed)

    @cached_property
    def _armed(self) -> list[tuple[float, float]]:
        channel = self["T"]
        on = np.concatenate(([False], channel.value > 0.0, [False])).astype(np.int8)
        edges = np.diff(on)
        first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
        if len(first) > MAX_STRETCHES:
            what = f"{len(first)} stretches with thrust"
            raise LogError(what, f"{self.source}: T", "this is not a flight log: give another file")
        return [(float(channel.time[a]), float(channel.time[b])) for a, b in zip(first, last, strict=True)]


def _floats(values: ArrayLike, where: str) -> NDArray[np.float64]:
    """Return a read-only float64 copy."""
    try:
        if np.iscomplexobj(values):
            raise TypeError("complex numbers")
        copy = np.array(values, dtype=np.float64, order="C")
    except (TypeError, ValueError) as reason:
        raise LogError(f"not real numbers: {reason}", where, "give an array of real numbers") from reason
    copy.flags.writeable = False
    return copy


def _check_finite(values: NDArray[np.float64], where: str, time: NDArray[np.float64], what: str) -> None:
    finite = np.isfinite(values)
    if not finite.all():
        bad = np.argwhere(~finite)
        k, count = int(bad[0][0]), "1 sample is" if len(bad) == 1 else f"{len(bad)} samples are"
        raise LogError(
            f"{what} is {values[tuple(bad[0])]!s} at sample {k} (time {time[k]!s} s), {count} like this",
            where,
            "leave the sample out together with its time stamp: the channel then has a gap there",
        )


def near_the_others(times: Sequence[NDArray[np.float64]]) -> list[NDArray[np.bool_]]:
    """Return for each channel which of its time stamps (n,) [s] are less than `FAR_S` from the rest of the log.

    The rest is what stands in runs of `RUN` stamps, or in the longest runs of a shorter log, without a jump of `FAR_S`.
    Flight controllers and cut files leave single stamps of years, which would stretch the log.
    """
    runs = [run for time in times for run in np.split(time, np.flatnonzero(np.abs(np.diff(time)) > FAR_S) + 1)]
    least = min(RUN, max(map(len, runs), default=0))
    bounds = np.array([(run.min(), run.max()) for run in runs if run.size >= max(1, least)]).reshape(-1, 2)
    bounds = bounds[np.argsort(bounds[:, 0])]
    latest = np.append(-np.inf, np.maximum.accumulate(bounds[:, 1]))
    return [time <= latest[np.searchsorted(bounds[:, 0], time + FAR_S, side="right")] + FAR_S for time in times]


def row_times(rows: int, period: str, scalar: Callable[[str], float], where: str) -> NDArray[np.float64]:
    """Return the times (n,) [s] of `rows` rows without time stamps, from 0.

    `period` is a number of seconds, or names a number of the file that `scalar` returns. Raises LogError.
    """
    try:
        found = float(period)
    except ValueError:
        found = scalar(period)
    if not 0.0 < found < np.inf:
        raise LogError(f"a period of {found:g} s", where, "give seconds above 0, as --period 0.02")
    return np.asarray(found * np.arange(rows), dtype=np.float64)


def sanitise(
    time: NDArray[np.float64], value: NDArray[np.float64], unit: str, fields: tuple[str, ...], name: str
) -> tuple[Channel, dict[str, int]]:
    """Return a channel made of samples in any order, and the counts of samples that were left out or reordered.

    `time` (n,) [s], `value` (n,) or (n, k). `not_finite` and `repeated` count samples that are left out; of samples
    with one stamp the first received is kept. `reordered` counts samples received after a later one. Raises LogError as
    Channel does.
    """
    counts: dict[str, int] = {}
    finite = np.isfinite(time) & (np.isfinite(value) if value.ndim == 1 else np.isfinite(value).all(axis=1))
    if not finite.all():
        counts["not_finite"] = int((~finite).sum())
        time, value = time[finite], value[finite]
    if (np.diff(time) < 0.0).any():
        counts["reordered"] = int((time < np.maximum.accumulate(time)).sum())
        order = np.argsort(time, kind="stable")
        time, value = time[order], value[order]
    fresh = np.concatenate(([True], np.diff(time) > 0.0))[: len(time)]
    if not fresh.all():
        counts["repeated"] = int((~fresh).sum())
        time, value = time[fresh], value[fresh]
    return Channel(time, value, unit, fields, name), counts


def log_of_rows(data: bytes, columns: Sequence[str], provenance: Mapping[str, Any]) -> FlightLog:
    """Return a log of the rows of a plot, in the form in which the page sends them for a download.

    `columns` are scalar signals of TOPICS by column name. `data` is little-endian: float64[n] times [s], rising, then
    float32[n] of each column, NaN for no value. Raises LogError for an unknown or repeated column, bytes that are not
    whole rows, and times that do not rise.
    """
    unknown = [name for name in columns if name not in _BY_COLUMN]
    if unknown:
        raise LogError(f"no column {unknown[0]!r:.80}", "export", f"choose of {nearest(unknown[0], _BY_COLUMN)}")
    if not columns or len(set(columns)) < len(columns):
        what = f"columns are missing or repeated: {listed(columns)}"
        raise LogError(what, "export", "give one or more, each once")
    row = 8 + 4 * len(columns)
    count, rest = divmod(len(data), row)
    if rest or not count:
        raise LogError(f"{len(data)} bytes are not whole rows of {row}", "export", "send times, then column by column")
    time = np.frombuffer(data, "<f8", count)
    if not np.isfinite(time).all() or np.any(np.diff(time) <= 0.0):
        raise LogError("a time is not finite or does not rise", "export", "send rows in the order of their times")
    channels = {}
    for name, values in zip(columns, np.frombuffer(data, "<f4", offset=8 * count).reshape(-1, count), strict=True):
        topic, there = _BY_COLUMN[name], ~np.isnan(values)
        channels[topic.mat] = Channel(time[there], values[there].astype(np.float64), topic.unit, name=topic.mat)
    return FlightLog(channels, dict(provenance))


def decimate(
    time: NDArray[np.float64], value: NDArray[np.float64], most: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Decimate a line `time` (n,), `value` (n,) to about `most` (2 or more) points, so that its plot looks the same.

    Each bucket keeps its lowest point, its highest and its first NaN; NaN interrupts the line. The first and the last
    point are kept too.
    """
    count = len(time)
    if count <= most:
        return time, value
    size = -(-count // max(1, most // 2))
    starts = np.arange(0, count, size)
    hole = np.isnan(value)

    def buckets(values: NDArray[Any], fill: float) -> NDArray[Any]:
        return np.append(values, np.full(len(starts) * size - count, fill, values.dtype)).reshape(-1, size)

    low = starts + buckets(np.where(hole, np.inf, value), np.inf).argmin(axis=1)
    high = starts + buckets(np.where(hole, -np.inf, value), -np.inf).argmax(axis=1)
    holes = buckets(hole, False)
    torn = (starts + holes.argmax(axis=1))[holes.any(axis=1)]
    index = np.unique(np.concatenate([[0, count - 1], low, high, torn]))
    return time[index], value[index]
