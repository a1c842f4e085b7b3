"""TracedBlock: a block that is its recorded expressions, as it travels in JSON."""

from collections.abc import Mapping, Sequence
from typing import Any

from twodof.blocks.block import Block, Clock
from twodof.blocks.declarations import State, check_name, located, shape
from twodof.blocks.elementary.functions import FUNCTIONS
from twodof.blocks.expressions.arrays import vector
from twodof.blocks.expressions.cost import MAX_LOOP_DEPTH, MAX_SIZE, CostMeter, too_large
from twodof.blocks.expressions.expr import Expr, const, convert, leaf, node, scalars, tracing
from twodof.blocks.expressions.graph import OPERATIONS, free_bounds, walk
from twodof.blocks.expressions.kinds import FLOATS, KINDS
from twodof.blocks.expressions.matrix import shaped
from twodof.blocks.expressions.numbers import fits
from twodof.blocks.matrix_views import matrices
from twodof.blocks.trace import SECTIONS, Trace, computed, leaves_of
from twodof.errors import DiagramError, shown

MAX_LENGTH = 1_000_000
MAX_CARRIED = 32  # values that a fold carries from one round to the next


class TracedBlock(Block):
    """A block whose methods recompute recorded expressions. `label` is the name of the class it was traced from."""

    def __init__(self, label: str, declared: Mapping[str, Sequence[Any]], crossing: bool = False) -> None:
        self.label = check_name(label, "custom block")
        self.inputs = declared["inputs"]
        self.outputs = declared["outputs"]
        self.states = declared["states"]
        self.params = declared["params"]
        self.derived = declared["derived"]
        self.crossing = crossing
        self.sections: dict[str, dict[str, Expr]] = {s: {} for s in SECTIONS if s != "edges"}
        states = matrices(self.states)
        self._matrices = {"prepare": matrices(self.derived), "output": matrices(self.outputs)}
        self._matrices |= dict.fromkeys(("update", "derivative", "project"), states)
        self.edge_pairs: dict[str, tuple[Expr, Expr]] = {}

    def _section(self, name: str, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        exprs = self.sections[name]
        values = zip(exprs, computed(list(exprs.values()), u, x, p, t), strict=True)
        return {key: shaped(value, self._matrices[name].get(key)) for key, value in values}

    def prepare(self, p: Any, t: Clock) -> Any:
        return self._section("prepare", None, None, p, t)

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return self._section("output", u, x, p, t)

    def edges(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        flat = computed([e for pair in self.edge_pairs.values() for e in pair], u, x, p, t)
        return {name: (flat[2 * i], flat[2 * i + 1]) for i, name in enumerate(self.edge_pairs)}

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return self._section("update", u, x, p, t)

    def derivative(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return self._section("derivative", u, x, p, t)

    def project(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return self._section("project", u, x, p, t)


def graph_to_json(trace: Trace) -> dict[str, Any]:
    """A trace as a list of nodes [op, arguments, ...], and the node of each name by section."""
    sections: dict[str, dict[str, Any]] = {
        "prepare": trace.prepare,
        "output": trace.outputs,
        "update": trace.update,
        "derivative": trace.derivative,
        "project": trace.project,
    }
    roots = [e for exprs in sections.values() for e in exprs.values()]
    roots += [e for pair in trace.edges.values() for e in pair]
    rows, number = nodes_to_json(roots)
    form: dict[str, Any] = {"nodes": rows}
    for name, exprs in sections.items():
        if exprs:
            form[name] = {key: number[id(e)] for key, e in exprs.items()}
    if trace.edges:
        form["edges"] = {key: [number[id(f)], number[id(a)]] for key, (f, a) in trace.edges.items()}
    return form


def nodes_to_json(roots: Sequence[Expr]) -> tuple[list[list[Any]], dict[int, int]]:
    """The rows of the nodes of expressions, arguments before their users; and each node's row by its id."""
    order = walk(roots)
    number = {id(item): i for i, item in enumerate(order)}
    return [_node_to(item, number) for item in order], number


def _node_to(item: Expr, number: dict[int, int]) -> list[Any]:
    args = [number[id(a)] for a in item.args]
    if item.op == "const":
        value = item.data.hex() if item.kind in FLOATS else item.data
        return ["const", [], item.kind, value]
    if item.op in ("input", "state", "param"):
        return [item.op, [], item.data]
    if item.op == "bound":
        return ["bound", [], item.kind, *item.data]
    if item.op in ("build", "fold"):
        return [item.op, args, *item.data]
    if item.op == "convert":
        return ["convert", args, item.kind]
    if item.data is None or item.op == "tick":
        return [item.op, args]
    return [item.op, args, item.data]


def graph_from_json(block: TracedBlock, form: Mapping[str, Any], where: str) -> None:
    """Fill `block` with the expressions in `form`. Raises DiagramError for a node that is not well formed."""
    made = nodes_from_json(form, block, block.states, where)

    def section(name: str) -> dict[str, Any]:
        found = form.get(name, {})
        if not isinstance(found, dict):
            raise DiagramError(f"{name!r} is not an object", where, "save the diagram again")
        return found

    def pick(index: Any, name: str) -> Expr:
        return picked(made, index, name, where)

    for name in block.sections:
        block.sections[name] = {key: pick(index, f"{name}.{key}") for key, index in section(name).items()}
    for key, pair in section("edges").items():
        if not (isinstance(pair, list) and len(pair) == 2):
            raise DiagramError(f"edges.{key} is not a pair of nodes", where, "save the diagram again")
        block.edge_pairs[key] = (pick(pair[0], f"edges.{key}"), pick(pair[1], f"edges.{key}"))
    roots = [e for exprs in block.sections.values() for e in exprs.values()]
    roots += [e for pair in block.edge_pairs.values() for e in pair]
    with located(where):
        # Before anything is computed, port by port as it will be: what is small in a file can be endless to follow.
        if sum(sizes_of(roots)) > MAX_SIZE:
            raise too_large()
        _ = block.trace  # checks the types, and that each declared name is given


def nodes_from_json(form: Mapping[str, Any], block: Block, states: Sequence[State], where: str) -> list[Expr]:
    """The expressions that the rows in `form` describe, over what `block` declares and over `states`.

    Raises DiagramError for a row that is not well formed.
    """
    rows = form.get("nodes")
    if not isinstance(rows, list) or len(rows) > MAX_SIZE:
        raise DiagramError(f"nodes are missing or more than {MAX_SIZE}", where, "save the diagram again")
    leaves = {
        "input": leaves_of("input", block.inputs),
        "state": leaves_of("state", states),
        "param": leaves_of("param", [*block.params, *block.derived]),
    }
    made: list[Expr] = []
    with tracing(where):
        for i, row in enumerate(rows):
            try:
                made.append(_node_from(row, made, leaves))
            except (DiagramError, TypeError, ValueError, LookupError, AttributeError, OverflowError) as error:
                what = error.what if isinstance(error, DiagramError) else str(error)
                raise DiagramError(
                    f"node {i}, {shown(row)}, is not well formed: {what:.200}", where, "save it again"
                ) from error
    return made


def picked(made: Sequence[Expr], index: Any, name: str, where: str) -> Expr:
    """The expression that `name` says it is. Raises DiagramError for one that is not there."""
    if type(index) is not int or not 0 <= index < len(made):
        raise DiagramError(f"{name} names node {shown(index)}, which is not there", where, "save the diagram again")
    return made[index]


def sizes_of(roots: Sequence[Expr]) -> list[int]:
    """The size of each expression by itself. Raises DiagramError for a variable that stands outside its loop."""
    free = free_bounds(roots)
    if any(free[id(root)] for root in roots):
        raise DiagramError("a loop variable stands outside its loop", "", "save the diagram again")
    meter = CostMeter()
    return [meter.measure([e]).size for e in roots]


def _node_from(row: Any, made: list[Expr], leaves: Mapping[str, Mapping[str, Expr]]) -> Expr:
    op, numbers_, *data = row
    if not all(type(n) is int and 0 <= n < len(made) for n in numbers_):
        raise ValueError("an argument does not stand above it")
    args = [made[n] for n in numbers_]
    if op not in ("select", "store", "build"):
        scalars(str(op), *args)
    found: Expr
    match [op, *data]:
        case ["const", "real" | "float32" | "float64" as kind, value]:
            found = const(float.fromhex(value), kind)
        case ["const", kind, value] if kind in KINDS and type(value) is (bool if kind == "bool" else int):
            if not fits(value, kind):
                raise ValueError(f"{value} does not fit {kind}")
            found = const(value, kind)
        case ["input" | "state" | "param", name]:
            found = leaves[op][name]
        case ["tick"]:
            found = leaf("tick", "tick", "uint32")
        case ["dt", "dt" | "base_dt" as name]:
            found = leaf("dt", name, "real")
        case ["bound", kind, depth, which] if kind in KINDS:
            _in_range(depth, MAX_LOOP_DEPTH)
            _in_range(which, MAX_CARRIED + 1)
            found = node("bound", kind, (), (depth, which))
        case ["convert", kind] if kind in KINDS and kind != "bool":
            found = convert(args[0], kind)
        case ["call", name] if name in FUNCTIONS:
            found = FUNCTIONS[name](*args)
        case ["vector"]:
            found = vector(args)
        case ["build", length, depth]:
            _in_range(length - 1, MAX_LENGTH)
            _in_range(depth, MAX_LOOP_DEPTH)
            (body,) = args
            width = length * (body.width or 1)
            _in_range(width - 1, MAX_LENGTH)
            found = node("build", body.kind, (body,), (length, depth), width)
        case ["fold", length, depth, which]:
            _in_range(length, MAX_LENGTH)
            _in_range(depth, MAX_LOOP_DEPTH)
            half = len(args) // 2
            if half > MAX_CARRIED:
                raise ValueError(f"a loop that carries more than {MAX_CARRIED} values")
            _in_range(which, half)
            for start, body in zip(args[:half], args[half:], strict=True):
                if shape(start) != shape(body) or start.width is not None:
                    raise ValueError("a loop changes a type")
            found = node("fold", args[which].kind, tuple(args), (length, depth, which))
        case [_] if op in OPERATIONS and op != "from_bits":  # bit patterns of reals are not for diagrams
            found = OPERATIONS[op](*args)
        case _:
            raise ValueError("the language has no such operation, function or type")
    return found


def _in_range(value: Any, end: int) -> None:
    if type(value) is not int or not 0 <= value < end:
        raise ValueError(f"{shown(value)} is not in 0..{end - 1}")
