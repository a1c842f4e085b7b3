"""Simulink's smaller blocks, and those that its own libraries compose of others: one formula each, in a table.

A formula is a function of numbers, computed element by element, in the order of operations of MathWorks' C.
"""

import math
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from twodof.blocks import Diagram
from twodof.blocks.block import Block, Clock
from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.elementary.functions import floor, sin, trunc
from twodof.blocks.elementwise import elementwise, search
from twodof.blocks.expressions.conversions import to_stored
from twodof.blocks.expressions.expr import convert, int32, to_int32, to_real, to_uint32, where
from twodof.blocks.expressions.numbers import INTEGERS
from twodof.blocks.library import Gain, Noise, Polynomial, Ramp, UniformNoise
from twodof.slx.matlab.function_block import MatlabFunction
from twodof.slx.matlab.parser import names_in
from twodof.slx.matlab.values import as_array
from twodof.slx.translation import (
    Asked,
    Made,
    NotTranslated,
    Rule,
    Signal,
    each,
    expanded,
    names_of,
    passes,
    row,
    widest,
)

Next = Callable[..., Any]
"""Next value of a state, of the time, the inputs and the states."""


class Formula(Block):
    """y = of(t, inputs, states), element by element; t is the time [s].

    `states` are {name: (initial value, function of the next one)}: of each element one. A state is real, or bool or
    int32 where its initial value is.
    """

    def __init__(
        self,
        of: Callable[..., Any],
        inputs: Sequence[Signal],
        output: Signal,
        states: Mapping[str, tuple[Any, Next]] | None = None,
    ) -> None:
        self.of, self.nexts = of, {name: after for name, (_, after) in (states or {}).items()}
        self.inputs = [Port(f"u{k}", one.kind, output.width) for k, one in enumerate(inputs, start=1)]
        self.outputs = [Port("y", output.kind, output.width)]
        self.states = [
            State(name, start, _KINDS[type(start)], output.width) for name, (start, _) in (states or {}).items()
        ]

    def _each(self, of: Next, u: Any, x: Any, t: Clock) -> Any:
        values = [*(u[port.name] for port in self.inputs), *(x[state.name] for state in self.states)]
        return elementwise(lambda *v: of(t.time, *v), *values) if values else of(t.time)

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Compute the formula."""
        return self._each(self.of, u, x, t)

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Compute the next states."""
        return {name: self._each(after, u, x, t) for name, after in self.nexts.items()}


_KINDS: dict[type, str] = {float: "real", bool: "bool", int: "int32"}


def formula(c: Asked, of: Callable[..., Any], kind: str = "real", **states: tuple[Any, Next]) -> Made:
    """Return the block of a formula with as many inputs as the Simulink block has."""
    return Made(Formula(of, c.inputs, Signal(kind, c.width), states))


def _within(low: Any, high: Any, value: Any, below: Any, above: Any) -> Any:
    """Return `value`, or what is wanted above or below the limits; the upper limit is looked at first."""
    return where(value > high, above, where(value < low, below, value))


def _detect(of: Callable[[Any, Any], Any]) -> Rule:
    """Compare the input with that of the sample before."""

    def rule(c: Asked) -> Made:
        kind, start = c.kind("real", "bool", *INTEGERS), c.scalar("vinit", "0")
        held, word = ("real",) * 2 if kind == "real" else ("int32", "uint32" if kind == "uint32" else "int32")
        x = (start if kind == "real" else int(start), lambda t, u, x: convert(u, held))
        return formula(c, lambda t, u, x: of(convert(u, word), convert(x, word)), "bool", x=x)

    return rule


def _becomes(true: Callable[[Any], Any]) -> Rule:
    """Say where a condition of the input is true, and was not before."""

    def rule(c: Asked) -> Made:
        exact = "real" if c.inputs[0].number == "real" else "float64"
        holds: Next = lambda t, u, x: true(convert(u, exact))  # noqa: E731
        return formula(c, lambda t, u, x: holds(t, u, x) & ~x, "bool", x=(bool(c.scalar("vinit", "0")), holds))

    return rule


def _interval(c: Asked) -> Made:
    low, high = c.scalar("lowlimit", "-0.5"), c.scalar("uplimit", "0.5")
    left, right = (c.text(f"IntervalClosed{side}", "on") == "on" for side in ("Left", "Right"))
    exact = "real" if c.inputs[0].number == "real" else "float64"

    def inside(t: Any, u: Any) -> Any:
        u = convert(u, exact)
        return (low <= u if left else low < u) & (u <= high if right else u < high)

    return formula(c, inside, "bool")


def _rate_limiter(c: Asked) -> Made:
    """Limit the change since the output before. One of continuous time begins at its input."""
    rise, fall = c.scalar("RisingSlewLimit", "1") * c.dt, c.scalar("FallingSlewLimit", "-1") * c.dt
    start = c.scalar("InitialCondition", "0")
    begins = c.text("SampleTimeMode", "continuous") == "continuous"

    def limited(t: Any, u: Any, x: Any, begun: Any) -> Any:
        y = where(u - x > rise, x + rise, where(u - x < fall, x + fall, u))
        return where(begun, y, u)

    return formula(c, limited, x=(start, limited), begun=(not begins, lambda t, u, x, begun: True | begun))


def _rate_limiter_dynamic(c: Asked) -> Made:
    def limited(t: Any, up: Any, u: Any, low: Any, x: Any) -> Any:
        high, least = up * c.dt, low * c.dt
        return _within(least, high, u - x, least, high) + x

    return formula(c, limited, x=(0.0, limited))


def _friction(c: Asked) -> Made:
    offset, gain = c.scalar("offset", "[1 3 2 0]"), c.scalar("gain", "1")
    return formula(c, lambda t, u: where(u > 0.0, 1.0, where(u < 0.0, -1.0, 0.0)) * (gain * abs(u) + offset))


def _quantizer(c: Asked) -> Made:
    step = c.scalar("QuantizationInterval", "0.5")

    def of(t: Any, u: Any) -> Any:
        scaled = u / step  # halves go away from 0
        return where(scaled < 0.0, -floor(0.5 - scaled), floor(scaled + 0.5)) * step

    return formula(c, of)


def _backlash(c: Asked) -> Made:
    half = c.scalar("BacklashWidth", "1") / 2.0

    def of(t: Any, u: Any, x: Any) -> Any:
        return where(u < x - half, u + half, where(u <= x + half, x, u - half))

    return formula(c, of, x=(c.scalar("InitialOutput", "0"), of))


def _derivative(c: Asked) -> Made:
    """Return the slope since the sample before, 0 in the first."""
    if c.block.type == "Derivative":
        c.notes.append("the slope is that since the sample before, also inside a step")
    return formula(
        c,
        lambda t, u, x, begun: where(begun, (u - x) / c.dt, 0.0),
        x=(0.0, lambda t, u, x, begun: u),
        begun=(False, lambda t, u, x, begun: True | begun),
    )


def _pole(c: Asked) -> Made:
    """Return one of the transfer functions of first order: a lag, a lead or lag, a zero."""
    pole, zero = c.scalar("PoleZ", "0.95"), c.scalar("ZeroZ", "0.75")
    if "First Order" in c.block.kind:
        y = lambda t, u, x: (1.0 - pole) * u + pole * x  # noqa: E731
        return formula(c, y, x=(c.scalar("ICPrevOutput", "0.0"), y))
    if "Real Zero" in c.block.kind:
        return formula(c, lambda t, u, x: u - zero * x, x=(c.scalar("ICPrevInput", "0.0"), lambda t, u, x: u))
    lead = lambda t, u, x, v: (pole * x - zero * v) + u  # noqa: E731
    before = (c.scalar("ICPrevInput", "0.0"), lambda t, u, x, v: u)
    return formula(c, lead, x=(c.scalar("ICPrevOutput", "0.0"), lead), v=before)


def _first(c: Asked) -> Made:
    start = c.scalar("Value", "1")
    return formula(c, lambda t, u, begun: where(begun, u, start), begun=(False, lambda t, u, begun: True | begun))


def _wrap(c: Asked, most: float) -> Made:
    return formula(c, lambda t, u: where(u > most, 0.0, u))


def _enabled_delay(c: Asked) -> Made:
    start = c.scalar("vinit", "0.0")
    if c.inputs[1].kind != "bool":
        raise NotTranslated("its enable is not boolean")
    return formula(c, lambda t, u, on, x: x, x=(start, lambda t, u, on, x: where(on, u, x)))


def _external_delay(c: Asked) -> Made:
    """Return the input of the sample before, in the first sample the second input."""
    c.kind("real")
    begun = False, lambda t, u, first, x, begun: True | begun
    return formula(c, lambda t, u, first, x, begun: where(begun, x, first),
                   x=(0.0, lambda t, u, first, x, begun: u), begun=begun)  # fmt: skip


# --- sources


def _pulse(c: Asked) -> Made:
    samples = c.needs("PulseType", "Sample based", "Time based", "Sample based") == "Sample based"
    amplitude, period, width = c.scalar("Amplitude", "1"), c.scalar("Period", "2"), c.scalar("PulseWidth", "1")
    delay = c.scalar("PhaseDelay", "0")
    if not samples:  # width is in % of the period
        period, width, delay = period / c.dt, period * width / 100.0 / c.dt, delay / c.dt
        if max(abs(one - round(one)) for one in (period, width, delay)) > 1e-6:
            c.notes.append("period, width and delay are rounded to samples")
    most, on = round(period), round(width)
    return formula(
        c,
        lambda t, k: where((k < on) & (k >= 0), amplitude, 0.0),
        k=(-round(delay), lambda t, k: where(k >= most - 1, int32(0), k + 1)),
    )


def _sine(c: Asked) -> Made:
    amplitude, bias, frequency, phase = (c.scalar(*one) for one in _SINE)
    if c.needs("SineType", "Time based", "Time based", "Sample based") == "Sample based":
        turns = 2.0 * math.pi / c.scalar("Samples", "10")
        frequency, phase = turns / c.dt, turns * c.scalar("Offset", "0")
    outside = c.needs("TimeSource", _TIMES[0], *_TIMES) == _TIMES[1]
    c.inputs = c.inputs[:outside]
    c.notes.append("sin is the language's own: within 2.5 units in the last place of the C library's")
    return formula(c, lambda t, *u: sin(frequency * (u[0] if outside else t) + phase) * amplitude + bias)


_TIMES = ("Use simulation time", "Use external signal")
_SINE = (("Amplitude", "1"), ("Bias", "0"), ("Frequency", "1"), ("Phase", "0"))


def _generator(c: Asked) -> Made:
    form = c.needs("WaveForm", "sine", "sine", "square", "sawtooth")
    amplitude, frequency = c.scalar("Amplitude", "1"), c.scalar("Frequency", "1")
    hertz = frequency if c.text("Units", "Hertz") == "Hertz" else frequency / (2.0 * math.pi)
    if form == "sine":
        c.notes.append("sin is the language's own: within 2.5 units in the last place of the C library's")
        return formula(c, lambda t: sin(2.0 * math.pi * hertz * t) * amplitude)
    if form == "square":
        return formula(c, lambda t: where(1.0 - (hertz * t - floor(hertz * t)) >= 0.5, amplitude, -amplitude))
    return formula(c, lambda t: (hertz * t - floor(hertz * t)) * (2.0 * amplitude) - amplitude)


def _sequence(c: Asked) -> Made:
    """Interpolate between points of time, again and again."""
    times, values = (c.value(name, "[0 2]").flatten().tolist() for name in ("rep_seq_t", "rep_seq_y"))
    if len(times) != len(values) or len(times) < 2 or sorted(set(times)) != times:
        raise NotTranslated("its times do not increase, or are not as many as its values")
    d = Diagram("sequence")
    length = times[-1] - times[0]
    d.add("time", Formula(lambda t: (t - floor(t / length) * length) + times[0], [], Signal()))
    d.add("value", LookupTable([times], [float(v) for v in values], "linear", clip=False), u1="time.y")
    d.output("y", "value")
    return Made(d, [Signal()])


def _stairs(c: Asked) -> Made:
    values = [float(v) for v in c.value("OutValues", "[3 1 4 2 1]'").flatten()]

    def of(t: Any, k: Any) -> Any:
        y: Any = values[-1]
        for number in range(len(values) - 1, 0, -1):
            y = where(k < number, values[number - 1], y)
        return y

    return formula(c, of, k=(0, lambda t, k: where(k >= len(values) - 1, int32(0), k + 1)))


def _counter(c: Asked) -> Made:
    bits = int(c.scalar("NumBits", "16")) if "Free" in c.block.kind else 0
    most = 2**bits - 1 if bits else int(c.scalar("uplimit", "7"))
    if most >= 2**31:
        raise NotTranslated("a counter beyond 31 bits is not translated")
    kind = next(kind for kind, top in (("uint8", 2**8), ("uint16", 2**16), ("uint32", 2**32)) if most < top)
    after = (0, lambda t, k: where(k >= most, int32(0), k + 1))
    return formula(c, lambda t, k: to_uint32(k) if kind == "uint32" else to_stored(k, kind, "wrap"), kind, k=after)


def _noise(block: Callable[..., Block], seed: tuple[str, str], *given: tuple[str, str], of: Any = lambda *v: v) -> Rule:
    """Return the rule of a source of random numbers: a block of the numbers `of` parameters, and of a seed."""

    def rule(c: Asked) -> Made:
        c.notes.append("other random numbers of the same distribution")
        stream = zlib.crc32(f"{c.path}/{c.block.name}".encode())  # one of its own for each block
        if (variance := c.scalar(*given[0])) < 0.0 and given[0][0].startswith("Var"):
            raise NotTranslated(f"Variance = {variance:g} is negative")
        return Made(block(*of(*(c.scalar(*one) for one in given)), int(c.scalar(*seed)) % 2**32, stream))

    return each(rule, seed[0], *(name for name, _ in given))


def _spread(variance: float, mean: float) -> tuple[float, float]:
    return math.sqrt(variance), mean


_SOURCES = {
    "Gaussian": _noise(Noise, ("rawSeed", "1"), ("VarVal", "1"), ("MeanVal", "0"), of=_spread),
    "Uniform": _noise(UniformNoise, ("rawSeed", "1"), ("MinVal", "0"), ("MaxVal", "1")),
}


def _drawn(c: Asked) -> Made:
    """Return DSP System Toolbox's source of real random numbers, one a sample."""
    c.only(SampFrame="1", OutComplex="Real", IsInherit="off")
    return _SOURCES[c.needs("SrcType", "Uniform", *_SOURCES)](c)


# --- choices, tables and expressions


def _multiport(c: Asked) -> Made:
    """Return a choice by number; a number without an input takes the last input, or the default one."""
    control, data = c.inputs[0], c.inputs[1:]
    if len(data) < 2 or control.width is not None or control.kind == "bool":
        raise NotTranslated("it has one data input, or a control that is no number")
    kind = Signal(widest(data)).number
    order = c.needs("DataPortOrder", "One-based contiguous", *_ORDERS)
    extra = c.text("DataPortForDefault", "Last data port") == "Additional data port"
    numbers = [[_ORDERS[order] + k] for k in range(len(data) - extra)]
    if order == "Specify indices":
        cells = c.structure("DataPortIndices", "{1,2,3}")
        numbers = [[int(n) for n in as_array(one).flatten()] for one in cells]

    def of(t: Any, u: Any, *values: Any) -> Any:
        whole, y = to_int32(trunc(u) if control.kind == "real" else u), convert(values[-1], kind)
        for value, number in ((value, number) for value, all_ in zip(values, numbers, strict=False) for number in all_):
            y = where(whole == number, convert(value, kind), y)
        return y

    return formula(c, of, kind)


_ORDERS = {"One-based contiguous": 1, "Zero-based contiguous": 0, "Specify indices": 0}


class LookupTable(Block):
    """y of a table at u1, u2, ...: `method` "linear", "flat" (the point below) or "nearest".

    The breakpoints increase; the table has the first dimension's points side by side. With `clip` u is held within
    the ends. It is interpolated along the first dimension, then along the next, as (right - left) share + left.
    Even breakpoints are found by their distance in `steps`, of which 0 stands for that of the first two in the build's
    precision; with `last` the last point is that of the table.
    """

    def __init__(
        self,
        points: Sequence[Sequence[float]],
        table: Sequence[float],
        method: str,
        clip: bool,
        steps: Sequence[float] = (),
        last: bool = False,
    ) -> None:
        self.sizes, self.method, self.clip, self.last = [len(one) for one in points], method, clip, last
        self.steps = steps
        self.inputs = [Port(f"u{k}") for k in range(1, len(points) + 1)]
        self.outputs = [Port("y")]
        self.params = [Param(f"points{k}", list(one), width=len(one)) for k, one in enumerate(points, start=1)]
        self.params += [Param("table", list(table), width=len(table))]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Look up."""
        places, shares, within = [], [], []
        for k, size in enumerate(self.sizes, start=1):
            value, points = u[f"u{k}"], p[f"points{k}"]
            inside = value < points[size - 1]
            if self.steps:
                first, step = points[0], self.steps[k - 1] or points[1] - points[0]
                inverse = 1.0 / step
                place = (value - first) * inverse
                inside = place < size - 1
                i = to_int32(where(inside, where(place > 0.0, place, 0.0), size - 2.0))
                share = where(value <= first, (value - first) / step, (value - (to_real(i) * step + first)) * inverse)
            else:
                i = search(points, size, value)
                share = (value - points[i]) / (points[i + 1] - points[i])
            if self.clip or self.method != "linear":
                share = where(value <= points[0], 0.0, where(inside, share, 1.0))
            if self.method != "linear":
                i = where(share >= (0.5 if self.method == "nearest" else 1.0), i + 1, i)
            places.append(i)
            shares.append(share)
            within.append(inside)

        def at(level: int, offset: Any) -> Any:
            if level < 0:
                return p.table[offset]
            stride = math.prod(self.sizes[:level])
            here = places[level] * stride + offset if stride > 1 else places[level] + offset
            left = at(level - 1, here)
            if self.method != "linear":
                return left
            right = at(level - 1, here + stride)
            between = (right - left) * shares[level] + left
            return where(within[level], between, right) if self.last else between

        return at(len(self.sizes) - 1, int32(0))


def _lookup(c: Asked) -> Made:
    methods = {
        "Linear point-slope": "linear",
        "Linear": "linear",
        "Linear interpolation": "linear",
        "None - Flat": "flat",
    }
    method = c.pick("InterpMethod", "Linear point-slope", methods | {"Flat": "flat", "Nearest": "nearest"})
    clip = c.pick("ExtrapMethod", "Linear", {"Clip": True, "None - Clip": True, "Linear": False})
    table, sizes = _sized_table(c)
    points, steps = list[list[float]](), list[float]()
    for k, size in enumerate(sizes, start=1):
        if c.text("BreakpointsSpecification", "Explicit values") == "Even spacing":
            first, step = (c.scalar(f"BreakpointsForDimension{k}{end}", "1") for end in ("FirstPoint", "Spacing"))
            points.append([first + step * n for n in range(size)])
            steps.append(step)
        else:
            points.append(c.value(f"BreakpointsForDimension{k}", "[10,22,31]").flatten().tolist())
            steps += [0.0] * (c.text("IndexSearchMethod", "") == "Evenly spaced points")
    last = clip and c.text("UseLastTableValue", "off") == "on"
    return _table(c, points, table, method, clip, steps, last)


def _sized_table(c: Asked) -> tuple[np.ndarray[Any, Any], list[int]]:
    """Return a table of as many dimensions as there are inputs, and its sizes."""
    count, table = int(c.scalar("NumberOfTableDimensions", "2")), c.value("Table", "[4 5 6;16 19 20;10 18 23]")
    if count > 2 or len(c.inputs) != count:
        raise NotTranslated(f"a table of {count} dimensions with {len(c.inputs)} inputs is not translated")
    return table, [table.size] if count == 1 else list(table.shape)


def _direct_lookup(c: Asked) -> Made:
    """Return the element of a table whose places, from 0, are the inputs; the nearest one outside."""
    c.only(InputsSelectThisObjectFromTable="Element", TableIsInput="off")
    table, sizes = _sized_table(c)
    c.values["OutDataTypeStr"] = "single" if table.dtype == np.float32 else "double"
    points = [[float(k) for k in range(size)] for size in sizes]
    return _table(c, points, table, "flat", True)


def _older_lookup(c: Asked) -> Made:
    known = {"Interpolation-Extrapolation": ("linear", False), "Interpolation-Use End Values": ("linear", True),
             "Use Input Nearest": ("nearest", True), "Use Input Below": ("flat", True)}  # fmt: skip
    method, clip = c.pick("LookUpMeth", "Interpolation-Extrapolation", known)
    names = ("RowIndex", "ColumnIndex") if c.block.type == "Lookup2D" else ("InputValues",)
    flat = len(names) == 1
    table = c.value("OutputValues" if "OutputValues" in c.values else "Table", "tanh([-4:5])" if flat else "[0 0;0 0]")
    points = [c.value(name, "[-4:5]" if flat else "[0 1]").flatten().tolist() for name in names]
    return _table(c, points, table, method, clip)


_REALS = ("double", "single")


def _table(c: Asked, points: list[list[float]], table: Any, method: str, clip: bool, *even: Any) -> Made:
    if math.prod(map(len, points)) != table.size or min(map(len, points)) < 2:
        raise NotTranslated("Table and breakpoints differ in size, or have one point")
    if any(sorted(set(one)) != one for one in points):
        raise NotTranslated("breakpoints do not increase")
    if c.width is not None:
        raise NotTranslated("a table of a vector is not translated")
    d, block = Diagram("table"), LookupTable(points, table.flatten("F").astype(float).tolist(), method, clip, *even)
    if all(one.kind == "real" for one in c.inputs):
        return Made(block)
    if c.inputs[0].kind != "real" and c.text("OutDataTypeStr", "Inherit: Same as first input") not in _REALS:
        raise NotTranslated(f"a table of {c.inputs[0]} whose output is not double is not translated")
    sources = [expanded(d, d.input(f"u{k}", one.kind), one, None, "real") for k, one in enumerate(c.inputs, start=1)]
    d.output("y", d.add("y", block, inputs=dict(zip(names_of(block), sources, strict=True))))
    return Made(d, [Signal()])


def _expression(c: Asked) -> Made:
    """Return an expression of u; the names of the workspace in it are its constants."""
    text = c.text("MATLABFcn", "sin") if c.block.type == "MATLABFcn" else c.text("Expr", "sin(u[1])")
    text = re.sub(r"\bu\[(\d+)\]", r"u(\1)", text)
    text = text if re.search(r"\bu\b", text) else f"{text}(u)"
    known = [name for name in names_in(text) if name in c.names and name != "u"]
    c.kind("real")
    item = MatlabFunction(
        f"function y = f({', '.join(['u', *known])})\ny = {text};", c.inputs[:1], c.names, folders=c.folders
    )
    c.notes += item.notes
    return Made(item)


def _one_input(of: Callable[..., Any]) -> Rule:
    return lambda c: formula(c, lambda t, *u: of(*u)) if c.kind("real") else passes(c)


COMPOSITE_RULES: dict[str, Rule] = {
    "Backlash": each(_backlash, "BacklashWidth", "InitialOutput"),
    "Band-Limited White Noise": _noise(
        Noise, ("seed", "[23341]"), ("Cov", "[0.1]"), ("Ts", "0.1"), of=lambda cov, ts: (math.sqrt(cov / ts), 0.0)
    ),
    "Coulomb & Viscous Friction": each(_friction, "offset", "gain"),
    "Counter Free-Running": _counter,
    "Counter Limited": _counter,
    "Dead Zone Dynamic": _one_input(lambda up, u, low: where(u > up, u - up, where(u < low, u - low, 0.0))),
    "Degrees to Radians": lambda c: Made(Gain(math.pi / 180.0, c.width)),
    "Derivative": _derivative,
    "Detect Change": _detect(lambda u, x: u != x),
    "Detect Decrease": _detect(lambda u, x: u < x),
    "Detect Fall Negative": _becomes(lambda u: u < 0.0),
    "Detect Fall Nonpositive": _becomes(lambda u: u <= 0.0),
    "Detect Increase": _detect(lambda u, x: u > x),
    "Detect Rise Nonnegative": _becomes(lambda u: u >= 0.0),
    "Detect Rise Positive": _becomes(lambda u: u > 0.0),
    "Difference": lambda c: formula(c, lambda t, u, x: u - x, x=(c.scalar("ICPrevInput", "0.0"), lambda t, u, x: u)),
    "DiscretePulseGenerator": each(_pulse, "Amplitude", "Period", "PulseWidth", "PhaseDelay"),
    "Fcn": _expression,
    "InitialCondition": _first,
    "Interval Test": each(_interval, "lowlimit", "uplimit", wide=True),
    "Lookup": each(_older_lookup),
    "Lookup2D": each(_older_lookup),
    "Lookup_n-D": each(_lookup),
    "LookupNDDirect": _direct_lookup,
    "MATLABFcn": _expression,
    "MultiPortSwitch": _multiport,
    "Polyval": lambda c: Made(Polynomial(c.value("coefs", "[1 2 3]").flatten().tolist())),
    "Quantizer": each(_quantizer, "QuantizationInterval"),
    "Radians to Degrees": lambda c: Made(Gain(180.0 / math.pi, c.width)),
    "Ramp": lambda c: row(
        Ramp, ("start", "0"), ("slope", "1"), ("InitialOutput" if "InitialOutput" in c.values else "X0", "0")
    )(c),
    "Rate Limiter Dynamic": _rate_limiter_dynamic,
    "RateLimiter": each(_rate_limiter, "RisingSlewLimit", "FallingSlewLimit", "InitialCondition"),
    "Repeating Sequence": _sequence,
    "Repeating Sequence Stair": _stairs,
    "Saturation Dynamic": _one_input(lambda up, u, low: where(u > up, up, where(u < low, low, u))),
    "SignalConversion": passes,
    "SignalGenerator": _generator,
    "Sin": each(_sine, "Amplitude", "Bias", "Frequency", "Phase"),
    "Slider Gain": lambda c: Made(Gain(c.scalar("gain", "1"), c.width)),
    "Transfer Fcn First Order": _pole,
    "Transfer Fcn Lead or Lag": _pole,
    "Transfer Fcn Real Zero": _pole,
    "Random Source": _drawn,
    "RandomNumber": _noise(Noise, ("Seed", "0"), ("Variance", "1"), ("Mean", "0"), of=_spread),
    "UniformRandomNumber": _noise(UniformNoise, ("Seed", "0"), ("Minimum", "-1"), ("Maximum", "1")),
    "Unit Delay Enabled": _enabled_delay,
    "Unit Delay External IC": _external_delay,
    "Wrap To Zero": lambda c: _wrap(c, c.scalar("Threshold", "255")),
}
"""Rule of each of these, by block type or by the library block's name."""
SHOWN = (
    "XY Graph", "Floating Scope", "Assertion", "MessageViewer", "SpectrumAnalyzer", "VideoViewer", "Record", "DocBlock",
    "Model Info", "Check Static Lower Bound", "Check Static Upper Bound", "Check Static Range", "Check Dynamic Range",
    "Check Dynamic Lower Bound", "Check Dynamic Upper Bound", "Check Discrete Gradient", "Check Input Resolution",
    "ComboBox", "SliderBlock", "PushButtonBlock", "EditField", "RadioButtonGroup", "ToggleSwitchBlock", "LampBlock",
    "SliderSwitchBlock", "RotarySwitchBlock", "RockerSwitchBlock", "KnobBlock", "DashboardScope", "Checkbox",
    "CallbackButton", "DisplayBlock", "MultiStateImageBlock", "LinearGaugeBlock", "HalfGaugeBlock", "QuarterGaugeBlock",
    "AirspeedIndicatorBlock", "ArtificialHorizonBlock", "AltimeterBlock", "HeadingIndicatorBlock",
    "RPMIndicatorBlock", "ClimbIndicatorBlock", "EGTIndicatorBlock", "TurnCoordinatorBlock", "CircularGaugeBlock",
)  # fmt: skip
"""Blocks that show or check signals, and those of a dashboard."""
