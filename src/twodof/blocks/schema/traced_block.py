"""TracedBlock: a block that is its recorded expressions, as it travels in JSON."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from types import NoneType
from typing import Any

from twodof.blocks.block import Block
from twodof.blocks.declarations import State, check_name, located, shape
from twodof.blocks.elementary.functions import FUNCTIONS
from twodof.blocks.expressions.arrays import shaped, vector
from twodof.blocks.expressions.expr import Expr, at_most, const, convert, leaf, node, scalars, tracing
from twodof.blocks.expressions.graph import (
    MAX_LOOP_DEPTH,
    MAX_SIZE,
    OPERATIONS,
    CostMeter,
    free_bounds,
    too_large,
    walk,
)
from twodof.blocks.expressions.numbers import KINDS, fits
from twodof.blocks.state_machine import Mode, StateMachine, Transition
from twodof.blocks.state_machine.chart import ACTIONS, ELAPSED, MachineFunction, MachineGraph
from twodof.blocks.trace import SECTIONS, MethodGraphs, Trace, by_method, computed_graphs, leaves_of, matrices, roots_of
from twodof.errors import DiagramError, nearest, shown

MAX_LENGTH = 1_000_000
MAX_CARRIED = 32  # values that a fold carries from one round to the next

Fields = Mapping[str, tuple[Any, Any]]
"""The keys of an object in a file, each with the type of its value and the value where it is left out.

A default of another type than its own, such as None for a list, means that the key must be there.
"""


def read(form: Any, what: str, fields: Fields, where: str) -> dict[str, Any]:
    """Return all `fields` of an object. Raises DiagramError for another key, or a value of another type."""
    if not isinstance(form, dict):
        raise DiagramError(f"{shown(form)} is not {what}", where, "save the diagram again")
    for key in form:  # a slip of the pen would change a diagram silently
        if key not in fields:
            raise DiagramError(f"unknown key {shown(key)}", where, f"there may be: {nearest(key, sorted(fields))}")
    return {key: member(form, key, kind, where, default) for key, (kind, default) in fields.items()}


def member(data: Mapping[str, Any], key: str, kind: Any, where: str, default: Any = None) -> Any:
    """`data[key]` (or `default`) if it is of the type `kind`; else DiagramError."""
    value = data.get(key, default)
    if not isinstance(value, kind):
        remedy = "see docs/reference/diagram-files.md"
        raise DiagramError(f"{key!r} is missing or of the wrong kind", where, remedy)
    return value


def position(given: Any, where: str) -> tuple[float, float]:
    """Return [x, y] as numbers. Raises DiagramError for anything else, and for what is far off."""
    good = isinstance(given, list) and len(given) == 2 and all(type(c) in (int, float) for c in given)
    if not good or any(abs(c) > 1e6 for c in given):
        raise DiagramError(f"position {shown(given)}", where, "write [x, y], each within +-1e6")
    return float(given[0]), float(given[1])


def _declare(block: Any, what: str, label: str, declared: Mapping[str, Sequence[Any]], crossing: bool) -> None:
    block.label = check_name(label, what)
    block.crossing = crossing
    for section, given in declared.items():
        setattr(block, section, given)


def _recorded(method: str) -> Any:
    """Return a method that recomputes a block's recorded expressions."""

    def compute(self: "TracedBlock | TracedMachine", *seen: Any) -> dict[str, Any]:
        u, x, p, t = seen if len(seen) == 4 else (None, None, *seen)
        found = computed_graphs(self.graphs[method], u, x, p, t)
        if method == "edges":
            return found
        return {name: shaped(value, self.shapes[method].get(name)) for name, (value,) in found.items()}

    return compute


class TracedBlock(Block):
    """A block whose methods recompute recorded expressions. `label` is the name of the class it was traced from."""

    label: str

    def __init__(self, label: str, declared: Mapping[str, Sequence[Any]], crossing: bool = False) -> None:
        _declare(self, "custom block", label, declared, crossing)
        self.graphs: MethodGraphs = {method: {} for method in SECTIONS}
        self.shapes = dict.fromkeys(SECTIONS, matrices(self.states))
        self.shapes |= {"prepare": matrices(self.derived), "output": matrices(self.outputs)}

    prepare, output, edges, update, derivative, project = map(_recorded, SECTIONS)


def graph_to_json(trace: Trace) -> dict[str, Any]:
    """Return a trace as {"nodes": rows, method: {name: row number}}; a row is [op, numbers of its arguments, ...]."""
    graphs = by_method(trace)
    rows, number = nodes_to_json(roots_of(graphs))
    form: dict[str, Any] = {"nodes": rows}
    for method, exprs in graphs.items():
        given = {name: [number[id(e)] for e in roots] for name, roots in exprs.items()}
        if given:
            form[method] = given if method == "edges" else {name: row for name, (row,) in given.items()}
    return form


def nodes_to_json(roots: Sequence[Expr]) -> tuple[list[list[Any]], dict[int, int]]:
    """Return the rows of expressions' nodes, arguments before their users, and each node's row by its id."""
    order = walk(roots)
    number = {id(item): i for i, item in enumerate(order)}
    return [_node_to(item, number) for item in order], number


def _node_to(item: Expr, number: dict[int, int]) -> list[Any]:
    kind = [item.kind] if item.op in ("const", "bound", "convert") else []
    if item.data is None or item.op == "tick":
        data = []
    elif isinstance(item.data, tuple):
        data = [*item.data]
    else:
        data = [item.data.hex() if isinstance(item.data, float) else item.data]
    return [item.op, [number[id(a)] for a in item.args], *kind, *data]


def graph_from_json(block: TracedBlock, form: Mapping[str, Any], where: str) -> None:
    """Fill `block` with the expressions in `form`. Raises DiagramError for a node that is not well formed."""
    made = nodes_from_json(form["nodes"], block, block.states, where)
    for method, exprs in block.graphs.items():
        for key, given in form[method].items():
            indices = given if method == "edges" else [given]
            if method == "edges" and not (isinstance(given, list) and len(given) == 2):
                raise DiagramError(f"edges.{key} is not a pair of nodes", where, "save the diagram again")
            exprs[key] = tuple(picked(made, index, f"{method}.{key}", where) for index in indices)
    roots = roots_of(block.graphs)
    with located(where):
        # Before anything is computed, port by port as it will be: what is small in a file can be endless to follow.
        if sum(sizes_of(roots)) > MAX_SIZE:
            raise too_large()
        _ = block.trace  # checks the types, and that each declared name is given


def nodes_from_json(rows: Sequence[Any], block: Block, states: Sequence[State], where: str) -> list[Expr]:
    """Return the expressions that `rows` describe, over what `block` declares and over `states`.

    Raises DiagramError for a row that is not well formed.
    """
    if len(rows) > MAX_SIZE:
        raise DiagramError(f"more than {MAX_SIZE} nodes", where, "make the block smaller")
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
    """Return the expression at the row that `name` gives. Raises DiagramError without such a row."""
    if type(index) is not int or not 0 <= index < len(made):
        raise DiagramError(f"{name:.80} names node {shown(index)}, which is not there", where, "save the diagram again")
    return made[index]


def sizes_of(roots: Sequence[Expr]) -> list[int]:
    """Return the size of each expression by itself. Raises DiagramError for a variable that stands outside its loop."""
    free = free_bounds(roots)
    if any(free[id(root)] for root in roots):
        raise DiagramError("a loop variable stands outside its loop", "", "save the diagram again")
    meter = CostMeter()
    return [meter.measure([e]).size for e in roots]


def _node_from(row: Any, made: list[Expr], leaves: Mapping[str, Mapping[str, Expr]]) -> Expr:
    op, numbers_, *data = row
    if not all(type(n) is int and 0 <= n < len(made) for n in numbers_):
        raise ValueError(f"node {len(made)} uses node {numbers_}, which does not come before it")
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
            raise ValueError("the operation, function or type is unknown")
    return found


def _in_range(value: Any, end: int) -> None:
    if type(value) is not int or not 0 <= value < end:
        raise ValueError(f"{shown(value)} is not in 0..{end - 1}")


_ACTION = ((dict, str, NoneType), None)
_MODE: Fields = {
    "name": (str, None),
    "history": (bool, False),
    "inner": (list, []),
    "position": ((list, NoneType), None),
    **dict.fromkeys(ACTIONS, _ACTION),
}
_TRANSITION: Fields = {"from": (str, None), "to": (str, None), "when": ((int, str), ""), "do": _ACTION}


class TracedMachine(StateMachine):
    """A state machine whose guards and actions are recorded expressions."""

    def __init__(self, label: str, declared: Mapping[str, Sequence[Any]], crossing: bool = False) -> None:
        _declare(self, "state machine", label, declared, crossing)
        self.graphs: MethodGraphs = {"prepare": {}}
        self.shapes = {"prepare": matrices(self.derived)}

    prepare = _recorded("prepare")


def machine_to_json(machine: StateMachine) -> dict[str, Any]:
    """Return the modes and transitions of a machine, whose guards and actions name rows of `nodes`."""
    chart, graph, prepare = machine.chart, machine.graph, machine.trace.prepare
    given = [({"": e}, chart.guards[k]) for k, e in enumerate(graph.guards)]
    given += [(exprs, function) for exprs, function in zip(graph.does, chart.does, strict=True) if function]
    given += [(graph.actions[key], function) for key, function in chart.actions.items()]
    roots = [e for exprs, function in given if function.text is None for e in exprs.values()]
    rows, number = nodes_to_json([*roots, *prepare.values()])

    def numbered(exprs: Mapping[str, Expr]) -> dict[str, int]:
        return {name: number[id(e)] for name, e in exprs.items()}

    def mode(m: Mode) -> dict[str, Any]:
        form: dict[str, Any] = {"name": m.name}
        form |= {a: action(chart.actions.get((m.name, a)), graph.action(m.name, a)) for a in ACTIONS}
        form |= {"history": True} if m.history else {}
        form |= {"position": list(m.position)} if m.position else {}
        form |= {"inner": [mode(one) for one in m.inner]} if m.inner else {}
        return {key: value for key, value in form.items() if value is not None}

    def action(function: MachineFunction | None, exprs: Mapping[str, Expr]) -> str | dict[str, int] | None:
        if function is None:
            return None
        return numbered(exprs) if function.text is None else function.text

    def transition(k: int, t: Transition) -> dict[str, Any]:
        text, do = chart.guards[k].text, action(chart.does[k], graph.does[k])
        form = {"from": t.source, "to": t.target, "when": number[id(graph.guards[k])] if text is None else text}
        return form | ({"do": do} if do else {})

    return {
        "nodes": rows,
        **({"prepare": numbered(prepare)} if prepare else {}),
        "modes": [mode(m) for m in chart.modes],
        "transitions": [transition(k, t) for k, t in enumerate(chart.transitions)],
    }


def machine_from_json(
    machine: TracedMachine, form: Mapping[str, Any], where: str, spend: Callable[[int], None]
) -> None:
    """Fill `machine` with the modes and transitions in `form`. Raises DiagramError for what is not well formed.

    `spend` counts the characters of guards and actions that are texts.
    """
    elapsed = State(ELAPSED, 0, "uint32")
    made = nodes_from_json(form["nodes"], machine, [*machine.variables, elapsed], where)
    shapes = matrices(machine.variables, machine.outputs)
    recorded: list[Expr] = []

    def values(given: Mapping[str, Any], name: str) -> dict[str, Expr]:
        return {key: picked(made, index, f"{name}.{key}", where) for key, index in given.items()}

    def action(given: Mapping[str, Any] | str | None, name: str) -> Mapping[str, Any] | str | None:
        if isinstance(given, str):
            spend(len(given))
        if given is None or isinstance(given, str):
            return given
        found = values(given, name)
        recorded.extend(found.values())
        return {key: shaped(e, shapes.get(key)) for key, e in found.items()}

    def mode(given: Any, depth: int = 0) -> Mode:
        if depth > 2:
            raise DiagramError("modes are nested more than two levels deep", where, "make several machines")
        m = read(given, "a mode", _MODE, where)
        name, inner = m["name"], [mode(one, depth + 1) for one in m["inner"]]
        acts = {a: action(m[a], f"{a} of {name}") for a in ACTIONS}
        place = None if m["position"] is None else position(m["position"], f"{where}.{name:.80}")
        return Mode(name, inner=inner, history=m["history"], position=place, **acts)

    def transition(given: Any) -> Transition:
        t = read(given, "a transition", _TRANSITION, where)
        text = f"{t['from']} -> {t['to']}"
        guard = t["when"]
        if isinstance(guard, str):
            spend(len(guard))
        else:
            guard = picked(made, guard, f"when of {text}", where)
            recorded.append(guard)
        return Transition(t["from"], t["to"], guard, action(t["do"], f"do of {text}"))

    machine.graphs["prepare"] = {name: (e,) for name, e in values(form["prepare"], "prepare").items()}
    with located(where):
        machine.modes = [mode(one) for one in form["modes"]]
        machine.transitions = [transition(one) for one in form["transitions"]]
        # Before the first is followed: what is small in a file can be endless to follow.
        if sum(sizes_of(recorded)) > MAX_SIZE:
            raise too_large()
    with located(where, keep=True), at_most(2 * MAX_SIZE):
        graph = machine.graph
    with located(where):
        _check_size(machine, graph)


def _check_size(machine: TracedMachine, graph: MachineGraph) -> None:
    """Raise DiagramError if following all ways of a machine is too much work; before the first is followed."""
    chart, roots = machine.chart, graph.expressions
    sizes = dict(zip(map(id, roots), sizes_of(roots), strict=True))

    def size(modes: Iterable[Mode], action: str) -> int:
        return sum(sizes[id(e)] for m in modes for e in graph.action(m.name, action).values())

    each = len(machine.variables) + 4
    total = sum(sizes_of(roots_of(machine.graphs)))
    for end in chart.leaves:
        total += each + size(end.path, "during")
        for route in chart.routes[end.number]:
            total += sum(sizes[id(e)] for e in (graph.guards[route.number], *graph.does[route.number].values()))
            entered = [m for one in route.leaves for m in (route.entered, one.mode) if m is not None]
            total += size(route.left, "exit") + each * len(route.leaves) + size(entered, "entry")
    if total > MAX_SIZE:
        raise too_large()
