"""A block's recorded expressions on whole arrays of cases at once, and mutants of them."""

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks import Block
from twodof.blocks.expressions.expr import Expr, const, node
from twodof.blocks.expressions.graph import walk
from twodof.signals import PERIOD

Array = NDArray[Any]
Columns = Mapping[Any, Any]
Graph = dict[str, Expr]
"""Section and name, "output.state" or "update.timer", -> expression."""

NUMPY: dict[str, Callable[..., Any]] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "neg": np.negative,
    "abs": np.abs,
    "lt": np.less,
    "le": np.less_equal,
    "eq": np.equal,
    "ne": np.not_equal,
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "xor": np.bitwise_xor,
    "not": np.invert,
    "where": np.where,
}
DTYPES = {"int32": np.int32, "bool": np.bool_, "real": np.float64}


def tell(what: str) -> None:
    """Print a figure that a test found; pytest shows it with -s or -rA."""
    sys.stdout.write(f"{what}\n")


def graph_of(block: Block) -> Graph:
    """Return the expressions of the block's outputs and next discrete states."""
    trace = block.trace
    sections = {"output": trace.outputs, "update": trace.update}
    return {f"{section}.{name}": e for section, exprs in sections.items() for name, e in exprs.items()}


def on_arrays(graph: Graph, columns: Columns) -> dict[str, Array]:
    """Every expression of `graph`; inputs, states and parameters are `columns` by name or (kind, name), of one length
    or scalars.
    """
    values: dict[int, Any] = {}
    _evaluate(walk(graph.values()), columns, values)
    length = max(np.size(column) for column in columns.values())
    return {name: np.broadcast_to(values[id(e)], length) for name, e in graph.items()}


def mutants_on_arrays(
    graph: Graph, among: Iterable[tuple[str, Graph]], columns: Columns
) -> Iterator[tuple[str, dict[str, Array]]]:
    """Yield each mutant's description and the values of its changed expressions on `columns`.

    Only nodes that depend on the fault are computed.
    """
    known: dict[int, Any] = {}
    _evaluate(walk(graph.values()), columns, known)
    length = max(np.size(column) for column in columns.values())
    for what, mutant in among:
        changed = {name: e for name, e in mutant.items() if e is not graph[name]}
        values = dict(known)
        _evaluate(_unknown(changed.values(), known), columns, values)
        yield what, {name: np.broadcast_to(values[id(e)], length) for name, e in changed.items()}


def _unknown(roots: Iterable[Expr], known: Mapping[int, Any]) -> list[Expr]:
    """The nodes below `roots` whose values are not known, arguments before their users."""
    order: list[Expr] = []
    seen: set[int] = set()

    def visit(item: Expr) -> None:
        if id(item) not in known and id(item) not in seen:
            seen.add(id(item))
            for argument in item.args:
                visit(argument)
            order.append(item)

    for root in roots:
        visit(root)
    return order


def _evaluate(items: Iterable[Expr], columns: Columns, values: dict[int, Any]) -> None:
    """Adds the values of `items`, by identity."""
    with np.errstate(all="ignore"):
        for item in items:
            if item.op == "const":
                values[id(item)] = DTYPES[item.kind](item.data)
            elif item.op == "dt":
                values[id(item)] = PERIOD
            elif item.op == "convert":
                values[id(item)] = np.asarray(values[id(item.args[0])]).astype(DTYPES[item.kind])
            elif item.op in NUMPY:
                values[id(item)] = NUMPY[item.op](*(values[id(a)] for a in item.args))
            else:
                given = columns[item.data] if item.data in columns else columns[item.op, item.data]
                values[id(item)] = np.asarray(given, DTYPES[item.kind])


def combinations(**choices: Sequence[Any]) -> dict[str, Array]:
    """Every combination of the values given by name, as columns of one length."""
    grid = np.meshgrid(*(np.arange(len(values)) for values in choices.values()), indexing="ij")
    return {
        name: np.asarray(values)[index.ravel()] for (name, values), index in zip(choices.items(), grid, strict=True)
    }


def flags(*names: str) -> dict[str, Sequence[Any]]:
    """False and true for each name: a choice for `combinations`."""
    return dict.fromkeys(names, (False, True))


def mutants(graph: Graph) -> Iterator[tuple[str, Graph]]:
    """Every graph with one small fault in it, and what the fault is.

    An operation is exchanged for a relative (< for <=, + for -), a choice for one of its branches. Each use of a
    constant or an integer parameter is off by one; each use of a flag is negated, true or false.
    """
    items = walk(graph.values())
    place = {id(item): number for number, item in enumerate(items)}
    for number, item in enumerate(items):
        users = _users(item, items[number + 1 :])
        for what, other in _relatives(item):
            yield f"{place[id(item)]} {item.op}: {what}", _replaced(graph, users, item, other)
        for position, argument in enumerate(item.args):
            for what, other in _misused(argument):
                args = (*item.args[:position], other, *item.args[position + 1 :])
                changed = node(item.op, item.kind, args, item.data, item.width)
                if changed is not item:
                    yield f"{place[id(item)]} {item.op}[{position}]: {what}", _replaced(graph, users, item, changed)


def _relatives(item: Expr) -> Iterator[tuple[str, Expr]]:
    a = item.args
    swaps = {"lt": "le", "le": "lt", "eq": "ne", "ne": "eq", "and": "or", "or": "and", "add": "sub", "sub": "add"}
    if item.op in swaps:
        yield f"{swaps[item.op]}", node(swaps[item.op], item.kind, a)
    if item.op in ("lt", "le"):
        yield "the other way round", node(item.op, item.kind, (a[1], a[0]))
    if item.op in ("mul", "div"):
        yield "add", node("add", item.kind, a)
    if item.op in ("not", "abs", "neg"):
        yield "left out", a[0]
    if item.op == "where":
        yield "always the first", a[1]
        yield "always the second", a[2]
        yield "exchanged", node("where", item.kind, (a[0], a[2], a[1]))


def _misused(argument: Expr) -> Iterator[tuple[str, Expr]]:
    if argument.op == "const" and argument.kind == "int32":
        for shift in (-1, 1):
            yield f"{argument.data} is {argument.data + shift}", const(argument.data + shift, "int32")
    elif argument.op == "const" and argument.kind == "real":
        yield f"{argument.data} is {argument.data + 0.5}", const(argument.data + 0.5, "real")
    elif argument.op == "param" and argument.kind == "int32":
        for op in ("sub", "add"):
            yield f"{argument.data} {op} 1", node(op, "int32", (argument, const(1, "int32")))
    elif argument.kind == "bool":
        name = argument.data if argument.op in ("input", "state", "param") else argument.op
        for constant in (False, True):
            yield f"{name} is {constant}", const(constant, "bool")
        yield f"{name} is negated", node("not", "bool", (argument,))


def _users(item: Expr, later: Sequence[Expr]) -> list[Expr]:
    """Return the nodes among `later` that depend on `item`, arguments before their users."""
    depend = {id(item)}
    users = []
    for other in later:
        if any(id(a) in depend for a in other.args):
            depend.add(id(other))
            users.append(other)
    return users


def _replaced(graph: Graph, users: Sequence[Expr], old: Expr, new: Expr) -> Graph:
    """`graph` with `new` in the place of the node `old`, whose own arguments stay; `users` depend on it."""
    made: dict[int, Expr] = {id(old): new}
    for item in users:
        args = tuple(made.get(id(a), a) for a in item.args)
        made[id(item)] = node(item.op, item.kind, args, item.data, item.width)
    return {name: made.get(id(e), e) for name, e in graph.items()}
