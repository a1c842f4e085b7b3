"""Walking and recomputing expression graphs; iterative, because a graph may be deeper than Python's stack."""

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
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
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "quot": lambda a, b: a // b,
    "rem": lambda a, b: a % b,
    "shl": lambda a, b: a << b,
    "shr": lambda a, b: a >> b,
    "and": lambda a, b: a & b,
    "or": lambda a, b: a | b,
    "xor": lambda a, b: a ^ b,
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "eq": lambda a, b: a == b,
    "ne": lambda a, b: a != b,
    "neg": lambda a: -a,
    "abs": abs,
    "not": lambda a: ~a,
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


def walk(roots: Iterable[Expr], loops: bool = True, known: Container[int] = ()) -> list[Expr]:
    """Every node below `roots`, `ordered`. With `loops` false, loop bodies are not entered."""
    return ordered(roots, attrgetter("args" if loops else "outside"), known)


KEPT = ("vector", "build", "store", "fold", "call")
"""What is computed once before a loop that does not change it; compilers of C see to simple arithmetic themselves."""


def unchanging(
    loop: Expr,
    resolve: Callable[[Expr], Expr] = lambda item: item,
    bodies: Callable[[Expr], Sequence[Expr]] = lambda item: item.bodies,
) -> list[Expr]:
    """Return the arrays, loops and calls in a loop's bodies that are the same at each turn, without those within them.

    They are computed once before the loop: in its bodies, chained products of matrices would cost the product of their
    lengths. `resolve` gives the node that is computed in place of another one, `bodies` those of a loop.
    """
    found: dict[int, Expr] = {}
    turning = 1 << loop.data[1]
    stack = [(resolve(body), turning) for body in bodies(loop)]
    seen: set[tuple[int, int]] = set()
    while stack:
        item, around = stack.pop()
        if (id(item), around) in seen:
            continue
        seen.add((id(item), around))
        if item.op in KEPT and not item.loops & around:
            found[id(item)] = item
            continue
        if item.op in LOOPS:
            stack.extend((resolve(body), around | 1 << item.data[1]) for body in bodies(item))
        stack.extend((resolve(a), around) for a in item.outside)
    return list(found.values())[::-1]


def scope(roots: Iterable[Expr], known: Container[int]) -> list[Expr]:
    """Return the nodes computed beside `roots`, `ordered`: unchanging nodes of loops before them, no loop entered."""
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

    def values_of(roots: Sequence[Expr], bound: Mapping[Any, Any], known: Mapping[int, Any]) -> list[Any]:
        values = dict(known)
        order = scope(roots, known)
        for item in order:
            values[id(item)] = compute(item, [values[id(a)] for a in item.outside], bound, values)
        if sight is not None:
            sight(roots, order, values)
        return [values[id(r)] for r in roots]

    def compute(item: Expr, args: list[Any], bound: Mapping[Any, Any], values: Mapping[int, Any]) -> Any:
        op = item.op
        if op in OPERATIONS:
            return OPERATIONS[op](*args)
        if op == "const":
            return item if recording() else numbers.cast(item.data, item.kind)
        if op == "bound":
            return bound[item.data]
        if op == "convert":
            return convert(args[0], item.kind)
        if op == "bits":
            return bits_of(args[0], item.data)
        if op == "call":
            return functions[item.data](*args)
        if op == "vector":
            return vector(args)
        if op not in LOOPS:
            return leaf_value(item)
        length, depth, *which = item.data
        known = {id(e): values[id(e)] for e in unchanging(item)}

        def turn(*carried: Any) -> list[Any]:
            return values_of(item.bodies, {**bound, **{(depth, j): v for j, v in enumerate(carried)}}, known)

        if op == "build":
            return array_of(length, lambda i: turn(i)[0])
        return fold(length, args, turn)[which[0]]

    return values_of(roots, {}, {})


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
