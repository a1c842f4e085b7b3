"""MachineSwitch: a state machine as a `switch` over its modes that reads like the drawing.

The first switch takes a transition, the second has the `during` actions of each mode. The variables are members of S
and change in place, in the order of the actions, as only the machine reads them.
"""

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager

from twodof.blocks.expressions.expr import Expr
from twodof.blocks.state_machine import Mode, StateMachine
from twodof.blocks.state_machine.chart import ELAPSED, MODE, OUTER_ELAPSED, Leaf, Route, last, owner_clock
from twodof.blocks.state_machine.state_machine import LONGEST
from twodof.compile.c.expressions import Renderer
from twodof.compile.c.graph import ProgramGraph
from twodof.compile.c.schedule import changed, commit
from twodof.compile.c.scope import Scope
from twodof.compile.c.statements import Call, IfStatement, LoopStatement, Statement, Text
from twodof.compile.program.flat_program import Node


class MachineSwitch:
    """Emitter of one machine; `states` are the lvalues of its states, `targets` those of the outputs to write, by name.

    `read` has the C of the signals that the machine reads; the statements are added to the renderer `outer`.
    """

    def __init__(
        self,
        scope: Scope,
        program: ProgramGraph,
        outer: Renderer,
        node: Node,
        machine: StateMachine,
        states: Mapping[str, str],
        targets: Mapping[str, str],
        read: Mapping[Expr, Text],
    ) -> None:
        self.scope = scope
        self.program = program
        self.outer = outer
        self.node = node
        self.machine = machine
        self.chart, self.graph = machine.chart, machine.graph
        self.states = states
        self.targets = targets
        self.read = read
        self.variables = {v.name for v in machine.variables}

    def write(self) -> None:
        """Add the statements of a tick: the transition, the `during` actions, and outputs that return a variable."""
        for clock in (ELAPSED, OUTER_ELAPSED):
            if clock in self.states:
                step: list[Statement] = [self._line(f"{self.states[clock]} += 1u;")]
                self._add(
                    IfStatement(f"{self.states[clock]} < {LONGEST}u", step, owner=self.node, reads=frozenset("s"))
                )
        cases = []
        for leaf in self.chart.leaves:
            with self._collecting() as body:
                self._transitions(self.chart.routes[leaf.number])
            cases.append((leaf, body))
        with self._collecting() as body:
            if self.chart.leaves[0].outer is None:
                self._set(OUTER_ELAPSED, "0u")
            self._enter(self.chart.leaves[0], self.chart.leaves[0].outer)
        self._switch(cases, "default: /* the start */", body)
        self._during()
        for port in self.machine.outputs:
            if port.name in self.targets and port.name in self.states:
                target, source = self.targets[port.name], self.states[port.name]
                self.outer.put(target, Text.of(source), port.kind, port.width)

    def _collecting(self) -> AbstractContextManager[list[Statement]]:
        return self.outer.collecting()

    def _add(self, statement: Statement) -> None:
        self.outer.out.append(statement)

    def _line(self, text: str) -> Call:
        return Call(text, owner=self.node, reads=frozenset("s"))

    def _switch(
        self, cases: Sequence[tuple[Leaf, list[Statement]]], label: str, last: list[Statement], mode: str = MODE
    ) -> None:
        """Add a switch over `mode` with a case for each leaf, and one of all others at the `label`."""
        rows = [(f"case {leaf.number}: /* {_path(leaf)} */", body) for leaf, body in cases]
        made: list[Statement] = [
            LoopStatement(head, [*body, Call("break;", owner=self.node)], owner=self.node)
            for head, body in [*rows, (label, last)]
        ]
        head = f"switch ({self.states[mode]})"
        self._add(LoopStatement(head, made, owner=self.node, reads=frozenset("s")))

    def _during(self) -> None:
        leaves, cases = self.chart.leaves, []
        for leaf in leaves:
            with self._collecting() as body:
                self._stay(leaf)
            if body:
                cases.append((leaf, body))
        if len(leaves) == 1:
            self.outer.out += [LoopStatement("", body, owner=self.node) for _, body in cases]
        elif len(cases) == len(leaves):  # so that a compiler sees that each output is given
            self._switch(cases[:-1], f"default: /* {_path(leaves[-1])} */", cases[-1][1])
        elif cases:
            self._switch(cases, "default:", [])

    def _stay(self, leaf: Leaf) -> None:
        """Add what `during` gives in each mode of a leaf: outputs that are wanted and stay, and variables."""
        for k, mode in enumerate(leaf.path):
            given = self._of(self.graph.action(mode.name, "during"))
            later = {name for m in leaf.path[k + 1 :] for name in self.graph.action(m.name, "during")}
            renderer = self._renderer(mode)
            stay = {n: e for n, e in given.items() if n in self.targets and n not in self.variables | later}
            renderer.assign([(self.targets[name], e) for name, e in stay.items()])
            self._change(renderer, {n: e for n, e in given.items() if n in self.variables})

    def _transitions(self, routes: Sequence[Route]) -> None:
        """Add the transitions out of a mode: if, else if, ..."""
        renderers: dict[Mode, Renderer] = {}
        outer = self.outer.out
        for route in routes:
            source = self._source(route)
            renderer = renderers.setdefault(source, self._renderer(source))
            renderer.out = self.outer.out
            guard = self.graph.guards[route.number]
            if guard.op == "const":  # it is the last one
                self._take(route)
                break
            test = renderer.text(self.program.of(self.node, guard))
            with self._collecting() as then:
                self._take(route)
            branch = IfStatement(test.text, then, owner=self.node, reads=test.reads)
            self._add(branch)
            self.outer.out = branch.otherwise
        self.outer.out = outer

    def _source(self, route: Route) -> Mode:
        return self.chart.by_name[route.transition.source]

    def _take(self, route: Route) -> None:
        self._add(Call(f"/* {route.transition.text} */", owner=self.node))
        for mode in route.left:
            self._act(mode, self.graph.action(mode.name, "exit"))
        self._act(self._source(route), self.graph.does[route.number])
        if route.resumes is None:
            self._enter(route.leaves[0], route.entered)
            return
        cases = []
        for leaf in (*route.leaves[1:], route.leaves[0]):
            with self._collecting() as body:
                self._enter(leaf, route.entered)
            cases.append((leaf, body))
        label = f"default: /* {_path(cases[-1][0])} */"
        self._switch(cases[:-1], label, cases[-1][1], last(route.resumes.name))

    def _enter(self, leaf: Leaf, outer: Mode | None) -> None:
        self._set(MODE, str(leaf.number))
        self._set(ELAPSED, "0u")
        if outer is not None:
            self._set(OUTER_ELAPSED, "0u")
            self._act(outer, self.graph.action(outer.name, "entry"))
        if leaf.outer is not None:
            self._set(last(leaf.outer.name), str(leaf.number))
        self._act(leaf.mode, self.graph.action(leaf.mode.name, "entry"))

    def _set(self, state: str, text: str) -> None:
        if state in self.states:
            self._add(self._line(f"{self.states[state]} = {text};"))

    def _act(self, mode: Mode, values: Mapping[str, Expr]) -> None:
        self._change(self._renderer(mode), self._of(values))

    def _change(self, renderer: Renderer, values: Mapping[str, Expr]) -> None:
        commit(renderer, changed(self.node, values, self.states.__getitem__))

    def _renderer(self, mode: Mode) -> Renderer:
        """Return a fresh one for each action: what it names is another value once the variables have changed."""
        clock = owner_clock(mode in self.chart.outers)
        text = self.scope.leaf(lambda _, name: self.states[clock if name == ELAPSED else name])
        made = self.scope.renderer(self.outer.names, text, lambda item: self.node)
        for item, value in self.read.items():
            made.know(item, value)
        made.out = self.outer.out
        made.owner = self.node
        return made

    def _of(self, values: Mapping[str, Expr]) -> dict[str, Expr]:
        return {name: self.program.of(self.node, e) for name, e in values.items()}


def _path(leaf: Leaf) -> str:
    return ".".join(mode.name for mode in leaf.path)
