"""Functions of C and their listing, in which each line has the block to which it belongs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from twodof.compile.c.statements import (
    Assign,
    IfStatement,
    LoopStatement,
    Statement,
    SwitchStatement,
    every,
    without_unread,
    written,
)
from twodof.compile.program.flat_program import Node

COMMENTS = {
    "rates": "/* which rates are due */",
    "disabled outputs": "/* outputs of what is disabled */",
    "returned signals": "/* what is returned */",
    "integration": "/* the continuous states of the next tick */",
    "disabled states": "/* what is disabled keeps its continuous states */",
    "next tick": "/* the next tick */",
    "next states": "/* the next tick */",
    "pieces": "/* what it does, in pieces */",
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
    """A C function: type of the result, name, parameters, body, a comment `remark`; `part` names it in source maps."""

    result: str
    name: str
    parameters: tuple[str, ...]
    body: list[Statement]
    part: str
    remark: str = ""

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

    def function(self, function: Function, role: str = "", block: str = "") -> None:
        """Add a function; lines of no block and no role of their own get `role`."""
        without_unread(function.body)
        self.cost += _cost(function.body)
        used = {name for s in every(function.body) for name in (*s.reads, written(s))}
        head = Mark(function.part, "", "head")
        if function.remark:
            self.add(f"/* {function.remark} */", head)
        self.add(f"{function.head}\n{{", head)
        pointers = [p for p, name in zip(function.parameters, function.arguments(), strict=True) if name not in used]
        for idle in pointers:
            if "*" in idle:
                name = idle.split()[-1].lstrip("*")
                self.add(f"    (void){name};", Mark(function.part, "", "unused argument"))
        _Body(self, function.part, role).print(function.body, 1, ("", role))
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


class _Body:
    """Prints statements; a comment stands above what belongs together."""

    def __init__(self, listing: Listing, part: str, role: str) -> None:
        self.listing = listing
        self.part = part
        self.role = role

    def print(self, statements: Sequence[Statement], depth: int, around: tuple[str, str]) -> None:
        """Add the lines of statements; `around` is the block or role that the last comment named."""
        told = around
        for statement in statements:
            mine = self._named(statement)
            if mine != told:
                comment = self._comment(statement)
                if comment:
                    self._line(depth, comment, statement)
                told = mine
            self._statement(statement, depth, mine)
            if isinstance(statement, IfStatement) and statement.role == "condition":
                told = ("", "")

    def _named(self, statement: Statement) -> tuple[str, str]:
        if statement.owner is not None:
            return statement.owner.path, ""
        return "", statement.role or self.role

    def _comment(self, statement: Statement) -> str:
        if statement.owner is not None:
            return describe(statement.owner)
        return COMMENTS.get(statement.role, "")

    def _line(self, depth: int, text: str, statement: Statement) -> None:
        block, role = self._named(statement)
        self.listing.add("    " * depth + text, Mark(self.part, block, role))

    def _statement(self, statement: Statement, depth: int, mine: tuple[str, str]) -> None:
        if isinstance(statement, IfStatement):
            self._branch(statement, depth, mine)
        elif isinstance(statement, LoopStatement):
            self._line(depth, f"{statement.head} {{".lstrip(), statement)
            self.print(statement.body, depth + 1, mine)
            self._line(depth, f"}} {statement.end}".rstrip(), statement)
        elif isinstance(statement, SwitchStatement):
            self._line(depth, f"switch ({statement.value}) {{", statement)
            for case in statement.cases:
                if not case.body and case.label == "default":
                    self._line(depth, "default: break;", statement)
                    continue
                comment = f" /* {case.comment} */" if case.comment else ""
                self._line(depth, f"{case.label}: {{{comment}", statement)
                self.print(case.body, depth + 1, mine)
                self._line(depth + 1, "break;", statement)
                self._line(depth, "}", statement)
            self._line(depth, "}", statement)
        else:
            self._line(depth, statement.text(), statement)

    def _branch(self, branch: IfStatement, depth: int, mine: tuple[str, str]) -> None:
        inside = ("", "") if branch.role == "condition" else mine
        self._line(depth, f"if ({branch.test}) {{", branch)
        while True:
            self.print(branch.then, depth + 1, inside)
            rest = branch.otherwise
            if not rest:
                break
            if len(rest) == 1 and isinstance(rest[0], IfStatement):
                branch = rest[0]
                self._line(depth, f"}} else if ({branch.test}) {{", branch)
                continue
            self._line(depth, "} else {", branch)
            self.print(rest, depth + 1, inside)
            break
        self._line(depth, "}", branch)
