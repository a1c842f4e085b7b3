"""Simulink's blocks as the library's: a table from type to the library's blocks that compute the same, to the bit.

A function of the table gets a block with its parameters computed and the signals at its inputs, and returns a block or
a small diagram. What it does not cover it refuses by the parameter's name. MathWorks' C computes sums and products from
left to right; a Discrete Derivative keeps the scaled input, and so on: each function follows that order of operations.
"""

import operator
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from twodof.blocks import Diagram
from twodof.blocks.bus import Bus
from twodof.blocks.elementwise import port_series
from twodof.blocks.expressions.expr import convert, where
from twodof.blocks.expressions.numbers import BY_NAME, INTEGERS, KINDS, STORED
from twodof.blocks.library import Atan2 as Atan2Block
from twodof.blocks.library import (
    CompareToConstant,
    Concatenate,
    Constant,
    Convert,
    DeadZone,
    Demux,
    DotProduct,
    Elementary,
    Gain,
    Hypot,
    Logic,
    MatrixGain,
    Mux,
    Power,
    Product,
    Remainder,
    Rounding,
    Selector,
    Sign,
    Sum,
    SumOfElements,
    Switch,
    Trigonometry,
    ZeroOrderHold,
)
from twodof.blocks.library.logic import COMPARISONS
from twodof.slx.arithmetic import ARITHMETIC_RULES, signed_sum, whole, whole_gain, whole_product, whole_sum
from twodof.slx.composite_blocks import COMPOSITE_RULES, SHOWN, formula
from twodof.slx.conditions import CONDITION_RULES
from twodof.slx.data_types import BUS_RULES, kind_of, sized, value_of
from twodof.slx.dynamic_blocks import DYNAMIC_RULES
from twodof.slx.matrices import MATRIX_LINES, matrix
from twodof.slx.toolbox_blocks import TOOLBOX_RULES
from twodof.slx.translation import (
    Asked,
    Made,
    NotTranslated,
    Rule,
    Signal,
    expanded,
    holds,
    of_elements,
    passes,
    plain,
    same,
)


def _constant(c: Asked) -> Made:
    said = c.text("OutDataTypeStr", "Inherit: Inherit from 'Constant value'")
    kind = "" if said.startswith("Inherit") else kind_of(said, c.names)
    if isinstance(kind, Bus):
        return Made(Constant(value_of(c.structure("Value", "1"), Signal(kind)), kind), [Signal(kind)])
    value = c.value("Value", "1")
    kind = kind or (kind_of("single", c.names) if value.dtype == np.float32 else _KIND_OF.get(value.dtype.name, ""))
    if not kind:
        raise NotTranslated(f"a constant of type {value.dtype.name} is not translated")
    if value.size == 1:
        return Made(Constant(plain(value.flat[0], kind), kind), [Signal(kind)])
    if 1 not in value.shape:
        signal = sized(kind, list(value.shape))
        return Made(Constant(value_of(value, signal), kind, shape=signal.shape), [signal])
    return Made(Constant([plain(v, kind) for v in value.flatten()], kind, value.size), [Signal(kind, value.size)])


def _gain(c: Asked) -> Made:
    gain = c.value("Gain", "1")
    mode = c.text("Multiplication", "Element-wise(K.*u)")
    if gain.size == 1 and (made := whole_gain(c, float(gain.flat[0]))) is not None:
        return made
    c.kind("real")
    if gain.size == 1:
        return same(c, Gain(float(gain.flat[0]), c.width))
    if mode.startswith("Element"):
        if 1 not in gain.shape or c.width not in (None, gain.size):
            raise NotTranslated(f"Gain has {gain.size} elements and the input {c.width or 1}")
        if c.width is None:
            return Made(MatrixGain([[float(k)] for k in gain.flatten()]), [Signal("real", gain.size)])
        d = Diagram("gains")
        d.input("u", width=gain.size)
        d.add("k", Constant([float(k) for k in gain.flatten()], width=gain.size))
        d.add("y", Product("**", gain.size), a="k", b="u")
        d.output("y", "y")
        return Made(d, [Signal("real", gain.size)])
    if mode not in ("Matrix(K*u)", "Matrix(K*u) (u vector)"):
        raise NotTranslated(f"Multiplication = {mode!r} is not translated")
    if gain.shape[1] != (c.width or 1):
        raise NotTranslated(f"Gain is {gain.shape[0]} by {gain.shape[1]} and the input has {c.width or 1} elements")
    return Made(MatrixGain(gain.tolist()), [Signal("real", None if gain.shape[0] == 1 else gain.shape[0])])


def _signs(c: Asked, default: str, one: str, known: str) -> str:
    said = c.text("Inputs", default).replace("|", "").replace(" ", "")
    if not said.strip(known):
        return said
    return one * int(c.scalar("Inputs", default))


def _sum(c: Asked) -> Made:
    signs = _signs(c, "++", "+", "+-")
    if len(signs) == 1 and c.width is not None:
        c.kind("real")
        if signs == "-":
            raise NotTranslated("a sum of elements with a minus is not translated")
        return Made(SumOfElements(c.width), [Signal()])
    made = whole_sum(c, signs)
    if made is None and len(signs) > 2 and signs[0] == "-" and "+" in signs:
        return formula(c, lambda t, *v: signed_sum(signs, *v))
    return made or same(c, Sum(signs, "real", c.width))


def _product(c: Asked) -> Made:
    vectors = sum(one.width is not None for one in c.inputs)  # with scalars beside it a vector is only scaled
    if c.text("Multiplication", "Element-wise(.*)") != "Element-wise(.*)" and (vectors > 1 or len(c.inputs) == vectors):
        raise NotTranslated("a product of matrices is not translated")
    signs = _signs(c, "2", "*", "*/")
    if (made := whole_product(c, signs)) is not None:
        return made
    if len(signs) == 1:
        if c.width is not None:
            raise NotTranslated("a product of elements is not translated")
        return same(c, Elementary("reciprocal") if signs == "/" else Gain(1.0))
    return same(c, Product(signs, c.width))


def _mux(c: Asked) -> Made:
    kind = c.kind(*KINDS)
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
    kind, width = c.kind(*KINDS), c.inputs[0].width or 1
    outputs = c.value("Outputs", "4")
    sizes = [int(n) for n in outputs.flatten()] if outputs.size > 1 else []
    count = len(sizes) or int(outputs.flat[0])
    if not sizes:
        sizes = [width // count + (k < width % count) for k in range(count)] if count <= width else []
    if sum(sizes) != width or min(sizes, default=0) < 1:
        raise NotTranslated(f"Outputs = {c.text('Outputs', '4')} does not fit an input of {width} elements")
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
    options = c.text("IndexOptions", c.text("IndexOptionArray", "Index vector (dialog)"))
    if c.text("NumberOfDimensions", "1") != "1" or options not in ("Index vector (dialog)", "Select all"):
        return matrix(c, MATRIX_LINES["Selector"])
    kind, width = c.kind(*KINDS), c.inputs[0].width or 1
    base = 0 if c.text("IndexMode", "One-based") == "Zero-based" else 1
    said = c.values.get("Indices", c.values.get("IndexParamArray", c.values.get("Elements", "1")))
    c.values["Indices"] = said.strip("{}") or "1"
    indices = (
        [int(k) - base for k in c.value("Indices", "1").flatten()] if options != "Select all" else list(range(width))
    )
    if min(indices) < 0 or max(indices) >= width:
        raise NotTranslated(f"Indices reach beyond an input of {width} elements")
    if width == 1:
        return Made(ZeroOrderHold(kind), [Signal(kind)])
    return Made(Selector(width, indices, kind), [Signal(kind, None if len(indices) == 1 else len(indices))])


def _switch(c: Asked) -> Made:
    """Compute the criterion of the second input beside the choice between the first and the third."""
    first, control, third = c.inputs
    kinds = {str(first.kind), str(third.kind)}
    whole = len(kinds) == 2 and kinds <= set(INTEGERS) and len({kind[0] for kind in kinds}) == 1
    mixed = whole or kinds == {"real", "bool"}  # the boolean becomes 0 or 1, of whole numbers the wider type is kept
    alike = mixed or replace(first, width=None).like(replace(third, width=None))
    if not alike or isinstance(control.kind, Bus) or (control.width is not None and mixed):
        raise NotTranslated(f"its inputs are {first} and {third}, and the control {control}")
    criterion = c.needs("Criteria", "u2 >= Threshold", "u2 >= Threshold", "u2 > Threshold", "u2 ~= 0")
    operation = {"u2 >= Threshold": ">=", "u2 > Threshold": ">", "u2 ~= 0": "!="}[criterion]
    threshold = 0.0 if criterion == "u2 ~= 0" else c.scalar("Threshold", "0")
    if control.width is not None:  # each element has its own
        exact = "real" if control.kind == "real" else "float64"
        return formula(
            c, lambda t, a, u, b: where(COMPARISONS[operation](convert(u, exact), threshold), a, b), first.number
        )
    c.inputs = [first, third]
    width, kind = c.width, first.kind
    if mixed:
        kind = max(kinds, key=lambda one: BY_NAME[one].high) if whole else "real"
    d = Diagram("switch")
    d.input("u1", first.kind, first.width)
    condition = d.input("u2", control.kind)
    d.input("u3", third.kind, third.width)
    if control.kind == "bool":
        low, high = (COMPARISONS[operation](value, threshold) for value in (0.0, 1.0))
        if low == high:  # whatever the control is
            condition = d.add("condition", Constant(high, "bool"))
    elif control.kind != "real" and not threshold.is_integer():
        raise NotTranslated(f"a comparison of {control} with Threshold = {threshold:g} is not translated")
    else:
        condition = d.add("condition", CompareToConstant(operation, threshold, control.kind), u="u2")
    sources = {}
    for name, one in (("u1", first), ("u3", third)):
        source = name
        if one.kind != kind:
            source = d.add(f"{name}_{kind}", Convert(str(one.kind), kind, width=one.width), u=name)
        sources[name] = expanded(d, source, replace(one, kind=kind), width)
    d.add("y", Switch(kind, width), condition=condition, a=sources["u1"], b=sources["u3"])
    d.output("y", "y")
    return Made(d, [Signal(kind, width)], expand=False)


def _function(block: type[Any], functions: dict[str, str]) -> Rule:
    def made(c: Asked) -> Made:
        c.kind("real")
        name = c.text("Operator", c.text("Function", next(iter(functions))))
        if name not in functions:
            raise NotTranslated(f"Operator = {name!r} is not translated")
        return same(c, block(functions[name], c.width))

    return made


def _math(c: Asked) -> Made:
    """Compute a function of one number, or of two by the language's own functions."""
    name = c.text("Operator", "exp")
    pairs = {"pow": Power, "mod": Remainder, "hypot": Hypot}
    if name not in pairs:
        return _function(Elementary, MATH)(c)
    c.kind("real")
    c.notes.append(f"{name} is the language's own: some units in the last place from the C library's")
    return same(c, pairs[name](width=c.width))


def _trigonometry(c: Asked) -> Made:
    c.kind("real")
    name = c.text("Operator", c.text("Function", "sin"))
    if name == "atan2":
        return same(c, Atan2Block(c.width))
    if name == "sincos":
        c.notes.append("sin and cos are the language's own: within 2.5 units in the last place of the C library's")
        d = Diagram("sincos")
        d.input("u", width=c.width)
        for one in ("sin", "cos"):
            d.output(one, d.add(f"{one}e", Trigonometry(one, c.width), u="u"))
        return Made(d, [Signal("real", c.width)] * 2)
    if name not in ("sin", "cos", "tan", "asin", "acos", "atan", "tanh"):
        raise NotTranslated(f"Operator = {name!r} is not translated")
    c.notes.append(f"{name} is the language's own: within 2.5 units in the last place of the C library's")
    return same(c, Trigonometry(name, c.width))


def _logic(c: Asked) -> Made:
    name = c.text("Operator", c.text("Function", "AND")).lower()
    if name not in ("and", "or", "xor", "nand", "nor", "not"):
        raise NotTranslated(f"Operator = {name!r} is not translated")
    if len(c.inputs) == 1 and c.width is not None and name != "not":  # of the elements of one vector
        return of_elements(c, _logic)
    logic, output = Logic(name, len(c.inputs), c.width), Signal("bool", c.width)
    if all(one.kind == "bool" for one in c.inputs):
        return Made(logic, [output])
    d = Diagram("logic")  # a number is true unless it is 0
    d.add("y", logic)
    for port, one in zip(logic.inputs, c.inputs, strict=True):
        source = d.input(port.name, one.kind, c.width)
        if one.kind != "bool":
            source = d.add(f"{port.name}_true", CompareToConstant("!=", 0, one.kind, c.width), u=source)
        d.connect(source, f"y.{port.name}")
    d.output("y", "y")
    return Made(d, [output])


def _dot(c: Asked) -> Made:
    c.kind("real")
    return Made(DotProduct(c.width), [Signal()]) if c.width else Made(Product("**"), [Signal()])


def _dropped(c: Asked) -> Made:
    return Made(None, [])


_KIND_OF = {"float64": "real", **{name: name for name in ("bool", *INTEGERS)}}


MATH = {**{name: name for name in ("exp", "log", "square", "reciprocal", "sqrt")}, "magnitude^2": "square"}
"""The first one is that of a block that says none."""


DROPPED = ("Terminator", "Scope", "Display", "ToWorkspace", "ToFile", "Stop", *SHOWN)


RULES: dict[str, Rule] = {
    **{name: partial(matrix, line=line) for name, line in MATRIX_LINES.items()},
    **COMPOSITE_RULES,
    **CONDITION_RULES,
    **DYNAMIC_RULES,
    **BUS_RULES,
    **ARITHMETIC_RULES,
    **TOOLBOX_RULES,
    "Concatenate": _mux,
    "Constant": _constant,
    "DeadZone": lambda c: same(c, DeadZone(c.scalar("LowerValue", "-0.5"), c.scalar("UpperValue", "0.5"), c.width)),
    "Demux": _demux,
    "DotProduct": _dot,
    "Gain": _gain,
    "Ground": lambda c: _constant(replace(c, values={"OutDataTypeStr": "double", **c.values, "Value": "0"})),
    "Logic": _logic,
    "Math": _math,
    "Mux": _mux,
    "Product": _product,
    "RateTransition": holds,
    "Rounding": _function(Rounding, {"floor": "floor", "ceil": "ceil", "round": "nearest", "fix": "trunc"}),
    "Selector": _selector,
    "SignalSpecification": passes,
    "Signum": lambda c: same(c, Sign(c.kind("real"), c.width)),
    "Sqrt": _function(Elementary, {"sqrt": "sqrt"}),
    "Sum": _sum,
    "Switch": _switch,
    "Trigonometry": _trigonometry,
    "UnaryMinus": lambda c: whole(c, operator.neg) or same(c, Sum("-", "real", c.width)),
    "ZeroOrderHold": holds,
    **dict.fromkeys(DROPPED, _dropped),
}
"""Rule of each block type, or of a library block by its name."""


TAKES_BUSES = (
    *("BusAssignment", "BusCreator", "BusSelector", "Delay", "ManualSwitch", "Memory", "RateTransition"),
    *("SignalConversion", "SignalSpecification", "Switch", "UnitDelay", "ZeroOrderHold", *DROPPED),
)
TAKES_SMALL = (
    *(*TAKES_BUSES, *ARITHMETIC_RULES, "Demux", "Mux", "Concatenate", "Selector", "Merge", "MultiPortSwitch", "If"),
    *("Assignment", "DiscreteIntegrator", "Gain", "Logic", "Product", "Reshape", "Sum", "SwitchCase", "UnaryMinus"),
)
"""Types that take integers of 8 and 16 bits."""
TAKES_MATRICES = ("BusAssignment", "BusCreator", *MATRIX_LINES, *DROPPED)


def check_inputs(kind: str, inputs: Sequence[Signal]) -> None:
    """Raise NotTranslated if a block of this kind does not take one of the signals."""
    for one in inputs:
        bad = (
            (isinstance(one.kind, Bus) and kind not in TAKES_BUSES)
            or (one.kind in STORED and kind not in TAKES_SMALL)
            or (one.shape is not None and kind not in TAKES_MATRICES)
        )
        if bad:
            raise NotTranslated(f"an input that is {one} is not translated")


INPUTS = {"Switch": 3, **dict.fromkeys(("RelationalOperator", "DotProduct", "Sum", "Product"), 2)}


INPUTS |= {"MultiPortSwitch": 4, "ManualSwitch": 2, "Merge": 2}
INPUTS |= dict.fromkeys(
    ("Clock", "Constant", "DigitalClock", "DiscretePulseGenerator", "Ground", "RandomNumber", "SignalGenerator", "Sin",
     "Step", "UniformRandomNumber", "DataStoreMemory", "DataStoreRead"), 0,
)  # fmt: skip
"""Inputs of a block of which the file does not say how many; of any other type one."""
