"""Literals, identifiers and statements of C. A statement has the names that it reads, and its block."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from twodof.blocks.elementary.functions import ARGUMENTS
from twodof.blocks.expressions.numbers import INTEGERS, Integer, dtype_of
from twodof.compile.c.operators import ATOM, C_TYPES, HELPER_NAMES, SIGNED
from twodof.compile.program.flat_program import Node

Names = frozenset[str]
NOTHING: Names = frozenset()


class Text(NamedTuple):
    """The C text of an expression, how tightly it binds, and the variables that it reads."""

    text: str
    binding: int = ATOM
    reads: Names = NOTHING

    @staticmethod
    def of(lvalue: str) -> Text:
        """Return the text of an lvalue that begins with a variable."""
        return Text(lvalue, ATOM, frozenset((name_of(lvalue),)))


def constant(value: Any, kind: str, precision: str) -> Text:
    """Return the C literal of a value of the type `kind`; a real is decimal if that reads back to the same bits."""
    value = value.value if isinstance(value, Integer) else value
    if kind == "bool":
        return Text("true" if value else "false")
    if kind == "int32":
        if value == -(2**31):
            return Text("INT32_MIN")
        return Text(str(value), ATOM if value >= 0 else SIGNED)
    if kind == "uint32":
        return Text(f"{value}u")
    if kind in INTEGERS:
        return Text(f"{value}", ATOM if value >= 0 else SIGNED)
    return _real(value, dtype_of(kind, precision).name)


def _real(value: float, precision: str) -> Text:
    single = precision == "float32"
    suffix = "f" if single else ""
    with np.errstate(over="ignore"):
        rounded: Any = np.float32(value) if single else np.float64(value)
    if np.isnan(rounded):
        return Text(f'__builtin_nan{suffix}("")')
    sign, binding = ("-", SIGNED) if math.copysign(1.0, rounded) < 0 else ("", ATOM)
    if np.isinf(rounded):
        return Text(f"{sign}__builtin_inf{suffix}()", binding)
    size = abs(rounded)
    decimal = str(size)
    normal = size == 0 or size >= np.finfo(precision).smallest_normal
    # A compiler may read a float as a double first.
    exact = normal and (not single or np.float32(float(decimal)) == size)
    if exact:
        return Text(f"{sign}{decimal}{suffix}", binding)
    digits, _, exponent = float(size).hex().partition("p")
    mantissa = digits.rstrip("0").rstrip(".") if "." in digits else digits
    return Text(f"{sign}{mantissa}p{exponent}{suffix}", binding)


EMPTY = Text("")


def name_of(lvalue: str) -> str:
    """Return the variable that an lvalue begins with."""
    for end in ("[", "->", "."):
        lvalue = lvalue.partition(end)[0]
    return lvalue.lstrip("*&")


@dataclass(eq=False)
class Statement:
    """Base of statements: `owner` is its block, else `role` tells its purpose; `reads` are the names that it reads."""

    owner: Node | None = field(default=None, kw_only=True)
    role: str = field(default="", kw_only=True)
    reads: Names = field(default=NOTHING, kw_only=True)

    @property
    def bodies(self) -> Sequence[list[Statement]]:
        """Lists of the statements inside."""
        return ()

    @property
    def parts(self) -> Sequence[tuple[str, list[Statement]]]:
        """Lists of the statements inside as they are printed, each with the line before it."""
        return ()

    @property
    def last(self) -> str:
        """The line after a statement with others inside."""
        return "}"

    def text(self) -> str:
        """Return the line of C of a statement without others inside."""
        raise NotImplementedError


@dataclass(eq=False)
class Assign(Statement):
    """`target = value;`. With the type `declared` it declares a variable, or an array of `size` elements."""

    target: str
    value: str = ""
    declared: str = ""
    size: int | None = None

    def text(self) -> str:
        """Return the line of C."""
        size = "" if self.size is None else f"[{self.size}]"
        declared = f"{self.declared} " if self.declared else ""
        return f"{declared}{self.target}{size}{f' = {self.value}' if self.value else ''};"


@dataclass(eq=False)
class Copy(Statement):
    """A copy of `width` elements of the C type `type`."""

    target: str
    source: str
    width: int
    type: str

    def text(self) -> str:
        """Return the line of C."""
        return f"(void)memcpy({self.target}, {self.source}, sizeof({self.type}) * {self.width}u);"


def stored(
    target: str, value: str, kind: str, width: int | None, owner: Node | None, reads: Names, role: str = ""
) -> Statement:
    """Return the statement that stores a number in an lvalue, or copies an array of `width` elements of `kind`."""
    if width is None:
        return Assign(target, value, owner=owner, reads=reads, role=role)
    return Copy(target, value, width, C_TYPES[kind], owner=owner, reads=reads, role=role)


@dataclass(eq=False)
class Call(Statement):
    """A call, or another line of C with an effect."""

    line: str

    def text(self) -> str:
        """Return the line of C."""
        return self.line


@dataclass(eq=False)
class IfStatement(Statement):
    """`if (test) {then} else {otherwise}`."""

    test: str
    then: list[Statement]
    otherwise: list[Statement] = field(default_factory=list)

    @property
    def bodies(self) -> Sequence[list[Statement]]:
        """Statements of both sides."""
        return self.then, self.otherwise

    @property
    def parts(self) -> Sequence[tuple[str, list[Statement]]]:
        """Both sides; another `if` alone on the second side continues the first."""
        found, rest = [(f"if ({self.test}) {{", self.then)], self.otherwise
        while len(rest) == 1 and isinstance(inner := rest[0], IfStatement):
            found.append((f"}} else if ({inner.test}) {{", inner.then))
            rest = inner.otherwise
        return [*found, ("} else {", rest)] if rest else found


@dataclass(eq=False)
class LoopStatement(Statement):
    """A block `{...}` after a head such as `for (...)` or `case 1:`, "" for none, before an end as `while (...);`."""

    head: str
    body: list[Statement]
    end: str = ""

    @property
    def bodies(self) -> Sequence[list[Statement]]:
        """Statements of the body."""
        return (self.body,)

    @property
    def parts(self) -> Sequence[tuple[str, list[Statement]]]:
        """The body and its head."""
        return ((f"{self.head} {{".lstrip(), self.body),)

    @property
    def last(self) -> str:
        """The closing bracket and the end."""
        return f"}} {self.end}".rstrip()


def every(statements: Iterable[Statement]) -> Iterator[Statement]:
    """Yield statements and what is inside them, in order."""
    for statement in statements:
        yield statement
        for body in statement.bodies:
            yield from every(body)


def written(statement: Statement) -> str:
    """Return the variable that a statement writes, or "" for none."""
    return name_of(statement.target) if isinstance(statement, Assign | Copy) else ""


def without_unread(body: list[Statement]) -> None:
    """Remove from `body` the statements that compute variables which no statement reads."""
    local = {s.target for s in every(body) if isinstance(s, Assign) and s.declared}
    reads = Counter(name for s in every(body) for name in s.reads)
    _remove_unread(body, local, reads)


def _remove_unread(body: list[Statement], local: set[str], reads: Counter[str]) -> None:
    kept = []
    for statement in reversed(body):
        for inner in statement.bodies:
            _remove_unread(inner, local, reads)
        target = written(statement)
        empty = isinstance(statement, IfStatement | LoopStatement) and not any(statement.bodies)
        if empty or (target in local and reads[target] == 0):
            reads.subtract(statement.reads)
        else:
            kept.append(statement)
    body[:] = kept[::-1]


RESERVED = """
    auto break case char const continue default do double else enum extern float for goto if inline int
    long register restrict return short signed sizeof static struct switch typedef union unsigned void
    volatile while asm typeof real bool true false offsetof linux unix memcpy memmove memset NULL
"""
# A header is for C++ too, and for whoever includes others before it, which define these as macros.
FOREIGN = """
    alignas alignof and and_eq bitand bitor catch char16_t char32_t char8_t class co_await co_return co_yield compl
    concept const_cast consteval constexpr constinit decltype delete dynamic_cast explicit export friend mutable
    namespace new noexcept not not_eq nullptr operator or or_eq private protected public reinterpret_cast requires
    static_assert static_cast template this thread_local throw try typeid typename using virtual wchar_t xor xor_eq
    complex imaginary noreturn assert errno stdin stdout stderr EOF INFINITY NAN HUGE_VAL BUFSIZ
"""
KEYWORDS = frozenset((RESERVED + FOREIGN).split())
# What the included headers and the emitted file itself define beside those: macros, types, helpers, a header's guard.
DEFINED = re.compile(r"[A-Z][A-Z0-9_]*_(MAX|MIN|C|WIDTH)|[a-z0-9_]+_t|td_inline|td_unrolled|\w+_INCLUDED")
FUNCTIONS = HELPER_NAMES | {f"td_{name}{kind}" for name in ARGUMENTS for kind in ("", "_float32", "_float64")}


@dataclass
class CNames:
    """Identifiers of one C scope, all different."""

    taken: set[str] = field(default_factory=set)
    last: dict[str, int] = field(default_factory=dict)
    tried: dict[str, int] = field(default_factory=dict)  # of a stem that is taken: the number that was tried last

    def new(self, stem: str) -> str:
        """Return a new identifier: `stem` with dots as underscores, and a number appended if that is taken."""
        name = base = stem.replace(".", "_")
        number = self.tried.get(base, 2)
        while name in self.taken or name in KEYWORDS or name in FUNCTIONS or DEFINED.fullmatch(name):
            name = f"{base}_{number}"
            self.tried[base] = number
            number += 1
        self.taken.add(name)
        return name

    def numbered(self, stem: str) -> str:
        """Return a new identifier: `stem` with dots as underscores, and the next number appended."""
        base = stem.replace(".", "_")
        self.last[base] = self.last.get(base, 0) + 1
        return self.new(f"{base}{self.last[base]}")
