"""The C that replaces a block's states by their next values, all of which are made of the old ones."""

from collections.abc import Iterator, Mapping

from twodof.blocks.expressions.expr import Expr
from twodof.blocks.expressions.graph import leaves
from twodof.compile.c.expressions import Renderer
from twodof.compile.c.names import CNames
from twodof.compile.c.writer import CWriter
from twodof.compile.program.flat_program import Node


def changes(node: Node) -> bool:
    """Whether the discrete states of a block may change."""
    return any(not _keeps(k, e) for k, e in node.trace.update.items())


def numbers_of(update: Mapping[str, Expr]) -> Iterator[Expr]:
    """The numbers of which the next states are made."""
    for name, e in update.items():
        if e.op == "vector":
            yield from e.args
        elif e.width is None:
            yield e
        for index, value in _stores(name, e):
            yield from (index, value)


def _keeps(name: str, e: Expr) -> bool:
    return e.op == "state" and e.data == name


def commit(
    writer: CWriter,
    renderer: Renderer,
    names: CNames,
    node: Node,
    values: Mapping[str, Expr],
    lvalues: Mapping[str, str],
) -> None:
    """Lines that replace states by `values`, all of which read the states before any is replaced."""
    changed = {name: e for name, e in values.items() if not _keeps(name, e)}
    reads = {name: leaves([e], "state") for name, e in changed.items()}
    later: list[tuple[str, str, str]] = []
    wide: list[tuple[str, str, int]] = []
    direct = []
    for name, e in changed.items():
        shared = any(name in read for other, read in reads.items() if other != name)
        chain = _stores(name, e)
        if chain and (shared or len(chain) > 1):
            for index, value in chain:
                i, v = names.new(f"{node.path}.index"), names.new(f"{node.path}.{name}_next")
                writer.index(i, renderer.index(index, e.width or 1))
                writer.line(f"const {renderer.types[e.kind]} {v} = {renderer.text(value)};")
                later.append((name, i, v))
        elif chain:
            direct.append((name, e))
        elif e.width is not None and (shared or name in reads[name]):
            source = renderer.text(e)
            if e.op == "state":
                source = names.new(f"{node.path}.{name}_next")
                writer.line(f"{renderer.types[e.kind]} {source}[{e.width}];")
                writer.copy(source, renderer.text(e), e.width, e.kind, own=True)
            wide.append((name, source, e.width))
        elif shared:
            new = names.new(f"{node.path}.{name}_next")
            writer.line(f"const {renderer.types[e.kind]} {new} = {renderer.text(e)};")
            later.append((name, "", new))
        else:
            direct.append((name, e))
    for name, e in direct:
        chain = _stores(name, e)
        if chain:
            ((index, value),) = chain
            at, (new, _) = renderer.index(index, e.width or 1), renderer.scalars([value])[0]
            writer.put(lvalues[name], at, new, e.kind)
        else:
            renderer.assign([(lvalues[name], e)])
    for changing, at, text in later:
        if at:
            writer.put(lvalues[changing], at, text, changed[changing].kind)
        else:
            writer.assign(lvalues[changing], text, changed[changing].kind)
    for changing, source, width in wide:
        writer.copy(lvalues[changing], source, width, changed[changing].kind)


def _stores(name: str, e: Expr) -> list[tuple[Expr, Expr]]:
    """(index, value) of each element that `e` replaces in the array state `name`, in order; [] for other values."""
    chain = []
    while e.op == "store":
        chain.append((e.args[1], e.args[2]))
        e = e.args[0]
    return chain[::-1] if _keeps(name, e) else []
