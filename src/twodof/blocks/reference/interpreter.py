"""The reference: a diagram interpreted on plain numbers, by its hierarchy, one block after the other.

It is the judge of every compiled target and shares no code with the compiler's lowering. What a step is says
docs/explanation/language.md, section 4.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.block import Block
from twodof.blocks.declarations import Param, Port, State, check_tick, numeric
from twodof.blocks.diagram import Diagram
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.expr import Expr
from twodof.blocks.expressions.numbers import UInt32, Vector
from twodof.blocks.machine import Machine
from twodof.blocks.namespaces import Clock, Inputs, Namespace, Parameters, States, twin
from twodof.blocks.reference.hierarchy import Cell, DiagramLevel, Hierarchy, PortOf
from twodof.blocks.trace import (
    HIDDEN,
    by_method,
    by_path,
    computed_graphs,
    is_users,
    matrices,
    mistake,
    place,
    with_matrices,
)
from twodof.errors import DiagramError, shown

_OWN_PRECISION = "write float(...) around numbers of numpy, which have a precision of their own"


class BlockMethod:
    """A method of the block at `path`. A call gives numbers of the declared types (tracing has checked the names).

    `edges` gives pairs of reals. A user's method is judged by its trace, which is what is compiled. What is recorded
    once cannot count, draw lots or remember. A method that does so computes on numbers, and then the reference and the
    compiled program would differ without a word: that is a DiagramError.
    """

    def __init__(self, path: str, block: Block, name: str, declared: Sequence[Port | State]) -> None:
        self.path, self.block, self.name = path, block, name
        self._method = getattr(block, name)
        self._declared = [(d.name, d.kind, d.width, None if d.width is not None else d.kind) for d in declared]
        self._matrices = matrices(declared)
        shapes = [matrices(block.inputs), matrices(block.states), matrices(block.params, block.derived), matrices()]
        self._shown = shapes[2:] if name == "prepare" else shapes
        self._sees_matrices = any(self._shown)
        self._recorded = by_method(block.trace)[name] if is_users(block) else None

    def __call__(self, *seen: Namespace) -> dict[str, Any]:
        if self._recorded is None:
            return self._given(self._result(seen))
        # It sees copies: whatever it does to them, the machine's own values stay.
        given = self._given(self._result([twin(view) for view in seen]))
        self._judge(given, self._recorded, seen)
        return given

    def _given(self, result: Any) -> dict[str, Any]:
        """Return a method's values by name, as numbers of the declared types."""
        if self.name == "edges":
            return {port: tuple(self._number(value, "real", None) for value in pair) for port, pair in result.items()}
        if self._matrices.buses:
            result = by_path(result, [name for name, *_ in self._declared])
        if type(result) is not dict and not isinstance(result, Mapping):
            result = {self._declared[0][0]: result} if self._declared else {}
        types = numbers.scalar_types()
        given = {}
        for name, kind, width, scalar in self._declared:
            if name in result:
                value = result[name]
                # What is of the type already, as nearly all is, needs no look at what else it could be.
                given[name] = value if type(value) is types.get(scalar) else self._number(value, kind, width, name)
        return given

    def _result(self, seen: Sequence[Namespace]) -> Any:
        if self._sees_matrices:
            seen = [with_matrices(view, shapes) for view, shapes in zip(seen, self._shown, strict=True)]
        try:
            return self._method(*seen)
        except Exception as error:
            found = mistake(error, self.block, self.name)
            raise DiagramError(found.what, f"{self.path}, {found.where}", found.remedy) from error

    def _number(self, value: Any, kind: str, width: int | None, name: str = "") -> Any:
        try:
            return numeric(value, kind, width, "", self._matrices.get(name))
        except DiagramError as error:
            if isinstance(value, Expr):
                what = f"{self.name} gives a value that it kept from when it was traced"
                raise DiagramError(what, self._where(), HIDDEN) from error
            raise DiagramError(error.what, self._where(), error.remedy) from error

    def _where(self) -> str:
        return f"{self.path}, {place(self.block, self.name)}"

    def _judge(self, given: Mapping[str, Any], recorded: Mapping[str, Any], seen: Sequence[Any]) -> None:
        """Raise DiagramError if a method gives another value than its trace."""
        u, x, p, t = seen if len(seen) == 4 else (None, None, *seen)
        found = computed_graphs(recorded, u, x, p, t)
        expected = self._given({n: pair if len(pair) == 2 else pair[0] for n, pair in found.items()})
        for name in {**given, **expected}:
            one, other = given.get(name), expected.get(name)
            if not numbers.identical(one, other):
                what = f"{self.name} gives {name!r} = {_text(one)} now, and {_text(other)} as it was traced"
                remedy = HIDDEN if numbers.real_type() is np.float64 else f"{HIDDEN}; {_OWN_PRECISION}"
                raise DiagramError(what, self._where(), remedy)


def _text(value: Any) -> str:
    if isinstance(value, tuple) and not isinstance(value, Vector):
        return shown([numbers.plain(one) for one in value])
    return "nothing" if value is None else shown(numbers.plain(value))


Watch = Callable[[Cell, str, Mapping[str, Any], tuple[Any, Any, Any, Any]], None]
"""Is told what a block's method gave, as far as it counts: the cell, the method, values by name, and what it saw."""


class Reference:
    """A diagram ready to be interpreted: `dt` [s] the base tick, `log` paths of further signals to return.

    Raises DiagramError if the diagram is not complete or not consistent.
    """

    def __init__(
        self, diagram: Diagram, dt: float, precision: str = "float64", log: Iterable[str] = (), integrator: str = "rk4"
    ) -> None:
        tick = check_tick(dt, diagram.name)
        if integrator not in ("rk4", "euler"):
            raise DiagramError(f"unknown integrator {integrator!r}", diagram.name, 'use "rk4" or "euler"')
        with numbers.precision(precision):
            self.hierarchy = Hierarchy(diagram)
        self.diagram = diagram
        self.dt = tick
        self.precision = precision
        self.integrator = integrator
        self.log = tuple(log)
        self.signals: dict[str, PortOf | str] = {}
        for name, source in diagram.outputs.items():
            self.signals |= self.hierarchy.root.spread(name, source) if source else {}
        for path in self.log:
            for name, port in self.hierarchy.signal(path).items():
                if self.signals.setdefault(name, port) != port:
                    what = f"{name!r} is both a field of an output of the diagram and the output of a part"
                    raise DiagramError(what, diagram.name, "rename the part or the output")

    def machine(self, watch: Watch | None = None) -> ReferenceMachine:
        """Return a fresh instance in its initial state, which shows `watch` each computed value."""
        return ReferenceMachine(self, watch)


_Place = tuple[dict[str, Any], str]
"""Where a value stands while a diagram runs, and under which name."""


class _Run:
    """A cell while it runs: what its methods see and the outputs that it holds.

    The dictionaries live as long as the run: the methods' views and the readers of the outputs refer to them.
    """

    def __init__(self, cell: Cell, clock: Clock, watch: Watch | None) -> None:
        self.cell = cell
        self.watch = watch
        self.t = clock
        self.u = {p.name: _number(0, p, p.name) for p in cell.block.inputs}
        self.x: dict[str, Any] = {}
        self.p: dict[str, Any] = {}
        self.y: dict[str, Any] = {}
        self.clear_outputs(cell.initial)
        self.after: dict[str, tuple[Any, Any]] = {}  # port -> (fraction of the step, value after it)
        self.feeds: list[tuple[str, dict[str, Any], str]] = []  # input, where its value stands, under which name
        self.enables: list[_Place] = []
        self.resets: list[_Place] = []
        self.clears: list[_Place] = []  # those of `enables` without which the outputs are initial
        self.restarts: list[tuple[DiagramLevel, _Place]] = []  # a diagram around it, and what says that it restarts
        self.active = False
        self.seen = (Inputs(self.u), States(self.x), Parameters(self.p), clock)
        self.discrete = cell.discrete
        self.continuous = cell.continuous
        block = cell.block
        declared: dict[str, Sequence[Port | State]] = dict.fromkeys(("derivative", "project"), self.continuous)
        declared |= {"prepare": block.derived, "output": block.outputs, "edges": (), "update": self.discrete}
        self._methods = {name: BlockMethod(cell.path, block, name, given) for name, given in declared.items()}

    def call(self, method: str, *seen: Any) -> dict[str, Any]:
        """Return what a method gives on the run's own values, or `prepare` on the p and t in `seen`; show the watch."""
        values = self._methods[method](*(seen or self.seen))
        if method not in ("output", "edges"):
            self.show(method, values, *seen)
        return values

    def show(self, method: str, values: dict[str, Any], *seen: Any) -> None:
        """Show a method's values to the watch."""
        if self.watch is not None:
            p, t = seen or self.seen[2:]
            self.watch(self.cell, method, values, (*self.seen[:2], p, t))

    def compute(self, ports: Sequence[str]) -> None:
        """Compute outputs."""
        fresh = self.call("output")
        for port in ports:
            self.y[port] = fresh[port]
        self.show("output", {port: fresh[port] for port in ports})

    def set_tick(self, tick: int) -> None:
        vars(self.t)["tick"] = UInt32(tick)

    def feed(self) -> None:
        u = self.u
        for port, values, key in self.feeds:
            u[port] = values[key]

    def clear_outputs(self, values: Mapping[str, Any]) -> None:
        self.y.update({p.name: _number(values.get(p.name, 0), p, p.name) for p in self.cell.block.outputs})


class ReferenceMachine(Machine):
    """One running instance of a diagram on plain numbers."""

    def __init__(self, program: Reference, watch: Watch | None = None) -> None:
        self.program = program
        self.hierarchy = program.hierarchy
        diagram = program.diagram
        states = {f"{cell.path}.{s.name}": s for cell in self.hierarchy.cells for s in cell.block.states}
        shapes = {
            path: (diagram.inputs[s] if isinstance(s, str) else s.declared).shape for path, s in program.signals.items()
        }
        inputs = diagram.inputs.values()
        super().__init__(diagram.name, program.precision, self.hierarchy.parameters, inputs, states, shapes)
        with numbers.precision(program.precision):
            self._values = {path: _number(p.value, p, path) for path, p in self.parameters.items()}
            self._real_dt = numbers.real_type()(program.dt)
            self._inputs = {name: _number(0, port, name) for name, port in self.inputs.items()}
            self._runs: dict[str, _Run] = {}
            for cell in self.hierarchy.cells:
                dt = numbers.real_type()(program.dt * cell.rate.divider)
                self._runs[cell.path] = _Run(cell, Clock(UInt32(0), dt, self._real_dt), watch)
        for run in self._runs.values():
            run.feeds = [(port, *self._place(driver)) for port, driver in run.cell.drivers.items()]
            run.enables = [self._place(enable) for level in run.cell.levels for enable in level.enables]
            run.resets = [self._place(level.reset) for level in run.cell.levels if level.reset]
            run.restarts = [(level, self._place(level.restart)) for level in run.cell.levels if level.restart]
            levels = [level for level in run.cell.levels if level.resets_outputs]
            run.clears = [self._place(level.enable) for level in levels if level.enable]
        begun: set[str] = set()
        self._schedule: list[tuple[_Run, Sequence[str], bool]] = []  # and whether it is the cell's first place
        for cell, ports in self.hierarchy.schedule:
            self._schedule.append((self._runs[cell.path], ports, cell.path not in begun))
            begun.add(cell.path)
        self._without_outputs = [run for path, run in self._runs.items() if path not in begun]
        self._logged = [(name, *self._place(driver)) for name, driver in program.signals.items()]
        self._inner = [(self._runs[c.path], ports) for c, ports in self.hierarchy.continuous_schedule]
        self.reset()

    def _place(self, driver: PortOf | str) -> _Place:
        if isinstance(driver, PortOf):
            return self._runs[driver.cell.path].y, driver.port
        return self._inputs, driver

    @property
    def tick(self) -> int:
        """Base ticks since the start, modulo 2^32."""
        return self._tick

    def reset(self) -> None:
        """To the initial states of the present parameters, tick 0, held outputs initial (0 unless told)."""
        self._tick = 0
        with numbers.precision(self.precision):
            for run in self._runs.values():
                self._prepare(run)
                run.x.update(self._initial(run))
                run.clear_outputs(run.cell.initial)
                run.after = {}

    def _store_parameters(self, values: Mapping[str, Any]) -> None:
        with numbers.precision(self.precision):
            for path, value in values.items():
                self._values[path] = _flat(value, self.parameters[path])
            for run in self._runs.values():
                if any(root in values for root in run.cell.parameters.values()):
                    self._prepare(run)

    def _parameter(self, path: str) -> Any:
        return numbers.plain(self._values[path])

    def _state(self, path: str, declared: State) -> Any:
        return numbers.plain(self._runs[path.removesuffix(f".{declared.name}")].x[declared.name])

    def _store_state(self, path: str, declared: State, value: Any) -> None:
        with numbers.precision(self.precision):
            self._runs[path.removesuffix(f".{declared.name}")].x[declared.name] = _flat(value, declared)

    def _store_input(self, port: Port, value: Any) -> None:
        with numbers.precision(self.precision):
            self._inputs[port.name] = _flat(value, port)

    def _run(self, steps: int, columns: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
        given = {name: column.tolist() for name, column in columns.items()}
        rows = []
        for k in range(steps):
            for name, column in given.items():
                self._store_input(self.inputs[name], column[k])
            rows.append(self._step())
        return {name: np.array([row[name] for row in rows]) for name in self.program.signals}

    def _step(self) -> dict[str, Any]:
        with numbers.precision(self.precision):
            return {name: numbers.plain(value) for name, value in self.exact_step({}).items()}

    def exact_step(self, inputs: Mapping[str, Any]) -> dict[str, Any]:
        """`step`, with the language's own numbers; needs an enclosing `numbers.precision`."""
        for name, value in inputs.items():
            self._write(name, value)
        self._outputs()
        logged = {name: values[key] for name, values, key in self._logged}
        active = [run for run in self._runs.values() if run.active]
        updates = [(run, run.call("update")) for run in active if run.discrete]
        states = self._integrate([run for run in active if run.continuous])
        for run, new in [*updates, *states]:
            run.x.update(new)
        self._tick = (self._tick + 1) % 2**32
        return logged

    def _outputs(self) -> None:
        for run, ports, first in self._schedule:
            if first:
                self._begin(run)
            run.feed()
            if run.active:
                run.compute(ports)
                if run.cell.block.trace.edges:
                    edges = {port: pair for port, pair in run.call("edges").items() if port in ports}
                    run.after |= edges
                    run.show("edges", edges)
            elif run.cell.rate.due(self.tick) and not all(values[key] for values, key in run.clears):
                run.clear_outputs(run.cell.initial | run.cell.disabled)
        for run in self._without_outputs:
            self._begin(run)
        for run in self._runs.values():
            run.feed()

    def _begin(self, run: _Run) -> None:
        """Find whether the cell acts in this tick, and its states as they read in this tick."""
        run.set_tick(self.tick)
        run.after = {}
        run.active = run.cell.rate.due(self.tick) and all(values[key] for values, key in run.enables)
        # A diagram restarts as a whole: also what is slower, or disabled by itself.
        restarts = any(level.rate.due(self.tick) and values[key] for level, (values, key) in run.restarts)
        if restarts or (run.active and any(values[key] for values, key in run.resets)):
            run.x.update(self._initial(run))

    def _integrate(self, runs: list[_Run]) -> list[tuple[_Run, dict[str, Any]]]:
        """Return the continuous states of the next tick."""
        if not runs:
            return []
        held = [(run, dict(run.u), dict(run.x)) for run in runs]
        held_y = [(run, dict(run.y)) for run in self._runs.values()]
        edged = [(run, port, run.y[port], *run.after[port]) for run in self._runs.values() for port in run.after]
        real = numbers.real_type()
        s, one = real(0), real(1)
        while s < one:
            end = one
            for run, port, before, fraction, after in edged:
                if before != after and fraction > s and fraction < end:
                    end = fraction
                run.y[port] = after if s >= fraction else before
            self._advance(runs, (end - s) * self._real_dt)
            s = end
        new = []
        for run, u, x in held:
            integrated = {c.name: run.x[c.name] for c in run.continuous}
            run.u.update(u)
            new.append((run, integrated | run.call("project")))
            run.x.update(x)
        for run, y in held_y:
            run.y.update(y)
        return new

    def _advance(self, runs: list[_Run], h: Any) -> None:
        """One piece of RK4 or Euler; leaves the integrated states in `run.x`."""
        real = numbers.real_type()
        x0 = [{c.name: run.x[c.name] for c in run.continuous} for run in runs]

        def moved(step: Any, slopes: list[dict[str, Any]]) -> None:
            for run, x, k in zip(runs, x0, slopes, strict=True):
                run.x.update({n: _elementwise(lambda a, b: a + step * b, x[n], k[n]) for n in x})

        k1 = self._derivative(runs)
        if self.program.integrator == "euler":
            moved(h, k1)
            return
        half = h * real(0.5)
        moved(half, k1)
        k2 = self._derivative(runs)
        moved(half, k2)
        k3 = self._derivative(runs)
        moved(h, k3)
        k4 = self._derivative(runs)
        two = real(2)
        total = [
            {n: _elementwise(lambda a, b, c, d: ((a + two * b) + two * c) + d, a[n], b[n], c[n], d[n]) for n in a}
            for a, b, c, d in zip(k1, k2, k3, k4, strict=True)
        ]
        moved(h * real(1 / 6), total)

    def _derivative(self, runs: list[_Run]) -> list[dict[str, Any]]:
        for run, ports in self._inner:
            if run.active:
                run.feed()
                run.compute(ports)
        for run in runs:
            run.feed()
        return [run.call("derivative") for run in runs]

    def _prepare(self, run: _Run) -> None:
        cell = run.cell
        given = {name: self._values[root] for name, root in cell.parameters.items()}
        run.p.update(given)
        # In doubles, whatever the build's precision is: what is computed once shall not carry its roundings about.
        with numbers.precision("float64"):
            exact = {d.name: _as_real(given[d.name], d) for d in cell.block.params}
            dt = np.float64(self.program.dt * cell.rate.divider)
            clock = Clock(None, dt, np.float64(self.program.dt))
            found = run.call("prepare", Parameters(exact), clock)
        run.p.update({d.name: _as_real(found[d.name], d) for d in cell.block.derived})

    def _initial(self, run: _Run) -> dict[str, Any]:
        return {
            s.name: run.p[s.initial] if isinstance(s.initial, str) else _number(s.initial, s, s.name)
            for s in run.cell.block.states
        }


def _number(value: Any, declared: Port | State | Param, where: str) -> Any:
    return numeric(value, declared.kind, declared.width, where, declared.shape)


def _flat(value: Any, declared: Port | State | Param) -> Any:
    """Return checked numbers as they are kept: a matrix's column after column."""
    return numeric(value, declared.kind, declared.width, declared.name)


def _as_real(value: Any, declared: Port | Param) -> Any:
    """Return a value whose reals are in the present precision."""
    if declared.kind != "real":
        return value
    return _elementwise(numbers.real_type(), value)


def _elementwise(f: Any, *values: Any) -> Any:
    if isinstance(values[0], Vector):
        return Vector(f(*items) for items in zip(*values, strict=True))
    return f(*values)
