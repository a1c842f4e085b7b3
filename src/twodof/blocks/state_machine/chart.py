"""Chart: modes and transitions of a state machine; MachineGraph: the expressions that their functions record."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from twodof.blocks.declarations import Declared, Port, State, check_name
from twodof.blocks.enumeration import Enumeration, comparing, plain_data
from twodof.blocks.expressions.expr import Expr, as_expr, leaf, scalars, to_real, tracing
from twodof.blocks.expressions.graph import leaves
from twodof.blocks.namespaces import Clock
from twodof.blocks.state_machine.action_text import ActionText, TextFault
from twodof.blocks.trace import clock_leaves, enumerations, mistake, returned, views
from twodof.errors import DiagramError, listed, nearest, shown

ACTIONS = ("entry", "during", "exit")
ARGUMENTS = ("u", "x", "p", "t")
Action = Callable[..., Any] | Mapping[str, Any] | str | None
Guard = Callable[..., Any] | Expr | bool | str


@dataclass(frozen=True, eq=False)
class Mode:
    """Mode of a state machine, one at a time; a `State` is a block's memory.

    An action is a function of any of u, x, p and t that returns new values by name, a mapping of constants, or a text
    such as "n = n + 1; y = 0.0". `entry` acts when the mode is entered, `exit` when it is left: both give variables.
    `during` acts at each tick that ends in the mode, and gives outputs and variables.

    `inner` are modes inside this one, of which the first is where it starts. With `history` it starts again in the one
    that it was left in. `position` is the mode's place on the editor's sheet.
    """

    name: str
    during: Action = None
    entry: Action = None
    exit: Action = None
    inner: Sequence[Mode] = ()
    history: bool = False
    position: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Transition:
    """From the mode `source` to the mode `target`, where the guard `when` holds; `do` gives variables as it is taken.

    A guard is a function of any of u, x, p and t that returns a bool, or a text such as "v > 0.1 and after(25)".
    `t.elapsed` are the ticks since the source was entered, `t.elapsed_time` the same in seconds.
    """

    source: str
    target: str
    when: Guard = True
    do: Action = None

    @property
    def text(self) -> str:
        """Where it leads, for messages and drawings."""
        return f"{self.source} -> {self.target}"


class ModeClock(Clock):
    """The clock of a machine's functions: `elapsed` [ticks of the block] and `elapsed_time` [s] since a mode began."""

    def __init__(self, tick: Any, dt: Any, base_dt: Any, elapsed: Any, elapsed_time: Any) -> None:
        super().__init__(tick, dt, base_dt)
        vars(self).update(elapsed=elapsed, elapsed_time=elapsed_time)


class MachineFunction:
    """A guard or an action, `given` as a function, a text or constants; `place` says whose it is.

    Raises DiagramError for one that takes other arguments than u, x, p and t.
    """

    def __init__(self, given: Any, place: str, guard: bool = False) -> None:
        if isinstance(given, str):
            given = ActionText(given, guard)
        self.given = given if callable(given) else plain_data(given, place)
        self.place = place
        self.text = given.text if isinstance(given, ActionText) else None
        self.constant = not callable(given)
        self.takes: tuple[str, ...] = ()
        if not self.constant:
            self.takes = tuple(inspect.signature(given).parameters)
            for name in self.takes:
                if name not in ARGUMENTS:
                    raise DiagramError(
                        f"{place} takes {shown(name)}", "", "let it take any of u (inputs), x (variables), p and t"
                    )

    def __call__(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        if self.constant:
            return self.given
        seen = {"u": u, "x": x, "p": p, "t": t}
        return self.given(*(seen[name] for name in self.takes))

    @property
    def line(self) -> str:
        """Its file and line, as an error's place names them; "" for constants."""
        code = getattr(inspect.unwrap(self.given), "__code__", None) if not self.constant else None
        return f", {code.co_filename}:{code.co_firstlineno}" if code else ""


MAX_MODES = 200
MAX_TRANSITIONS = 1000
MAX_WAYS = 100  # out of one mode, those of the mode around it included
MAX_ALL_WAYS = 2000  # from mode to mode


@dataclass(frozen=True, eq=False)
class Leaf:
    """A mode without inner ones, and the mode around it: the machine is in one leaf. `number` is what `mode` says."""

    number: int
    mode: Mode
    outer: Mode | None

    @property
    def path(self) -> tuple[Mode, ...]:
        """The mode around it, if there is one, and itself."""
        return (self.mode,) if self.outer is None else (self.outer, self.mode)


@dataclass(frozen=True, eq=False)
class Route:
    """Way of a transition from one leaf: the modes left, inner ones first, and those entered, outer ones first.

    `leaves` are where it may end. There are several where `resumes`, an outer mode, knows in which it was left.
    """

    number: int
    transition: Transition
    source: Leaf
    left: tuple[Mode, ...]
    entered: Mode | None
    leaves: tuple[Leaf, ...]
    resumes: Mode | None


class Chart:
    """The checked modes and transitions of a machine. Raises DiagramError for names that are wrong or missing.

    `routes` are those of each leaf, by its number, in the order in which they are tried. Those of the mode around it
    come first; those of one mode stand in the order in which they are listed.
    """

    def __init__(self, modes: Sequence[Mode], transitions: Sequence[Transition]) -> None:
        self.modes = _listed(modes, Mode, "modes", MAX_MODES)
        self.transitions: list[Transition] = _listed(transitions, Transition, "transitions", MAX_TRANSITIONS)
        if not self.modes:
            raise DiagramError("it has no modes", "", 'write modes = [Mode("..."), ...]; the first starts')
        self.leaves: list[Leaf] = []
        self.by_name: dict[str, Mode] = {}
        self.outers: list[Mode] = []
        for mode in self.modes:
            self._add(mode, None)
        if len(self.by_name) > MAX_MODES:
            raise DiagramError(f"more than {MAX_MODES} modes", "", "make several machines")
        for t in self.transitions:
            for name in (t.source, t.target):
                if name not in self.by_name:
                    what = f"the transition {shown(t.source)} -> {shown(t.target)} names no mode"
                    raise DiagramError(what, "", f"there are: {nearest(name, self.by_name)}")
        self.routes: list[list[Route]] = []
        for start in self.leaves:
            self.routes.append(list(self._routes(start)))
            ways = [sum(len(route.leaves) for route in routes) for routes in self.routes]
            if ways[-1] > MAX_WAYS or sum(ways) > MAX_ALL_WAYS:
                what = f"more than {MAX_WAYS} ways out of {start.mode.name!r}, or {MAX_ALL_WAYS} in all"
                raise DiagramError(what, "", "make several machines")
        self.guards = [MachineFunction(t.when, f"when of {t.text}", guard=True) for t in self.transitions]
        self.does = [None if t.do is None else MachineFunction(t.do, f"do of {t.text}") for t in self.transitions]
        self.actions = {
            (name, action): MachineFunction(getattr(mode, action), f"{action} of {name}")
            for name, mode in self.by_name.items()
            for action in ACTIONS
            if getattr(mode, action) is not None
        }

    def _add(self, mode: Mode, outer: Mode | None) -> None:
        check_name(mode.name, "modes")
        if mode.name in self.by_name:
            raise DiagramError(f"two modes are named {mode.name!r}", "", "name each mode once, inner ones too")
        self.by_name[mode.name] = mode
        inner = _listed(mode.inner, Mode, f"inner modes of {mode.name}", MAX_MODES)
        if not inner:
            if mode.history:
                raise DiagramError(
                    f"{mode.name!r} has a history", "", "only a mode with inner ones has something to remember"
                )
            self.leaves.append(Leaf(len(self.leaves), mode, outer))
            return
        if outer is not None:
            what = f"{mode.name!r} is inside {outer.name!r} and has inner modes itself"
            raise DiagramError(
                what, "", "modes have two levels: put its inner modes beside it, or into another machine"
            )
        self.outers.append(mode)
        for one in inner:
            self._add(one, mode)

    def inside(self, outer: Mode) -> list[Leaf]:
        """Return the leaves inside a mode, its start first."""
        return [leaf for leaf in self.leaves if leaf.outer is outer]

    def leaf(self, mode: Mode) -> Leaf:
        """Return the leaf that a mode is, or starts in."""
        return next(leaf for leaf in self.leaves if mode in leaf.path)

    def _routes(self, leaf: Leaf) -> Iterator[Route]:
        for mode in leaf.path:
            for number, t in enumerate(self.transitions):
                if t.source == mode.name:
                    yield self._route(number, t, leaf)

    def _route(self, number: int, t: Transition, leaf: Leaf) -> Route:
        target = self.by_name[t.target]
        end = self.leaf(target)
        # A mode around both ends stays. It is left if it is itself the source or the target.
        stays = leaf.outer is not None and leaf.outer is end.outer and leaf.outer.name not in (t.source, t.target)
        left = (leaf.mode,) if stays or leaf.outer is None else (leaf.mode, leaf.outer)
        entered = None if stays else end.outer
        inside = self.inside(target)
        if target.history and len(inside) > 1:
            return Route(number, t, leaf, left, entered, tuple(inside), target)
        return Route(number, t, leaf, left, entered, (end,), None)


def _listed(given: Sequence[Any], kind: type, what: str, most: int) -> list[Any]:
    if isinstance(given, str) or not isinstance(given, Sequence) or not all(isinstance(one, kind) for one in given):
        raise DiagramError(f"{what} are {shown(given)}", "", f"write a list of {kind.__name__}(...)")
    if len(given) > most:
        raise DiagramError(f"{len(given)} {what}", "", f"at most {most}: make several machines")
    return list(given)


MODE, ELAPSED, OUTER_ELAPSED = "mode", "elapsed", "elapsed_outer"
STARTING = -1  # the mode before the first tick

Recorded = dict[str, Expr]
Found = TypeVar("Found")


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

    def _check_variables(self) -> None:
        given = self._machine.variables
        if isinstance(given, str) or not isinstance(given, Sequence) or not all(isinstance(v, State) for v in given):
            raise DiagramError(
                f"variables is {shown(given)}", f"block {self._label}", 'write variables = [State("name"), ...]'
            )
        for variable in given:
            if variable.continuous:
                what = "a variable of a state machine is continuous"
                remedy = "integrate in another block, which the machine's outputs enable or reset"
                raise DiagramError(what, f"block {self._label}.{variable.name}", remedy)

    def _call(self, function: MachineFunction) -> Any:
        m, clock, elapsed = self._machine, clock_leaves(), leaf("state", ELAPSED, "uint32")
        t = ModeClock(**clock, elapsed=elapsed, elapsed_time=to_real(elapsed) * clock["dt"])
        try:
            return function(*views(m, m.variables), t)
        except TextFault as error:
            where = f"block {self._label}, {function.place}, {error.where}"
            raise DiagramError(error.what, where, error.remedy) from error
        except Exception as error:
            found = mistake(error, m, "output")
            line = found.where.partition(", ")[2]
            where = f", {line}" if not isinstance(error, DiagramError) and line else function.line
            raise DiagramError(found.what, f"block {self._label}, {function.place}{where}", found.remedy) from error

    def _guard(self, function: MachineFunction) -> Expr:
        def fitted(given: Any) -> Expr:
            try:
                found = as_expr(given, "bool")
                scalars("a guard", found)
            except DiagramError as error:
                raise DiagramError(f"the guard gives {_described(given)}", "", _BOOL) from error
            return found

        return self._recorded(function, fitted)

    def _values(self, function: MachineFunction, declared: Sequence[Any]) -> Recorded:
        return self._recorded(function, lambda given: returned(function.place, given, declared, partial=True))

    def _recorded(self, function: MachineFunction, fitted: Callable[[Any], Found]) -> Found:
        """Record a guard or an action, and return its result after `fitted` has checked it."""
        with tracing(f"{self._label}, {function.place}"), comparing(self._enumerated):
            given = self._call(function)
            try:
                return fitted(given)
            except DiagramError as error:
                where = f"block {self._label}, {function.place}{function.line}"
                raise DiagramError(error.what, where, error.remedy) from error

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
                what = f"the output {port.name!r} is not given in {listed(without)}"
                remedy = "give it in `during` there, or declare a variable of this name, which keeps it"
                raise DiagramError(what, f"block {self._label}", remedy)

    def _check_enumeration(self, enumeration: Enumeration, chart: Chart) -> None:
        """Check that the members of the output `mode` are named as the modes are."""
        for one in chart.leaves:
            if enumeration.members.get(one.mode.name) != one.number:
                what = f"the mode {one.mode.name!r} is number {one.number}, and {enumeration} says otherwise"
                remedy = "name the members as the modes without inner ones, from 0 on in their order"
                raise DiagramError(what, f"block {self._label}", remedy)

    def _own_states(self, chart: Chart) -> Sequence[State]:
        """Return the states for the mode, the times that are read, and the histories."""
        owned = [(mode, [*exprs.values()]) for (mode, _), exprs in self.actions.items()]
        for way, guard, does in zip(chart.transitions, self.guards, self.does, strict=True):
            owned.append((way.source, [guard, *does.values()]))
        read = {chart.by_name[owner] in chart.outers for owner, roots in owned if ELAPSED in leaves(roots, "state")}
        shown = any(port.name == ELAPSED for port in self._machine.outputs)
        return [
            State(MODE, STARTING, "int32"),
            *([State(ELAPSED, 0, "uint32")] if shown or False in read else []),
            *([State(OUTER_ELAPSED, 0, "uint32")] if True in read else []),
            *(State(last(m.name), chart.leaf(m).number, "int32") for m in chart.outers if m.history),
        ]


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
                what = f"the transition {route.transition.text} is never taken: its guard is never true"
                raise DiagramError(what, "", "remove it, or correct its guard")
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
        what = f"no transition leads to {listed(never)} from {chart.leaves[0].mode.name}, where the machine starts"
        raise DiagramError(what, "", "add a transition to it, or remove it")
