"""Simulink's blocks as the library's: a table from type to the library's blocks that compute the same, to the bit.

A function of the table gets a block with its parameters computed and the signals at its inputs, and returns a block or
a small diagram. What it does not cover it refuses by the parameter's name. MathWorks' C computes sums and products from
left to right; a Discrete Derivative keeps the scaled input, and so on: each function follows that order of operations.
"""

import math
import operator
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from twodof.blocks import Diagram
from twodof.blocks.bus import Bus
from twodof.blocks.elementary.functions import floor, log
from twodof.blocks.elementary.functions import pow as power
from twodof.blocks.elementwise import port_series
from twodof.blocks.expressions.expr import convert, sqrt, where
from twodof.blocks.expressions.numbers import KINDS, STORED
from twodof.blocks.library import Atan2 as Atan2Block
from twodof.blocks.library import (
    BusSelect,
    Concatenate,
    Constant,
    DeadZone,
    Demux,
    DotProduct,
    Elementary,
    Gain,
    Hypot,
    Logic,
    MatrixGain,
    Mux,
    Product,
    Reshape,
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
from twodof.slx.composite_blocks import COMPOSITE_RULES, SHOWN, Formula, formula
from twodof.slx.conditions import CONDITION_RULES
from twodof.slx.data_types import BUS_RULES, bus_array, bus_parts, kind_of, signal_of, sized, value_of
from twodof.slx.dynamic_blocks import DYNAMIC_RULES
from twodof.slx.matlab.signals import mod, rem
from twodof.slx.matrices import MATRIX_LINES, makes_matrix, matrix
from twodof.slx.toolbox_blocks import TOOLBOX_RULES
from twodof.slx.translation import (
    TYPES,
    Asked,
    Item,
    Made,
    NotTranslated,
    Rule,
    Signal,
    each,
    expanded,
    holds,
    names_of,
    of_elements,
    passes,
    plain,
    same,
    signs,
    widest,
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
        return Made(Constant(plain(value.flat[0], kind), kind))
    if 1 not in value.shape:
        signal = sized(kind, list(value.shape))
        return Made(Constant(value_of(value, signal), kind, shape=signal.shape), [signal])
    return Made(Constant([plain(v, kind) for v in value.flatten()], kind, value.size))


def _gain(c: Asked) -> Made:
    gain = c.value("Gain", "1")
    mode = c.text("Multiplication", "Element-wise(K.*u)")
    if gain.size == 1 and (made := whole_gain(c, float(gain.flat[0]))) is not None:
        return made
    c.kind("real")
    if gain.size == 1:
        return same(c, Gain(float(gain.flat[0]), c.width))
    if mode.startswith("Element"):
        return each(_gain, "Gain")(c)
    if mode == "Matrix(u*K)":  # a vector is a row where that fits
        if gain.shape[0] == 1:
            return matrix(c, MATRIX_LINES["Gain"])
        gain, mode = gain.T, "Matrix(K*u)"
    if mode not in ("Matrix(K*u)", "Matrix(K*u) (u vector)"):
        raise NotTranslated(f"Multiplication = {mode!r} is not translated")
    if gain.shape[1] != (c.width or 1):
        raise NotTranslated(f"Gain is {gain.shape[0]} by {gain.shape[1]} and the input has {c.width or 1} elements")
    return Made(MatrixGain(gain.tolist()), [Signal("real", None if gain.shape[0] == 1 else gain.shape[0])])


def _sum(c: Asked) -> Made:
    terms = signs(c, "++")
    if len(terms) == 1 and c.width is not None:
        if c.inputs[0].number != "real":
            return of_elements(replace(c, values={**c.values, "Inputs": terms * c.width}), _sum)
        if terms == "-":
            raise NotTranslated("a sum of elements with a minus is not translated")
        return Made(SumOfElements(c.width))
    made = whole_sum(c, terms)
    if made is None and len(terms) > 2 and terms[0] == "-" and "+" in terms:
        return formula(c, lambda t, *v: signed_sum(terms, *v))
    return made or same(c, Sum(terms, "real", c.width))


def _product(c: Asked) -> Made:
    vectors = sum(one.width is not None for one in c.inputs)  # with scalars beside it a vector is only scaled
    if c.text("Multiplication", "Element-wise(.*)") != "Element-wise(.*)" and (vectors > 1 or len(c.inputs) == vectors):
        raise NotTranslated("a product of matrices is not translated")
    terms = signs(c, "**")
    if len(terms) == 1 and c.width is not None:
        if terms == "/":
            raise NotTranslated("a quotient of elements is not translated")
        return of_elements(replace(c, values={**c.values, "Inputs": "*" * c.width}), _product)
    if (made := whole_product(c, terms)) is not None:
        return made
    if len(terms) == 1:
        return same(c, Elementary("reciprocal") if terms == "/" else Gain(1.0))
    return same(c, Product(terms, c.width))


def _mux(c: Asked) -> Made:
    if any(isinstance(one.kind, Bus) for one in c.inputs):
        return bus_array(c)
    kind = c.kind(*KINDS)
    widths = [one.width for one in c.inputs]
    total = Signal(kind, sum(width or 1 for width in widths))
    if len(widths) == 1:
        return Made(ZeroOrderHold(kind, widths[0]), [Signal(kind, widths[0])])
    if None not in widths:
        return Made(Concatenate([width or 1 for width in widths], kind), [total])
    if not any(widths):
        return Made(Mux(len(widths), kind), [total])
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
    return Made(d, [total])


def _demux(c: Asked) -> Made:
    kind, width = c.kind(*KINDS), c.inputs[0].width or 1
    outputs = c.value("Outputs", "4")
    sizes = [int(n) for n in outputs.flatten()] if outputs.size > 1 else []
    count = len(sizes) or int(outputs.flat[0])
    if not sizes or -1 in sizes:  # -1 takes what the others leave
        left, free = width - sum(n for n in sizes if n > 0), [k for k in range(count) if not sizes or sizes[k] == -1]
        share = [left // len(free) + (k < left % len(free)) for k in range(len(free))]
        sizes = [share[free.index(k)] if k in free else sizes[k] for k in range(count)]
    if sum(sizes) != width or min(sizes, default=0) < 1:
        raise NotTranslated(f"Outputs = {c.text('Outputs', '4')} does not fit an input of {width} elements")
    if c.inputs[0].width is None:
        return passes(c)
    if all(size == 1 for size in sizes) and width > 1:
        return Made(Demux(width, kind))
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
    if len(c.inputs) != 3:
        raise NotTranslated(f"it has {len(c.inputs)} inputs; a Switch has 3")
    first, control, third = c.inputs
    if isinstance(control.kind, Bus):
        raise NotTranslated(f"its control is {control}")
    compare = c.pick("Criteria", "u2 >= Threshold", {"u2 >= Threshold": ">=", "u2 > Threshold": ">", "u2 ~= 0": "!="})
    threshold = 0.0 if compare == "!=" else c.scalar("Threshold", "0")
    if control.kind not in ("real", "bool") and not threshold.is_integer():
        threshold = math.floor(threshold + 0.5)
        c.notes.append(f"Threshold is rounded to {threshold}, as the control is {control}")
    kind, exact = widest([first, third]), "real" if control.kind == "real" else "float64"

    def holds(t: Any, u: Any) -> Any:
        return COMPARISONS[compare](convert(u, exact), float(threshold))

    if control.width is not None:  # each element has its own
        number = Signal(kind).number
        return formula(c, lambda t, a, u, b: where(holds(t, u), convert(a, number), convert(b, number)), number)
    c.inputs = [first, third]
    d, width = Diagram("switch"), c.width
    for name, one in (("u1", first), ("u2", control), ("u3", third)):
        d.input(name, one.kind, one.width)
    d.add("condition", Formula(holds, [control], Signal("bool")), u1="u2")
    chosen = {port: expanded(d, name, one, width, kind) for port, name, one in (("a", "u1", first), ("b", "u3", third))}
    d.output("y", d.add("y", Switch(kind, width), inputs={"condition": "condition", **chosen}))
    return Made(d, [Signal(kind, width)])


def _function(c: Asked) -> Made:
    """Compute a function of one number or of two; those of angles and powers by the language's own definitions."""
    functions = FUNCTIONS[c.block.type]
    name = c.text("Operator", c.text("Function", next(iter(functions))))
    if name in ("transpose", "hermitian"):
        return matrix(c, MATRIX_LINES["Math"])
    c.kind("real")
    if name not in functions:
        raise NotTranslated(f"Operator = {name!r} is not translated")
    if c.block.type == "Trigonometry" or name in ("pow", "hypot", "log10"):
        c.notes.append(f"{name} is the language's own: within 2.5 units in the last place of the C library's")
    if name != "sincos":
        return same(c, functions[name](width=c.width))
    d = Diagram("sincos")
    d.input("u", width=c.width)
    for one in ("sin", "cos"):
        d.output(one, d.add(f"{one}e", functions[one](width=c.width), u="u"))
    return Made(d, [Signal("real", c.width)] * 2)


def _formula(of: Callable[..., Any], width: int | None, count: int = 1) -> Item:
    return Formula(of, [Signal("real", width)] * count, Signal("real", width))


def _signed_root(t: Any, u: Any) -> Any:
    """Return the root of the size with the number's sign."""
    return where(u < 0.0, -sqrt(abs(u)), sqrt(abs(u)))


def _signed_power(t: Any, u: Any, v: Any) -> Any:
    """Return a power; that of a negative number with a fraction is the size's with a minus, as MathWorks' C has it."""
    turned = (u < 0.0) & (v > floor(v))
    found = power(where(turned, -u, u), v)
    return where(turned, -found, found)


_ANGLES = ("sin", "cos", "tan", "asin", "acos", "atan", "tanh")
_ELEMENTARY = {name: partial(Elementary, name) for name in ("exp", "log", "square", "reciprocal", "sqrt")}
_ROUNDED = {"floor": "floor", "ceil": "ceil", "round": "nearest", "fix": "trunc"}
FUNCTIONS: dict[str, dict[str, Callable[..., Item]]] = {
    "Math": {
        **_ELEMENTARY,
        "sqrt": partial(_formula, _signed_root),
        "magnitude^2": _ELEMENTARY["square"],
        "pow": partial(_formula, _signed_power, count=2),
        "mod": partial(_formula, lambda t, u, v: mod(u, v), count=2),
        "hypot": Hypot,
        "log10": partial(_formula, lambda t, u: log(u) / math.log(10.0)),
        "rem": partial(_formula, lambda t, u, v: rem(u, v), count=2),
    },
    "Rounding": {name: partial(Rounding, mode) for name, mode in _ROUNDED.items()},
    "Sqrt": {
        "sqrt": _ELEMENTARY["sqrt"],
        "signedSqrt": partial(_formula, _signed_root),
        "rSqrt": partial(_formula, lambda t, u: 1.0 / sqrt(u)),
    },
    "Trigonometry": {
        **{one: partial(Trigonometry, one) for one in _ANGLES},
        "atan2": Atan2Block,
        "sincos": Trigonometry,
    },
}
"""Functions of the blocks that have a choice of them; the first one is that of a block that says none."""


def _logic(c: Asked) -> Made:
    name = c.text("Operator", c.text("Function", "AND")).lower()
    if name not in ("and", "or", "xor", "nand", "nor", "not"):
        raise NotTranslated(f"Operator = {name!r} is not translated")
    if len(c.inputs) == 1 and c.width is not None and name != "not":  # of the elements of one vector
        return of_elements(c, _logic)
    logic, flags = Logic(name, len(c.inputs), c.width), [one.kind == "bool" for one in c.inputs]
    said = c.text("OutDataTypeStr", "boolean")
    kind = "bool" if said.startswith("Inherit") else str(kind_of(said, c.names)).replace("float32", "real")
    if all(flags) and kind == "bool":
        return Made(logic)
    # a number is true unless it is 0

    def of(t: Any, *u: Any) -> Any:
        return convert(logic.of(None, *(one if flag else one != 0 for one, flag in zip(u, flags, strict=True))), kind)

    return formula(c, of, kind)


_KIND_OF = TYPES | {"float64": "real", "bool": "bool"}


DROPPED = ("Terminator", "Scope", "Display", "ToWorkspace", "ToFile", "Stop", "DataTypeDuplicate", *SHOWN)


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
    "Enumerated Constant": _constant,
    "DotProduct": lambda c: Made(DotProduct(c.width) if c.kind("real") and c.width else Product("**")),
    "Gain": _gain,
    "Ground": lambda c: _constant(replace(c, values={"OutDataTypeStr": "double", **c.values, "Value": "0"})),
    "Logic": _logic,
    "Mux": _mux,
    "Product": _product,
    "RateTransition": holds,
    **dict.fromkeys(FUNCTIONS, _function),
    "Selector": _selector,
    **dict.fromkeys(("BusToVector", "SignalSpecification"), passes),
    "Signum": lambda c: same(c, Sign(c.kind("real"), c.width)),
    "Sum": _sum,
    "Switch": _switch,
    "Width": lambda c: Made(Constant(float(c.inputs[0].width or 1))),
    "UnaryMinus": lambda c: whole(c, operator.neg) or same(c, Sum("-", "real", c.width)),
    "ZeroOrderHold": holds,
    **dict.fromkeys(DROPPED, lambda c: Made(None, [])),
}
"""Rule of each block type, or of a library block by its name."""


TAKES_BUSES = (
    *("BusAssignment", "BusCreator", "BusSelector", "Concatenate", "Delay", "Memory", "RateTransition"),
    *("SignalConversion", "SignalSpecification", "Switch", "UnitDelay", "ZeroOrderHold", *DROPPED),
)
TAKES_SMALL = (
    *(*TAKES_BUSES, *ARITHMETIC_RULES, *(name for name in RULES if name.startswith("Detect ")), "Assignment", "Demux"),
    *("DiscreteIntegrator", "Gain", "If", "Interval Test", "Logic", "Lookup_n-D", "LookupNDDirect", "Merge", "Mux"),
    *("MultiPortSwitch", "Product", "Relay", "Reshape", "Selector", "Sum", "SwitchCase", "UnaryMinus"),
)
"""Types that take integers of 8 and 16 bits."""
_BY_ELEMENTS = ("DiscreteIntegrator", "Integrator", "DataTypeConversion", "MultiPortSwitch", "RelationalOperator",
                "Rounding", "Signum", "Sqrt", "Switch", "Trigonometry")  # fmt: skip
"""Types that take matrices element by element, and have no parameter of an element's own."""
_TAKES_ROWS = ("Math", "Reshape", "Selector", *DROPPED)
TAKES_MATRICES = ("BusAssignment", "BusCreator", *_BY_ELEMENTS, *MATRIX_LINES, *DROPPED)


def carried_out(c: Asked, rule: Rule) -> Made:
    """Return the block of a rule, or of the line of MATLAB for its matrices, or of the vectors that its buses are.

    Raises NotTranslated if the block does not take one of the signals.
    """
    kind, matrices = c.block.kind, [one.shape for one in c.inputs if one.shape is not None]
    rows = bool(matrices) and all(one[0] == 1 for one in matrices)
    if kind in ("Sum", "Product") and len(c.inputs) == 1 and c.text("CollapseMode")[:9] == "Specified":
        if c.text("CollapseDim", "1") != ("2" if rows else "1"):
            raise NotTranslated("CollapseMode = Specified dimension is translated along the vector only")
    if odd := [one for one in c.inputs if one.kind in STORED and kind in RULES and kind not in TAKES_SMALL]:
        raise NotTranslated(f"an input that is {odd[0]} is not translated")
    if kind in RULES and kind not in _TAKES_ROWS and rows:
        if c.text("Multiplication")[:6] != "Matrix" and c.text("Mode")[:5] != "Multi":
            return _of_columns(c, rule)
    for one in c.inputs if kind in RULES else ():
        if one.shape is not None and kind not in TAKES_MATRICES:
            raise NotTranslated(f"an input that is {one} is not translated")
    if kind in RULES and kind not in TAKES_BUSES and any(isinstance(one.kind, Bus) for one in c.inputs):
        return _of_vectors(c, rule)
    if kind in _BY_ELEMENTS and matrices:
        return _of_columns(c, rule)
    return matrix(c, MATRIX_LINES[kind]) if makes_matrix(c) else rule(c)


def _of_columns(c: Asked, rule: Rule) -> Made:
    """Return the block of a rule for matrices of one size and scalars: the columns, one after another, are a vector.

    A row beside another size, or whose block does not go by elements, is a vector.
    """
    shape = next(one.shape for one in c.inputs if one.shape is not None)
    alike = all(one.shape == shape or one.width is None for one in c.inputs)
    if not alike and shape[0] > 1:
        raise NotTranslated("a matrix beside another size is not translated")
    d, sources = Diagram("of_columns"), list[str]()
    for k, one in enumerate(c.inputs, start=1):
        sources.append(d.input(f"u{k}", one.kind, one.width if one.shape is None else None, shape=one.shape))
        if one.shape is not None:
            sources[-1] = d.add(f"vector{k}", Reshape(one.shape, [one.width or 1], one.number), u=f"u{k}")
    made = rule(replace(c, inputs=[replace(one, shape=None) for one in c.inputs]))
    if made.item is None:
        return Made(None, [replace(one, shape=shape) for one in made.outputs])
    if len(made.outputs) > 1 and shape[0] > 1:
        raise NotTranslated("a second output of a matrix is not translated")
    ports = list(made.item.inputs.values()) if isinstance(made.item, Diagram) else made.item.inputs
    for k, (port, one) in enumerate(zip(ports, c.inputs, strict=True)):
        sources[k] = expanded(d, sources[k], one, port.width) if one.width is None else sources[k]
    d.add("of", made.item, inputs=dict(zip(names_of(made.item), sources, strict=True)))
    names, width = names_of(made.item, outputs=True), shape[0] * shape[1]
    if not alike or c.block.kind not in (*_BY_ELEMENTS, *MATRIX_LINES) or made.outputs[0].width != width:
        for name in names:
            d.output(name, f"of.{name}")
        return Made(d, made.outputs)
    back = Reshape([width], shape, made.outputs[0].number)
    d.output("y", d.add("y", back, u=f"of.{names[0]}"))
    return Made(d, [replace(made.outputs[0], shape=shape)])


def _of_vectors(c: Asked, rule: Rule) -> Made:
    """Return the block of a rule that takes no buses: one whose elements are of one type is the vector of them."""
    if c.block.type == "Demux" and c.inputs[0].width is not None:
        return bus_parts(c)
    d, inputs, sources = Diagram("of_buses"), list[Signal](), list[str]()
    for k, one in enumerate(c.inputs, start=1):
        sources.append(d.input(f"u{k}", one.kind, one.width))
        inputs.append(one)
        if isinstance(one.kind, Bus):
            if len({leaf.kind for leaf in one.kind.leaves}) > 1 or one.width is not None:
                raise NotTranslated(f"an input that is {one} is not translated")
            leaves = [signal_of(leaf) for leaf in one.kind.leaves]
            joined = _mux(replace(c, inputs=leaves))
            assert isinstance(joined.item, Item)
            fields = d.add(f"fields{k}", BusSelect(one.kind, [leaf.name for leaf in one.kind.leaves]), bus=sources[-1])
            named = [f"{fields}.{leaf.name.replace('.', '_')}" for leaf in one.kind.leaves]
            sources[-1] = d.add(f"vector{k}", joined.item, inputs=dict(zip(names_of(joined.item), named, strict=True)))
            inputs[-1] = joined.outputs[0]
    made = rule(replace(c, inputs=list(inputs)))
    if made.item is None:
        return made
    c.notes.append("a bus is taken for the vector of its elements")
    d.add("of", made.item, inputs=dict(zip(names_of(made.item), sources, strict=True)))
    for k, name in enumerate(names_of(made.item, outputs=True), start=1):
        d.output(f"y{k}", f"of.{name}")
    return Made(d, made.outputs)


_SOURCES = (
    "Band-Limited White Noise", "Clock", "Constant", "Counter Free-Running", "Counter Limited", "DataStoreMemory",
    "DataStoreRead", "DigitalClock", "DiscretePulseGenerator", "Function-Call Generator", "Ground", "Ramp", "Sin",
    "Random Source", "RandomNumber", "Repeating Sequence", "Repeating Sequence Stair", "SignalGenerator", "Step",
    "UniformRandomNumber")  # fmt: skip
_TWO = ("DotProduct", "Merge", "PID Controller (2DOF)", "Product", "RelationalOperator", "Sum")
INPUTS = {"MultiPortSwitch": 4, "Switch": 3, **dict.fromkeys(_TWO, 2), **dict.fromkeys(_SOURCES, 0)}
"""Inputs of a block of which the file does not say how many; of any other type one."""
