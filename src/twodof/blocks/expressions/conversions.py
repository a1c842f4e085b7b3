"""Conversions by name to the kinds of fixed size; `expr` has those to real, int32 and uint32.

A float becomes an integer by truncation: round it first, with `floor`, `ceil`, `round_half_even` or `round_half_away`.
NaN gives 0 and an infinity the end of int32's range, on every target; then the rule for overflow applies.
"""

from typing import Any

from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.expr import (
    Expr,
    arrays_among,
    as_expr,
    computed_in,
    convert,
    fault,
    maximum,
    minimum,
    recording,
    to_int32,
)
from twodof.blocks.expressions.numbers import BY_NAME, FLOATS, STORED, rules

OVERFLOW = ("wrap", "saturate")


def to_float32(x: Any) -> Any:
    """To float32, rounded to nearest; a float32 is returned as it is; bool gives 0 or 1. `to_float32(0.1)` is one."""
    return _to_float(x, "float32")


def to_float64(x: Any) -> Any:
    """To float64, rounded to nearest; a float64 is returned as it is; bool gives 0 or 1. `to_float64(0.1)` is one."""
    return _to_float(x, "float64")


def to_int8(x: Any, overflow: str | None = None) -> Any:
    """To int8. What does not fit has its low 8 bits kept (`overflow="wrap"`), or is -128 or 127 (`"saturate"`).

    `overflow` may be left out where all values fit: of bools, literals that do, narrower kinds. Else DiagramError. A
    float is truncated to an int32 first.
    """
    return to_stored(x, "int8", overflow)


def to_uint8(x: Any, overflow: str | None = None) -> Any:
    """To uint8: see `to_int8`; the ends of its range are 0 and 255."""
    return to_stored(x, "uint8", overflow)


def to_int16(x: Any, overflow: str | None = None) -> Any:
    """To int16: see `to_int8`; the ends of its range are -32768 and 32767."""
    return to_stored(x, "int16", overflow)


def to_uint16(x: Any, overflow: str | None = None) -> Any:
    """To uint16: see `to_int8`; the ends of its range are 0 and 65535."""
    return to_stored(x, "uint16", overflow)


def _to_float(x: Any, kind: str) -> Any:
    if arrays_among(x):
        return rules.spread(lambda item: _to_float(item, kind), x)
    if type(x) in (int, float):
        return as_expr(x, kind) if recording() else numbers.cast(x, kind)
    return convert(x, kind)


def may_overflow(source: str, target: str) -> bool:
    """Return True if a value may not fit a kind of 8 or 16 bits; the other kinds have a rule of their own."""
    if target not in STORED:
        return False
    origin, room = BY_NAME[source], BY_NAME[target]
    return source in FLOATS or not room.low <= origin.low <= origin.high <= room.high


def to_stored(x: Any, kind: str, overflow: str | None) -> Any:
    """`x` as one of the kinds of 8 and 16 bits; see `to_int8`."""
    if arrays_among(x):
        return rules.spread(lambda item: to_stored(item, kind, overflow), x)
    if overflow is not None and overflow not in OVERFLOW:
        raise fault(f"overflow={overflow!r:.40}", f"use one of {', '.join(OVERFLOW)}")
    low, high = BY_NAME[kind].low, BY_NAME[kind].high
    if type(x) is int:
        if not low <= x <= high:
            raise fault(f"the literal {x} is given for {kind}", f"write one from {low} to {high}")
        return as_expr(x, kind) if recording() else numbers.cast(x, kind)
    source = x.kind if isinstance(x, Expr) else numbers.kind_of(x)
    if not may_overflow(source, kind):
        return convert(x, kind)
    if overflow is None:
        remedy = f'write to_{kind}(x, overflow="saturate"), or "wrap" to keep the low bits'
        raise fault(f"a {source} may not fit {kind}, and what happens then is not said", remedy)
    whole = to_int32(x) if source in FLOATS else computed_in(x)
    if overflow == "saturate":
        whole = minimum(whole, high) if source == "uint32" else maximum(minimum(whole, high), low)
    return convert(whole, kind)
