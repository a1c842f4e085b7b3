"""Statements that give states their next values, which are computed from the old values only."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from twodof.blocks.expressions.expr import Expr
from twodof.blocks.expressions.expr import node as make
from twodof.blocks.expressions.graph import ordered
from twodof.compile.c.expressions import Renderer
from twodof.compile.c.statements import Text
from twodof.compile.program.flat_program import Node


def changes(node: Node) -> bool:
    """Return True if the discrete states of a block may change."""
    return any(not _keeps(k, e) for k, e in node.trace.update.items())


@dataclass
class StateChange:
    """The next value `e` of the state `name` of `node`, whose lvalue is `place`."""

    node: Node
    name: str
    e: Expr
    place: str

    @property
    def numbers(self) -> Sequence[tuple[Expr | None, Expr]]:
        """Numbers to store, each with its index in an array; none for an array made by a loop."""
        if self.e.width is None:
            return [(None, self.e)]
        if self.e.op == "vector":
            return [(make("const", "int32", (), k), element) for k, element in enumerate(self.e.args)]
        chain, e = [], self.e
        while e.op == "store":
            chain.append((e.args[1], e.args[2]))
            e = e.args[0]
        return chain[::-1] if _keeps(self.name, e) else []

    @property
    def roots(self) -> list[Expr]:
        """Expressions of the numbers, each index before its element."""
        return [e for pair in self.numbers for e in pair if e is not None]


def changed(node: Node, values: Mapping[str, Expr], place: Callable[[str], str]) -> list[StateChange]:
    """Return the changes of a block's states to `values`, by name; `place` gives the lvalue of a state."""
    return [StateChange(node, name, e, place(name)) for name, e in values.items() if not _keeps(name, e)]


def commit(renderer: Renderer, rows: Sequence[StateChange]) -> None:
    """Add the statements of changes that happen together: none reads a state that another has replaced."""
    arrays = [row for row in rows if not row.numbers]
    # The signals that arrays are made of must be computed before any state changes.
    read = [item for item in _own(row.e for row in arrays) if item.op == "signal"]
    texts = iter(renderer.texts([*(e for row in rows for e in row.roots), *read]))
    stores = []
    for row in rows:
        for index, _ in row.numbers:
            at = None if index is None else renderer.index(next(texts), index, row.e.width or 1)
            stores.append((row, at, next(texts)))
    copies: list[tuple[StateChange, Text]] = []
    for row in arrays:
        renderer.owner = row.node
        beside = _own(other.e for other in rows if other.node is row.node)
        place = row.place
        if any(item.op == "state" and _own_name(item) == row.name for item in beside):
            place = renderer.names.new(f"{row.node.path}.{row.name}_next")
            renderer.declare(place, row.e.kind, width=row.e.width)
            copies.append((row, Text.of(place)))
        renderer.assign([(place, row.e)])
    replaced: set[str] = set()
    ready: list[tuple[StateChange, Text | None, Text]] = []
    for row, at, value in stores:
        renderer.owner = row.node
        if at is not None and at.reads & replaced:
            at = _kept(renderer, row, "index", at, "int32")
        if value.reads & replaced:
            value = _kept(renderer, row, f"{row.name}_next", value, row.e.kind)
        ready.append((row, at, value))
        replaced.add(row.place)
    for row, at, value in ready:
        renderer.owner = row.node
        if at is None:
            renderer.put(row.place, value)
        else:
            renderer.put(f"{row.place}[{at.text}]", value, more=at.reads)
    for row, source in copies:
        renderer.owner = row.node
        renderer.put(row.place, source, row.e.kind, row.e.width)
    renderer.owner = None


def _kept(renderer: Renderer, row: StateChange, name: str, value: Text, kind: str) -> Text:
    """Keep a number in a variable."""
    new = renderer.names.new(f"{row.node.path}.{name}")
    renderer.declare(new, kind, value, fixed=True)
    return Text.of(new)


def _own_name(item: Expr) -> str:
    """Return the name of a state leaf, of a block's own expressions or of the program's."""
    name: str = item.data if isinstance(item.data, str) else item.data[1]
    return name


def _own(roots: Iterable[Expr]) -> list[Expr]:
    """Return the nodes of a block's own expressions, with the signals that it reads."""
    return ordered(roots, lambda item: () if item.op == "signal" else item.args)


def _keeps(name: str, e: Expr) -> bool:
    return e.op == "state" and _own_name(e) == name
