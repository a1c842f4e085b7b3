"""Statements that give states their next values, which are computed from the old values only."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from twodof.blocks.expressions.expr import Expr
from twodof.blocks.expressions.graph import walk
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
    def numbers(self) -> Sequence[Expr]:
        """Expressions of the numbers to store, each index before its element; none for an array made by a loop."""
        chain = _stores(self.name, self.e)
        if chain:
            return [x for pair in chain for x in pair]
        return self.e.args if self.e.op == "vector" else [self.e] if self.e.width is None else []

    def stores(self, renderer: Renderer, texts: Sequence[Text]) -> list[tuple[Text | None, Text]]:
        """Return the C of (index, value) of each number to store, given that of `numbers`; a scalar's index is None."""
        chain = _stores(self.name, self.e)
        if chain:
            indices = [renderer.index(i, x, self.e.width or 1) for i, (x, _) in zip(texts[::2], chain, strict=True)]
            return list(zip(indices, texts[1::2], strict=True))
        return [(Text(str(k)) if self.e.op == "vector" else None, text) for k, text in enumerate(texts)]


def changed(node: Node, values: Mapping[str, Expr], place: Callable[[str], str]) -> list[StateChange]:
    """Return the changes of a block's states to `values`, by name; `place` gives the lvalue of a state."""
    return [StateChange(node, name, e, place(name)) for name, e in values.items() if not _keeps(name, e)]


def commit(renderer: Renderer, rows: Sequence[StateChange]) -> None:
    """Add the statements of changes that happen together: none reads a state that another has replaced."""
    arrays = [row for row in rows if not row.numbers]
    # The signals that arrays are made of must be computed before any state changes.
    read = [item for row in arrays for item in walk([row.e]) if item.op == "input"]
    texts = iter(renderer.texts([*(e for row in rows for e in row.numbers), *read]))
    stores = []
    for row in rows:
        own = [next(texts) for _ in row.numbers]
        stores += [(row, at, value) for at, value in row.stores(renderer, own)]
    copies: list[tuple[StateChange, Text]] = []
    for row in arrays:
        renderer.owner = row.node
        if any(row.name in _states(other.e) for other in rows if other.node is row.node):
            copies.append((row, _beside(renderer, row)))
        else:
            renderer.assign([(row.place, row.e)])
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
            renderer.put(f"{row.place}[{at.text}]", value, at.reads)
    for row, source in copies:
        renderer.owner = row.node
        renderer.copy(row.place, source, row.e.width or 1, row.e.kind)
    renderer.owner = None


def _kept(renderer: Renderer, row: StateChange, name: str, value: Text, kind: str) -> Text:
    """Keep a number in a variable."""
    new = renderer.names.new(f"{row.node.path}.{name}")
    renderer.declare(new, kind, value, fixed=True)
    return Text(new, reads=frozenset((new,)))


def _beside(renderer: Renderer, row: StateChange) -> Text:
    """Return an array beside the states."""
    source = renderer.text(row.e)
    if row.e.op != "state":
        return source
    new = renderer.names.new(f"{row.node.path}.{row.name}_next")
    renderer.declare(new, row.e.kind, width=row.e.width)
    renderer.copy(new, source, row.e.width or 1, row.e.kind)
    return Text(new, reads=frozenset((new,)))


def _own_name(item: Expr) -> str:
    """Return the name of a state leaf, of a block's own expressions or of the program's."""
    name: str = item.data if isinstance(item.data, str) else item.data[1]
    return name


def _states(e: Expr) -> set[str]:
    return {_own_name(item) for item in walk([e]) if item.op == "state"}


def _keeps(name: str, e: Expr) -> bool:
    return e.op == "state" and _own_name(e) == name


def _stores(name: str, e: Expr) -> list[tuple[Expr, Expr]]:
    """Return (index, value) of each element that `e` replaces in the array state `name`, in order; else []."""
    chain = []
    while e.op == "store":
        chain.append((e.args[1], e.args[2]))
        e = e.args[0]
    return chain[::-1] if _keeps(name, e) else []
