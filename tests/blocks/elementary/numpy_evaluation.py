"""Evaluates a traced graph on numpy arrays, so that a definition can be tried on millions of arguments.

numpy's elementwise arithmetic rounds as the language does; that the values are those of the reference to the bit is a
test of its own. Only what the elementary functions and the noise are made of is known here.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.elementary.functions import ARGUMENTS, DEFINITIONS
from twodof.blocks.expressions.expr import Expr, leaf, tracing
from twodof.blocks.expressions.graph import walk

REALS = {"float64": np.float64, "float32": np.float32}
_TYPES = {"int32": np.int32, "uint32": np.uint32, "bool": np.bool_}
_WORDS = {"float64": np.uint64, "float32": np.uint32}
_PLAIN: dict[str, Callable[..., Any]] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "shl": np.left_shift,
    "shr": np.right_shift,
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "xor": np.bitwise_xor,
    "not": np.invert,
    "lt": np.less,
    "le": np.less_equal,
    "eq": np.equal,
    "ne": np.not_equal,
    "neg": np.negative,
    "abs": np.abs,
    "sqrt": np.sqrt,
    "where": np.where,
}


def traced(name: str, precision: str) -> tuple[Expr, list[str]]:
    """The graph of the elementary function `name` and the names of its arguments."""
    names = [f"x{i}" for i in range(ARGUMENTS[name])]
    with tracing(name):
        return DEFINITIONS[name][precision](*(leaf("input", n, "real") for n in names)), names


def function(name: str, precision: str) -> Callable[..., NDArray[Any]]:
    """The elementary function `name` on arrays of the precision's reals."""
    root, names = traced(name, precision)

    def run(*arrays: NDArray[Any]) -> NDArray[Any]:
        return evaluate([root], dict(zip(names, arrays, strict=True)), precision)[0]

    return run


def evaluate(
    roots: Sequence[Expr], inputs: Mapping[str, NDArray[Any]], precision: str, chunk: int = 1 << 14
) -> list[NDArray[Any]]:
    """The values of `roots` where the leaves are `inputs`: arrays of one length, real or uint32."""
    order = walk(roots)
    length = len(next(iter(inputs.values())))
    parts = [
        _evaluate(order, roots, {k: v[i : i + chunk] for k, v in inputs.items()}, precision)
        for i in range(0, length, chunk)
    ]
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


def _evaluate(
    order: Sequence[Expr], roots: Sequence[Expr], inputs: Mapping[str, NDArray[Any]], precision: str
) -> list[NDArray[Any]]:
    length = len(next(iter(inputs.values())))
    values: dict[Expr, Any] = {}
    with np.errstate(all="ignore"):
        for item in order:
            result = _compute(item, [values[a] for a in item.args], inputs, precision)
            expected = REALS[precision] if item.kind == "real" else _TYPES[item.kind]
            assert result.dtype == expected, f"{item} gave {result.dtype}"
            values[item] = result
    return [np.broadcast_to(values[r], (length,)) for r in roots]


def _compute(item: Expr, args: list[Any], inputs: Mapping[str, NDArray[Any]], precision: str) -> Any:
    op = item.op
    if op in _PLAIN:
        return _PLAIN[op](*args)
    if op == "const":
        return (REALS[precision] if item.kind == "real" else _TYPES[item.kind])(item.data)
    if op == "bits":
        canonical = np.where(args[0] != args[0], REALS[precision](np.nan), args[0])
        words = np.atleast_1d(canonical).view(_WORDS[precision])
        return (words >> (32 * item.data)).astype(np.uint32)
    if op == "from_bits":
        if len(args) == 1:
            return np.atleast_1d(args[0]).view(np.float32)
        words = args[0].astype(np.uint64) | np.atleast_1d(args[1]).astype(np.uint64) << np.uint64(32)
        return words.view(np.float64)
    if op == "mulhi":
        return (args[0].astype(np.uint64) * args[1].astype(np.uint64) >> np.uint64(32)).astype(np.uint32)
    if op == "convert" and item.args[0].kind != "real":
        return args[0].astype(REALS[precision] if item.kind == "real" else _TYPES[item.kind])
    if op == "call":
        return function(item.data, precision)(*args)
    if op in ("input", "param"):
        return inputs[item.data]
    raise NotImplementedError(f"{item} has no array form")
