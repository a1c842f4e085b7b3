"""The kinds of values: what each is in memory, and in which kind it computes. The one place that lists them."""

from dataclasses import dataclass

import numpy as np


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
