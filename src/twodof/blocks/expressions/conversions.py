"""Conversions to float32, float64 and integers of 8 and 16 bits; those to real, int32 and uint32 are in `expr`.

A float becomes an integer by truncation; for another rounding use `floor`, `ceil`, `round_half_even` or
`round_half_away` first. NaN gives 0 and an infinity the end of int32's range, on every target; then the rule for
overflow applies.
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
    """Return `x` as a float32, rounded to nearest; a bool gives 0 or 1. `to_float32(0.1)` makes a literal."""
    return _to_float(x, "float32")


def to_float64(x: Any) -> Any:
    """Return `x` as a float64, rounded to nearest; a bool gives 0 or 1. `to_float64(0.1)` makes a literal."""
    return _to_float(x, "float64")


def to_int8(x: Any, overflow: str | None = None) -> Any:
    """Return `x` as an int8. A value that does not fit keeps its low 8 bits with `overflow` "wrap".

    With "saturate" it becomes -128 or 127. A float is truncated to an int32 first. Without `overflow`, raises
    DiagramError unless all values fit: those of a bool, a narrower kind, or a literal that fits.
    """
    return to_stored(x, "int8", overflow)


def to_uint8(x: Any, overflow: str | None = None) -> Any:
    """Return `x` as a uint8, with the range 0 to 255; see `to_int8`."""
    return to_stored(x, "uint8", overflow)


def to_int16(x: Any, overflow: str | None = None) -> Any:
    """Return `x` as an int16, with the range -32768 to 32767; see `to_int8`."""
    return to_stored(x, "int16", overflow)


def to_uint16(x: Any, overflow: str | None = None) -> Any:
    """Return `x` as a uint16, with the range 0 to 65535; see `to_int8`."""
    return to_stored(x, "uint16", overflow)


def _to_float(x: Any, kind: str) -> Any:
    if arrays_among(x):
        return rules.spread(lambda item: _to_float(item, kind), x)
    if type(x) in (int, float):
        return as_expr(x, kind) if recording() else numbers.cast(x, kind)
    return convert(x, kind)


def may_overflow(source: str, target: str) -> bool:
    """Return True if `target` is a kind of 8 or 16 bits and a value of the kind `source` may not fit it."""
    if target not in STORED:
        return False
    origin, room = BY_NAME[source], BY_NAME[target]
    return source in FLOATS or not room.low <= origin.low <= origin.high <= room.high


def to_stored(x: Any, kind: str, overflow: str | None) -> Any:
    """Return `x` as `kind`, one of 8 or 16 bits; see `to_int8`."""
    if arrays_among(x):
        return rules.spread(lambda item: to_stored(item, kind, overflow), x)
    if overflow is not None and overflow not in OVERFLOW:
        raise fault(f"overflow={overflow!r:.40} is unknown", f"use one of {', '.join(OVERFLOW)}")
    low, high = BY_NAME[kind].low, BY_NAME[kind].high
    if type(x) is int:
        if not low <= x <= high:
            raise fault(f"the literal {x} does not fit {kind}", f"write one from {low} to {high}")
        return as_expr(x, kind) if recording() else numbers.cast(x, kind)
    source = x.kind if isinstance(x, Expr) else numbers.kind_of(x)
    if not may_overflow(source, kind):
        return convert(x, kind)
    if overflow is None:
        remedy = f'write to_{kind}(x, overflow="saturate"), or "wrap" to keep the low bits'
        raise fault(f"a {source} may not fit {kind}, and no rule for overflow is given", remedy)
    whole = to_int32(x) if source in FLOATS else computed_in(x)
    if overflow == "saturate":
        whole = minimum(whole, high) if source == "uint32" else maximum(minimum(whole, high), low)
    return convert(whole, kind)
