"""TracedMachine: a state machine that is its recorded guards and actions, as it travels in JSON."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from twodof.blocks.block import Clock
from twodof.blocks.declarations import State, check_name, located
from twodof.blocks.expressions.cost import MAX_SIZE, too_large
from twodof.blocks.expressions.expr import Expr
from twodof.blocks.expressions.matrix import shaped
from twodof.blocks.matrix_views import matrices
from twodof.blocks.namespaces import States
from twodof.blocks.schema.traced_block import nodes_from_json, nodes_to_json, picked, sizes_of
from twodof.blocks.state_machine import Mode, StateMachine, Transition
from twodof.blocks.state_machine.chart import MAX_MODES, MAX_TRANSITIONS
from twodof.blocks.state_machine.machine_graph import ELAPSED
from twodof.blocks.state_machine.mode import ACTIONS
from twodof.blocks.trace import computed
from twodof.errors import DiagramError, nearest, shown

_MODE = {"name", "history", "inner", *ACTIONS}
_TRANSITION = {"from", "to", "when", "do"}


class TracedMachine(StateMachine):
    """A state machine whose guards and actions recompute recorded expressions."""

    def __init__(self, label: str, declared: Mapping[str, Sequence[Any]], crossing: bool = False) -> None:
        self.label = check_name(label, "state machine")
        self.inputs = declared["inputs"]
        self.outputs = declared["outputs"]
        self.variables = declared["variables"]
        self.params = declared["params"]
        self.derived = declared["derived"]
        self.crossing = crossing
        self.prepared: dict[str, Expr] = {}

    def prepare(self, p: Any, t: Clock) -> Any:
        shapes = matrices(self.derived)
        values = computed(list(self.prepared.values()), None, None, p, t)
        return {n: shaped(value, shapes.get(n)) for n, value in zip(self.prepared, values, strict=True)}


class RecordedFunction:
    """A guard (one expression, of no name) or an action (one for each name) of recorded expressions."""

    def __init__(self, exprs: Mapping[str, Expr], shapes: Mapping[str, tuple[int, int]]) -> None:
        self.exprs = exprs
        self.shapes = shapes

    def __call__(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        seen = States({**vars(x), ELAPSED: t.elapsed})
        values = computed(list(self.exprs.values()), u, seen, p, t)
        found = {n: shaped(value, self.shapes.get(n)) for n, value in zip(self.exprs, values, strict=True)}
        return found.get("", found)


def machine_to_json(machine: StateMachine) -> dict[str, Any]:
    """The modes and transitions of a machine, whose guards and actions name rows of `nodes`."""
    chart, graph, prepare = machine.chart, machine.graph, machine.trace.prepare
    actions = [e for exprs in [*graph.actions.values(), *graph.does] for e in exprs.values()]
    rows, number = nodes_to_json([*graph.guards, *actions, *prepare.values()])

    def numbered(exprs: Mapping[str, Expr]) -> dict[str, int]:
        return {name: number[id(e)] for name, e in exprs.items()}

    def mode(m: Mode) -> dict[str, Any]:
        form: dict[str, Any] = {"name": m.name}
        form |= {a: numbered(graph.action(m.name, a)) for a in ACTIONS if (m.name, a) in graph.actions}
        form |= {"history": True} if m.history else {}
        return form | ({"inner": [mode(one) for one in m.inner]} if m.inner else {})

    def transition(t: Transition, guard: Expr, does: Mapping[str, Expr]) -> dict[str, Any]:
        form = {"from": t.source, "to": t.target, "when": number[id(guard)]}
        return form | ({"do": numbered(does)} if does else {})

    return {
        "nodes": rows,
        **({"prepare": numbered(prepare)} if prepare else {}),
        "modes": [mode(m) for m in chart.modes],
        "transitions": [transition(*one) for one in zip(chart.transitions, graph.guards, graph.does, strict=True)],
    }


def machine_from_json(machine: TracedMachine, form: Mapping[str, Any], where: str) -> None:
    """Fill `machine` with the modes and transitions in `form`. Raises DiagramError for what is not well formed."""
    elapsed = State(ELAPSED, 0, "uint32")
    made = nodes_from_json(form, machine, [*machine.variables, elapsed], where)
    shapes = matrices(machine.variables, machine.outputs)

    def values(given: Any, name: str) -> dict[str, Expr]:
        if not isinstance(given, dict):
            raise DiagramError(f"{name} is not an object", where, "save the diagram again")
        return {key: picked(made, index, f"{name}.{key:.80}", where) for key, index in given.items()}

    def action(given: Any, name: str) -> RecordedFunction | None:
        return None if given is None else RecordedFunction(values(given, name), shapes)

    def mode(given: Any, depth: int = 0) -> Mode:
        _only(given, _MODE, "a mode", where)
        name, inner, history = given.get("name"), given.get("inner", []), given.get("history", False)
        if depth > 2 or not isinstance(inner, list) or len(inner) > MAX_MODES or type(history) is not bool:
            raise DiagramError(f"the mode {shown(given)} is not well formed", where, "save the diagram again")
        check_name(name, where)
        acts = {a: action(given.get(a), f"{a} of {name}") for a in ACTIONS}
        return Mode(name, inner=[mode(one, depth + 1) for one in inner], history=history, **acts)

    def transition(given: Any) -> Transition:
        _only(given, _TRANSITION, "a transition", where)
        for end in ("from", "to"):
            check_name(given.get(end), where)
        text = f"{given['from']} -> {given['to']}"
        guard = RecordedFunction({"": picked(made, given.get("when"), f"when of {text}", where)}, {})
        return Transition(given["from"], given["to"], guard, action(given.get("do"), f"do of {text}"))

    machine.prepared = values(form.get("prepare", {}), "prepare")
    machine.modes = [mode(one) for one in _rows(form, "modes", MAX_MODES, where)]
    machine.transitions = [transition(one) for one in _rows(form, "transitions", MAX_TRANSITIONS, where)]
    with located(where):
        _check_size(machine)


def _rows(form: Mapping[str, Any], key: str, most: int, where: str) -> list[Any]:
    found = form.get(key, [])
    if not isinstance(found, list) or len(found) > most:
        raise DiagramError(f"{key} is not a list of at most {most}", where, "save the diagram again")
    return found


def _only(given: Any, known: set[str], what: str, where: str) -> None:
    if not isinstance(given, dict):
        raise DiagramError(f"{shown(given)} is not {what}", where, "save the diagram again")
    for key in given:
        if key not in known:
            raise DiagramError(f"unknown key {shown(key)}", where, f"there may be: {nearest(key, sorted(known))}")


def _check_size(machine: TracedMachine) -> None:
    """Raise DiagramError if following all ways of a machine is too much work; before the first is followed."""
    chart = machine.chart
    functions: list[Any] = [f.given for f in (*chart.guards, *chart.does, *chart.actions.values()) if f is not None]
    roots = [e for f in functions for e in f.exprs.values()]
    sizes = dict(zip(map(id, roots), sizes_of(roots), strict=True))

    def size(functions: Iterable[Any]) -> int:
        return sum(sizes[id(e)] for f in functions if f is not None for e in f.given.exprs.values())

    each = len(machine.variables) + 4
    total = sum(sizes_of(list(machine.prepared.values())))
    for leaf in chart.leaves:
        total += each + size(chart.actions.get((m.name, "during")) for m in leaf.path)
        for route in chart.routes[leaf.number]:
            total += size([chart.guards[route.number], chart.does[route.number]])
            total += size(chart.actions.get((m.name, "exit")) for m in route.left)
            entered = [m for one in route.leaves for m in (route.entered, one.mode) if m is not None]
            total += each * len(route.leaves) + size(chart.actions.get((m.name, "entry")) for m in entered)
    if total > MAX_SIZE:
        raise too_large()
