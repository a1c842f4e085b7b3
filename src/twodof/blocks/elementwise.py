"""Common parts of library blocks: elementwise evaluation, dot products, clamping, checks of arguments."""

import math
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

from twodof.blocks.block import Block, Clock
from twodof.blocks.declarations import MAX_WIDTH, Param, Port
from twodof.blocks.enumeration import Kind, enumeration_of
from twodof.blocks.expressions.arrays import Matrix, array_of, flat_of, fold, shaped
from twodof.blocks.expressions.expr import Expr, int32, maximum, minimum, where
from twodof.blocks.expressions.numbers import NUMERIC, STORED, Vector
from twodof.blocks.namespaces import BusView
from twodof.blocks.trace import MAX_PORTS
from twodof.errors import DiagramError

ORDERED = (*NUMERIC, *STORED)
"""Kinds whose values are smaller and larger."""
LETTERS = "abcdefghijklmnopqrstuvwxyz"


def elementwise(f: Callable[..., Any], *values: Any) -> Any:
    """`f` of the values; of arrays, the array of `f` of the i-th elements, and of buses `f` of each field."""
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
    """Block with the output y alone."""

    def ports(
        self,
        names: Iterable[str],
        kind: Kind = "real",
        width: int | None = None,
        unit: str = "",
        input_unit: str | None = None,
    ) -> None:
        """Declare the inputs and the output y, all of one type and, without an `input_unit`, of one unit."""
        self.inputs = [Port(name, kind, width, unit if input_unit is None else input_unit) for name in names]
        self.outputs = [Port("y", kind, width, unit)]


class Recurrent(OneOutput):
    """Block whose output is its next state."""

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return self.output(u, x, p, t)


class Pointwise(OneOutput):
    """y = of(p, inputs): a function of numbers, element by element where the ports are arrays."""

    of: Callable[..., Any]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return elementwise(partial(self.of, p), *(u[port.name] for port in self.inputs))


def dot(length: int, a: Callable[[Any], Any], b: Callable[[Any], Any]) -> Any:
    """((0 + a(0) * b(0)) + a(1) * b(1)) + ... over `length` terms, as a loop."""
    return fold(length, [0.0], lambda j, total: [total + a(j) * b(j)])[0]


def clamp(low: Any, high: Any, value: Any) -> Any:
    """`value` within [low, high]; NaN stays NaN."""
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
    """`kind` if its values can be compared so: numbers anyhow, members of an enumeration for == and !=; else raise."""
    if enumeration_of(kind) is None:
        return one_of(kind, ORDERED, "kind")
    one_of(operation, ("==", "!="), "operation on an enumeration")
    return kind


def one_of(value: Any, choices: Sequence[str], argument: str) -> str:
    """`value` if it is one of `choices`; else DiagramError, which the block's constructor locates."""
    if value not in choices:
        raise DiagramError(f"{argument}={value!r:.80}", "", f"use one of {', '.join(choices)}")
    return str(value)


def count(value: Any, low: int, high: int, argument: str) -> int:
    """`value` if it is an integer within [low, high]; else DiagramError."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise DiagramError(f"{argument}={value!r:.80}", "", f"give an integer within {low} .. {high}")
    return value


def port_series(number: int) -> list[str]:
    """Return the names of `number` ports of one sort: a to z, then u27, u28, ... by their number.

    Raises DiagramError for more than a block may have. (Two letters would give `as`, `if`, `in`, `is` and `or`. Python
    does not take these as keywords of a call.)
    """
    count(number, 1, MAX_PORTS, "number of ports")
    return [*LETTERS[:number], *(f"u{i}" for i in range(len(LETTERS) + 1, number + 1))]


def counts(values: Any, low: int, high: int, argument: str) -> list[int]:
    """`values` if they are a list of integers within [low, high]; else DiagramError."""
    if not isinstance(values, (list, tuple)):
        raise DiagramError(f"{argument}={values!r:.80}", "", f"give a list of integers within {low} .. {high}")
    return [count(value, low, high, argument) for value in values]


def sized(name: str, shape: Any, kind: Kind = "real", unit: str = "") -> Port:
    """Return the port of an array with `shape` (n,) or (rows, columns); raise DiagramError for another shape."""
    if not isinstance(shape, (list, tuple)) or len(shape) not in (1, 2):
        raise DiagramError(f"the shape {shape!r:.80} of {name}", "", "write [n], or [rows, columns]")
    sizes = [count(n, 1, MAX_WIDTH, f"the shape of {name}") for n in shape]
    return Port(name, kind, sizes[0], unit) if len(sizes) == 1 else Port(name, kind, None, unit, (sizes[0], sizes[1]))


def reals(values: Any, argument: str, least: int = 1, finite: bool = True) -> list[float]:
    """`values` as a list of at least `least` floats, none of them infinite unless `finite` is false.

    Raises DiagramError for anything else.
    """
    good = isinstance(values, (list, tuple)) and all(
        isinstance(v, (int, float)) and not isinstance(v, bool) for v in values
    )
    if not good or len(values) < least:
        raise DiagramError(f"{argument}={values!r:.80}", "", f"give a list of {least} or more numbers")
    found = [float(v) for v in values]
    for i, v in enumerate(found):
        if finite and not math.isfinite(v):
            raise DiagramError(f"{argument}[{i}] = {v} is not finite", "", "give finite numbers")
    return found


def matrix(rows: Any, height: int | None, width: int | None, argument: str) -> list[list[float]]:
    """`rows` as a list of rows of floats, with the height and width asked for (None: any); else DiagramError."""
    if not isinstance(rows, (list, tuple)) or not rows:
        raise DiagramError(f"{argument}={rows!r:.80}", "", "give a list of rows")
    found = [reals(row, f"{argument}[{i}]") for i, row in enumerate(rows)]
    columns = len(found[0]) if width is None else width
    if any(len(row) != columns for row in found) or len(found) != (len(found) if height is None else height):
        size = " x ".join("any" if n is None else str(n) for n in (height, width))
        raise DiagramError(f"{argument} has rows {[len(row) for row in found]}", "", f"its size is {size}")
    return found


def limit_params(limits: Sequence[float] | None, unit: str) -> list[Param]:
    """Return the parameters low and high of the pair `limits`, low <= high; none for None, else DiagramError."""
    if limits is None:
        return []
    pair = reals(limits, "limits", 2, finite=False)
    if len(pair) != 2 or not pair[0] <= pair[1]:
        raise DiagramError(f"limits={limits!r:.80}", "", "give [low, high] with low <= high, or None")
    return [Param("low", pair[0], unit=unit), Param("high", pair[1], unit=unit)]
