"""Arrays of fixed length, and the loops over them that stay loops when they are recorded."""

from collections.abc import Callable, Sequence
from contextvars import ContextVar
from typing import Any

import numpy as np

from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.expr import (
    Expr,
    as_expr,
    computed_in,
    during,
    fault,
    node,
    of_one_kind,
    position,
    recording,
    scalars,
    traced,
)
from twodof.blocks.expressions.numbers import Int32, Vector

LOOPS: ContextVar[tuple[int, ...]] = ContextVar("loops", default=())
"""The lengths of the loops that enclose what is being recorded, the outermost first."""


def vector(elements: Sequence[Any]) -> Any:
    """Return an array of the given scalars, all of one type."""
    if isinstance(elements, np.ndarray):
        elements = elements.tolist()
    if not elements:
        raise fault("an array of no elements", "an array has at least one element")
    elements = of_one_kind(elements)
    anchor = next((v for v in elements if isinstance(v, Expr)), None)
    kind = anchor.kind if anchor is not None else numbers.common_kind(elements)
    if not traced(*elements):
        return Vector(numbers.cast(v, kind) for v in elements)
    items = tuple(as_expr(e, kind) for e in elements)
    scalars("vector", *items)
    return node("vector", kind, items, None, len(items))


def store(array: Any, index: Any, value: Any) -> Any:
    """`array` with the element at the (clamped) index replaced; compiled to a write in place where it can be."""
    if traced(array, index, value):
        base = array if isinstance(array, Expr) else vector(list(array))
        if base.width is None:
            raise fault("store into a scalar", "only arrays have elements")
        item = as_expr(value, base.kind)
        scalars("store", item)
        return node("store", base.kind, (base, position(index, base.width), item), None, base.width)
    items = list(array)
    items[numbers.clamp_index(index, len(items))] = numbers.cast(value, numbers.kind_of(items[0]))
    return Vector(items)


def array_of(length: int, element: Callable[[Any], Any]) -> Any:
    """Return the array of `element(i)` for the int32 i = 0 .. length - 1; stays a loop when compiled.

    Where the elements are arrays themselves, it is all of them, one after the other.
    """
    if length < 1:
        raise fault("an array of no elements", "an array has at least one element")
    if not recording():
        made = [element(Int32(i)) for i in range(length)]
        return vector([v for one in made for v in (one if isinstance(one, (list, tuple)) else (one,))])
    depth = len(LOOPS.get())
    with during(LOOPS, (*LOOPS.get(), length)):
        made = element(node("bound", "int32", (), (depth, 0)))
        body = vector(made) if isinstance(made, (list, tuple)) else as_expr(made)
    return node("build", body.kind, (body,), (length, depth), length * (body.width or 1))


def fold(length: int, initial: Sequence[Any], step: Callable[..., Sequence[Any]]) -> tuple[Any, ...]:
    """Repeat `values = step(i, *values)` for the int32 i = 0 .. length - 1 from `initial`; stays a loop when compiled.

    The values are scalars; `step` returns as many as it takes, of the same types. An integer of 8 or 16 bits is carried
    as int32. Returns the last values.
    """
    initial = [computed_in(v) for v in initial]
    if not recording():
        kinds = [numbers.kind_of(v) for v in initial]
        values = tuple(numbers.cast(v, k) for v, k in zip(initial, kinds, strict=True))
        for i in range(length):
            values = tuple(numbers.cast(v, k) for v, k in zip(step(Int32(i), *values), kinds, strict=True))
        return values
    starts = tuple(as_expr(v) for v in initial)
    scalars("fold", *starts)
    depth = len(LOOPS.get())
    index = node("bound", "int32", (), (depth, 0))
    carried = [node("bound", s.kind, (), (depth, j + 1)) for j, s in enumerate(starts)]
    with during(LOOPS, (*LOOPS.get(), length)):
        results = tuple(step(index, *carried))
    if len(results) != len(starts):
        raise fault(
            f"the body of fold returns {len(results)} values and takes {len(starts)}",
            "return one value for each initial value",
        )
    bodies = tuple(as_expr(r, s.kind) for r, s in zip(results, starts, strict=True))
    scalars("fold", *bodies)
    # One node an output; all share (starts, bodies), so a compiler can emit them as one loop.
    return tuple(node("fold", s.kind, starts + bodies, (length, depth, j)) for j, s in enumerate(starts))
