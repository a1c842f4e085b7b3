"""How values, conditions and constants are written: for one instance, or (`compile.lanes`) for several at once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from twodof.compile.c.branching import BranchingRenderer
from twodof.compile.c.expressions import Renderer, Text
from twodof.compile.c.names import STRAIGHT as STRAIGHT_NAME
from twodof.compile.c.names import CNames
from twodof.compile.c.operators import C_TYPES
from twodof.compile.c.writer import CWriter
from twodof.compile.program.layout import Member


class CStyle:
    """C for one instance: values are scalars, conditions are C's."""

    types: Mapping[str, str] = C_TYPES
    writer: type[CWriter] = CWriter
    renderer: type[Renderer] = BranchingRenderer
    function = "static"  # how an elementary function is declared
    reserved: frozenset[str] = frozenset()  # names that the prelude defines
    tables = True  # whether the file ends with tables of parameters and signals
    copies = 1  # instances in a struct
    branches = True  # whether a condition can leave out what it guards: lanes compute both sides
    foresees = True  # whether numbers of the ticks to come are computed together: lanes fill the vectors themselves
    shares = True  # whether copies share functions: lanes would have to hand on which of them act
    along = "{0} + h * {1}"
    gathers = True  # whether the sum of an integration's slopes is built up between its stages
    weighted = "x->{m} + sixth * (((k1.{m} + {two} * k2.{m}) + {two} * k3.{m}) + k4.{m})"

    @property
    def inner(self) -> CStyle:
        """The style of the elementary functions."""
        return self

    @property
    def straight(self) -> CStyle:
        """The style of elementary functions that go in place into a loop for vectors."""
        return STRAIGHT

    def prelude(self, programs: str) -> tuple[str, frozenset[str]]:
        """The C that comes before that of `programs`, and the helpers that it calls."""
        return "", frozenset()

    def same(self, text: str, kind: str) -> str:
        """A value that is the same in all instances, as an instance's own."""
        return text

    def literal(self, text: str, binding: int, kind: str) -> Text:
        """A constant, as an instance's own."""
        return text, binding

    def conjunction(self, texts: Sequence[str]) -> str:
        """Whether all hold."""
        return " && ".join(texts)

    def disjunction(self, texts: Sequence[str]) -> str:
        """Whether any holds."""
        return " || ".join(texts)

    def negation(self, text: str) -> str:
        """Whether it does not hold."""
        return f"!({text})"

    def truth(self, due: str, tests: Sequence[str]) -> str:
        """Whether a rate is due ("" if always) and all `tests` hold."""
        return " && ".join([*filter(None, (due,)), *tests])

    def product(self, a: str, b: str) -> str:
        """a * b"""
        return f"{a} * {b}"

    def compared(self, sign: str, a: str, b: str, kind: str = "real") -> str:
        """A comparison."""
        return f"{a} {sign} {b}"

    def chosen(self, test: str, a: str, b: str, kind: str) -> str:
        """`a` where `test` holds, else `b`."""
        return f"{test} ? {a} : {b}"

    def anywhere(self, test: str) -> str:
        """Whether `test` holds in any instance."""
        return test

    def piece(self, start: str, end: str, dt: str) -> str:
        """The length of a part of a step [s]."""
        return f"({end} - {start}) * {dt}"

    @contextmanager
    def moving(
        self, writer: CWriter, names: CNames, prefix: str, members: Sequence[Member], start: str, x: str
    ) -> Iterator[str]:
        """The states to integrate by the next part of a step, which begins at `start` < 1."""
        yield x


class StraightRenderer(Renderer):
    """Writes expressions without branches, and the elementary functions likewise: as a loop for vectors wants it."""

    way = STRAIGHT_NAME


class StraightStyle(CStyle):
    """C for one instance, without branches and in place."""

    renderer = StraightRenderer
    function = "td_inline"


SCALAR = CStyle()
STRAIGHT = StraightStyle()
