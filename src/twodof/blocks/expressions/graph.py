"""Walk, evaluate, measure and print expression graphs; iterative, as a graph may be deeper than Python's stack."""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.arrays import array_of, fold, store, vector
from twodof.blocks.expressions.expr import (
    LOOPS,
    Expr,
    bits_of,
    convert,
    from_bits,
    multiply_high,
    node,
    recording,
    sqrt,
    where,
)
from twodof.errors import DiagramError

OPERATIONS: dict[str, Callable[..., Any]] = {
    **numbers.COMPUTE,
    "sqrt": sqrt,
    "where": where,
    "mulhi": multiply_high,
    "select": lambda array, index: array[index],
    "store": store,
    "from_bits": from_bits,
}


def ordered(roots: Iterable[Expr], below: Callable[[Expr], Sequence[Expr]], known: Container[int] = ()) -> list[Expr]:
    """`roots` and what `below` says that each needs, once, arguments before their users.

    Nodes whose id is in `known` are left out, with what only they need.
    """
    order: list[Expr] = []
    seen: set[int] = set()
    stack: list[tuple[Expr, bool]] = [(r, False) for r in reversed(list(roots))]
    while stack:
        item, done = stack.pop()
        if done:
            order.append(item)
        elif id(item) not in seen and id(item) not in known:
            seen.add(id(item))
            stack.append((item, True))
            stack.extend((a, False) for a in reversed(below(item)))
    return order


def walk(roots: Iterable[Expr], known: Container[int] = ()) -> list[Expr]:
    """Every node below `roots`, those of loops' bodies too, `ordered`."""
    return ordered(roots, attrgetter("args"), known)


KEPT = ("vector", "build", "store", "fold", "call")
"""What is computed once before a loop that does not change it; compilers of C see to simple arithmetic themselves."""


def unchanging(
    loop: Expr, resolve: Callable[[Expr], Expr] = lambda item: item, also: Callable[[Expr], bool] = lambda item: False
) -> list[Expr]:
    """Return the arrays, loops and calls in a loop's bodies that are the same at each turn, without those within them.

    They are computed once before the loop: in its bodies, chained products of matrices would cost the product of their
    lengths. `resolve` gives the node that is computed in place of another one. Nodes for which `also` is true count as
    unchanging.
    """
    found: dict[int, Expr] = {}
    turning = 1 << loop.data[1]
    stack = [(resolve(body), turning) for body in loop.bodies]
    seen: set[tuple[int, int]] = set()
    while stack:
        item, around = stack.pop()
        if (id(item), around) in seen:
            continue
        seen.add((id(item), around))
        if (item.op in KEPT and not item.loops & around) or also(item):
            found[id(item)] = item
            continue
        if item.op in LOOPS:
            stack.extend((resolve(body), around | 1 << item.data[1]) for body in item.bodies)
        stack.extend((resolve(a), around) for a in item.outside)
    return list(found.values())[::-1]


def scope(roots: Iterable[Expr], known: Container[int]) -> list[Expr]:
    """Return the nodes to compute for `roots`, in order; of a loop only the unchanging ones, which stand before it."""
    return ordered(roots, lambda item: (*item.outside, *unchanging(item)) if item.op in LOOPS else item.outside, known)


def leaves(roots: Iterable[Expr], op: str) -> set[str]:
    """Return the names of the leaves of kind `op` that `roots` depend on."""
    return {n.data for n in walk(roots) if n.op == op}


def of_kinds(roots: Iterable[Expr], kinds: Mapping[str, str]) -> list[Expr]:
    """Return the graphs of `roots` with each kind of value replaced by the one that `kinds` gives."""
    made: dict[int, Expr] = {}
    order = walk(roots := list(roots))
    for item in order:
        args = tuple(made[id(a)] for a in item.args)
        made[id(item)] = node(item.op, kinds.get(item.kind, item.kind), args, item.data, item.width)
    return [made[id(r)] for r in roots]


Sight = Callable[[Sequence[Expr], Sequence[Expr], Mapping[int, Any]], None]
"""Is shown roots that were computed, all nodes computed for them, arguments before their users, and values by id."""


def evaluate(
    roots: Sequence[Expr],
    leaf_value: Callable[[Expr], Any],
    functions: Mapping[str, Callable[..., Any]],
    sight: Sight | None = None,
) -> list[Any]:
    """Recompute a graph on other values: numbers compute, Exprs record again (so this is also substitution).

    `leaf_value` gives the value of an input, state, param, tick or dt leaf; `functions` the elementary functions by
    name. Under `tracing`, loops are recorded as loops; otherwise they are run. `sight` is shown each turn of each loop,
    and then the whole.
    """

    def compute(item: Expr, args: list[Any]) -> Any:
        op = item.op
        if op in OPERATIONS:
            return OPERATIONS[op](*args)
        if op == "const":
            return item if recording() else numbers.cast(item.data, item.kind)
        if op == "convert":
            return convert(args[0], item.kind)
        if op == "bits":
            return bits_of(args[0], item.data)
        if op == "call":
            return functions[item.data](*args)
        return vector(args) if op == "vector" else leaf_value(item)

    return followed(roots, compute, array_of, fold, {}, sight)


def followed(
    roots: Sequence[Expr],
    compute: Callable[[Expr, list[Any]], Any],
    build: Callable[..., Any],
    fold: Callable[..., tuple[Any, ...]],
    known: dict[Any, Any],
    sight: Sight | None = None,
) -> list[Any]:
    """Follow a graph from its leaves to `roots`, and return their values.

    `compute` gives the value of a node from those of its arguments. `build` and `fold` run loops as `array_of` and
    `fold` do. `known` are the values computed before, by the node's id; the new ones are added. `sight`: as `evaluate`.
    """

    def values_of(roots: Sequence[Expr], bound: Mapping[Any, Any], values: dict[Any, Any]) -> list[Any]:
        order = scope(roots, values)
        for item in order:
            values[id(item)] = value_of(item, [values[id(a)] for a in item.outside], bound, values)
        if sight is not None:
            sight(roots, order, values)
        return [values[id(r)] for r in roots]

    def value_of(item: Expr, args: list[Any], bound: Mapping[Any, Any], values: dict[Any, Any]) -> Any:
        if item.op == "bound":
            return bound[item.data]
        if item.op not in LOOPS:
            return compute(item, args)
        length, depth, *which = item.data
        before = {id(e): values[id(e)] for e in unchanging(item)}

        def turn(*carried: Any) -> list[Any]:
            variables = {(depth, j): v for j, v in enumerate(carried)}
            return values_of(item.bodies, {**bound, **variables}, dict(before))

        if item.op == "build":
            return build(length, lambda i: turn(i)[0])
        run = (length, depth, *map(id, item.args))  # all results of a loop come from one run of it
        if run not in values:
            values[run] = fold(length, args, turn)
        return values[run][which[0]]

    return values_of(roots, {}, known)


def free_bounds(roots: Sequence[Expr]) -> dict[int, frozenset[tuple[int, int, str]]]:
    """For each of `roots`, by id: the loop variables (depth, which, kind) below it that no loop binds.

    Raises DiagramError where a loop's body uses its variables with another type or number than the loop gives them.
    """
    # Sets as bits of one integer each: of a large graph all of them together stay small.
    variables: dict[tuple[int, int, str], int] = {}
    names: list[tuple[int, int, str]] = []
    free: dict[int, int] = {}
    for item in walk(roots):
        below = 0
        for a in item.outside:
            below |= free[id(a)]
        if item.op == "bound":
            variable = (*item.data, item.kind)
            if variable not in variables:
                variables[variable] = len(names)
                names.append(variable)
            below = 1 << variables[variable]
        elif item.op in ("build", "fold"):
            starts = item.outside
            kinds = ["int32", *(s.kind for s in starts)]
            depth = item.data[1]
            inside = 0
            for body in item.bodies:
                inside |= free[id(body)]
            for bit, (d, which, kind) in enumerate(names):
                if not inside >> bit & 1:
                    continue
                if d != depth:
                    below |= 1 << bit
                elif which >= len(kinds) or kinds[which] != kind:
                    raise DiagramError(f"a loop has no variable {which} of type {kind}", "", "record the loop again")
        free[id(item)] = below
    return {id(r): frozenset(v for i, v in enumerate(names) if free[id(r)] >> i & 1) for r in roots}


MAX_SIZE = 50_000
"""Nodes of a graph, each loop's body counted where it stands: what a compiler gets to see."""
MAX_OPERATIONS = 1_000_000
"""Elementary operations of one step."""
MAX_LOOP_DEPTH = 8

CALL = 30  # an elementary function in operations, about the longest of them
COPIED = 64  # elements of an array that are copied in the time of one operation


@dataclass(frozen=True)
class ExpressionCost:
    """Cost of a graph: `size`, the number of compiled nodes, and `operations`, the number in one evaluation."""

    size: int = 0
    operations: int = 0

    def __add__(self, other: ExpressionCost) -> ExpressionCost:
        return ExpressionCost(self.size + other.size, self.operations + other.operations)


class CostMeter:
    """Measures graphs; those of one meter may share loops, which are then measured once.

    A body that two loops share is compiled and computed in each of them. What a loop does not change is computed once,
    before it. So a few hundred nested loops can stand for more operations than there are atoms. The
    numbers grow so fast only for nested loops, whose depth is bounded.
    """

    def __init__(self, most: int | None = MAX_SIZE) -> None:
        self.most = most  # the largest size; None: any, and loops of any depth
        self._loops: dict[int, tuple[ExpressionCost, int]] = {}
        self._before: dict[int, list[Expr]] = {}
        self._kept: list[Expr] = []  # so that an identity stays that of one node
        self._visited = 0

    def measure(self, roots: Iterable[Expr]) -> ExpressionCost:
        """Measure the effort of evaluating `roots` once. Raises DiagramError if it is beyond any diagram's limit."""
        roots = list(roots)
        nodes = self._scope(roots, {})
        new = any(n.op in LOOPS and id(n) not in self._loops for n in nodes)
        for loop in walk(roots) if new else ():  # inner loops come before those around them
            if loop.op not in LOOPS or id(loop) in self._loops:
                continue
            before = {id(e): None for e in self._unchanging(loop)}
            effort, depth = self._sum(self._scope(loop.bodies, before))
            if self.most is not None and depth + 1 > MAX_LOOP_DEPTH:
                raise DiagramError(
                    f"loops are nested more than {MAX_LOOP_DEPTH} deep", "", "use fewer loops within one another"
                )
            length, copied = loop.data[0], sum(e.width or 0 for e in loop.bodies)
            operations = 1 + length * (1 + copied + effort.operations)
            self._loops[id(loop)] = (ExpressionCost(1 + effort.size, operations), depth + 1)
            self._kept.append(loop)
        return self._sum(nodes)[0]

    def _scope(self, roots: Iterable[Expr], known: Mapping[int, None]) -> list[Expr]:
        """As `graph.scope`, in any order and so in half the time."""
        nodes: dict[int, Expr] = {}
        stack = list(roots)
        while stack:
            item = stack.pop()
            if id(item) not in nodes and id(item) not in known:
                nodes[id(item)] = item
                stack.extend(item.outside)
                if item.op in LOOPS:
                    stack.extend(self._unchanging(item))
        self._visit(len(nodes))
        return list(nodes.values())

    def _unchanging(self, loop: Expr) -> list[Expr]:
        """Return the nodes computed once before a loop; the time of finding them is bounded too."""
        if id(loop) not in self._before:

            def counted(item: Expr) -> Expr:
                self._visit(1)
                return item

            self._before[id(loop)] = unchanging(loop, counted)
            self._kept.append(loop)
        return self._before[id(loop)]

    def _visit(self, nodes: int) -> None:
        """Bounds the time of measuring itself by the sum of all bodies."""
        self._visited += nodes
        self._check(self._visited // 10)

    def _sum(self, nodes: Iterable[Expr]) -> tuple[ExpressionCost, int]:
        """Return the effort of `nodes`, a loop as one of them, and how deep loops are nested."""
        size = operations = depth = 0
        for item in nodes:
            if item.op in LOOPS:
                inner, below = self._loops[id(item)]
                size += inner.size
                operations += inner.operations
                depth = max(depth, below)
            else:
                elements = len(item.args) if item.op == "vector" else 0
                size += 1 + elements
                operations += CALL if item.op == "call" else 1
                operations += (item.width or 0) // COPIED if item.op == "store" else elements
        self._check(size)
        return ExpressionCost(size, operations), depth

    def _check(self, size: int) -> None:
        if self.most is not None and size > self.most:
            raise too_large()


def too_large() -> DiagramError:
    """Return the error for an expression of more than MAX_SIZE."""
    return DiagramError(f"expressions of more than {MAX_SIZE} operations", "", "compute less, or in loops")


MAX_TEXT = 72
_DEPTH = 4
_INFIX: Mapping[str, str] = {
    "add": "+", "sub": "-", "mul": "*", "div": "/", "quot": "//", "rem": "%", "shl": "<<", "shr": ">>",
    "and": "&", "or": "|", "xor": "^",
}  # fmt: skip
_COMPARES: Mapping[str, str] = {"lt": "<", "le": "<=", "eq": "==", "ne": "!="}
_TURNED: Mapping[str, str] = {"lt": ">", "le": ">="}
_PREFIX: Mapping[str, str] = {"neg": "-", "not": "~"}
_SECONDS = "to_real(x.elapsed) * t.dt"
_LEAVES: Mapping[str, str] = {"input": "u.", "state": "x.", "param": "p.", "tick": "t.", "dt": "t."}


def text_of(item: Expr) -> str:
    """`item` in the language's own words, such as `u.u < p.low`."""
    text = _text(item, _DEPTH)
    return text if len(text) <= MAX_TEXT else text[: MAX_TEXT - 3] + "..."


def machine_text(item: Expr) -> str:
    """Return a guard or an action's value of a state machine in the words of its function."""
    text = text_of(item).replace(f"({_SECONDS})", "t.elapsed_time").replace(_SECONDS, "t.elapsed_time")
    return re.sub(r"\bx\.elapsed\b", "t.elapsed", text)


def limit_of(item: Expr) -> tuple[str, Expr, Expr] | None:
    """Return ("min" or "max", a, b) for the expression recorded by minimum(a, b) or maximum(a, b), else None."""
    if item.op != "where" or item.args[0].op != "lt":
        return None
    low, high = item.args[0].args
    if item.args[1] is low and item.args[2] is high:
        return "min", low, high
    if item.args[1] is high and item.args[2] is low:
        return "max", high, low
    return None


def _text(item: Expr, depth: int) -> str:
    if item.op in _LEAVES:
        return f"{_LEAVES[item.op]}{item.data}"
    if item.op == "const":
        return f"{item.data:g}" if isinstance(item.data, float) else str(item.data).lower()
    if item.op == "bound":
        return "i" if item.data[1] == 0 else f"s{item.data[1]}"
    if depth == 0 or not item.args:
        return "..."
    limit = limit_of(item)
    if limit is not None:
        return f"{limit[0]}({_text(limit[1], depth - 1)}, {_text(limit[2], depth - 1)})"
    args = [_text(a, depth - 1) for a in item.args[:4]]
    if item.op in _COMPARES:
        if item.args[0].op == "const" and item.op in _TURNED:
            return f"{args[1]} {_TURNED[item.op]} {args[0]}"  # u > 5 is recorded as 5 < u
        return f"{args[0]} {_COMPARES[item.op]} {args[1]}"
    if item.op in _INFIX:
        return " ".join((_inner(item.args[0], args[0]), _INFIX[item.op], _inner(item.args[1], args[1])))
    if item.op in _PREFIX:
        return _PREFIX[item.op] + _inner(item.args[0], args[0])
    if item.op == "select":
        return f"{args[0]}[{args[1]}]"
    name = {"call": item.data, "convert": f"to_{item.kind}"}.get(item.op, item.op)
    if item.op in ("build", "fold"):
        return f"{name}(...)"
    return f"{name}({', '.join(args)}{', ...' if len(item.args) > len(args) else ''})"


def _inner(item: Expr, text: str) -> str:
    """Return the text of an operand, in parentheses where it is an operation of two itself."""
    return f"({text})" if item.op in _INFIX or item.op in _COMPARES else text
