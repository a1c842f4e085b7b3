"""What Simulink's blocks are here: a table from type to the library's blocks that compute the same, to the bit.

A function of the table gets a block with its parameters computed and the signals at its inputs, and returns a block or
a small diagram. What it does not cover it refuses by the parameter's name. MathWorks' C computes sums and products from
left to right; a Discrete Derivative keeps the scaled input, and so on: each function follows that order of operations.
"""

import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from twodof.blocks import Diagram
from twodof.blocks.block import Block as LibraryBlock
from twodof.blocks.elementwise import port_series
from twodof.blocks.library import (
    Abs,
    Bias,
    Compare,
    CompareToConstant,
    Concatenate,
    Constant,
    Convert,
    DeadZone,
    Delay,
    Demux,
    DiscreteIntegrator,
    DotProduct,
    Elementary,
    Gain,
    Integrator,
    Logic,
    MatrixGain,
    Maximum,
    Minimum,
    Mux,
    Noise,
    Product,
    Relay,
    Rounding,
    Saturation,
    Selector,
    Sign,
    StateSpace,
    Step,
    Sum,
    SumOfElements,
    Switch,
    Time,
    TransferFunction,
    Trigonometry,
    UnitDelay,
    ZeroOrderHold,
)
from twodof.blocks.library import Atan2 as Atan2Block
from twodof.errors import DiagramError
from twodof.slx.matlab import evaluate
from twodof.slx.matlab_values import Value, number
from twodof.slx.model import Block, collapsed


@dataclass(frozen=True)
class Signal:
    """The type of a signal: its kind in the block language, and its width; None of a scalar."""

    kind: str = "real"
    width: int | None = None


class Refused(Exception):
    """Why a block cannot be imported."""


@dataclass
class Asked:
    """A block to be translated: its values as text, the names that they may use, and the signals at its inputs."""

    block: Block
    path: str
    values: dict[str, str]
    names: dict[str, Value]
    inputs: list[Signal]
    dt: float
    notes: list[str] = field(default_factory=list)
    """What is approximated."""

    def text(self, name: str, default: str = "") -> str:
        """Return a choice as it stands in the file."""
        return collapsed(self.values.get(name, default))

    def value(self, name: str, default: str) -> np.ndarray[Any, Any]:
        """Return a parameter's array. Raises Refused, naming it."""
        text = self.values.get(name, default)
        try:
            found = number(evaluate(text, self.names, name))
        except DiagramError as error:
            raise Refused(f"parameter {name}: {error.what}") from None
        if not isinstance(found, np.ndarray):
            raise Refused(f"parameter {name} = {text[:60]} is not a number")
        return found

    def scalar(self, name: str, default: str) -> float:
        """Return a parameter of one number. Raises Refused for an array."""
        found = self.value(name, default)
        if found.size != 1:
            raise Refused(f"parameter {name} has {found.size} elements, which is not translated")
        return float(found.flat[0])

    def needs(self, name: str, default: str, *known: str) -> str:
        """Return a choice that must be one of `known`."""
        found = self.text(name, default)
        if found not in known:
            raise Refused(f"{name} = {found!r} is not translated")
        return found

    def pick(self, name: str, default: str, choices: dict[str, Any]) -> Any:
        """Return what a choice stands for."""
        return choices[self.needs(name, default, *choices)]

    @property
    def width(self) -> int | None:
        """The width of the widest input: scalars are expanded to it."""
        widths = {one.width for one in self.inputs if one.width is not None}
        if len(widths) > 1:
            raise Refused(f"its inputs have {' and '.join(map(str, sorted(widths)))} elements")
        return widths.pop() if widths else None

    def kind(self, *allowed: str) -> str:
        """Return the kind that all inputs have."""
        kinds = {one.kind for one in self.inputs}
        if len(kinds) != 1 or not kinds <= set(allowed):
            raise Refused(f"inputs of type {' and '.join(sorted(kinds))} are not translated")
        return kinds.pop()


Item = LibraryBlock | Diagram


@dataclass
class Made:
    """What a block became: None where it only passes its inputs on, or is dropped."""

    item: Item | None
    outputs: list[Signal]
    ports: Sequence[str] | None = None
    """The names of the inputs in Simulink's order; None: those of the item."""
    expand: bool = True
    """Whether a scalar at an input is expanded to the others' width."""


Rule = Callable[[Asked], Made]


def _same(c: Asked, item: LibraryBlock, kind: str = "real") -> Made:
    return Made(item, [Signal(kind, c.width)])


def _constant(c: Asked) -> Made:
    value = c.value("Value", "1")
    said = c.text("OutDataTypeStr", "Inherit: Inherit from 'Constant value'")
    kind = TYPES.get(said, "") if not said.startswith("Inherit") else _KIND_OF.get(value.dtype.type, "")
    if not kind:
        raise Refused(f"OutDataTypeStr = {said!r} is not translated")
    if value.size == 1:
        return Made(Constant(_plain(value.flat[0], kind), kind), [Signal(kind)])
    if 1 not in value.shape:
        raise Refused(f"a constant matrix of {value.shape[0]} by {value.shape[1]} is not translated")
    return Made(Constant([_plain(v, kind) for v in value.flatten()], kind, value.size), [Signal(kind, value.size)])


def _plain(value: Any, kind: str) -> Any:
    """Return a number as the parameter of a kind."""
    return bool(value) if kind == "bool" else float(value) if kind == "real" else int(value)


def _gain(c: Asked) -> Made:
    c.kind("real")
    gain = c.value("Gain", "1")
    mode = c.text("Multiplication", "Element-wise(K.*u)")
    if gain.size == 1 and (mode.startswith("Element") or c.width is None):
        return _same(c, Gain(float(gain.flat[0]), c.width))
    if mode.startswith("Element"):
        if 1 not in gain.shape or c.width not in (None, gain.size):
            raise Refused(f"Gain has {gain.size} elements and the input {c.width or 1}")
        if c.width is None:
            return Made(MatrixGain([[float(k)] for k in gain.flatten()]), [Signal("real", gain.size)])
        d = Diagram("gains")
        d.input("u", width=gain.size)
        d.add("k", Constant([float(k) for k in gain.flatten()], width=gain.size))
        d.add("y", Product("**", gain.size), a="k", b="u")
        d.output("y", "y")
        return Made(d, [Signal("real", gain.size)])
    if mode not in ("Matrix(K*u)", "Matrix(K*u) (u vector)"):
        raise Refused(f"Multiplication = {mode!r} is not translated")
    if gain.shape[1] != (c.width or 1):
        raise Refused(f"Gain is {gain.shape[0]} by {gain.shape[1]} and the input has {c.width or 1} elements")
    return Made(MatrixGain(gain.tolist()), [Signal("real", None if gain.shape[0] == 1 else gain.shape[0])])


def _signs(c: Asked, default: str, one: str, known: str) -> str:
    said = c.text("Inputs", default).replace("|", "").replace(" ", "")
    if not said.strip(known):
        return said
    return one * int(c.scalar("Inputs", default))


def _sum(c: Asked) -> Made:
    kind, signs = c.kind("real", "int32", "uint32"), _signs(c, "++", "+", "+-")
    if len(signs) == 1:
        if c.width is None:
            return _same(c, Sum(signs, kind), kind)
        if signs == "-" or kind != "real":
            raise Refused("a sum of elements with a minus is not translated")
        return Made(SumOfElements(c.width), [Signal()])
    return _same(c, Sum(signs, kind, c.width), kind)


def _product(c: Asked) -> Made:
    c.kind("real")
    if c.text("Multiplication", "Element-wise(.*)") != "Element-wise(.*)" and c.width is not None:
        raise Refused("a product of matrices is not translated")
    signs = _signs(c, "2", "*", "*/")
    if len(signs) == 1:
        if c.width is not None:
            raise Refused("a product of elements is not translated")
        return _same(c, Elementary("reciprocal") if signs == "/" else Gain(1.0))
    return _same(c, Product(signs, c.width))


def _saturate(c: Asked) -> Made:
    kind = c.kind("real")
    return _same(c, Saturation(c.scalar("LowerLimit", "-0.5"), c.scalar("UpperLimit", "0.5"), kind, c.width))


def _initial(c: Asked, *names: str) -> tuple[Any, Signal]:
    """Return initial condition and signal of a delay, which may be wider than a scalar input."""
    name = next((one for one in names if one in c.values), names[0])
    value = c.value(name, "0")
    known = c.inputs[0]
    width = known.width or (value.size if value.size > 1 else None)
    initial = _plain(value.flat[0], known.kind) if value.size == 1 else [_plain(v, known.kind) for v in value.flatten()]
    if value.size not in (1, width or 1):
        raise Refused(f"parameter {name} has {value.size} elements and the input {width or 1}")
    return initial, Signal(known.kind, width)


def _unit_delay(c: Asked) -> Made:
    initial, signal = _initial(c, "InitialCondition", "X0")
    return Made(UnitDelay(initial, signal.kind, signal.width), [signal])


def _delay(c: Asked) -> Made:
    c.needs("DelayLengthSource", "Dialog", "Dialog")
    c.needs("InitialConditionSource", "Dialog", "Dialog")
    c.needs("ExternalReset", "None", "None")
    if c.text("ShowEnablePort", "off") != "off":
        raise Refused("ShowEnablePort is not translated")
    initial, signal = _initial(c, "InitialCondition")
    samples = int(c.scalar("DelayLength", "2"))
    if samples == 0:
        return Made(ZeroOrderHold(signal.kind, signal.width), [signal])
    return Made(Delay(samples, None, initial, signal.kind, signal.width), [signal])


def _discrete_integrator(c: Asked) -> Made:
    c.kind("real")
    method = c.text("IntegratorMethod", "Integration: Forward Euler").partition(": ")
    rules = {"Forward Euler": "forward", "Backward Euler": "backward", "Trapezoidal": "trapezoidal"}
    if method[0] != "Integration" or method[2] not in rules:
        raise Refused(f"IntegratorMethod = {''.join(method)!r} is not translated")
    c.needs("ExternalReset", "none", "none")
    c.needs("InitialConditionSource", "internal", "internal")
    for name in ("ShowSaturationPort", "ShowStatePort"):
        c.needs(name, "off", "off")
    initial, signal = _initial(c, "InitialCondition")
    limits = None
    if c.text("LimitOutput", "off") == "on":
        limits = [c.scalar("LowerSaturationLimit", "-inf"), c.scalar("UpperSaturationLimit", "inf")]
    gain = c.scalar("gainval", "1.0")
    return Made(DiscreteIntegrator(rules[method[2]], gain, initial, limits, width=signal.width), [signal])


def _discrete_derivative(c: Asked) -> Made:
    """Keep the scaled input: y = K u / T less the last one of it."""
    c.kind("real")
    d = Diagram("derivative")
    d.input("u", width=c.width)
    d.add("scaled", Gain(c.scalar("gainval", "1.0") / c.dt, c.width), u="u")
    d.add("UD", UnitDelay(c.scalar("ICPrevScaledInput", "0.0"), "real", c.width), u="scaled")
    d.add("difference", Sum("+-", "real", c.width), a="scaled", b="UD")
    d.output("y", "difference")
    return _same(c, d)  # type: ignore[arg-type]


def _pid(c: Asked) -> Made:
    """Compute y = (P u + integral) + N (D u - filter state), or P times that in ideal form; in MathWorks' order."""
    c.kind("real")
    if c.width is not None:
        raise Refused("a PID of a vector is not translated")
    kind = c.pick("Controller", "PID", {name: name for name in ("PID", "PI", "PD", "P", "I")})
    continuous = c.needs("TimeDomain", "Continuous-time", "Continuous-time", "Discrete-time") == "Continuous-time"
    ideal = c.needs("Form", "Parallel", "Parallel", "Ideal") == "Ideal"
    for name, default in (("ExternalReset", "none"), ("InitialConditionSource", "internal")):
        c.needs(name, default, default)
    c.needs("TrackingMode", "off", "off")
    c.needs("ControllerParametersSource", "internal", "internal")
    if c.text("LimitOutput", "off") == "on":
        c.needs("AntiWindupMode", "none", "none", "back-calculation")
    windup = c.text("LimitOutput", "off") == "on" and c.text("AntiWindupMode", "none") == "back-calculation"
    d = Diagram("pid")
    d.input("u")
    error, terms = "u", list[str]()
    if ideal:
        if kind == "I":
            raise Refused("an integral controller in ideal form is not translated")
        terms.append("u")
    elif "P" in kind:
        d.add("P", Gain(c.scalar("P", "1")), u="u")
        terms.append("P")
    if "I" in kind:
        start = c.scalar("InitialConditionForIntegrator", "0")
        method = c.text("IntegratorMethod", "Forward Euler")
        rules = {"Forward Euler": "forward", "Backward Euler": "backward", "Trapezoidal": "trapezoidal"}
        if method not in rules:
            raise Refused(f"IntegratorMethod = {method!r} is not translated")
        d.add("I", Gain(c.scalar("I", "1")), u=error)
        d.add("integral", Integrator(start) if continuous else DiscreteIntegrator(rules[method], 1.0, start))
        terms.append("integral")
    if "D" in kind:
        c.needs("UseFilter", "on", "on")
        if not continuous:
            c.needs("FilterMethod", "Forward Euler", "Forward Euler")
        start = c.scalar("InitialConditionForFilter", "0")
        d.add("D", Gain(c.scalar("D", "0")), u="u")
        d.add("filter", Integrator(start) if continuous else DiscreteIntegrator("forward", 1.0, start))
        d.add("slope", Sum("+-"), a="D", b="filter")
        d.add("N", Gain(c.scalar("N", "100")), u="slope")
        d.connect("N", "filter.u")
        terms.append("N")
    y = terms[0]
    if len(terms) > 1:
        d.add("sum", Sum("+" * len(terms)), inputs=dict(zip("abc", terms, strict=False)))
        y = "sum"
    if ideal:
        d.add("P", Gain(c.scalar("P", "1")), u=y)
        y = "P"
    if c.text("LimitOutput", "off") == "on":
        low, high = c.scalar("LowerSaturationLimit", "-inf"), c.scalar("UpperSaturationLimit", "inf")
        d.add("limited", Saturation(low, high), u=y)
        if windup and "I" in kind:
            d.add("excess", Sum("+-"), a="limited", b=y)
            d.add("Kb", Gain(c.scalar("Kb", "1")), u="excess")
            d.add("driven", Sum("++"), a="Kb", b="I")
            d.connect("driven", "integral.u")
        y = "limited"
    if "I" in kind and not windup:
        d.connect("I", "integral.u")
    d.output("y", y)
    return Made(d, [Signal()])


def _mux(c: Asked) -> Made:
    kind = c.kind("real", "bool", "int32", "uint32")
    widths = [one.width for one in c.inputs]
    total = Signal(kind, sum(width or 1 for width in widths))
    if len(widths) == 1:
        return Made(ZeroOrderHold(kind, widths[0]), [Signal(kind, widths[0])])
    if None not in widths:
        return Made(Concatenate([width or 1 for width in widths], kind), [total], expand=False)
    if not any(widths):
        return Made(Mux(len(widths), kind), [total], expand=False)
    d, elements = Diagram("mux"), list[str]()
    for k, width in enumerate(widths, start=1):
        d.input(f"u{k}", kind, width)
        if width is None:
            elements.append(f"u{k}")
            continue
        d.add(f"split{k}", Demux(width, kind), u=f"u{k}")
        elements += [f"split{k}.{name}" for name in port_series(width)]
    d.add("y", Mux(len(elements), kind), inputs=dict(zip(port_series(len(elements)), elements, strict=True)))
    d.output("y", "y")
    return Made(d, [total], expand=False)


def _demux(c: Asked) -> Made:
    kind, width = c.kind("real", "bool", "int32", "uint32"), c.inputs[0].width or 1
    outputs = c.value("Outputs", "4")
    sizes = [int(n) for n in outputs.flatten()] if outputs.size > 1 else []
    count = len(sizes) or int(outputs.flat[0])
    if not sizes:
        sizes = [width // count + (k < width % count) for k in range(count)] if count <= width else []
    if sum(sizes) != width or min(sizes, default=0) < 1:
        raise Refused(f"Outputs = {c.text('Outputs', '4')} does not fit an input of {width} elements")
    if all(size == 1 for size in sizes) and width > 1:
        return Made(Demux(width, kind), [Signal(kind)] * width)
    d, first = Diagram("demux"), 0
    d.input("u", kind, width)
    for k, size in enumerate(sizes):
        d.add(f"part{k + 1}", Selector(width, list(range(first, first + size)), kind), u="u")
        d.output(f"y{k + 1}", f"part{k + 1}")
        first += size
    return Made(d, [Signal(kind, None if size == 1 else size) for size in sizes])


def _selector(c: Asked) -> Made:
    kind, width = c.kind("real", "bool", "int32", "uint32"), c.inputs[0].width or 1
    if c.text("NumberOfDimensions", "1") != "1":
        raise Refused("NumberOfDimensions other than 1 is not translated")
    options = c.text("IndexOptions", c.text("IndexOptionArray", "Index vector (dialog)"))
    if options not in ("Index vector (dialog)", "Select all"):
        raise Refused(f"IndexOptions = {options!r} is not translated")
    base = 0 if c.text("IndexMode", "One-based") == "Zero-based" else 1
    said = c.values.get("Indices", c.values.get("IndexParamArray", c.values.get("Elements", "1")))
    c.values["Indices"] = said.strip("{}") or "1"
    indices = (
        [int(k) - base for k in c.value("Indices", "1").flatten()] if options != "Select all" else list(range(width))
    )
    if min(indices) < 0 or max(indices) >= width:
        raise Refused(f"Indices reach beyond an input of {width} elements")
    if width == 1:
        return Made(ZeroOrderHold(kind), [Signal(kind)])
    return Made(Selector(width, indices, kind), [Signal(kind, None if len(indices) == 1 else len(indices))])


def _switch(c: Asked) -> Made:
    """Compute the criterion of the second input beside the choice between the first and the third."""
    first, control, third = c.inputs
    if first.kind != third.kind or control.width is not None:
        raise Refused("its inputs have other types, or the control is a vector")
    c.inputs = [first, third]
    width, kind = c.width, first.kind
    criterion = c.needs("Criteria", "u2 >= Threshold", "u2 >= Threshold", "u2 > Threshold", "u2 ~= 0")
    d = Diagram("switch")
    d.input("u1", kind, first.width)
    d.input("u2", control.kind)
    d.input("u3", kind, third.width)
    condition = "u2"
    if control.kind != "bool":
        operation = {"u2 >= Threshold": ">=", "u2 > Threshold": ">", "u2 ~= 0": "!="}[criterion]
        threshold = 0.0 if criterion == "u2 ~= 0" else c.scalar("Threshold", "0")
        d.add("condition", CompareToConstant(operation, threshold, control.kind), u="u2")
        condition = "condition"
    elif criterion != "u2 ~= 0" and not 0.0 < c.scalar("Threshold", "0") <= 1.0 - (criterion == "u2 > Threshold"):
        raise Refused(f"Criteria = {criterion!r} of a boolean is not translated")
    sources = {}
    for name, one in (("u1", first), ("u3", third)):
        sources[name] = expanded(d, name, one, width)
    d.add("y", Switch(kind, width), condition=condition, a=sources["u1"], b=sources["u3"])
    d.output("y", "y")
    return Made(d, [Signal(kind, width)], expand=False)


def expanded(d: Diagram, source: str, signal: Signal, width: int | None) -> str:
    """Return the source of a signal with this width: a scalar is repeated. Raises Refused for another width."""
    if signal.width == width or width is None:
        return source
    if signal.width is not None or signal.kind != "real":
        raise Refused(f"an input of {signal.width or 1} elements meets {width}")
    name = f"{source.replace('.', '_')}_expanded"
    if name not in d.parts:
        d.add(name, MatrixGain([[1.0]] * width), u=source)
    return name


def _function(block: type[Any], functions: dict[str, str]) -> Rule:
    def made(c: Asked) -> Made:
        c.kind("real")
        name = c.text("Operator", c.text("Function", next(iter(functions))))
        if name not in functions:
            raise Refused(f"Operator = {name!r} is not translated")
        return _same(c, block(functions[name], c.width))

    return made


def _trigonometry(c: Asked) -> Made:
    c.kind("real")
    name = c.text("Operator", c.text("Function", "sin"))
    if name == "atan2":
        return _same(c, Atan2Block(c.width))
    if name not in ("sin", "cos", "tan", "asin", "acos", "atan", "tanh"):
        raise Refused(f"Operator = {name!r} is not translated")
    c.notes.append(f"{name} is the language's own: within 2.5 units in the last place of the C library's")
    return _same(c, Trigonometry(name, c.width))


def _relational(c: Asked) -> Made:
    kind = c.kind("real", "bool", "int32", "uint32")
    name = c.text("Operator", c.text("Function", ">="))
    operations = {"==": "==", "~=": "!=", "<": "<", "<=": "<=", ">": ">", ">=": ">="}
    if name not in operations:
        raise Refused(f"Operator = {name!r} is not translated")
    return Made(Compare(operations[name], kind, c.width), [Signal("bool", c.width)])


def _compare_to(value: Callable[[Asked], float]) -> Rule:
    def made(c: Asked) -> Made:
        kind = c.kind("real", "int32", "uint32")
        operation = c.pick("relop", "<=", {"==": "==", "~=": "!=", "<": "<", "<=": "<=", ">": ">", ">=": ">="})
        c.needs("OutDataTypeStr", "boolean", "boolean", "uint8")
        return Made(CompareToConstant(operation, value(c), kind, c.width), [Signal("bool", c.width)])

    return made


def _logic(c: Asked) -> Made:
    name = c.text("Operator", c.text("Function", "AND")).lower()
    if name not in ("and", "or", "xor", "nand", "nor", "not"):
        raise Refused(f"Operator = {name!r} is not translated")
    if any(one.kind != "bool" for one in c.inputs):
        raise Refused("inputs that are not boolean are not translated")
    return Made(Logic(name, len(c.inputs), c.width), [Signal("bool", c.width)])


def _min_max(c: Asked) -> Made:
    kind = c.kind("real", "int32", "uint32")
    block = {"min": Minimum, "max": Maximum}[c.needs("Function", "min", "min", "max")]
    if len(c.inputs) == 1:
        if c.width is not None:
            raise Refused("the smallest or largest element of one input is not translated")
        return Made(ZeroOrderHold(kind), [Signal(kind)])
    return _same(c, block(len(c.inputs), kind, c.width), kind)


def _passes(c: Asked) -> Made:
    one = c.inputs[0]
    return Made(ZeroOrderHold(one.kind, one.width), [one])


def _convert(c: Asked) -> Made:
    one, said = c.inputs[0], c.text("OutDataTypeStr", "Inherit: Inherit via back propagation")
    if said.startswith("Inherit"):
        c.notes.append("the type is inherited from behind: that of the input is kept")
        return _passes(c)
    if said not in TYPES:
        raise Refused(f"OutDataTypeStr = {said!r} is not translated")
    kind = TYPES[said]
    if kind == one.kind:
        return _passes(c)
    if kind in ("int32", "uint32") and one.kind == "real":
        if c.text("SaturateOnIntegerOverflow", "off") != "on":
            c.notes.append("what does not fit the integer saturates, where Simulink wraps")
        rounding = {
            "Floor": "floor",
            "Zero": "trunc",
            "Ceiling": "ceil",
            "Convergent": "half_even",
            "Simplest": "trunc",
        }
        rounding |= dict.fromkeys(("Nearest", "Round"), "half_away")
        return Made(Convert(one.kind, kind, c.pick("RndMeth", "Floor", rounding), one.width), [Signal(kind, one.width)])
    return Made(Convert(one.kind, kind, width=one.width), [Signal(kind, one.width)])


def _rational(c: Asked) -> tuple[list[float], list[float]]:
    for name in ("NumeratorSource", "DenominatorSource", "InitialStatesSource"):
        c.needs(name, "Dialog", "Dialog")
    if c.inputs[0].width is not None:
        raise Refused("a transfer function of a vector is not translated")
    default = "[1 0.5]" if c.block.type.startswith("Discrete") else "[1 1]"
    top, bottom = c.value("Numerator", "[1]"), c.value("Denominator", default)
    if 1 not in top.shape or 1 not in bottom.shape:
        raise Refused("Numerator is a matrix")
    return [float(v) for v in top.flatten()], [float(v) for v in bottom.flatten()]


def _discrete_transfer(c: Asked) -> Made:
    """Direct form II as MathWorks' C computes it: x = (u - a1 x1 - ...) / a0, y = b0 x + b1 x1 + ..."""
    top, bottom = _rational(c)
    reset = c.needs("ExternalReset", "None", "None", "Level hold")
    if c.block.type == "DiscreteTransferFcn":  # in powers of z: both begin at the highest
        top = [0.0] * (len(bottom) - len(top)) + top
    order = max(len(top), len(bottom)) - 1
    initial = c.value("InitialStates", "0")
    if len(top) > len(bottom) and c.block.type == "DiscreteTransferFcn":
        raise Refused("Numerator is longer than Denominator")
    top, bottom = top + [0.0] * (order + 1 - len(top)), bottom + [0.0] * (order + 1 - len(bottom))
    if order == 0:
        return _same(c, Gain(top[0] / bottom[0]))
    states = [float(initial.flat[min(k, initial.size - 1)]) for k in range(order)]
    d = Diagram("filter")
    d.input("u")
    previous = "u"
    for k in range(1, order + 1):
        d.add(f"a{k}", Gain(bottom[k]), u=f"x{k}")
        d.add(f"less{k}", Sum("+-"), a=previous, b=f"a{k}")
        previous = f"less{k}"
    if bottom[0] != 1.0:
        d.add("a0", Constant(bottom[0]))
        d.add("x0", Product("*/"), a=previous, b="a0")
        previous = "x0"
    for k in range(1, order + 1):
        d.add(f"x{k}", UnitDelay(states[k - 1]), u=previous if k == 1 else f"x{k - 1}")
    total = ""
    for k in range(order + 1):
        if top[k] == 0.0 and (k or total):
            continue
        if top[k] == 0.0:
            continue
        d.add(f"b{k}", Gain(top[k]), u=previous if k == 0 else f"x{k}")
        if total:
            d.add(f"sum{k}", Sum("++"), a=total, b=f"b{k}")
        total = f"sum{k}" if total else f"b{k}"
    if not total:
        raise Refused("Numerator is 0")
    d.output("y", total)
    return Made(d, [Signal()]) if reset == "None" else _resettable(c, d)


def _resettable(c: Asked, inner: Diagram) -> Made:
    """Put a diagram whose states are initial while the second input is not 0: Level hold."""
    if len(c.inputs) != 2 or c.inputs[1].width is not None:
        raise Refused("its reset is not one signal")
    d = Diagram("resettable")
    d.input("u")
    d.input("reset", c.inputs[1].kind)
    source = "reset"
    if c.inputs[1].kind != "bool":
        d.add("on", CompareToConstant("!=", 0.0, c.inputs[1].kind), u="reset")
        source = "on"
    d.add("filter", inner, inputs={"u": "u"}, reset=source)
    d.output("y", "filter")
    return Made(d, [Signal()])


def _noise(c: Asked) -> Made:
    variance = c.scalar("Variance", "1")
    if variance < 0.0:
        raise Refused("Variance is negative")
    c.notes.append("other random numbers of the same distribution")
    seed = int(c.scalar("Seed", "0")) % 2**32
    stream = zlib.crc32(f"{c.path}/{c.block.name}".encode())  # one of its own for each block
    return Made(Noise(math.sqrt(variance), c.scalar("Mean", "0"), seed, stream), [Signal()])


def _transport_delay(c: Asked) -> Made:
    if c.width is not None:
        raise Refused("a delay of a vector is not translated")
    time = c.scalar("DelayTime", "1")
    samples = round(time / c.dt)
    c.notes.append(f"{time:g} s: {samples} of the period's samples")
    if samples == 0:
        return _passes(c)
    return Made(Delay(samples, None, c.scalar("InitialOutput", "0")), [Signal()])


def _transfer(c: Asked) -> Made:
    return Made(TransferFunction(*_rational(c)), [Signal()])


def _integrator(c: Asked) -> Made:
    c.kind("real")
    c.needs("ExternalReset", "none", "none")
    c.needs("InitialConditionSource", "internal", "internal")
    for name in ("ShowSaturationPort", "ShowStatePort", "WrapState"):
        c.needs(name, "off", "off")
    initial, signal = _initial(c, "InitialCondition")
    limits = None
    if c.text("LimitOutput", "off") == "on":
        limits = [c.scalar("LowerSaturationLimit", "-inf"), c.scalar("UpperSaturationLimit", "inf")]
    return Made(Integrator(initial, limits, signal.width), [signal])


def _state_space(c: Asked) -> Made:
    c.kind("real")
    a, b, cc, d = (c.value(name, "1") for name in "ABCD")
    initial = c.value("InitialCondition" if "InitialCondition" in c.values else "X0", "0").flatten().tolist()
    shape = (a.shape[0], b.shape[1], cc.shape[0])
    if b.shape[1] != (c.width or 1):
        raise Refused(f"B has {b.shape[1]} columns and the input {c.width or 1} elements")
    if d.size == 1 and shape[1:] != (1, 1):
        d = np.full(shape[:0:-1], float(d.flat[0]))
    block = StateSpace(a.tolist(), b.tolist(), cc.tolist(), d.tolist(), initial if len(initial) > 1 else initial[0])
    return Made(block, [Signal("real", None if shape[2] == 1 else shape[2])])


def _step(c: Asked) -> Made:
    return Made(Step(c.scalar("Time", "1"), c.scalar("Before", "0"), c.scalar("After", "1")), [Signal()])


def _clock(c: Asked) -> Made:
    d = Diagram("clock")
    d.add("time", Time())
    d.output("y", "time.y")
    return Made(d, [Signal()])


def _relay(c: Asked) -> Made:
    on, off = c.scalar("OnSwitchValue", "eps"), c.scalar("OffSwitchValue", "eps")
    return _same(c, Relay(on, off, c.scalar("OnOutputValue", "1"), c.scalar("OffOutputValue", "0")))


def _dot(c: Asked) -> Made:
    c.kind("real")
    return Made(DotProduct(c.width), [Signal()]) if c.width else Made(Product("**"), [Signal()])


def _dropped(c: Asked) -> Made:
    return Made(None, [])


_KIND_OF = {np.float64: "real", np.float32: "real", np.bool_: "bool", np.int32: "int32", np.uint32: "uint32"}
TYPES = {"double": "real", "single": "real", "boolean": "bool", "int32": "int32", "uint32": "uint32"}
"""Data types that have a kind here."""

MATH = {"magnitude^2": "square", **{name: name for name in ("exp", "log", "square", "reciprocal", "sqrt")}}
DROPPED = ("Terminator", "Scope", "Display", "ToWorkspace", "ToFile", "Stop")

RULES: dict[str, Rule] = {
    "Abs": lambda c: _same(c, Abs(c.kind("real", "int32"), c.width), c.kind("real", "int32")),
    "Bias": lambda c: _same(c, Bias(c.scalar("Bias", "0.0"), c.width)),
    "Clock": _clock,
    "CompareToConstant": _compare_to(lambda c: c.scalar("const", "3.0")),
    "Compare To Constant": _compare_to(lambda c: c.scalar("const", "3.0")),
    "Compare To Zero": _compare_to(lambda c: 0.0),
    "CompareToZero": _compare_to(lambda c: 0.0),
    "Concatenate": _mux,
    "Constant": _constant,
    "DataTypeConversion": _convert,
    "DeadZone": lambda c: _same(c, DeadZone(c.scalar("LowerValue", "-0.5"), c.scalar("UpperValue", "0.5"), c.width)),
    "Delay": _delay,
    "Demux": _demux,
    "DigitalClock": _clock,
    "Discrete Derivative": _discrete_derivative,
    "DiscreteFilter": _discrete_transfer,
    "DiscreteIntegrator": _discrete_integrator,
    "DiscreteTransferFcn": _discrete_transfer,
    "DotProduct": _dot,
    "Gain": _gain,
    "Ground": lambda c: Made(Constant(0.0), [Signal()]),
    "Integrator": _integrator,
    "Logic": _logic,
    "Math": _function(Elementary, MATH),
    "Memory": _unit_delay,
    "MinMax": _min_max,
    "Mux": _mux,
    "PID Controller": _pid,
    "Product": _product,
    "RelationalOperator": _relational,
    "RandomNumber": _noise,
    "RateTransition": _passes,
    "Relay": _relay,
    "Rounding": _function(Rounding, {"floor": "floor", "ceil": "ceil", "round": "nearest", "fix": "trunc"}),
    "Saturate": _saturate,
    "Selector": _selector,
    "SignalSpecification": _passes,
    "Signum": lambda c: _same(c, Sign(c.kind("real"), c.width)),
    "Sqrt": _function(Elementary, {"sqrt": "sqrt"}),
    "StateSpace": _state_space,
    "Step": _step,
    "Sum": _sum,
    "Switch": _switch,
    "TransferFcn": _transfer,
    "TransportDelay": _transport_delay,
    "Trigonometry": _trigonometry,
    "UnaryMinus": lambda c: _same(c, Sum("-", c.kind("real"), c.width)),
    "UnitDelay": _unit_delay,
    "ZeroOrderHold": _passes,
    **dict.fromkeys(DROPPED, _dropped),
}
"""Rule of each block type, or of a library block by its name."""

INPUTS = {"Switch": 3, **dict.fromkeys(("RelationalOperator", "DotProduct", "Sum", "Product"), 2)}
INPUTS |= dict.fromkeys(("Clock", "Constant", "DigitalClock", "Ground", "RandomNumber", "Step"), 0)
"""Inputs of a block of which the file does not say how many; of any other type one."""
STATEFUL = ("UnitDelay", "Memory", "Delay", "DiscreteIntegrator", "Integrator", "TransferFcn", "StateSpace",
            "TransportDelay")  # fmt: skip
"""Types whose output may be known before their input: where a loop is broken."""
