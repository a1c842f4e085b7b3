"""Values of the reference interpreter: plain numbers that obey the language's arithmetic.

real is `numpy.float64` or `numpy.float32` (one IEEE rounding after each operation), bool is `numpy.bool_`;
`Int32` and `UInt32` wrap around, divide towards zero, give 0 for x / 0 and x % 0, and mask shift counts.
A `Vector` is a fixed-length array whose dynamic index is clamped.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, ClassVar

import numpy as np

from twodof.errors import DiagramError, shown

PRECISIONS: dict[str, type[np.floating[Any]]] = {"float64": np.float64, "float32": np.float32}
_REAL: ContextVar[type[np.floating[Any]]] = ContextVar("real", default=np.float64)


@contextmanager
def precision(name: str) -> Iterator[None]:
    """Run the enclosed code with real numbers of the precision "float64" or "float32", IEEE exceptions silent.

    Raises DiagramError for another name.
    """
    if name not in PRECISIONS:
        raise DiagramError(f"unknown precision {name!r}", "precision", 'use "float64" or "float32"')
    token = _REAL.set(PRECISIONS[name])
    try:
        with np.errstate(all="ignore"):
            yield
    finally:
        _REAL.reset(token)


def real_type() -> type[np.floating[Any]]:
    """The numpy scalar type of a real under the enclosing `precision`."""
    return _REAL.get()


def scalar_types() -> Mapping[str | None, type]:
    """What a number of each kind is an instance of under the enclosing `precision`."""
    return _SCALARS[_REAL.get()]


def scalars() -> frozenset[type]:
    """The types of numbers under the enclosing `precision`."""
    return _TYPES[_REAL.get()]


class Integer:
    """A 32-bit integer; the base of Int32 and UInt32."""

    __slots__ = ("value",)
    __array_ufunc__ = None  # numpy scalars must not absorb these
    kind: ClassVar[str]
    low: ClassVar[int]

    def __init__(self, value: int) -> None:
        self.value = (int(value) - self.low) % 2**32 + self.low

    def _other(self, other: object) -> int:
        if isinstance(other, type(self)):
            return other.value
        if type(other) is int:
            return type(self)(other).value
        raise DiagramError(
            f"{self.kind} meets {type(other).__name__} in one operation",
            "",
            "convert with to_real, to_int32 or to_uint32",
        )

    def __add__(self, other: object) -> Any:
        return type(self)(self.value + self._other(other))

    def __radd__(self, other: object) -> Any:
        return type(self)(self._other(other) + self.value)

    def __sub__(self, other: object) -> Any:
        return type(self)(self.value - self._other(other))

    def __rsub__(self, other: object) -> Any:
        return type(self)(self._other(other) - self.value)

    def __mul__(self, other: object) -> Any:
        return type(self)(self.value * self._other(other))

    def __rmul__(self, other: object) -> Any:
        return type(self)(self._other(other) * self.value)

    def __floordiv__(self, other: object) -> Any:
        return type(self)(_quotient(self.value, self._other(other)))

    def __rfloordiv__(self, other: object) -> Any:
        return type(self)(_quotient(self._other(other), self.value))

    def __mod__(self, other: object) -> Any:
        return type(self)(_remainder(self.value, self._other(other)))

    def __rmod__(self, other: object) -> Any:
        return type(self)(_remainder(self._other(other), self.value))

    def __lshift__(self, other: object) -> Any:
        return type(self)(self.value << (self._other(other) & 31))

    def __rlshift__(self, other: object) -> Any:
        return type(self)(self._other(other)) << self

    def __rshift__(self, other: object) -> Any:
        return type(self)(self.value >> (self._other(other) & 31))

    def __rrshift__(self, other: object) -> Any:
        return type(self)(self._other(other)) >> self

    def __and__(self, other: object) -> Any:
        return type(self)(self.value & self._other(other))

    def __or__(self, other: object) -> Any:
        return type(self)(self.value | self._other(other))

    def __xor__(self, other: object) -> Any:
        return type(self)(self.value ^ self._other(other))

    __rand__, __ror__, __rxor__ = __and__, __or__, __xor__

    def __invert__(self) -> Any:
        return type(self)(~self.value)

    def __neg__(self) -> Any:
        return type(self)(-self.value)

    def __abs__(self) -> Any:
        return type(self)(abs(self.value))

    def __lt__(self, other: object) -> Any:
        return np.bool_(self.value < self._other(other))

    def __le__(self, other: object) -> Any:
        return np.bool_(self.value <= self._other(other))

    def __gt__(self, other: object) -> Any:
        return np.bool_(self.value > self._other(other))

    def __ge__(self, other: object) -> Any:
        return np.bool_(self.value >= self._other(other))

    def __eq__(self, other: object) -> Any:
        return np.bool_(self.value == self._other(other))

    def __ne__(self, other: object) -> Any:
        return np.bool_(self.value != self._other(other))

    def __hash__(self) -> int:
        return hash((self.kind, self.value))

    def __repr__(self) -> str:
        return f"{self.kind}({self.value})"


def _deferring(operation: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """`operation`, leaving an operand of the expression graph (which this module cannot know) to its own method."""

    @functools.wraps(operation)
    def deferred(self: Any, other: Any) -> Any:
        # First what it nearly always is: an attribute that is not there is found out slowly.
        return operation(self, other) if type(other) is type(self) or not hasattr(other, "op") else NotImplemented

    return deferred


for _name in ("add", "sub", "mul", "floordiv", "mod", "lshift", "rshift", "and", "or", "xor"):
    for _dunder in (f"__{_name}__", f"__r{_name}__"):
        setattr(Integer, _dunder, _deferring(getattr(Integer, _dunder)))
for _name in ("lt", "le", "gt", "ge", "eq", "ne"):
    setattr(Integer, f"__{_name}__", _deferring(getattr(Integer, f"__{_name}__")))


class Int32(Integer):
    """A signed 32-bit integer in two's complement."""

    __slots__ = ()
    kind = "int32"
    low = -(2**31)


class UInt32(Integer):
    """An unsigned 32-bit integer."""

    __slots__ = ()
    kind = "uint32"
    low = 0


_SCALARS: dict[type, dict[str | None, type]] = {
    real: {"real": real, "bool": np.bool_, "int32": Int32, "uint32": UInt32} for real in PRECISIONS.values()
}
_TYPES = {real: frozenset(kinds.values()) for real, kinds in _SCALARS.items()}


def _quotient(a: int, b: int) -> int:
    if b == 0:
        return 0
    q = abs(a) // abs(b)
    return q if (a < 0) == (b < 0) else -q


def _remainder(a: int, b: int) -> int:
    # MIN % -1 is MIN - (MIN / -1) * -1 with a wrapped quotient, and that is 0, as for any other a % -1.
    return 0 if b == 0 else a - b * _quotient(a, b)


class Vector(tuple[Any, ...]):
    """A fixed-length array. An `Integer` index is clamped; a literal Python index must be inside."""

    __slots__ = ()

    def __getitem__(self, index: Any) -> Any:
        return tuple.__getitem__(self, clamp_index(index, len(self)))


def clamp_index(index: Any, length: int) -> int:
    """The position that `index` addresses in an array of `length` elements.

    Raises DiagramError for a literal outside [0, length) and for an index that is not an integer.
    """
    if isinstance(index, Integer):
        return min(max(index.value, 0), length - 1)
    if isinstance(index, (int, np.integer)) and not isinstance(index, bool):
        if not 0 <= index < length:
            raise DiagramError(f"index {index} is outside an array of {length}", "", "literal indices count from 0")
        return int(index)
    raise DiagramError(f"an array is indexed with {type(index).__name__}", "", "convert the index with to_int32")


def cast(value: Any, kind: str) -> Any:
    """`value` as a number of `kind` under the current precision; Python literals and numpy scalars are accepted.

    Raises DiagramError where a conversion must be explicit in the language, such as real to integer. That also catches
    a float64 that leaked into a float32 run.
    """
    real = real_type()
    if kind == "real":
        if isinstance(value, real):
            return value
        if type(value) in (int, float):
            return real(value)
    elif kind == "bool":
        if isinstance(value, (bool, np.bool_)):
            return np.bool_(value)
    else:
        integer = Int32 if kind == "int32" else UInt32
        if isinstance(value, integer):
            return value
        if type(value) is int:
            return integer(value)
    raise DiagramError(
        f"a {kind} is expected and {shown(value)} of type {type(value).__name__} is given",
        "",
        "convert it explicitly",
    )


def plain(value: Any) -> Any:
    """A number of the language as a Python number, a Vector as a list."""
    if isinstance(value, Vector):
        return [plain(v) for v in value]
    return value.value if isinstance(value, Integer) else value.item()


def cast_array(values: Sequence[Any], kind: str) -> Vector:
    """`values` as a Vector of numbers of `kind`; raises like `cast`."""
    return Vector(cast(v, kind) for v in values)


def kind_of(value: Any) -> str:
    """The language's type of a number; a Python float or int literal is taken for a real.

    Raises DiagramError for anything that is not a number of the language.
    """
    if isinstance(value, Integer):
        return value.kind
    if isinstance(value, (bool, np.bool_)):
        return "bool"
    if isinstance(value, (int, float, np.floating)):
        return "real"
    raise DiagramError(f"{type(value).__name__} is not a number of the language", "", "use real, int32, uint32 or bool")


def same_bits(a: Any, b: Any) -> bool:
    """Whether two numbers (or Vectors) are the same value to the bit; all NaNs are one value, -0.0 differs from 0.0."""
    if isinstance(a, tuple):
        return len(a) == len(b) and all(same_bits(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, Integer):
        return type(a) is type(b) and a.value == b.value
    if isinstance(a, np.floating):
        if np.isnan(a) or np.isnan(b):
            return bool(np.isnan(a) and np.isnan(b))
        return type(a) is type(b) and a.tobytes() == b.tobytes()
    return bool(a == b)
