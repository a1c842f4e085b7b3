"""A record: the piece of a log or table that a fit uses, inputs held on a uniform grid, outputs at their own stamps."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.errors import IdentificationError, is_number, listed, shown
from twodof.flightlog.log import FlightLog

Array = NDArray[np.float64]

HOLDS = ("zoh", "linear", "band-limited")
"""Held from one sample to the next; straight lines between samples; no content above half the sampling rate
(Pintelon and Schoukens, System Identification, section 13.2)."""

MAX_STEPS = 1_000_000
"""Longest record: more than an hour at 250 Hz."""

GAP = 3
"""Samples lost in a row from which on it is not known what an input did meanwhile. Fewer do little harm."""

_JITTERY = 0.05
"""Standard deviation of the stamps about the grid [steps] from which on an input moves within steps."""

_JITTER, _FEW_LOST, _FOLLOWED = 0.3, 0.05, 0.1
"""Jitter [steps] from which on stamps are counted one by one; share of lost samples that may pass for another step; and
how far the clock follows each stamp."""

_MANY_SHORTEST = 0.2
"""Share of the intervals that are the shortest one, from which on it counts as the step."""

_RATIO, _SAME_STEP = 1000, 1e-3
"""Largest denominator of two sample times in `resample`; share by which the steps of merged records may differ."""

SHORTEST_PIECE = 10
"""Steps of a piece between two gaps that is kept."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Values of one measured output; `position` is the time of each in steps since the record's start."""

    position: Array
    value: Array

    @property
    def on_grid(self) -> bool:
        """Return True if sample k lies on step k, without gaps."""
        return bool(np.array_equal(self.position, np.arange(self.position.size)))


@dataclass(frozen=True, eq=False)
class Record:
    """Inputs that were applied and outputs that were measured, in one window.

    `inputs[name]` has shape (steps,); `outputs[name]` are samples at their own times. `dt` [s] is the step, `start` [s]
    the time of step 0 on the log's axis. `hold[name]` says how an input behaves between its steps. The default "zoh"
    holds it, and "linear" draws straight lines. With "band-limited" it has nothing above half the sampling rate, as
    behind an anti-alias filter. `gaps[name]` are the stretches (from, to) [s] in which an input lost `GAP` samples or
    more, and was held: what was applied there is not known. `flight` is the record that this one is a piece of, or
    empty; the pieces of a flight have one noise. Raises IdentificationError for a hold that is none of
    these, or of no input.
    """

    name: str
    dt: float
    start: float
    inputs: Mapping[str, Array]
    outputs: Mapping[str, Samples]
    hold: Mapping[str, str] = field(default_factory=dict)
    gaps: Mapping[str, tuple[tuple[float, float], ...]] = field(default_factory=dict)
    flight: str = ""

    def __post_init__(self) -> None:
        for name, hold in self.hold.items():
            if hold not in HOLDS or name not in self.inputs:
                what = f"no hold named {hold!r:.40} is defined for an input '{name}'"
                raise self.error(what, f"holds: {', '.join(HOLDS)}; inputs: {', '.join(self.inputs)}")

    def __repr__(self) -> str:
        ports = f"inputs {listed(self.inputs)}; outputs {listed(self.outputs)}"
        return f"<Record {self.name}: {self.steps} steps of {self.dt:g} s from {self.start:g} s; {ports}>"

    def error(self, what: str, remedy: str = "") -> IdentificationError:
        """Return the error `what` of this record."""
        return IdentificationError(what, f"record '{self.name}'", remedy)

    def hold_of(self, input: str) -> str:
        """How `input` behaves between its steps."""
        return self.hold.get(input, "zoh")

    @property
    def steps(self) -> int:
        """Number of steps of the grid."""
        return len(next(iter(self.inputs.values())))

    @property
    def time(self) -> Array:
        """Times of the steps on the log's axis [s], shape (steps,)."""
        return np.asarray(self.start + self.dt * np.arange(self.steps))

    def output_time(self, output: str) -> Array:
        """Return the times of the samples of `output` on the log's axis [s]."""
        return np.asarray(self.start + self.dt * self.outputs[output].position)

    def signals(self, input: str, output: str) -> tuple[Array, Array, Array]:
        """Return times and values of an output, and an input's steps. Raises IdentificationError if one is missing."""
        if input not in self.inputs or output not in self.outputs:
            what = f"the record does not hold '{input}' as input and '{output}' as output"
            raise self.error(what, f"inputs: {', '.join(self.inputs)}; outputs: {', '.join(self.outputs)}")
        return self.output_time(output), self.outputs[output].value, self.inputs[input]

    @classmethod
    def from_columns(
        cls,
        time: ArrayLike,
        columns: Mapping[str, ArrayLike],
        inputs: Sequence[str],
        outputs: Sequence[str],
        name: str = "record",
        *,
        smooth: Collection[str] = (),
        hold: str | Mapping[str, str] = "zoh",
    ) -> Self:
        """Make a record from a table whose columns share the column `time` [s]; `smooth`, `hold` as in `from_channels`.

        Raises IdentificationError for a missing column, NaN, time that does not increase, fewer than two rows.
        """
        channels = {column: (time, value) for column, value in columns.items()}
        return cls.from_channels(channels, inputs, outputs, smooth=smooth, hold=hold, name=name)

    @classmethod
    def from_channels(
        cls,
        channels: Mapping[str, tuple[ArrayLike, ArrayLike]],
        inputs: Sequence[str],
        outputs: Sequence[str],
        *,
        start: float = -math.inf,
        stop: float = math.inf,
        smooth: Collection[str] = (),
        hold: str | Mapping[str, str] = "zoh",
        name: str = "record",
    ) -> Self:
        """Make a record from channels (time [s], value), each with its own clock, in the window `start` to `stop` [s].

        The grid is that of the first input: its step is the mean of its regular intervals, its phase fits all its
        stamps. Inputs are held: step k takes the latest sample at or before it, half a step of
        jitter forgiven. Where the stamps of the first input jitter by a twentieth of a step and more, step k takes the
        mean over the step of that input, and of those with the same stamps. Inputs named in `smooth` are samples of a
        signal that moves on between them, such as a measured pitch. Of those, step k takes the value half-way to the
        next step, interpolated linearly. Outputs keep their stamps. A channel may have gaps; the inputs hold across
        them (see `gaps` and `pieces`). `hold`: how inputs behave between samples, one of HOLDS for all or by input (see
        `Record`). An input that is not held has at step k its value at that time, interpolated linearly between its
        stamps; simulations then move it on between the steps.
        Raises IdentificationError for a missing channel, NaN, time that does not increase, an empty window.
        """
        if not inputs or not outputs:
            raise IdentificationError("no input or no output named", f"record '{name}'", "name at least one of each")
        holds = dict(hold) if isinstance(hold, Mapping) else dict.fromkeys(inputs, hold)
        for channel in smooth:
            if channel not in inputs or holds.get(channel, "zoh") != "zoh":
                what = f"'{channel}' is named in `smooth`, but it is not an input that is held"
                raise IdentificationError(what, f"record '{name}'", "name it in `inputs` too, or use `hold` alone")
        checked = {channel: _checked(channel, channels) for channel in (*inputs, *outputs)}
        clock = checked[inputs[0]][0]
        inside = (clock >= start) & (clock <= stop)
        _check_window(inside, 2, (start, stop), f"record '{name}', channel '{inputs[0]}'", clock)
        clock = clock[inside]
        step, origin = _grid(clock)
        steps = round((clock[-1] - origin) / step) + 1
        if steps > MAX_STEPS:
            raise IdentificationError(
                f"{steps} steps of {step:g} s", f"record '{name}'", f"give a window of at most {MAX_STEPS} steps"
            )
        late = (clock - origin) / step
        jittery = float(np.std(late - np.round(late))) > _JITTERY
        held, gaps = {}, {}
        for channel in inputs:
            time, value = checked[channel]
            rhythm = step if np.array_equal(time, checked[inputs[0]][0]) else None
            if found := _gaps(time, float(clock[0]), float(clock[-1]), rhythm):
                gaps[channel] = found
            middle = origin + step * (np.arange(steps) + 0.5)
            latest = np.searchsorted(time, middle, side="left") - 1
            if channel in smooth:
                held[channel] = np.interp(middle, time, value)
            elif latest[0] < 0 and time[0] > middle[0] + step:
                what = f"no sample at or before the window's start {origin:g} s"
                raise IdentificationError(what, f"record '{name}', channel '{channel}'", "start the window later")
            elif holds.get(channel, "zoh") != "zoh":
                held[channel] = np.interp(origin + step * np.arange(steps), time, value)
            elif jittery and np.array_equal(time, checked[inputs[0]][0]):
                held[channel] = _means(time, value, origin + step * np.arange(steps + 1))
            else:
                held[channel] = value[np.maximum(latest, 0)]
        measured = {}
        for channel in outputs:
            time, value = checked[channel]
            position = (time - origin) / step
            near = np.round(position)
            # A stamp that is on the grid but for rounding is on the grid; real jitter is thousands of times larger.
            position = np.where(np.abs(position - near) < 1e-6, near, position)
            keep = (position >= 0.0) & (position <= steps - 1)
            _check_window(keep, 1, (start, stop), f"record '{name}', channel '{channel}'", time)
            measured[channel] = Samples(position[keep], value[keep])
        own = {n: kind for n, kind in holds.items() if kind != "zoh"}
        return cls(name, step, origin, held, measured, own, gaps)

    @classmethod
    def from_log(
        cls,
        log: FlightLog,
        inputs: Sequence[str] | Mapping[str, str],
        outputs: Sequence[str] | Mapping[str, str],
        start: float,
        stop: float,
        *,
        smooth: Collection[str] = (),
        hold: str | Mapping[str, str] = "zoh",
        name: str = "",
    ) -> Self:
        """Make a record from a flight log's window `start` to `stop` [s]; see `from_channels`.

        Channels are named as in the log, or as {name in the structure: channel in the log}. Raises LogError for a
        channel that the log lacks, IdentificationError as `from_channels` does.
        """
        ins = dict(inputs) if isinstance(inputs, Mapping) else {channel: channel for channel in inputs}
        outs = dict(outputs) if isinstance(outputs, Mapping) else {channel: channel for channel in outputs}
        channels = {}
        for own, channel in (*ins.items(), *outs.items()):
            found = log[channel]
            if found.value.ndim != 1:
                raise IdentificationError(
                    f"channel '{channel}' has {found.value.shape[1]} columns", log.source, "use a scalar channel"
                )
            channels[own] = (found.time, found.value)
        title = name or log.source
        window = {"start": start, "stop": stop}
        return cls.from_channels(channels, list(ins), list(outs), **window, smooth=smooth, hold=hold, name=title)

    def part(self, start: float, stop: float, name: str | None = None) -> Self:
        """Return the piece from `start` to `stop` [s] on the log's axis. Raises IdentificationError if it is empty."""
        slack = 1e-6 * self.dt
        inside = (self.time >= start - slack) & (self.time <= stop + slack)
        _check_window(inside, 2, (start, stop), f"record '{self.name}'", self.time)
        first, last = (int(k) for k in np.flatnonzero(inside)[[0, -1]])
        outputs = {}
        for output, samples in self.outputs.items():
            keep = (samples.position >= first) & (samples.position <= last)
            where = f"record '{self.name}', channel '{output}'"
            _check_window(keep, 1, (start, stop), where, self.output_time(output))
            outputs[output] = Samples(samples.position[keep] - first, samples.value[keep])
        inputs = {channel: value[first : last + 1] for channel, value in self.inputs.items()}
        begin, end = self.start + first * self.dt, self.start + last * self.dt
        within = {
            channel: kept
            for channel, stretches in self.gaps.items()
            if (kept := tuple((a, b) for a, b in stretches if a < end and b > begin + self.dt))
        }
        return replace(self, name=name or self.name, start=begin, inputs=inputs, outputs=outputs, gaps=within)

    def detrend(self, linear: bool = False) -> Self:
        """Return the record without the means of its signals, with `linear` without their straight lines."""

        def level(position: Array, value: Array) -> Array:
            order = int(linear and value.size > 1)
            return np.asarray(value - np.polyval(np.polyfit(position, value, order), position))

        outputs = {n: Samples(one.position, level(one.position, one.value)) for n, one in self.outputs.items()}
        steps = np.arange(float(self.steps))
        return replace(self, inputs={n: level(steps, one) for n, one in self.inputs.items()}, outputs=outputs)

    def resample(self, period: float) -> Self:
        """Return the record with steps of `period` [s], all outputs at each step.

        For a longer period all signals pass one anti-alias filter without a phase (`scipy.signal.resample_poly`), which
        leaves the model between them as it is. A held input is half a step behind its samples, and is filtered there.
        Inputs then have nothing above half the new rate (hold "band-limited").
        For the present period outputs are interpolated linearly at the steps. Raises IdentificationError for a shorter
        period, which would add nothing, for under two such steps, and for gaps, which a filter would spread.
        """
        ratio = Fraction(period / self.dt).limit_denominator(_RATIO) if is_number(period, 0.0) else Fraction(0)
        if ratio < 1 or self.steps <= ratio:
            last = self.dt * (self.steps - 1)
            raise self.error(f"a period of {shown(period)} s", f"give {self.dt:.6g} to {last:.6g} s")
        for name, one in self.outputs.items():
            lost = np.diff(one.position, prepend=0.0, append=self.steps - 1.0)
            if lost.max() > GAP + 0.5 or self.gaps:
                raise self.error(
                    f"'{name}' or an input has a gap"
                    if self.gaps
                    else f"'{name}' lacks {lost.max() - 1.0:.0f} samples",
                    "take the pieces between the gaps, Record.pieces or part (--window), and merge them",
                )
        from scipy.signal import resample_poly  # imported late: most commands start without it

        def slower(value: Array, late: float = 0.0) -> Array:
            """Return the signal at the new steps, `late` old steps before them."""
            if ratio == 1:
                return value
            up, down = ratio.denominator, ratio.numerator
            at = np.arange(-10.0 * max(up, down), 10.0 * max(up, down) + 1.0)  # as scipy's own filter, but late
            window = np.sinc((at - late * up) / max(up, down)) * np.kaiser(at.size, 5.0)
            return np.asarray(resample_poly(value, up, down, window=window / window.sum(), padtype="line"))

        steps = np.arange(float(self.steps))
        inputs = {name: slower(value, 0.5 * (self.hold_of(name) == "zoh")) for name, value in self.inputs.items()}
        outputs = {name: slower(np.interp(steps, one.position, one.value)) for name, one in self.outputs.items()}
        count = len(next(iter(inputs.values())))
        measured = {name: Samples(np.arange(float(count)), value) for name, value in outputs.items()}
        hold = self.hold if ratio == 1 else dict.fromkeys(inputs, "band-limited")
        return replace(self, dt=self.dt * float(ratio), inputs=inputs, outputs=measured, hold=hold)

    def pieces(self) -> tuple[Self, ...]:
        """Return the pieces between the gaps of the inputs, of `SHORTEST_PIECE` steps and more.

        Fit them together: each has initial states of its own, so the input in a gap does not matter.
        Their noise is that of one flight.
        """
        if not self.gaps:
            return (self,)
        end = self.start + (self.steps - 1) * self.dt
        begin, pieces = self.start, list[Self]()
        for a, b in (*sorted(one for found in self.gaps.values() for one in found), (end, end)):
            if a - begin >= SHORTEST_PIECE * self.dt:
                piece = self.part(begin, a, f"{self.name}, piece {len(pieces) + 1}")
                pieces.append(replace(piece, flight=self.flight or self.name))
            begin = max(begin, b)
        return tuple(pieces)


def merge(*records: Record) -> tuple[Record, ...]:
    """Return experiments with one machine for one fit of them all: one verb fits several.

    Each keeps its own initial states. Records of one name get numbers. Raises IdentificationError for records that
    differ in their channels or by more than a thousandth in their steps.
    """
    for one in records:
        check_record(one)
        first = records[0]
        if (one.inputs.keys(), one.outputs.keys()) != (first.inputs.keys(), first.outputs.keys()):
            raise one.error(f"it does not have the channels of '{first.name}'", "give records with the same channels")
        if abs(one.dt - first.dt) > _SAME_STEP * first.dt:
            raise one.error(f"steps of {one.dt:.6g} s, and {first.dt:.6g} s in '{first.name}'", "resample one of them")
    names = [one.name for one in records]
    alike = len(set(names)) < len(names)
    return tuple(replace(one, name=f"{one.name} ({i + 1})") if alike else one for i, one in enumerate(records))


def check_record(one: object) -> None:
    """Raise IdentificationError for anything but a Record."""
    if not isinstance(one, Record):
        raise IdentificationError(
            f"a {type(one).__name__} is not a record", "records", "cut one from a log: cut(log, 'doublet')"
        )


def _check_window(keep: NDArray[np.bool_], least: int, window: tuple[float, float], where: str, time: Array) -> None:
    """Raise IdentificationError if a window [s] keeps fewer than `least` of the samples at `time`."""
    if np.count_nonzero(keep) < least:
        what = f"the window {window[0]:g} to {window[1]:g} s holds {np.count_nonzero(keep)} samples"
        remedy = f"it spans {time[0]:g} to {time[-1]:g} s" if time.size else "it is empty"
        raise IdentificationError(what, where, remedy)


def _checked(channel: str, channels: Mapping[str, tuple[ArrayLike, ArrayLike]]) -> tuple[Array, Array]:
    where = f"channel '{channel}'"
    if channel not in channels:
        raise IdentificationError("it is not there", where, f"present are: {', '.join(sorted(channels)) or 'none'}")
    if any(np.iscomplexobj(one) for one in channels[channel]):
        raise IdentificationError("it is complex", where, "take its real part, or its size and phase as two columns")
    t, y = (np.asarray(one, dtype=float) for one in channels[channel])
    if t.ndim != 1 or t.shape != y.shape:
        raise IdentificationError(f"time {t.shape} and value {y.shape} are not two equal columns", where)
    finite = np.isfinite(t) & np.isfinite(y)
    if not finite.all():
        bad = int(np.argmin(finite))
        raise IdentificationError(
            f"sample {bad}, {y[bad]:g} at {t[bad]:g} s, is not finite", where, "leave it out or choose another window"
        )
    back = np.flatnonzero(np.diff(t) <= 0.0)
    if back.size:
        what = f"time does not increase at sample {back[0] + 1} ({t[back[0]]:g} s, then {t[back[0] + 1]:g} s)"
        raise IdentificationError(what, where, "sort the log or cut it at the jump")
    return t, y


def _gaps(time: Array, start: float, stop: float, step: float | None) -> tuple[tuple[float, float], ...]:
    """Stretches from `start` to `stop` that lack `GAP` samples or more; none without a rhythm or a `step`."""
    first, last = np.searchsorted(time, start), np.searchsorted(time, stop, side="right")
    if last - first < SHORTEST_PIECE:
        return ()
    interval = np.diff(time[first:last])
    usual = step or float(np.median(interval))
    if step is None and np.mean(interval > 1.5 * usual) > 0.1:
        return ()
    # A gap may reach over the window's edges, or begin with the last sample of all.
    near = np.append(time[max(first - 1, 0) : last + 1], [stop] if last == time.size else [])
    long = np.flatnonzero(np.diff(near) > (GAP + 0.5) * usual)
    gaps = [(max(float(near[k]), start), min(float(near[k + 1]), stop)) for k in long]
    return tuple((a, b) for a, b in gaps if b - a > 0.5 * usual)  # one that ends at the window's edge lies outside


def _grid(clock: Array) -> tuple[float, float]:
    """Step and phase of the uniform grid that fits the stamps; gaps count as the whole steps they are."""
    interval = np.diff(clock)
    count = _counted(clock, interval, float(np.median(interval)))
    centred = count - count.mean()
    step = float(centred @ clock / (centred @ centred))
    # A clock that is exact but for rounding gives back its own first stamp and round step.
    exact = round(step, 9)
    if np.abs(clock - clock[0] - exact * count).max() < 1e-9:
        return exact, float(clock[0])
    return step, float(clock.mean() - step * count.mean())


def _means(time: Array, value: Array, edges: Array) -> Array:
    """Return the mean of held samples between each two `edges` [s]."""
    stamps = np.append(time, max(float(edges[-1]), float(time[-1])))
    total = np.concatenate([[0.0], np.cumsum(value * np.diff(stamps))])
    before = np.minimum(edges - stamps[0], 0.0) * value[0]
    return np.asarray(np.diff(np.interp(edges, stamps, total) + before) / np.diff(edges))


def _counted(clock: Array, interval: Array, step: float) -> Array:
    """Return the number of each stamp in steps of `step` [s], lost ones counted.

    Where stamps jitter by a third of a step, each is counted from where the clock is expected and not from the stamp
    before, as the mistakes would add up.
    """
    whole = np.maximum(1.0, np.round(interval / step))
    if np.abs(interval / step - whole).max() < _JITTER:
        return np.concatenate([[0.0], np.cumsum(whole)])
    # Where more than half of the samples are lost, the shortest interval is the step, unless it is an odd one out.
    whole = np.round(interval / interval.min())
    if np.abs(interval / interval.min() - whole).max() < _JITTERY and np.mean(whole == 1.0) > _MANY_SHORTEST:
        return np.concatenate([[0.0], np.cumsum(whole)])
    mean = float(interval.mean())
    step = mean if abs(mean - step) < _FEW_LOST * step else step
    expected, counts = float(clock[0]), [0.0]
    for stamp in clock[1:].tolist():
        passed = max(1.0, round((stamp - expected) / step))
        expected += passed * step
        expected += _FOLLOWED * (stamp - expected)
        counts.append(counts[-1] + passed)
    return np.array(counts)
