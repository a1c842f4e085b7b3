"""MachineSwitch: a state machine as C for one instance, a `switch` over its modes that reads like the drawing.

The first switch takes a transition, the second does what each mode does while it lasts. The variables stand in S and
change in place, as the actions follow each other: nobody else reads them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Protocol

from twodof.blocks.expressions.expr import Expr
from twodof.blocks.state_machine import Mode, StateMachine
from twodof.blocks.state_machine.chart import Leaf, Route
from twodof.blocks.state_machine.machine_graph import ELAPSED, MODE, OUTER_ELAPSED, last, owner_clock
from twodof.blocks.state_machine.state_machine import LONGEST
from twodof.compile.c.expressions import Renderer
from twodof.compile.c.writer import CWriter

RendererOf = Callable[[Callable[[str], str]], Renderer]
"""A fresh renderer of a block, given the C text of its states by name."""


class Commit(Protocol):
    """Lines that replace states by expressions, all of which read the states before any is replaced."""

    def __call__(self, renderer: Renderer, values: Mapping[str, Expr], lvalues: Mapping[str, str]) -> None: ...


class MachineSwitch:
    """Writes one machine; `states` are the lvalues of its states, `targets` those of the outputs to write, by name."""

    def __init__(
        self,
        writer: CWriter,
        machine: StateMachine,
        states: Mapping[str, str],
        targets: Mapping[str, str],
        renderer: RendererOf,
        commit: Commit,
    ) -> None:
        self.writer = writer
        self.machine = machine
        self.chart, self.graph = machine.chart, machine.graph
        self.states = states
        self.targets = targets
        self.renderer = renderer
        self.commit = commit
        self.variables = {v.name for v in machine.variables}

    def write(self) -> None:
        """The tick: what a transition does, what the modes do, the outputs that show a variable."""
        write = self.writer
        for clock in (ELAPSED, OUTER_ELAPSED):
            if clock in self.states:
                with write.block(f"if ({self.states[clock]} < {LONGEST}u)"):
                    write.line(f"{self.states[clock]} += 1u;")
        with write.block(f"switch ({self.states[MODE]})"):
            for leaf in self.chart.leaves:
                with self._case(f"case {leaf.number}", leaf):
                    self._ways(self.chart.routes[leaf.number])
            with self._case("default", None):
                if self.chart.leaves[0].outer is None:
                    self._set(OUTER_ELAPSED, "0u")
                self._enter(self.chart.leaves[0], self.chart.leaves[0].outer)
        self._during()
        for port in self.machine.outputs:
            if port.name in self.targets and port.name in self.states:
                target, source = self.targets[port.name], self.states[port.name]
                if port.width is None:
                    write.assign(target, source, port.kind)
                else:
                    write.duplicate(target, source, port.width, port.kind)

    @contextmanager
    def _case(self, label: str, leaf: Leaf | None) -> Iterator[None]:
        """A case, whose comment names the mode."""
        name = "the start" if leaf is None else ".".join(mode.name for mode in leaf.path)
        write = self.writer
        write.line(f"{label}: {{ /* {name} */")
        write.depth += 1
        yield
        write.line("break;")
        write.depth -= 1
        write.line("}")

    def _during(self) -> None:
        acting = [leaf for leaf in self.chart.leaves if any(self._stays(leaf))]
        if not acting:
            return
        if len(self.chart.leaves) == 1:
            with self.writer.block(""):
                self._stay(self.chart.leaves[0])
            return
        with self.writer.block(f"switch ({self.states[MODE]})"):
            *others, end = self.chart.leaves
            for leaf in others:
                if leaf in acting:
                    with self._case(f"case {leaf.number}", leaf):
                        self._stay(leaf)
            # The last one is the default, so that a compiler sees that each output is given.
            if len(acting) == len(self.chart.leaves):
                with self._case("default", end):
                    self._stay(end)
            else:
                if end in acting:
                    with self._case(f"case {end.number}", end):
                        self._stay(end)
                self.writer.line("default: break;")

    def _stays(self, leaf: Leaf) -> Iterator[tuple[Mode, dict[str, Expr], dict[str, Expr]]]:
        """For each mode of a leaf what `during` gives: outputs that are wanted and stay, and variables."""
        for k, mode in enumerate(leaf.path):
            given = self.graph.action(mode.name, "during")
            later = {name for m in leaf.path[k + 1 :] for name in self.graph.action(m.name, "during")}
            outputs = {n: e for n, e in given.items() if n in self.targets and n not in self.variables | later}
            variables = {n: e for n, e in given.items() if n in self.variables}
            if outputs or variables:
                yield mode, outputs, variables

    def _stay(self, leaf: Leaf) -> None:
        for mode, outputs, variables in self._stays(leaf):
            renderer = self._renderer(mode)
            renderer.expect(variables.values())
            renderer.assign([(self.targets[name], e) for name, e in outputs.items()])
            self.commit(renderer, variables, self.states)

    def _ways(self, routes: Sequence[Route]) -> None:
        """The transitions out of a mode: if, else if, ..."""
        write = self.writer
        renderers = {owner: self._renderer(owner) for owner in {self._source(route): None for route in routes}}
        first, nested = True, 0
        for route in routes:
            guard = self.graph.guards[route.number]
            always = guard.op == "const"
            start = len(write.lines)
            test = renderers[self._source(route)].text(guard)
            before = write.lines[start:]  # what the test needs
            del write.lines[start:]
            if always and first:  # then it is the only one
                self._take(route)
                return
            if always or (before and not first):
                write.line("} else {")
            elif not first:
                write.line(f"}} else if ({test}) {{")
            if before and not first:
                write.depth += 1
                nested += 1
                write.lines += [f"    {line}" for line in before]
            elif first:
                write.lines += before
            if (first or before) and not always:
                write.line(f"if ({test}) {{")
            write.depth += 1
            self._take(route)
            write.depth -= 1
            first = False
        if not first:
            write.line("}")
        for _ in range(nested):
            write.depth -= 1
            write.line("}")

    def _source(self, route: Route) -> Mode:
        return self.chart.by_name[route.transition.source]

    def _take(self, route: Route) -> None:
        write = self.writer
        write.line(f"/* {route.transition.text} */")
        for mode in route.left:
            self._act(mode, self.graph.action(mode.name, "exit"))
        self._act(self._source(route), self.graph.does[route.number])
        if route.resumes is None:
            self._enter(route.leaves[0], route.entered)
            return
        with write.block(f"switch ({self.states[last(route.resumes.name)]})"):
            for leaf in route.leaves[1:]:
                with self._case(f"case {leaf.number}", leaf):
                    self._enter(leaf, route.entered)
            with self._case("default", route.leaves[0]):
                self._enter(route.leaves[0], route.entered)

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
            self.writer.line(f"{self.states[state]} = {text};")

    def _act(self, mode: Mode, values: Mapping[str, Expr]) -> None:
        if values:
            self.commit(self._renderer(mode), values, self.states)

    def _renderer(self, owner: Mode) -> Renderer:
        """A fresh one for each action: what it names is another value once the variables have changed."""
        clock = owner_clock(owner in self.chart.outers)
        return self.renderer(lambda name: self.states[clock if name == ELAPSED else name])
