"""Walking and recomputing expression graphs; iterative, because a graph may be deeper than Python's stack."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.arrays import array_of, fold, store, vector
from twodof.blocks.expressions.expr import Expr, bits_of, convert, from_bits, multiply_high, recording, sqrt, where
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


def walk(roots: Iterable[Expr], loops: bool = True) -> list[Expr]:
    """Every node below `roots` once, arguments before their users. With `loops` false, loop bodies are not entered."""
    order: list[Expr] = []
    seen: set[int] = set()
    stack: list[tuple[Expr, bool]] = [(r, False) for r in reversed(list(roots))]
    while stack:
        item, done = stack.pop()
        if done:
            order.append(item)
        elif id(item) not in seen:
            seen.add(id(item))
            stack.append((item, True))
            stack.extend((a, False) for a in reversed(item.args if loops else outside(item)))
    return order


def outside(item: Expr) -> tuple[Expr, ...]:
    """The arguments evaluated outside a node's loop: all of them, a fold's initial values, none of a build's."""
    if item.op == "build":
        return ()
    if item.op == "fold":
        return item.args[: len(item.args) // 2]
    return item.args


def leaves(roots: Iterable[Expr], op: str) -> set[str]:
    """The names of the leaves of kind `op` that `roots` depend on."""
    return {n.data for n in walk(roots) if n.op == op}


Sight = Callable[[Sequence[Expr], Sequence[Expr], Mapping[int, Any]], None]
"""Is shown roots that were computed, all nodes computed for them, arguments before their users, and values by id."""


def evaluate(
    roots: Sequence[Expr],
    leaf_value: Callable[[Expr], Any],
    functions: Mapping[str, Callable[..., Any]],
    sight: Sight | None = None,
) -> list[Any]:
    """Recompute a graph on other values: numbers compute, Exprs record anew (so this is also substitution).

    `leaf_value` gives the value of an input, state, param, tick or dt leaf; `functions` the elementary functions by
    name. Under `tracing`, loops are recorded as loops; otherwise they are run. `sight` is shown each turn of each loop,
    and then the whole.
    """

    def values_of(roots: Sequence[Expr], bound: Mapping[Any, Any]) -> list[Any]:
        values: dict[int, Any] = {}
        order = walk(roots, loops=False)
        for item in order:
            values[id(item)] = compute(item, [values[id(a)] for a in outside(item)], bound)
        if sight is not None:
            sight(roots, order, values)
        return [values[id(r)] for r in roots]

    def compute(item: Expr, args: list[Any], bound: Mapping[Any, Any]) -> Any:
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
        if op == "build":
            length, depth = item.data
            return array_of(length, lambda i: values_of(item.args, {**bound, (depth, 0): i})[0])
        if op == "fold":
            length, depth, which = item.data
            bodies = item.args[len(args) :]

            def step(*values: Any) -> list[Any]:
                return values_of(bodies, {**bound, **{(depth, j): v for j, v in enumerate(values)}})

            return fold(length, args, step)[which]
        return leaf_value(item)

    return values_of(roots, {})


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
        for a in outside(item):
            below |= free[id(a)]
        if item.op == "bound":
            variable = (*item.data, item.kind)
            if variable not in variables:
                variables[variable] = len(names)
                names.append(variable)
            below = 1 << variables[variable]
        elif item.op in ("build", "fold"):
            starts = outside(item)
            kinds = ["int32", *(s.kind for s in starts)]
            depth = item.data[1]
            inside = 0
            for body in item.args[len(starts) :]:
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
