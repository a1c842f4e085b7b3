"""Sources that play recorded values, and look-ups in one and two dimensions."""

from collections.abc import Callable, Sequence
from typing import Any

from twodof.blocks.block import Block, Clock, library_block
from twodof.blocks.declarations import Param, Port
from twodof.blocks.elementwise import OneOutput, clamp, matrix, one_of, reals, search
from twodof.blocks.expressions.arrays import array_of
from twodof.blocks.expressions.expr import to_real, uint32, where
from twodof.blocks.library.sources import start_param, ticks
from twodof.errors import DiagramError

__all__ = ["Lookup", "Lookup2D", "Playback", "Table"]

MAX_POINTS = 1_000_000
METHODS = ("hold", "linear")
OUTSIDE = ("clip", "extrapolate")


def _points(first: str, xs: Any, second: str, ys: Any) -> tuple[list[float], list[float]]:
    """Two lists of equal length, at least two points, the first increasing; else DiagramError."""
    x, y = _increasing(first, xs), reals(ys, second, 2)
    if len(x) != len(y) or len(x) > MAX_POINTS:
        raise DiagramError(f"{len(x)} {first} and {len(y)} {second}", "", f"give as many of each, {MAX_POINTS} at most")
    return x, y


def _increasing(name: str, values: Any) -> list[float]:
    """At least two numbers, each above the one before it; else DiagramError."""
    x = reals(values, name, 2)
    for i in range(1, len(x)):
        if not x[i - 1] < x[i]:
            raise DiagramError(f"{name}[{i}] = {x[i]:g} is not above the one before it", "", f"let {name} increase")
    return x


@library_block("playback")
class Playback(Block):
    """Plays `values`, one every `period` [s] from `start` on; before it the first one, after the last the last one.

    With `repeat` the first follows the last without end. `period` is the nearest number, at least one, of ticks.
    """

    def __init__(
        self,
        values: Sequence[float] = (0.0, 1.0),
        period: float = 0.1,
        start: float = 0.0,
        repeat: bool = False,
        unit: str = "",
    ) -> None:
        column = reals(values, "values")
        if len(column) > MAX_POINTS:
            raise DiagramError(f"{len(column)} values", "Playback", f"at most {MAX_POINTS} are played")
        self.length, self.repeat = len(column), repeat
        self.outputs = [Port("y", unit=unit)]
        self.params = [
            Param("values", column, width=self.length, unit=unit),
            Param("period", period, unit="s", low=0.0),
            start_param(start),
        ]
        self.derived = [Port("first", "uint32"), Port("hold", "uint32")]

    def prepare(self, p: Any, t: Clock) -> Any:
        hold = ticks(p.period, t)
        return {"first": ticks(p.start, t), "hold": where(hold == 0, 1, hold)}

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        place = where(p.first <= t.tick, t.tick - p.first, 0) // p.hold
        return p.values[place % uint32(self.length) if self.repeat else place]


@library_block("table")
class Table(Block):
    """Plays `values` at `times` [s], which increase: "hold" (each value from its time on) or "linear" in between.

    Before the first time the first value, after the last time the last one. Times are taken as the nearest ticks.
    """

    def __init__(
        self,
        times: Sequence[float] = (0.0, 1.0),
        values: Sequence[float] = (0.0, 1.0),
        method: str = "hold",
        unit: str = "",
    ) -> None:
        self.method = one_of(method, METHODS, "method")
        x, y = _points("times", times, "values", values)
        self.length = len(x)
        self.outputs = [Port("y", unit=unit)]
        self.params = [
            Param("times", x, width=self.length, unit="s", low=0.0),
            Param("values", y, width=self.length, unit=unit),
        ]
        self.derived = [Port("at", "uint32", self.length)]

    def prepare(self, p: Any, t: Clock) -> Any:
        return array_of(self.length, lambda i: ticks(p.times[i], t))

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        i = search(p.at, self.length, t.tick)
        left, right = p.values[i], p.values[i + 1]
        if self.method == "hold":
            return where(p.at[i + 1] <= t.tick, right, left)
        since = where(p.at[i] <= t.tick, t.tick - p.at[i], 0)
        share = where(since == 0, 0.0, to_real(since) / to_real(p.at[i + 1] - p.at[i]))
        return where(p.at[i + 1] <= t.tick, right, left + (right - left) * share)


@library_block("lookup")
class Lookup(OneOutput):
    """Look-up with linear interpolation: y = v_i + (u - b_i) (v_(i+1) - v_i) / (b_(i+1) - b_i).

    b are the `breakpoints`, which increase, v the `values`; b_i <= u < b_(i+1), found by bisection in a loop with a
    constant bound. Beyond the ends `outside` "clip" gives the end's value, "extrapolate" goes on along the segment.
    """

    def __init__(
        self,
        breakpoints: Sequence[float] = (0.0, 1.0),
        values: Sequence[float] = (0.0, 1.0),
        outside: str = "clip",
        input_unit: str = "",
        unit: str = "",
    ) -> None:
        self.outside = one_of(outside, OUTSIDE, "outside")
        b, v = _points("breakpoints", breakpoints, "values", values)
        self.length = len(b)
        self.ports("u", unit=unit, input_unit=input_unit)
        self.params = [
            Param("breakpoints", b, width=self.length, unit=input_unit),
            Param("values", v, width=self.length, unit=unit),
        ]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        b, v, last = p.breakpoints, p.values, self.length - 1
        at = clamp(b[0], b[last], u.u) if self.outside == "clip" else u.u
        i = search(b, self.length, at)
        y = v[i] + (at - b[i]) * ((v[i + 1] - v[i]) / (b[i + 1] - b[i]))
        if self.outside == "clip":
            return where(b[last] <= at, v[last], y)
        return y


@library_block("lookup_2d")
class Lookup2D(Block):
    """Bilinear look-up: y at (u, w) from `values`[i][j], which belongs to `rows`[i] of u and `columns`[j] of w.

    Between two rows it interpolates along u as `Lookup` does, in both columns beside w; then along w between these.
    Rows and columns increase. Beyond the ends `outside` "clip" holds each of u and w at its end, "extrapolate" goes on
    along the segments.
    """

    def __init__(
        self,
        rows: Sequence[float] = (0.0, 1.0),
        columns: Sequence[float] = (0.0, 1.0),
        values: Sequence[Sequence[float]] = ((0.0, 0.0), (0.0, 1.0)),
        outside: str = "clip",
        row_unit: str = "",
        column_unit: str = "",
        unit: str = "",
    ) -> None:
        self.outside = one_of(outside, OUTSIDE, "outside")
        a, b = _increasing("rows", rows), _increasing("columns", columns)
        if len(a) * len(b) > MAX_POINTS:
            raise DiagramError(f"{len(a)} x {len(b)} values", "Lookup2D", f"at most {MAX_POINTS} are looked up")
        table = matrix(values, len(a), len(b), "values")
        self.shape = len(a), len(b)
        self.inputs = [Port("u", unit=row_unit), Port("w", unit=column_unit)]
        self.outputs = [Port("y", unit=unit)]
        self.params = [
            Param("rows", a, width=len(a), unit=row_unit),
            Param("columns", b, width=len(b), unit=column_unit),
            Param("values", table, shape=self.shape, unit=unit),
        ]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        i, along_rows = self._segment(p.rows, self.shape[0], u.u)
        j, along_columns = self._segment(p.columns, self.shape[1], u.w)
        v = p.values
        return along_columns(along_rows(v[i, j], v[i + 1, j]), along_rows(v[i, j + 1], v[i + 1, j + 1]))

    def _segment(self, b: Any, length: int, value: Any) -> tuple[Any, Callable[[Any, Any], Any]]:
        """Return the segment of the grid `b` around `value`, and the interpolation between two values at its ends."""
        clips = self.outside == "clip"
        at = clamp(b[0], b[length - 1], value) if clips else value
        i = search(b, length, at)

        def between(left: Any, right: Any) -> Any:
            y = left + (at - b[i]) * ((right - left) / (b[i + 1] - b[i]))
            return where(b[length - 1] <= at, right, y) if clips else y

        return i, between
