"""Commit: the statements that replace a block's states by their next values, which read only the old ones."""

from collections.abc import Callable, Mapping, Sequence
from itertools import islice

from twodof.blocks.expressions.expr import Expr
from twodof.blocks.expressions.graph import walk
from twodof.compile.c.expressions import SMALL_ARRAY, Renderer
from twodof.compile.c.statements import Text, name_of
from twodof.compile.program.flat_program import Node


def changes(node: Node) -> bool:
    """Return True if the discrete states of a block may change."""
    return any(not _keeps(k, e) for k, e in node.trace.update.items())


class Commit:
    """Replaces the states of `node` by `values`.

    `roots` are the numbers that the values are made of: they may be computed earlier, with what shares their terms.
    """

    def __init__(self, node: Node, values: Mapping[str, Expr], lvalue: Callable[[str], str]) -> None:
        self.node = node
        self.lvalue = lvalue
        self.changed = {name: e for name, e in values.items() if not _keeps(name, e)}
        self.roots: list[Expr] = []
        read: list[Expr] = []  # signals that arrays are made of, which must be computed before any state changes
        for name, e in self.changed.items():
            numbers = _numbers(name, e)
            self.roots += numbers
            if not numbers:
                read += [item for item in walk([e]) if item.op == "input"]
        self.roots += read

    @property
    def written(self) -> set[str]:
        """The lvalues of the states that change."""
        return {self.lvalue(name) for name in self.changed}

    def keep(self, renderer: Renderer, k: int, text: Text) -> Text:
        """Keep a root in a variable, before a state that it reads changes."""
        outer, renderer.owner = renderer.owner, self.node
        kept = self._kept(renderer, "old", text, self.roots[k].kind)
        renderer.owner = outer
        return kept

    def write(self, renderer: Renderer, texts: Sequence[Text]) -> None:
        """Add the statements; `texts` are those of the roots."""
        outer, renderer.owner = renderer.owner, self.node
        given = iter(texts)
        parts = {name: list(islice(given, len(_numbers(name, e)))) for name, e in self.changed.items()}
        reads = {
            name: _states(e).union(*(self._named(text) for text in parts[name])) for name, e in self.changed.items()
        }
        now: list[tuple[str, Text | None, Text]] = []
        later: list[tuple[str, Text | None, Text]] = []
        copied: list[tuple[str, Text]] = []
        for name, e in self.changed.items():
            shared = any(name in read for other, read in reads.items() if other != name)
            pairs = self._pairs(renderer, name, parts[name])
            first = shared or (len(pairs) != 1 and name in reads[name])  # made before any state changes
            for at, value in pairs:
                if first:
                    kept = self._kept(renderer, "index", at, "int32") if at is not None and at.reads else at
                    later.append((name, kept, self._next(renderer, name, value)))
                else:
                    now.append((name, at, value))
            if not pairs and first:
                copied.append((name, self._array(renderer, name, e)))
            elif not pairs:
                renderer.assign([(self.lvalue(name), e)])
        for name, at, value in (*now, *later):
            self._put(renderer, name, at, value)
        for name, source in copied:
            renderer.copy(self.lvalue(name), source, self.changed[name].width or 1, self.changed[name].kind)
        renderer.owner = outer

    def _pairs(self, renderer: Renderer, name: str, parts: Sequence[Text]) -> list[tuple[Text | None, Text]]:
        """Return (index, value) of each number to store; a scalar has no index. Return [] to store a whole array."""
        e = self.changed[name]
        chain = _stores(name, e)
        if chain:
            indices = [renderer.index(i, x, e.width or 1) for i, (x, _) in zip(parts[::2], chain, strict=True)]
            return list(zip(indices, parts[1::2], strict=True))
        if e.op == "vector" and len(e.args) <= SMALL_ARRAY:
            return [(Text(str(k)), value) for k, value in enumerate(parts)]
        return [(None, parts[0])] if e.width is None else []

    def _named(self, text: Text) -> set[str]:
        """Return the names of the block's changing states that a text reads."""
        return {name for name in self.changed if self.lvalue(name) in text.reads}

    def _put(self, renderer: Renderer, name: str, at: Text | None, value: Text) -> None:
        place = self.lvalue(name)
        if at is not None:
            renderer.put(f"{place}[{at.text}]", value, at.reads)
        else:
            renderer.put(place, value)

    def _next(self, renderer: Renderer, name: str, value: Text) -> Text:
        return self._kept(renderer, f"{name}_next", value, self.changed[name].kind)

    def _kept(self, renderer: Renderer, name: str, value: Text, kind: str) -> Text:
        """Keep a number in a variable."""
        new = renderer.names.new(f"{self.node.path}.{name}")
        renderer.declare(new, kind, value, fixed=True)
        return Text(new, reads=frozenset((new,)))

    def _array(self, renderer: Renderer, name: str, e: Expr) -> Text:
        """Return an array beside the states."""
        (source,) = renderer.texts([e])
        if e.op != "state":
            return source
        new = renderer.names.new(f"{self.node.path}.{name}_next")
        renderer.declare(new, e.kind, width=e.width)
        renderer.copy(new, source, e.width or 1, e.kind)
        return Text(new, reads=frozenset((name_of(new),)))


def _numbers(name: str, e: Expr) -> Sequence[Expr]:
    """Return the numbers that the next value of a state is made of; none of an array that a loop makes."""
    chain = _stores(name, e)
    if chain:
        return [x for pair in chain for x in pair]
    return e.args if e.op == "vector" else [e] if e.width is None else []


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
