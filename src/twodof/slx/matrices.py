"""Matrix operations of Simulink: each is a line of MATLAB on the inputs u1, u2, ..., carried out on signals.

A vector of Simulink is a column here. Products are summed from left to right, as MathWorks' C does it.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from twodof.blocks.bus import Bus
from twodof.blocks.expressions.numbers import KINDS
from twodof.slx.data_types import SINGLE
from twodof.slx.matlab.function_block import MatlabFunction
from twodof.slx.matlab.values import Value
from twodof.slx.translation import Asked, Made, NotTranslated, signs

_BETWEEN = re.compile(r",(?![^\[(]*[\])])")
"""A comma between expressions, outside brackets."""
MOST_PLACES = 10_000
"""Most pairs of an element and a place that a signal says."""
_ACROSS = ("Concatenate", "Gain", "Math", "Product")
"""Blocks whose rows stay rows, which the next product of matrices reads; to most other blocks they are vectors."""
Line = Callable[[Asked], tuple[str, dict[str, Value]]]
"""What a block is in MATLAB: statements that give y, and values that they use by name."""


def matrix(c: Asked, line: Line) -> Made:
    """Return the block of a line of MATLAB."""
    if any(isinstance(one.kind, Bus) for one in c.inputs):
        raise NotTranslated("a matrix of buses is not translated")
    if {"real", "float32"} <= {one.kind for one in c.inputs}:
        raise NotTranslated("a matrix of single beside double is not translated")
    c.inputs = [replace(one, kind="real") if one.kind == "float32" else one for one in c.inputs]
    text, values = line(c)
    names = [f"u{k}" for k in range(1, len(c.inputs) + 1)]
    code = f"function y = f({', '.join([*names, *values])})\n{text}"
    item = MatlabFunction(code, c.inputs, values, names)
    if item.rows and c.block.type in _ACROSS and SINGLE not in c.names:
        item.outputs = [replace(one, shape=(1, one.width or 1)) for one in item.outputs]
    return Made(item)


def _sum(c: Asked) -> tuple[str, dict[str, Value]]:
    c.kind("real")
    terms = [(sign, f"u{k}") for k, sign in enumerate(signs(c, "++"), start=1)]
    if len(terms) == 1:
        raise NotTranslated("a sum of the elements of a matrix is not translated")
    first = next((term for term in terms if term[0] == "+"), terms[0])  # where MathWorks' C begins
    return f"y = {''.join(''.join(term) for term in [first, *(one for one in terms if one != first)])};", {}


def _product(c: Asked) -> tuple[str, dict[str, Value]]:
    c.kind("real")
    whole = c.text("Multiplication", "Element-wise(.*)") == "Matrix(*)"
    terms = [(sign, f"u{k}") for k, sign in enumerate(signs(c, "**"), start=1)]
    if len(terms) == 1 or terms[0][0] == "/" or (whole and any(sign == "/" for sign, _ in terms)):
        raise NotTranslated("a product of the elements or an inverse of a matrix is not translated")
    dot = "" if whole else "."
    return f"y = u1{''.join(f'{dot}{sign}{name}' for sign, name in terms[1:])};", {}


def _gain(c: Asked) -> tuple[str, dict[str, Value]]:
    c.kind("real")
    texts = {"Element-wise(K.*u)": "K.*u1", "Matrix(u*K)": "u1*K"}
    texts |= dict.fromkeys(("Matrix(K*u)", "Matrix(K*u) (u vector)"), "K*u1")
    return f"y = {c.pick('Multiplication', 'Element-wise(K.*u)', texts)};", {"K": c.value("Gain", "1").astype(float)}


def _math(c: Asked) -> tuple[str, dict[str, Value]]:
    c.needs("Operator", "exp", "transpose", "hermitian")
    return "y = u1';", {}


def _reshape(c: Asked) -> tuple[str, dict[str, Value]]:
    kind = c.needs("OutputDimensionality", "1-D array", "1-D array", "Column vector (2-D)", "Customize")
    if kind != "Customize":
        return "y = u1(:);", {}
    return "y = reshape(u1, S);", {"S": c.value("OutputDimensions", "[1,1]").astype(float)}


def _concatenate(c: Asked) -> tuple[str, dict[str, Value]]:
    c.kind(*KINDS)
    names = [f"u{k}" for k in range(1, len(c.inputs) + 1)]
    if c.text("Mode", "Vector") == "Vector":
        if any(one.shape for one in c.inputs):
            raise NotTranslated("a matrix is joined with a vector")
        return f"y = [{'; '.join(names)}];", {}
    between = {1.0: "; ", 2.0: ", "}.get(c.scalar("ConcatenateDimension", "1"))
    if between is None:
        raise NotTranslated("ConcatenateDimension is neither 1 nor 2")
    return f"y = [{between.join(names)}];", {}


def _selector(c: Asked, result: str = "y = u1({});", port: int = 2) -> tuple[str, dict[str, Value]]:
    """Take elements out; the first input with indices has the number `port`."""
    options = c.text("IndexOptions", c.text("IndexOptionArray", "Index vector (dialog)")).split(",")
    count = int(c.scalar("NumberOfDimensions", "1"))
    given = c.values.get("Indices", c.values.get("IndexParamArray", c.values.get("Elements", "1")))
    texts = (given, c.values.get("OutputSizes", c.values.get("OutputSizeArray", "1")))
    listed = [_BETWEEN.split(one.strip("{} ")) if count > 1 else [one.strip("{} ")] for one in texts]
    parts, sizes = ([*one, *["1"] * count][:count] for one in listed)
    shift = 1.0 if c.text("IndexMode", "One-based") == "Zero-based" else 0.0
    values, indices = dict[str, Value](), list[str]()
    if len(options) != count:
        raise NotTranslated(f"IndexOptions = {','.join(options)!r} of {count} dimensions is not translated")
    for k, option in enumerate(options, start=1):
        form, _, source = option.strip().rpartition(" (")
        name, span = f"I{k}", np.full((1, 1), shift)
        if form == "Starting index":
            c.values[f"Sizes{k}"] = sizes[k - 1]
            span = span + np.arange(c.scalar(f"Sizes{k}", "1"))
        if option == "Select all":
            indices.append(":")
        elif form not in ("Index vector", "Starting index") or (source == "port)" and port > len(c.inputs)):
            raise NotTranslated(f"IndexOptions = {option!r} is not translated")
        elif source == "dialog)":
            c.values[f"Indices{k}"] = parts[k - 1] or "1"
            values[name] = c.value(f"Indices{k}", "1").astype(float) + span
            indices.append(name)
        else:
            if (size := (c.inputs[0].width or 1)) * max(one.width or 1 for one in c.inputs[1:]) > MOST_PLACES:
                raise NotTranslated(f"IndexOptions = {option!r} of {size} elements is not translated")
            values[name] = span
            indices.append(f"double(u{port}) + {name}")
            port += 1
    return result.format(", ".join(indices)), values


def _assignment(c: Asked) -> tuple[str, dict[str, Value]]:
    return _selector(c, "y = u1;\ny({}) = u2;", 3)


def _delay(c: Asked) -> tuple[str, dict[str, Value]]:
    start = c.value("InitialCondition" if "InitialCondition" in c.values else "X0", "0").astype(float)
    return "persistent x\nif isempty(x)\n x = zeros(size(u1)) + X;\nend\ny = x;\nx = u1;", {"X": start}


def _fixed(text: str, c: Asked) -> tuple[str, dict[str, Value]]:
    return f"y = {text};", {}


_VALUES = {
    "3x3 Cross Product": "cross(u1, u2)",
    "Abs": "abs(u1)",
    "Create 3x3 Matrix": "[u1, u2, u3; u4, u5, u6; u7, u8, u9]",
    "Create Diagonal Matrix": "diag(u1)",
    "Determinant of 3x3 Matrix": "det(u1)",
    "Invert 3x3 Matrix": "inv(u1)",
    "Quaternion Conjugate": "quatconj(u1')'",
    "Quaternion Inverse": "quatinv(u1')'",
    "Quaternion Multiplication": "quatmultiply(u1', u2')'",
    "Quaternion Normalize": "quatnormalize(u1')'",
    "Quaternion Rotation": "quatrotate(u1', u2')'",
    "Rod2Quat": "[1; u1] / sqrt(1 + sum(u1 .^ 2))",
    "UnaryMinus": "-u1",
    **dict.fromkeys(("SignalConversion", "SignalSpecification", "ZeroOrderHold"), "u1"),
}
"""What blocks without a dialog are. A quaternion of Aerospace Blockset is [w, x, y, z]."""
MATRIX_LINES: Mapping[str, Line] = {
    **{name: partial(_fixed, text) for name, text in _VALUES.items()},
    "Assignment": _assignment,
    "Concatenate": _concatenate,
    "Gain": _gain,
    "Math": _math,
    "Memory": _delay,
    "Product": _product,
    "Reshape": _reshape,
    "Selector": _selector,
    "Sum": _sum,
    "UnitDelay": _delay,
}
"""Blocks that take matrices, or make them."""


def makes_matrix(c: Asked) -> bool:
    """Return True for a block that is a line of MATLAB: a matrix comes in, or may go out."""
    kind = c.block.kind
    if kind not in MATRIX_LINES:
        return False
    joined = kind == "Concatenate" and c.text("Mode", "Vector") == "Multidimensional array"
    return kind in ("Assignment", "Reshape") or joined or any(one.shape is not None for one in c.inputs)
