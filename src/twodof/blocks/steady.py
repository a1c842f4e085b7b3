"""steady_trace: the trace of a block of which it is certain that it stays the same."""

from collections.abc import Mapping, Sequence

from twodof.blocks.block import Block
from twodof.blocks.declarations import located
from twodof.blocks.expressions.expr import Expr
from twodof.blocks.expressions.graph import free_bounds, walk
from twodof.blocks.mistakes import HIDDEN, is_users, place
from twodof.blocks.trace import Trace, by_method, clock_leaves, leaves_of, trace_of
from twodof.errors import DiagramError


def steady_trace(block: Block, path: str) -> Trace:
    """The trace of the block at `path`. A user's block is checked anew; DiagramError if it is not steady."""
    try:
        trace = block.trace
        if is_users(block):
            check_steady(block)
    except DiagramError as error:
        raise DiagramError(error.what, f"{path}, {error.where}", error.remedy) from error
    return trace


def check_steady(block: Block) -> None:
    """Trace a block again. Raises DiagramError if that gives another graph than the first time.

    What is compiled is the first graph. A method that depends on more than it is given would mean another thing at
    each step of the reference. Values that another block or a loop recorded are refused too.
    """
    first, again = by_method(block.trace), by_method(trace_of(block))
    prepared, stepped = _own(block)
    for method, exprs in first.items():
        for name in exprs | again[method]:
            # By identity: equal graphs are one node, and == on two of them would record a comparison.
            if list(map(id, exprs.get(name, ()))) != list(map(id, again[method].get(name, ()))):
                raise DiagramError(
                    f"{method} gives another {name!r} when it is traced again", place(block, method), HIDDEN
                )
        own = prepared if method == "prepare" else stepped
        _check_own(block, method, [e for roots in exprs.values() for e in roots], own)


def _own(block: Block) -> tuple[dict[int, Expr], dict[int, Expr]]:
    """The leaves that `prepare` is given, and those that the other methods are, by id."""
    clock = clock_leaves()
    prepared = [*leaves_of("param", block.params).values(), clock["dt"], clock["base_dt"]]
    stepped = [*prepared, clock["tick"], *leaves_of("param", block.derived).values()]
    stepped += [*leaves_of("input", block.inputs).values(), *leaves_of("state", block.states).values()]
    return {id(e): e for e in prepared}, {id(e): e for e in stepped}


def _check_own(block: Block, method: str, roots: Sequence[Expr], own: Mapping[int, Expr]) -> None:
    """Raise DiagramError if `roots` hold a leaf that the method was not given, or a variable outside its loop."""
    for item in walk(roots):
        if item.op in ("input", "state", "param", "tick", "dt") and id(item) not in own:
            raise DiagramError(f"{method} uses a value that it was not given, {item!r}", place(block, method), HIDDEN)
    with located(place(block, method)):
        if any(free_bounds(roots).values()):
            raise DiagramError(
                f"{method} uses a variable of a loop outside that loop", "", "return what a loop computes from its body"
            )
