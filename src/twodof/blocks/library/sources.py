"""Sources: constant, time, step, ramp, pulses, doublet, 3-2-1-1, noise.

Times are parameters in seconds; `prepare` turns them into whole base ticks (the nearest), so that edges fall on ticks
and equal times give equal numbers of ticks. An edge acts in its own tick: the new value is there at tick start / dt.

Noise is a pure function of (seed, stream, tick), so that any run can be repeated to the bit.
"""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from twodof.blocks.block import Block, Clock, library_block
from twodof.blocks.declarations import Param, Port
from twodof.blocks.elementwise import count
from twodof.blocks.enumeration import Kind
from twodof.blocks.expressions.arrays import vector
from twodof.blocks.expressions.expr import to_real, to_uint32, where
from twodof.blocks.noise import normal4, uniform4

# Laws of test signals, shared with `twodof.excitation`. Sources: Jategaonkar, Flight Vehicle System Identification,
# chapter 2; Golomb, Shift Register Sequences.
LAWS = ("linear", "logarithmic")
"""How a sweep's frequency goes from its start to its end."""

MAX_LINES = 500
MAX_HARMONIC = 10_000
"""Of a multisine."""

PATTERNS: Mapping[str, tuple[int, ...]] = {"doublet": (1, -1), "3-2-1-1": (3, -2, 1, -1)}
"""Signals that are held at plus or minus their amplitude: for how many times the unit of time, with the sign."""

# Feedback taps of the primitive polynomials of lowest weight: the register runs through all 2^order - 1 states.
TAPS: Mapping[int, tuple[int, ...]] = {
    3: (3, 2),
    4: (4, 3),
    5: (5, 3),
    6: (6, 5),
    7: (7, 6),
    8: (8, 6, 5, 4),
    9: (9, 5),
    10: (10, 7),
    11: (11, 9),
    12: (12, 6, 4, 1),
    13: (13, 4, 3, 1),
    14: (14, 5, 3, 1),
    15: (15, 14),
    16: (16, 15, 13, 4),
}
"""By the order of a pseudo-random binary sequence."""


def shifted(register: Any, order: int) -> Any:
    """Return a linear feedback shift register of `order` bits after one step; its lowest bit is the output."""
    feedback = register & 0
    for tap in TAPS[order]:
        feedback = feedback ^ (register >> (order - tap))
    return (register >> 1) | ((feedback & 1) << (order - 1))


__all__ = [
    "Constant",
    "DoubletSource",
    "Noise",
    "Pulse",
    "Ramp",
    "Step",
    "ThreeTwoOneOneSource",
    "Time",
    "UniformNoise",
]


def ticks(seconds: Any, t: Clock) -> Any:
    """Return the nearest whole number of base ticks, as uint32 (0 for a negative time)."""
    return to_uint32(seconds / t.base_dt + 0.5)


def start_param(start: float) -> Param:
    """Return the parameter `start`."""
    return Param("start", start, unit="s", low=0.0, text="when it begins")


@library_block("constant")
class Constant(Block):
    """y = value, a number, an array of `width` or the rows of a matrix of `shape`; blocks of any rate may read it."""

    def __init__(
        self,
        value: Any = 0.0,
        kind: Kind = "real",
        width: int | None = None,
        unit: str = "",
        shape: tuple[int, int] | None = None,
    ) -> None:
        self.outputs = [Port("y", kind, width, unit, shape)]
        self.params = [Param("value", value, kind, width, unit, shape=shape)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return p.value


@library_block("clock")
class Time(Block):
    """Outputs: `y`, the time since the start [s], tick * dt; and `tick`, the number of base ticks (uint32)."""

    outputs = (Port("y", unit="s"), Port("tick", "uint32"))

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return {"y": t.time, "tick": t.tick}


@library_block("step")
class Step(Block):
    """y = before until `start`, after from then on."""

    def __init__(self, start: float = 1.0, before: float = 0.0, after: float = 1.0, unit: str = "") -> None:
        self.outputs = [Port("y", unit=unit)]
        self.params = [start_param(start), Param("before", before, unit=unit), Param("after", after, unit=unit)]
        self.derived = [Port("first", "uint32")]

    def prepare(self, p: Any, t: Clock) -> Any:
        return ticks(p.start, t)

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return where(p.first <= t.tick, p.after, p.before)


@library_block("ramp")
class Ramp(Block):
    """y = bias until `start`, then bias + slope (t - start)."""

    def __init__(self, start: float = 0.0, slope: float = 1.0, bias: float = 0.0, unit: str = "") -> None:
        self.outputs = [Port("y", unit=unit)]
        self.params = [start_param(start), Param("slope", slope), Param("bias", bias, unit=unit)]
        self.derived = [Port("first", "uint32")]

    def prepare(self, p: Any, t: Clock) -> Any:
        return ticks(p.start, t)

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        run = where(p.first <= t.tick, t.tick - p.first, 0)
        return p.bias + p.slope * (to_real(run) * t.base_dt)


@library_block("pulse")
class Pulse(Block):
    """y = bias + amplitude for `duration` from `start` on, else bias; again every `period` unless that is 0."""

    def __init__(
        self,
        start: float = 0.0,
        duration: float = 0.2,
        amplitude: float = 1.0,
        bias: float = 0.0,
        period: float = 0.0,
        unit: str = "",
    ) -> None:
        self.outputs = [Port("y", unit=unit)]
        self.params = [
            start_param(start),
            Param("duration", duration, unit="s", low=0.0),
            Param("amplitude", amplitude, unit=unit),
            Param("bias", bias, unit=unit),
            Param("period", period, unit="s", low=0.0, text="0: one pulse"),
        ]
        self.derived = [Port("first", "uint32"), Port("length", "uint32"), Port("every", "uint32")]

    def prepare(self, p: Any, t: Clock) -> Any:
        return {"first": ticks(p.start, t), "length": ticks(p.duration, t), "every": ticks(p.period, t)}

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        since = t.tick - p.first
        since = where(p.every == 0, since, since % p.every)
        return where((p.first <= t.tick) & (since < p.length), p.bias + p.amplitude, p.bias)


class _PatternSource(Block):
    """y = bias plus or minus amplitude, as a row of `PATTERNS` says, from `start` on, then bias."""

    pattern: ClassVar[tuple[int, ...]]

    def declare(self, start: float, unit_time: Param, amplitude: float, bias: float, unit: str) -> None:
        """Declare the output and the parameters; `unit_time` is that from which the unit of time is made."""
        self.outputs = [Port("y", unit=unit)]
        self.params = [start_param(start), unit_time, Param("amplitude", amplitude, unit=unit)]
        self.params += [Param("bias", bias, unit=unit)]
        self.derived = [Port("first", "uint32"), Port("unit_ticks", "uint32")]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        since, end, up = t.tick - p.first, 0, None
        for times in self.pattern:
            begin, end = end, end + abs(times)
            if times > 0:
                held = (
                    (p.unit_ticks * begin <= since) & (since < p.unit_ticks * end)
                    if begin
                    else since < p.unit_ticks * end
                )
                up = held if up is None else up | held
        level = where(up, p.bias + p.amplitude, p.bias - p.amplitude)
        return where((p.first <= t.tick) & (since < p.unit_ticks * end), level, p.bias)


@library_block("doublet")
class DoubletSource(_PatternSource):
    """y = bias + amplitude for half a `period` from `start` on, bias - amplitude for the other half, then bias.

    Both halves are the whole number of ticks nearest to period / 2.
    """

    pattern = PATTERNS["doublet"]

    def __init__(
        self, start: float = 0.0, period: float = 0.6, amplitude: float = 1.0, bias: float = 0.0, unit: str = ""
    ) -> None:
        self.declare(start, Param("period", period, unit="s", low=0.0), amplitude, bias, unit)

    def prepare(self, p: Any, t: Clock) -> Any:
        return {"first": ticks(p.start, t), "unit_ticks": ticks(0.5 * p.period, t)}


@library_block("three_two_one_one")
class ThreeTwoOneOneSource(_PatternSource):
    """y - bias = +, -, +, - amplitude for 3, 2, 1 and 1 times `step` [s] from `start` on, then 0.

    Source: Jategaonkar, Flight Vehicle System Identification, chapter 2.
    """

    pattern = PATTERNS["3-2-1-1"]

    def __init__(
        self, start: float = 0.0, step: float = 0.3, amplitude: float = 1.0, bias: float = 0.0, unit: str = ""
    ) -> None:
        self.declare(start, Param("step", step, unit="s", low=0.0), amplitude, bias, unit)

    def prepare(self, p: Any, t: Clock) -> Any:
        return {"first": ticks(p.start, t), "unit_ticks": ticks(p.step, t)}


class _Random(Block):
    """One number a tick, or up to 4 of one evaluation, made by `of` from those that `four` draws."""

    four: Callable[..., Any]
    of: Callable[..., Any]

    def declare(self, params: list[Param], seed: int, stream: int, width: int | None, unit: str) -> None:
        """Declare the output, and the parameters of the generator beside `params`."""
        most = 2**32 - 1
        self.width = width if width is None else count(width, 1, 4, "width")
        self.outputs = [Port("y", width=width, unit=unit)]
        self.params = [
            *params,
            Param("seed", count(seed, 0, most, "seed"), "uint32"),
            Param("stream", count(stream, 0, most, "stream"), "uint32", text="one of its own for each source"),
        ]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        found = [self.of(p, z) for z in self.four(p.seed, p.stream, t.tick)[: self.width or 1]]
        return found[0] if self.width is None else vector(found)


@library_block("noise")
class Noise(_Random):
    """y = mean + deviation z, z standard normal and independent from tick to tick (Philox 4x32-10, Box-Muller).

    `width` up to 4 gives independent elements from one evaluation. Two blocks need different `stream`s, two runs
    different `seed`s.
    """

    four = staticmethod(normal4)

    def __init__(
        self,
        deviation: float = 1.0,
        mean: float = 0.0,
        seed: int = 0,
        stream: int = 0,
        width: int | None = None,
        unit: str = "",
    ) -> None:
        params = [Param("deviation", deviation, unit=unit, low=0.0), Param("mean", mean, unit=unit)]
        self.declare(params, seed, stream, width, unit)

    def of(self, p: Any, z: Any) -> Any:
        return p.mean + p.deviation * z


@library_block("uniform_noise")
class UniformNoise(_Random):
    """y = low + (high - low) w, w uniform on [0, 1) in steps of 2^-24 and independent from tick to tick (Philox).

    `width` up to 4 gives independent elements from one evaluation.
    """

    four = staticmethod(uniform4)

    def __init__(
        self,
        low: float = 0.0,
        high: float = 1.0,
        seed: int = 0,
        stream: int = 0,
        width: int | None = None,
        unit: str = "",
    ) -> None:
        self.declare([Param("low", low, unit=unit), Param("high", high, unit=unit)], seed, stream, width, unit)

    def of(self, p: Any, w: Any) -> Any:
        return p.low + (p.high - p.low) * w
