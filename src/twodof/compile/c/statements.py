"""Statements: what a C function does, with the names that each statement reads and the block that it belongs to."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from twodof.compile.c.operators import ATOM
from twodof.compile.program.flat_program import Node

Names = frozenset[str]
NOTHING: Names = frozenset()


class Text(NamedTuple):
    """The C text of an expression, how tightly it binds, and the variables that it reads."""

    text: str
    binding: int = ATOM
    reads: Names = NOTHING


EMPTY = Text("")


def name_of(lvalue: str) -> str:
    """Return the variable that an lvalue begins with."""
    for end in ("[", "->", "."):
        lvalue = lvalue.partition(end)[0]
    return lvalue.lstrip("*&")


@dataclass(eq=False)
class Statement:
    """Base of statements: `owner` is the block that it belongs to, else `role` says what it is for."""

    owner: Node | None = field(default=None, kw_only=True)
    role: str = field(default="", kw_only=True)
    reads: Names = field(default=NOTHING, kw_only=True)

    @property
    def bodies(self) -> Sequence[list[Statement]]:
        """The lists of statements inside."""
        return ()

    def text(self) -> str:
        """Return the line of C of a statement without others inside."""
        raise NotImplementedError


@dataclass(eq=False)
class Assign(Statement):
    """`target = value;`, with the type `declared` where it declares a variable, an array if it has a `size`."""

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


@dataclass(eq=False)
class Call(Statement):
    """A call, or another line of C with an effect."""

    line: str

    def text(self) -> str:
        """Return the line of C."""
        return self.line


@dataclass(eq=False)
class Branch(Statement):
    """`if (test) {then} else {otherwise}`."""

    test: str
    then: list[Statement]
    otherwise: list[Statement] = field(default_factory=list)

    @property
    def bodies(self) -> Sequence[list[Statement]]:
        """Both sides."""
        return self.then, self.otherwise


@dataclass(eq=False)
class Loop(Statement):
    """A block behind a head such as `for (...)`, and perhaps an end such as `while (...);`."""

    head: str
    body: list[Statement]
    end: str = ""

    @property
    def bodies(self) -> Sequence[list[Statement]]:
        """The body."""
        return (self.body,)


@dataclass(eq=False)
class Case:
    """A case of a switch: its label, and a comment that names it."""

    label: str
    comment: str
    body: list[Statement]


@dataclass(eq=False)
class Switch(Statement):
    """`switch (value) {...}`."""

    value: str
    cases: list[Case]

    @property
    def bodies(self) -> Sequence[list[Statement]]:
        """The cases."""
        return [case.body for case in self.cases]


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
    """Remove the computation of variables that nothing reads: a reader may need less in the end than was prepared."""
    local = {s.target for s in every(body) if isinstance(s, Assign) and s.declared}
    reads = Counter(name for s in every(body) for name in s.reads)
    _remove_unread(body, local, reads)


def _remove_unread(body: list[Statement], local: set[str], reads: Counter[str]) -> None:
    kept = []
    for statement in reversed(body):
        for inner in statement.bodies:
            _remove_unread(inner, local, reads)
        target = written(statement)
        empty = isinstance(statement, Branch | Loop) and not any(statement.bodies)
        if empty or (target in local and reads[target] == 0):
            reads.subtract(statement.reads)
        else:
            kept.append(statement)
    body[:] = kept[::-1]
