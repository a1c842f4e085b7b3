"""MachineGraph: what the guards and actions of a state machine record, each by itself, checked for names and types."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from twodof.blocks.declarations import Declared, Port, State
from twodof.blocks.enumeration import Enumeration, comparing
from twodof.blocks.expressions.expr import Expr, as_expr, leaf, to_real, tracing
from twodof.blocks.expressions.graph import leaves
from twodof.blocks.mistakes import mistake
from twodof.blocks.namespaces import Inputs, Parameters, States
from twodof.blocks.state_machine.chart import Chart, Leaf, MachineFunction, ModeClock, Route
from twodof.blocks.trace import clock_leaves, enumerations, leaves_of, matrices, returned, with_matrices
from twodof.errors import DiagramError, listed, shown

MODE, ELAPSED, OUTER_ELAPSED = "mode", "elapsed", "elapsed_outer"
STARTING = -1  # the mode before the first tick

Recorded = dict[str, Expr]


class Charted(Declared, Protocol):
    """A state machine as far as recording it needs one."""

    variables: Sequence[State]
    label: str

    @property
    def chart(self) -> Chart: ...


class MachineGraph:
    """The expressions of the guards and actions of `machine`, over its inputs, variables, parameters and the clock.

    The leaf `elapsed` of kind state is the time in the mode whose the guard or action is; after an entry it is 0.
    `states` are what the machine remembers beside its variables. Raises DiagramError, which names the mode and the
    user's line, for a mistake in a function, and for names and types that do not fit.
    """

    def __init__(self, machine: Charted) -> None:
        self._machine = machine
        self._label = machine.label or type(machine).__name__
        chart = machine.chart
        self._check_variables()
        self._shapes = matrices(machine.inputs), matrices(machine.variables), matrices(machine.params, machine.derived)
        self._enumerated = enumerations(machine.inputs, machine.variables, machine.params, machine.derived)
        both = _unique([*machine.variables, *machine.outputs])
        own = (MODE, ELAPSED)
        self.guards = [self._guard(function) for function in chart.guards]
        self.does = [{} if f is None else self._values(f, machine.variables) for f in chart.does]
        self.actions = {
            (mode, action): self._values(
                function, [d for d in both if d.name not in own] if action == "during" else machine.variables
            )
            for (mode, action), function in chart.actions.items()
        }
        self._check_outputs(chart)
        self.states = list(self._own_states(chart))

    @property
    def expressions(self) -> list[Expr]:
        """All that guards and actions give; the machine's trace leaves out what another action takes back."""
        return [*self.guards, *(e for given in (*self.does, *self.actions.values()) for e in given.values())]

    def action(self, mode: str, action: str) -> Recorded:
        """Return the values of a mode's action, by name."""
        return self.actions.get((mode, action), {})

    def fault(self, function: MachineFunction, what: str, remedy: str) -> DiagramError:
        """Return the error for a mistake in a guard or an action."""
        return DiagramError(what, f"block {self._label}, {function.place}{function.line}", remedy)

    def _check_variables(self) -> None:
        given = self._machine.variables
        if isinstance(given, str) or not isinstance(given, Sequence) or not all(isinstance(v, State) for v in given):
            raise DiagramError(
                f"variables is {shown(given)}", f"block {self._label}", 'write variables = [State("name"), ...]'
            )
        for variable in given:
            if variable.continuous:
                raise DiagramError(
                    "a variable of a state machine is continuous",
                    f"block {self._label}.{variable.name}",
                    "integrate in another block, which the machine's outputs enable or reset",
                )

    def _call(self, function: MachineFunction) -> Any:
        m = self._machine
        clock, elapsed = clock_leaves(), leaf("state", ELAPSED, "uint32")
        parameters = leaves_of("param", m.params) | leaves_of("param", m.derived)
        try:
            t = ModeClock(clock["tick"], clock["dt"], clock["base_dt"], elapsed, to_real(elapsed) * clock["dt"])
            return function(
                with_matrices(Inputs(leaves_of("input", m.inputs)), self._shapes[0]),
                with_matrices(States(leaves_of("state", m.variables)), self._shapes[1]),
                with_matrices(Parameters(parameters), self._shapes[2]),
                t,
            )
        except Exception as error:
            found = mistake(error, m, "output")
            line = found.where.partition(", ")[2]
            where = f", {line}" if not isinstance(error, DiagramError) and line else function.line
            raise DiagramError(found.what, f"block {self._label}, {function.place}{where}", found.remedy) from error

    def _guard(self, function: MachineFunction) -> Expr:
        with tracing(f"{self._label}, {function.place}"), comparing(self._enumerated):
            given = self._call(function)
            try:
                found = as_expr(given, "bool")
            except DiagramError as error:
                raise self.fault(function, f"the guard gives {_described(given)}", _BOOL) from error
        if found.width is not None:
            raise self.fault(function, f"the guard gives {_described(given)}", _BOOL)
        return found

    def _values(self, function: MachineFunction, declared: Sequence[Any]) -> Recorded:
        with tracing(f"{self._label}, {function.place}"), comparing(self._enumerated):
            given = self._call(function)
            try:
                return returned(function.place, given, declared, partial=True)
            except DiagramError as error:
                raise self.fault(function, error.what, error.remedy) from error

    def _check_outputs(self, chart: Chart) -> None:
        """Each output is given in each mode, or is a variable."""
        kept = {MODE, ELAPSED, *(v.name for v in self._machine.variables)}
        for port in self._machine.outputs:
            if port.name == MODE and port.enum is not None:
                self._check_enumeration(port.enum, chart)
            without = [
                one.mode.name
                for one in chart.leaves
                if not any(port.name in self.action(mode.name, "during") for mode in one.path)
            ]
            if port.name not in kept and without:
                raise DiagramError(
                    f"the output {port.name!r} is not given in {listed(without)}",
                    f"block {self._label}",
                    "give it in `during` there, or declare a variable of this name, which keeps it",
                )

    def _check_enumeration(self, enumeration: Enumeration, chart: Chart) -> None:
        """Check that the members of the output `mode` are named as the modes are."""
        for one in chart.leaves:
            if enumeration.members.get(one.mode.name) != one.number:
                raise DiagramError(
                    f"the mode {one.mode.name!r} is number {one.number}, and {enumeration} says otherwise",
                    f"block {self._label}",
                    "name the members as the modes without inner ones, from 0 on in their order",
                )

    def _own_states(self, chart: Chart) -> Sequence[State]:
        """Return the states for the mode, the times that are read, and the histories."""
        read: set[bool] = {False} if any(port.name == ELAPSED for port in self._machine.outputs) else set()
        for owner, roots in self._by_owner(chart):
            if ELAPSED in leaves(roots, "state"):
                read.add(chart.by_name[owner] in chart.outers)
        return [
            State(MODE, STARTING, "int32"),
            *([State(ELAPSED, 0, "uint32")] if False in read else []),
            *([State(OUTER_ELAPSED, 0, "uint32")] if True in read else []),
            *(State(last(m.name), chart.leaf(m).number, "int32") for m in chart.outers if m.history),
        ]

    def _by_owner(self, chart: Chart) -> list[tuple[str, list[Expr]]]:
        """Return the expressions, each with the mode whose time it reads."""
        found = [(mode, [*exprs.values()]) for (mode, _), exprs in self.actions.items()]
        for t, guard, does in zip(chart.transitions, self.guards, self.does, strict=True):
            found.append((t.source, [guard, *does.values()]))
        return found


_BOOL = "return a bool: a comparison, or several with & | ~"


def last(outer: str) -> str:
    """Return the state that knows in which of its inner modes a mode with history was left."""
    return f"last_{outer}"


def _unique(declared: Sequence[State | Port]) -> list[State | Port]:
    return list({d.name: d for d in declared}.values())


def _described(value: Any) -> str:
    if isinstance(value, Expr):
        return f"a {value.kind}" if value.width is None else f"an array of {value.width}"
    return "nothing" if value is None else shown(value)


def owner_clock(outer: bool) -> str:
    """Return the state that a function of an outer mode, or of a leaf, reads as its time."""
    return OUTER_ELAPSED if outer else ELAPSED


def check_ways(chart: Chart, graph: MachineGraph) -> None:
    """Raise DiagramError for a transition that is never taken, and for modes that are never entered.

    The guards' recorded expressions tell it for certain. A guard is never true, or it holds only where that of an
    earlier transition does, of the same mode or of the mode around it.
    """
    seen: dict[int, list[str]] = {}  # of each transition that something hides in some leaf: what
    open_in: dict[int, int] = {}
    for routes in chart.routes:
        for k, route in enumerate(routes):
            guard = graph.guards[route.number]
            if guard.op == "const" and not guard.data:
                raise DiagramError(
                    f"the transition {route.transition.text} is never taken: its guard is never true",
                    "",
                    "remove it, or correct its guard",
                )
            hiding = [r.transition.text for r in routes[:k] if _hides(r, route, graph)]
            seen.setdefault(route.number, []).extend(hiding)
            open_in[route.number] = open_in.get(route.number, 0) + (not hiding)
    for number, open_leaves in open_in.items():
        if not open_leaves:
            earlier = listed(dict.fromkeys(seen[number]), most=3)
            raise DiagramError(
                f"the transition {chart.transitions[number].text} is never taken: {earlier} comes before it, and holds "
                "whenever it does",
                "",
                "put it before, or change one of the guards",
            )
    _check_reached(chart)


def _hides(earlier: Route, later: Route, graph: MachineGraph) -> bool:
    first, second = graph.guards[earlier.number], graph.guards[later.number]
    if earlier.transition.source != later.transition.source and ELAPSED in leaves([first, second], "state"):
        # The time of another mode. It is the same one only in the text.
        return first.op == "const" and bool(first.data)
    return _implies(second, first)


def _implies(a: Expr, b: Expr) -> bool:
    """Return True if b certainly holds wherever a does. Equal expressions are one node."""
    if b.op == "const":
        return bool(b.data)
    return _among(_operands(b, "and"), _operands(a, "and")) or _among(_operands(a, "or"), _operands(b, "or"))


def _among(some: Sequence[Expr], all_of: Sequence[Expr]) -> bool:
    return {id(e) for e in some} <= {id(e) for e in all_of}


def _operands(e: Expr, op: str) -> list[Expr]:
    seen: dict[int, Expr] = {}
    stack = [e]
    while stack:
        item = stack.pop()
        if id(item) not in seen:
            seen[id(item)] = item
            stack.extend(item.args if item.op == op else ())
    return [item for item in seen.values() if item.op != op]


def _check_reached(chart: Chart) -> None:
    reached: set[Leaf] = set()
    stack = [chart.leaves[0]]
    while stack:
        leaf = stack.pop()
        if leaf not in reached:
            reached.add(leaf)
            for route in chart.routes[leaf.number]:
                stack.extend(route.leaves)
    never = [leaf.mode.name for leaf in chart.leaves if leaf not in reached]
    if never:
        raise DiagramError(
            f"no transition leads to {listed(never)} from {chart.leaves[0].mode.name}, where the machine starts",
            "",
            "add a transition to it, or remove it",
        )
