"""Common parts of library blocks: evaluation element by element, dot products, clamping, checks of arguments."""

import math
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

from twodof.blocks.block import Block, Clock
from twodof.blocks.declarations import MAX_WIDTH, Param, Port
from twodof.blocks.enumeration import Kind, enumeration_of
from twodof.blocks.expressions.arrays import Matrix, array_of, flat_of, fold, shaped
from twodof.blocks.expressions.expr import Expr, const, int32, maximum, minimum, where
from twodof.blocks.expressions.numbers import NUMERIC, STORED, Vector
from twodof.blocks.namespaces import BusView
from twodof.blocks.trace import MAX_PORTS
from twodof.errors import DiagramError

ORDERED = (*NUMERIC, *STORED)
"""Kinds whose values have an order."""
LETTERS = "abcdefghijklmnopqrstuvwxyz"


def elementwise(f: Callable[..., Any], *values: Any) -> Any:
    """Return `f` of the values: element by element for arrays, field by field for buses."""
    first = values[0]
    if isinstance(first, BusView):
        return {name: elementwise(f, *(v[name] for v in values)) for name in vars(first)}
    if isinstance(first, Matrix):
        return shaped(elementwise(f, *map(flat_of, values)), first.shape)
    width = width_of(first)
    return f(*values) if width is None else array_of(width, lambda i: f(*(v[i] for v in values)))


def width_of(value: Any) -> int | None:
    """Return the number of elements of an array, or None for a number."""
    return value.width if isinstance(value, Expr) else len(value) if isinstance(value, Vector) else None


class OneOutput(Block):
    """Base of blocks whose only output is y."""

    def ports(
        self,
        names: Iterable[str],
        kind: Kind = "real",
        width: int | None = None,
        unit: str = "",
        input_unit: str | None = None,
    ) -> None:
        """Declare the inputs `names` and the output y, of one type, and of one unit unless `input_unit` is given."""
        self.inputs = [Port(name, kind, width, unit if input_unit is None else input_unit) for name in names]
        self.outputs = [Port("y", kind, width, unit)]


class Recurrent(OneOutput):
    """Base of blocks whose output is their next state."""

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return self.output(u, x, p, t)


class Pointwise(OneOutput):
    """Base of blocks with y = of(p, inputs), a function of numbers that is computed element by element for arrays."""

    of: Callable[..., Any]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return elementwise(partial(self.of, p), *(u[port.name] for port in self.inputs))


def dot(length: int, a: Callable[[Any], Any], b: Callable[[Any], Any]) -> Any:
    """Return ((0 + a(0) * b(0)) + a(1) * b(1)) + ... over `length` terms, as a loop."""
    first = a(0)
    zero = const(0.0, first.kind) if isinstance(first, Expr) else 0.0
    return fold(length, [zero], lambda j, total: [total + a(j) * b(j)])[0]


def clamp(low: Any, high: Any, value: Any) -> Any:
    """Return `value` limited to [low, high]; NaN stays NaN."""
    return maximum(low, minimum(high, value))


def search(breakpoints: Any, length: int, value: Any) -> Any:
    """Return the largest int32 i in 0 .. length - 2 with breakpoints[i] <= value, or 0 if there is none.

    Bisection in a loop with a constant bound; the breakpoints increase.
    """

    def halve(_: Any, low: Any, high: Any) -> list[Any]:
        middle = (low + high) // 2
        right = breakpoints[middle] <= value
        return [where(right, middle, low), where(right, high, middle)]

    return fold((length - 1).bit_length(), [int32(0), int32(length - 1)], halve)[0]


def comparable(kind: Any, operation: str) -> Any:
    """Return `kind` if `operation` can compare its values; raise DiagramError otherwise.

    Numbers can be compared by all operations, members of an enumeration by == and != only.
    """
    if enumeration_of(kind) is None:
        return one_of(kind, ORDERED, "kind")
    one_of(operation, ("==", "!="), "operation on an enumeration")
    return kind


def one_of(value: Any, choices: Sequence[str], argument: str) -> str:
    """Return `value` if it is one of `choices`; else raise DiagramError, whose place the block's constructor adds."""
    if value not in choices:
        raise DiagramError(f"{argument}={value!r:.80} is unknown", "", f"use one of {', '.join(choices)}")
    return str(value)


def count(value: Any, low: int, high: int, argument: str) -> int:
    """Return `value` if it is an integer within [low, high]; else raise DiagramError."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise DiagramError(f"{argument}={value!r:.80} is not valid", "", f"give an integer within {low} .. {high}")
    return value


def port_series(number: int) -> list[str]:
    """Return the names of a series of `number` ports: a to z, then u27, u28, ... by their number.

    Raises DiagramError for more ports than a block may have. (Names of two letters would include `as`, `if`, `in`, `is`
    and `or`, which Python does not accept as arguments by keyword.)
    """
    count(number, 1, MAX_PORTS, "number of ports")
    return [*LETTERS[:number], *(f"u{i}" for i in range(len(LETTERS) + 1, number + 1))]


def counts(values: Any, low: int, high: int, argument: str) -> list[int]:
    """Return `values` if it is a list of integers within [low, high]; else raise DiagramError."""
    if not isinstance(values, (list, tuple)):
        what = f"{argument}={values!r:.80} is not a list"
        raise DiagramError(what, "", f"give a list of integers within {low} .. {high}")
    return [count(value, low, high, argument) for value in values]


def sized(name: str, shape: Any, kind: Kind = "real", unit: str = "") -> Port:
    """Return the port of an array with `shape` (n,) or (rows, columns); raise DiagramError for another shape."""
    if not isinstance(shape, (list, tuple)) or len(shape) not in (1, 2):
        raise DiagramError(f"the shape {shape!r:.80} of {name} is not valid", "", "write [n], or [rows, columns]")
    sizes = [count(n, 1, MAX_WIDTH, f"the shape of {name}") for n in shape]
    return Port(name, kind, sizes[0], unit) if len(sizes) == 1 else Port(name, kind, None, unit, (sizes[0], sizes[1]))


def reals(values: Any, argument: str, least: int = 1, finite: bool = True) -> list[float]:
    """Return `values` as a list of at least `least` floats, all finite unless `finite` is false.

    Raises DiagramError for anything else.
    """
    good = isinstance(values, (list, tuple)) and all(
        isinstance(v, (int, float)) and not isinstance(v, bool) for v in values
    )
    if not good or len(values) < least:
        what = f"{argument}={values!r:.80} is not valid"
        raise DiagramError(what, "", f"give a list of {least} or more numbers")
    found = [float(v) for v in values]
    for i, v in enumerate(found):
        if finite and not math.isfinite(v):
            raise DiagramError(f"{argument}[{i}] = {v} is not finite", "", "give finite numbers")
    return found


def matrix(rows: Any, height: int | None, width: int | None, argument: str) -> list[list[float]]:
    """Return `rows` as a list of `height` rows of `width` floats (None: any number); else raise DiagramError."""
    if not isinstance(rows, (list, tuple)) or not rows:
        raise DiagramError(f"{argument}={rows!r:.80} is not a matrix", "", "give a list of rows")
    found = [reals(row, f"{argument}[{i}]") for i, row in enumerate(rows)]
    columns = len(found[0]) if width is None else width
    if any(len(row) != columns for row in found) or len(found) != (len(found) if height is None else height):
        size = " x ".join("any" if n is None else str(n) for n in (height, width))
        what = f"{argument} has rows of {[len(row) for row in found]} elements"
        raise DiagramError(what, "", f"give a matrix of {size}")
    return found


def limit_params(limits: Sequence[float] | None, unit: str) -> list[Param]:
    """Return the parameters low and high of the pair `limits`, low <= high, or [] for None.

    Raises DiagramError for anything else.
    """
    if limits is None:
        return []
    pair = reals(limits, "limits", 2, finite=False)
    if len(pair) != 2 or not pair[0] <= pair[1]:
        raise DiagramError(f"limits={limits!r:.80} is not valid", "", "give [low, high] with low <= high, or None")
    return [Param("low", pair[0], unit=unit), Param("high", pair[1], unit=unit)]
