"""Functions of C and their listing, in which each line has the block to which it belongs."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from twodof.compile.c.statements import Assign, Statement, every, without_unread, written
from twodof.compile.program.flat_program import Node

COMMENTS = {
    "rates": "/* which rates are due */",
    "disabled outputs": "/* outputs of what is disabled */",
    "returned signals": "/* what is returned */",
    "integration": "/* the continuous states of the next tick */",
    "disabled states": "/* what is disabled keeps its continuous states */",
    "next tick": "/* the next tick */",
    "next states": "/* the next tick */",
}
"""The comments above statements of no single block, by their role."""


def describe(node: Node) -> str:
    """Return a block's path and type as a comment."""
    kind = node.block.type_name or type(node.block).__name__
    legend = "".join(f"; {e}" for e in node.enumerations)
    named = kind.isascii() and kind.isidentifier()
    return f"/* {node.path}: {kind}{legend} */" if named else f"/* {node.path}{legend} */"


@dataclass(eq=False)
class Function:
    """A C function: type of the result, name, parameters, body; `part` names it in source maps."""

    result: str
    name: str
    parameters: tuple[str, ...]
    body: list[Statement]
    part: str

    @property
    def head(self) -> str:
        """Declaration before the body."""
        return f"{self.result} {self.name}({', '.join(self.parameters) or 'void'})"

    def arguments(self) -> list[str]:
        """Return the names of the parameters."""
        return [parameter.split()[-1].lstrip("*") for parameter in self.parameters]


@dataclass(frozen=True)
class Mark:
    """Origin of a line of C: its function or struct `part`, and the path of its block or, without one, its role."""

    part: str = ""
    block: str = ""
    role: str = ""


NO_MARK = Mark()


@dataclass
class Listing:
    """Lines of C with a mark for each; `cost` estimates the work of compiling them (see `EmittedProgram`)."""

    lines: list[str] = field(default_factory=list)
    marks: list[Mark] = field(default_factory=list)
    cost: int = 0

    def add(self, text: str, mark: Mark = NO_MARK) -> None:
        """Add whole lines that all have the same mark."""
        more = text.splitlines()
        self.lines += more
        self.marks += [mark] * len(more)

    def function(self, function: Function, role: str = "") -> None:
        """Add a function; lines of no block and no role of their own get `role`."""
        without_unread(function.body)
        self.cost += _cost(function.body)
        used = {name for s in every(function.body) for name in (*s.reads, written(s))}
        head = Mark(function.part, "", "head")
        self.add(f"{function.head}\n{{", head)
        pointers = [p for p, name in zip(function.parameters, function.arguments(), strict=True) if name not in used]
        for idle in pointers:
            if "*" in idle:
                name = idle.split()[-1].lstrip("*")
                self.add(f"    (void){name};", Mark(function.part, "", "unused argument"))
        for line, origin in _lines(function.body, 1, ("", role), role):
            self.add(line, Mark(function.part, *origin))
        self.add("}\n\n", head)

    def text(self) -> str:
        """Return the whole text."""
        return "\n".join(self.lines) + "\n"


def _cost(body: Sequence[Statement]) -> int:
    statements = list(every(body))
    last: dict[str, int] = {}
    for k, s in enumerate(statements):
        if isinstance(s, Assign) and s.declared and s.size is None:
            last[s.target] = k
        last.update((name, k) for name in s.reads & last.keys())
    ends = Counter(last.values())
    alive = total = 0
    for k, s in enumerate(statements):
        alive += isinstance(s, Assign) and s.target in last and bool(s.declared)
        total += alive * alive
        alive -= ends[k]
    return total


def _lines(
    statements: Sequence[Statement], depth: int, around: tuple[str, str], role: str
) -> Iterator[tuple[str, tuple[str, str]]]:
    """Yield the lines of statements, each with its block or role, with a comment where the block or role changes.

    `around` is the block or role that the last comment named, `role` that of statements without one.
    """
    told, indent = around, "    " * depth
    for s in statements:
        mine = (s.owner.path, "") if s.owner is not None else ("", s.role or role)
        comment = COMMENTS.get(s.role, "") if s.owner is None else describe(s.owner)
        if mine != told and comment:
            yield indent + comment, mine
        told = ("", "") if s.role == "condition" else mine
        for head, body in s.parts:
            yield indent + head, mine
            yield from _lines(body, depth + 1, told, role)
        yield indent + (s.last if s.parts else s.text()), mine
