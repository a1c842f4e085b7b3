"""Kinds of values, and the reference's numbers of each kind, which obey the language's arithmetic.

real, float32 and float64 are numpy's (one IEEE rounding after each operation), bool is `numpy.bool_`. `Int32` and
`UInt32` wrap around, divide towards zero, give 0 for x / 0 and x % 0, and mask shift counts. `Int8`, `UInt8`, `Int16`
and `UInt16` compute as `Int32`. A `Vector` is a fixed-length array whose dynamic index is clamped.
"""

import operator
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar

import numpy as np

from twodof.errors import DiagramError, shown


@dataclass(frozen=True)
class ValueKind:
    """One kind: its numpy type ("" of real: the build's precision) and the kind that operations on it have.

    `low` and `high` are the range of an integer or bool. `letter` stands for it in the tables of a program's C.
    """

    name: str
    dtype: str
    computes: str
    letter: str
    low: int = 0
    high: int = 0


def _integer(name: str, computes: str, letter: str) -> ValueKind:
    limits = np.iinfo(name)
    return ValueKind(name, name, computes, letter, int(limits.min), int(limits.max))


BY_NAME: dict[str, ValueKind] = {
    kind.name: kind
    for kind in (
        ValueKind("real", "", "real", "r"),
        ValueKind("float32", "float32", "float32", "f"),
        ValueKind("float64", "float64", "float64", "d"),
        _integer("int32", "int32", "i"),
        _integer("uint32", "uint32", "u"),
        _integer("int8", "int32", "c"),
        _integer("uint8", "int32", "C"),
        _integer("int16", "int32", "h"),
        _integer("uint16", "int32", "H"),
        ValueKind("bool", "bool", "bool", "b", 0, 1),
    )
}
KINDS = tuple(BY_NAME)
FLOATS = ("real", "float32", "float64")
WORDS = ("int32", "uint32")
"""The integers that arithmetic gives."""
STORED = tuple(name for name, kind in BY_NAME.items() if kind.computes != name)
"""The integers of 8 and 16 bits: kinds of what is stored. They compute as int32, as in C."""
INTEGERS = (*WORDS, *STORED)
NUMERIC = (*FLOATS, *WORDS)
"""Kinds that arithmetic takes and gives."""

CONVERSIONS: tuple[tuple[str, str], ...] = (
    *((a, b) for a in FLOATS for b in FLOATS if a != b),
    *((a, b) for f in FLOATS for w in WORDS for a, b in ((f, w), (w, f))),
    *((a, b) for a in WORDS for b in WORDS if a != b),
    *((a, b) for s in STORED for a, b in ((s, "int32"), ("int32", s))),
)
"""From which kind to which one operation converts: what is stored is an int32 on the way, a bool is chosen by."""


def dtype_of(kind: str, precision: str) -> np.dtype[np.generic]:
    """Return a value's numpy type in a build of `precision`, which is real's."""
    return np.dtype(BY_NAME[kind].dtype or precision)


TAKES: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("add", "sub", "mul", "neg", "abs", "lt", "le"), NUMERIC),
    **dict.fromkeys(("div", "sqrt"), FLOATS),
    **dict.fromkeys(("quot", "rem", "shl", "shr"), WORDS),
    **dict.fromkeys(("and", "or", "xor", "not"), (*WORDS, "bool")),
    **dict.fromkeys(("eq", "ne"), (*NUMERIC, "bool")),
}
"""Which kinds an operation takes; comparisons give bool, everything else the kind of its operands."""


class ArrayRules:
    """Meaning of the operators. `arrays` fills it in, because numbers and nodes below it have operators too.

    `spread(f, *values)` is `f` element by element; `product(a, b)` is `a @ b`; `part(a, index)` is a slice or an
    element of a matrix.
    """

    spread: Callable[..., Any]
    product: Callable[[Any, Any], Any]
    part: Callable[[Any, Any], Any]


rules = ArrayRules()


COMPUTE: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "quot": operator.floordiv,
    "rem": operator.mod,
    "shl": operator.lshift,
    "shr": operator.rshift,
    "and": operator.and_,
    "or": operator.or_,
    "xor": operator.xor,
    "lt": operator.lt,
    "le": operator.le,
    "eq": operator.eq,
    "ne": operator.ne,
    "neg": operator.neg,
    "abs": abs,
    "not": operator.invert,
}
"""Python's operator for each operation of one or two operands."""


def _both_ways(op: str) -> tuple[Callable[[Any, Any], Any], Callable[[Any, Any], Any]]:
    """Return the methods for `self op other` and `other op self`."""
    return lambda self, other: self.operation(op, self, other), lambda self, other: self.operation(op, other, self)


class Operators:
    """The base of arrays and nodes: each operator calls `operation` with its name in COMPUTE and its operands."""

    __slots__ = ()
    __array_ufunc__ = None  # numpy must not make arrays of its own of these

    @staticmethod
    def operation(op: str, *operands: Any) -> Any:
        """Return the result of an operation."""
        raise NotImplementedError

    __add__, __radd__ = _both_ways("add")
    __sub__, __rsub__ = _both_ways("sub")
    __mul__, __rmul__ = _both_ways("mul")
    __truediv__, __rtruediv__ = _both_ways("div")
    __floordiv__, __rfloordiv__ = _both_ways("quot")
    __mod__, __rmod__ = _both_ways("rem")
    __lshift__, __rlshift__ = _both_ways("shl")
    __rshift__, __rrshift__ = _both_ways("shr")
    __and__, __rand__ = _both_ways("and")
    __or__, __ror__ = _both_ways("or")
    __xor__, __rxor__ = _both_ways("xor")
    __lt__, __gt__ = _both_ways("lt")
    __le__, __ge__ = _both_ways("le")
    __eq__ = _both_ways("eq")[0]
    __ne__ = _both_ways("ne")[0]

    def __matmul__(self, other: Any) -> Any:
        return rules.product(self, other)

    def __rmatmul__(self, other: Any) -> Any:
        return rules.product(other, self)

    def __neg__(self) -> Any:
        return self.operation("neg", self)

    def __pos__(self) -> Any:
        return self

    def __abs__(self) -> Any:
        return self.operation("abs", self)

    def __invert__(self) -> Any:
        return self.operation("not", self)


class ArrayOperators(Operators):
    """The base of the arrays that are not nodes: operators element by element."""

    __slots__ = ()

    @staticmethod
    def operation(op: str, *operands: Any) -> Any:
        return rules.spread(COMPUTE[op], *operands)


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
    """Return the numpy scalar type of a real under the enclosing `precision`."""
    return _REAL.get()


def scalar_types() -> Mapping[str | None, type]:
    """Return the type of a number of each kind under the enclosing `precision`."""
    return _SCALARS[_REAL.get()]


def scalars() -> frozenset[type]:
    """Return the types of numbers under the enclosing `precision`."""
    return _TYPES[_REAL.get()]


def _quotient(a: int, b: int) -> int:
    if b == 0:
        return 0
    q = abs(a) // abs(b)
    return q if (a < 0) == (b < 0) else -q


def _remainder(a: int, b: int) -> int:
    # MIN % -1 is MIN - (MIN / -1) * -1 with a wrapped quotient, and that is 0, as for any other a % -1.
    return 0 if b == 0 else a - b * _quotient(a, b)


_ON_INTEGERS: dict[str, Callable[..., Any]] = {
    **{op: compute for op, compute in COMPUTE.items() if op != "div"},
    "quot": _quotient,
    "rem": _remainder,
    "shl": lambda a, b: a << (b & 31),
    "shr": lambda a, b: a >> (b & 31),
}
_COMPARISONS = frozenset(("lt", "le", "eq", "ne"))


class Integer(Operators):
    """An integer of `size` values from `low` on, which wraps around; the base of all of them."""

    __slots__ = ("value",)
    kind: ClassVar[str]
    size: ClassVar[int] = 2**32
    low: ClassVar[int] = 0
    computes: ClassVar[type[Any]]
    """The type of what arithmetic gives."""

    def __init__(self, value: int) -> None:
        self.value = (int(value) - self.low) % self.size + self.low

    def _other(self, other: object) -> int | None:
        """Return the value of an operand, or None for an array or an Expr, which have methods of their own."""
        if isinstance(other, Integer) and other.computes is self.computes:
            return other.value
        if type(other) is int or (isinstance(other, IntEnum) and self.computes is Int32):
            return int(self.computes(other).value)
        if hasattr(other, "op") or isinstance(other, ArrayOperators):
            return None
        what = f"{self.kind} meets {type(other).__name__} in one operation"
        raise DiagramError(what, "", "convert one of them by name, such as float64(x) or int32(x)")

    @staticmethod
    def operation(op: str, *operands: Any) -> Any:
        own = operands[0] if isinstance(operands[0], Integer) else operands[1]
        values = [own._other(v) for v in operands]
        if None in values or op not in _ON_INTEGERS:
            return NotImplemented
        found = _ON_INTEGERS[op](*values)
        return np.bool_(found) if op in _COMPARISONS else own.computes(found)

    def __hash__(self) -> int:
        return hash((self.kind, self.value))

    def __repr__(self) -> str:
        return f"{self.kind}({self.value})"


class Int32(Integer):
    """A signed 32-bit integer in two's complement."""

    __slots__ = ()
    kind = "int32"
    low = -(2**31)


class UInt32(Integer):
    """An unsigned 32-bit integer."""

    __slots__ = ()
    kind = "uint32"


Int32.computes, UInt32.computes = Int32, UInt32


class Int8(Integer):
    """A signed 8-bit integer."""

    __slots__ = ()
    kind, size, low, computes = "int8", 2**8, -(2**7), Int32


class UInt8(Integer):
    """An unsigned 8-bit integer."""

    __slots__ = ()
    kind, size, computes = "uint8", 2**8, Int32


class Int16(Integer):
    """A signed 16-bit integer."""

    __slots__ = ()
    kind, size, low, computes = "int16", 2**16, -(2**15), Int32


class UInt16(Integer):
    """An unsigned 16-bit integer."""

    __slots__ = ()
    kind, size, computes = "uint16", 2**16, Int32


INTEGER_TYPES: dict[str, type[Integer]] = {t.kind: t for t in (Int8, UInt8, Int16, UInt16, Int32, UInt32)}
"""The integers by kind."""
_SCALARS: dict[type, dict[str | None, type]] = {
    real: dict([("real", real), ("bool", np.bool_), *PRECISIONS.items(), *INTEGER_TYPES.items()])
    for real in PRECISIONS.values()
}
_TYPES = {real: frozenset(kinds.values()) for real, kinds in _SCALARS.items()}
_FLOAT_KINDS: dict[type, dict[type, str]] = {
    real: {other: "real" if other is real else name for name, other in PRECISIONS.items()}
    for real in PRECISIONS.values()
}


class Vector(ArrayOperators, tuple[Any, ...]):
    """A fixed-length array. An `Integer` index is clamped; a literal Python index must be inside, -1 is the last."""

    __slots__ = ()
    __hash__ = tuple.__hash__

    @property
    def shape(self) -> tuple[int, ...]:
        """(n,)."""
        return (len(self),)

    @property
    def T(self) -> Any:
        """The vector itself: it is both a row and a column."""
        return self

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, (slice, tuple)):
            return rules.part(self, index)
        return tuple.__getitem__(self, clamp_index(index, len(self)))


def clamp_index(index: Any, length: int) -> int:
    """Return the position that `index` addresses in an array of `length` elements.

    Raises DiagramError for a literal outside [-length, length) and for an index that is not an integer.
    """
    if isinstance(index, Integer):
        return min(max(index.value, 0), length - 1)
    if isinstance(index, (int, np.integer)) and not isinstance(index, bool):
        if not -length <= index < length:
            remedy = "literal indices count from 0, or from -1 at the end"
            raise DiagramError(f"index {index} is outside an array of {length}", "", remedy)
        return int(index) % length
    raise DiagramError(f"an array is indexed with {type(index).__name__}", "", "convert the index with to_int32")


def cast(value: Any, kind: str) -> Any:
    """`value` as a number of `kind` under the current precision; Python literals and numpy scalars are accepted.

    Raises DiagramError where a conversion must be explicit in the language, such as real to integer. That also catches
    a float64 that leaked into a float32 run.
    """
    if kind in FLOATS:
        real = scalar_types()[kind]
        if isinstance(value, real):
            return value
        if type(value) in (int, float):
            return real(value)
    elif kind == "bool":
        if isinstance(value, (bool, np.bool_)):
            return np.bool_(value)
    else:
        integer = INTEGER_TYPES[kind]
        if isinstance(value, integer):
            return value
        if type(value) is int or (isinstance(value, IntEnum) and kind == "int32"):
            return integer(value)
    if isinstance(value, str):
        raise DiagramError(f"it takes {kind}, not the text {shown(value)}", "", "give a number")
    given = getattr(value, "kind", None) or type(value).__name__
    remedy = "give true or false, or a comparison" if kind == "bool" else f"convert it, as in to_{kind}(x)"
    raise DiagramError(f"it takes {kind}, not {shown(value)} of type {given}", "", remedy)


def identical(a: Any, b: Any) -> bool:
    """Return True if two numbers, or tuples of them, are of one type and equal to the bit; NaN is one value."""
    if type(a) is not type(b):
        return False
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(identical, a, b))
    if isinstance(a, np.floating):
        return bool(a == b and np.signbit(a) == np.signbit(b)) or bool(a != a and b != b)
    return bool(a == b)


def plain(value: Any) -> Any:
    """Return a number of the language as a Python number, a Vector as a list."""
    if isinstance(value, Vector):
        return [plain(v) for v in value]
    return value.value if isinstance(value, Integer) else value.item()


def kind_of(value: Any) -> str:
    """Return the kind of a number; a Python float or int literal counts as real, an IntEnum as int32.

    So is a number of numpy that has the precision of a real. Raises DiagramError for anything that is not a number of
    the language.
    """
    if isinstance(value, Integer):
        return value.kind
    if isinstance(value, (bool, np.bool_)):
        return "bool"
    if isinstance(value, IntEnum):
        return "int32"
    if isinstance(value, (int, float, np.floating)):
        return _FLOAT_KINDS[_REAL.get()].get(type(value), "real")
    remedy = "write int(...) around it" if isinstance(value, np.integer) else f"use {', '.join(KINDS)}"
    raise DiagramError(f"{type(value).__name__} is not a number of the language", "", remedy)


def common_kind(values: Iterable[Any]) -> str:
    """Return the kind of the first of `values` that is not a Python literal, which may be a real or an integer.

    It is "real" if all are such literals.
    """
    typed = (v for v in values if isinstance(v, (Integer, np.floating, np.bool_, bool, IntEnum)))
    return next(map(kind_of, typed), "real")


def computed_in(value: Any) -> Any:
    """Return a number in the kind of its operations: an integer of 8 or 16 bits as an Int32."""
    return value.computes(value.value) if isinstance(value, Integer) else value


def fits(value: int, kind: str) -> bool:
    """Return True if a whole number is in the range of an integer kind, without wrapping around."""
    return BY_NAME[kind].low <= value <= BY_NAME[kind].high
