"""linearize: the exact linear model of a diagram at a point, by differentiating its expression graph.

docs/how-to/check-a-diagram.md says what is assumed: which model it is, and what happens to delays, counters, noise
and kinks.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.declarations import element_names, unknown_name
from twodof.blocks.diagram import BASE, Diagram, Rate
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.derivative import Dual, Slope, Tie, Value, constant
from twodof.compile.linear.integer_states import IntegerStates
from twodof.compile.linear.linear_model import LinearModel
from twodof.compile.linear.operating_point import OperatingPoint
from twodof.compile.linear.tangent import States, TangentStep, elements
from twodof.compile.program.flat_program import FlatProgram, FlatSignal, Key
from twodof.compile.program.flatten import constants
from twodof.compile.program.lower import lower
from twodof.errors import DiagramError

Array = NDArray[np.float64]

MAX_STATES = 1500
TIME = ("auto", "continuous", "discrete")
WHAT = ("next", "slope", "projection")  # of the states: after a step, their derivatives, after the jumps
DIRECTIONS = 8  # tried at a tie beside the two across each
SAME = 1e-9  # relative: what two branches that agree may differ by, rounded on their ways


def linearize(
    diagram: Diagram,
    dt: float,
    at: Mapping[str, Any] | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    trim: bool = False,
    free: Sequence[str] = (),
    time: str = "auto",
    keep_all: bool = False,
) -> LinearModel:
    """The linear model of `diagram`, with the base tick `dt` [s], at a point.

    `at` gives the values of inputs, states, parameters and "tick" (default 0) at the point, by name or path. What
    is not named has its initial value, its default or 0. With `trim` the states are moved to an equilibrium near it,
    or, with inputs in `free`, these inputs and the states that `at` does not name. `inputs` and `outputs` are the
    model's: inputs of the diagram, or signals by path. The default is its real inputs and outputs. A signal that is an
    input is *cut*: what reads it reads the input instead. `time`: "continuous" (dx/dt), "discrete" (the step map) or,
    for "auto", continuous where all states are. `keep_all` keeps the states that have no influence or always come back
    to the point's value.

    Raises DiagramError for a diagram that does not compile or has several rates, and at a kink, where nothing is
    differentiable. It also does so for a whole-number state that moves the model, or without an equilibrium.
    """
    if time not in TIME:
        raise DiagramError(f"time={time!r}", diagram.name, f"use one of {', '.join(TIME)}")
    chosen_outputs = list(outputs) if outputs is not None else None
    wanted = [*(chosen_outputs or []), *(inputs or [])]
    paths = [p for p in dict.fromkeys(wanted) if p not in diagram.outputs and p not in diagram.inputs]
    program = lower(diagram, dt, paths)
    _refuse_triggers(program)
    work = _Linearization(program, OperatingPoint(program, at or {}), diagram.outputs, inputs, chosen_outputs)
    with numbers.precision("float64"):
        work.settle()
        if trim:
            work.trim(free)
        elif free:
            raise DiagramError("inputs are free without trim", diagram.name, "ask for trim too")
        return work.model(time, keep_all)


@dataclass
class _Matrices:
    """A and B by the seeds, C and D by the seeds: rows of (states, seeds) and (outputs, seeds)."""

    change: Array
    output: Array
    value: Array  # the states' next values or derivatives
    made: Array  # the outputs' values


class _Linearization:
    """A program at a point, its seeds (states, then inputs) and what is asked of it."""

    def __init__(
        self,
        program: FlatProgram,
        point: OperatingPoint,
        ports: Iterable[str],
        inputs: Sequence[str] | None,
        outputs: Sequence[str] | None,
    ) -> None:
        self.program = program
        self.ports = frozenset(ports)  # the diagram's own outputs
        self.point = point
        self.name = program.name
        rate = _single_rate(program)
        self.divider = rate.divider
        point.tick += (rate.offset - point.tick) % rate.divider  # the next at which its blocks are due
        self.whole = IntegerStates(program, point, self.divider)
        self.inputs = self._inputs(inputs)
        self.outputs = self._outputs(outputs)
        self.states = self._moving()
        size = sum(point.width(k) for k in self.states)
        if size > MAX_STATES:
            raise DiagramError(
                f"its model has {size} states", self.name, f"at most {MAX_STATES}: shorten the delays, or cut signals"
            )
        self.seeds = size + sum(s.width or 1 for s in self.inputs.values())
        self.size = size

    def _inputs(self, names: Sequence[str] | None) -> dict[str, FlatSignal]:
        if names is None:
            return {n: s for n, s in self.program.inputs.items() if s.kind == "real"}
        return {name: self._signal(name, self.program.inputs) for name in names}

    def _outputs(self, names: Sequence[str] | None) -> dict[str, FlatSignal]:
        if names is None:
            return {n: s for n, s in self.program.outputs.items() if s.kind == "real" and n in self.ports}
        return {name: self._signal(name, {**self.program.inputs, **self.program.outputs}) for name in names}

    def _signal(self, name: str, ports: Mapping[str, FlatSignal]) -> FlatSignal:
        found = ports.get(name) or self.program.signals.get(name)
        if found is None:
            raise unknown_name("signal", name, [*ports, *self.program.signals], self.name)
        if found.kind != "real":
            raise DiagramError(f"{name!r} is {found.kind}", self.name, "a linear model has real inputs and outputs")
        return found

    def _moving(self) -> list[Key]:
        """The real states that may change."""
        found: list[Key] = []
        for node in self.program.nodes:
            for s in node.block.states:
                e = node.trace.update.get(s.name)
                kept = e is None or (e.op == "state" and e.data == s.name)
                if s.kind == "real" and (s.continuous or not kept):
                    found.append((node, s.name))
        return found

    def settle(self) -> None:
        """Bring whole-number states to where they stay, and continuous states to where projections put them."""
        self.whole.settle(self._plain_step)
        step = self._plain_step()
        x = {(n, s.name): self.point.states[n, s.name] for n in self.program.integrated for s in n.continuous}
        projected = step.projected({k: constant(v) for k, v in x.items()})
        self.point.put(projected)

    def _seeded(self) -> tuple[States, dict[FlatSignal, Value], dict[FlatSignal, Slope]]:
        """States and inputs with unit slopes, and the slopes of the signals that are cut."""
        unit = np.eye(self.seeds)
        states: States = {k: constant(v) for k, v in self.point.states.items()}
        at = 0
        for key in self.states:
            value = self.point.states[key]
            items = list(elements(value))
            for place in self.whole.order(key):
                items[place] = Dual(items[place], unit[at])
                at += 1
            states[key] = tuple(items) if isinstance(value, tuple) else items[0]
        inputs: dict[FlatSignal, Value] = {s: constant(v) for s, v in self.point.inputs.items()}
        cut: dict[FlatSignal, Slope] = {}
        for s in self.inputs.values():
            if s.node is None:
                duals = tuple(Dual(v, unit[at + i]) for i, v in enumerate(elements(self.point.inputs[s])))
                inputs[s] = duals[0] if s.width is None else duals
            elif s.width is None:
                cut[s] = unit[at]
            else:
                raise DiagramError("an array is cut", s.path, "cut its elements behind a Demux")
            at += s.width or 1
        return states, inputs, cut

    def _seeded_step(self, direction: Slope | None = None) -> TangentStep:
        states, inputs, cut = self._seeded()
        return TangentStep(self.program, self.point.parameters, states, inputs, self.point.tick, cut, direction)

    def _plain_step(self) -> TangentStep:
        """A step without slopes."""
        states: States = {k: constant(v) for k, v in self.point.states.items()}
        inputs: dict[FlatSignal, Value] = {s: constant(v) for s, v in self.point.inputs.items()}
        return TangentStep(self.program, self.point.parameters, states, inputs, self.point.tick)

    def _once(self, what: str, direction: Slope | None) -> tuple[_Matrices, list[Tie]]:
        """The slopes of `what` becomes of the states (one of WHAT) and of the outputs, ties resolved by `direction`."""
        step = self._seeded_step(direction)
        x = {(n, s.name): step.states[n, s.name] for n in self.program.integrated for s in n.continuous}
        if what == "slope":
            new = step.derivative(x)
        elif what == "projection":
            new = step.states | step.projected(x)
        else:
            new = step.updates()
            if self.program.integrated:
                new |= step.projected(step.integrated())
        rows: list[Dual] = []
        for key in self.states:
            items = elements(new[key])
            rows += [items[place] for place in self.whole.order(key, 1 if what == "next" else 0)]
            self._finite(key[0].path, items)
        made: list[Dual] = []
        for signal in self.outputs.values():
            made += elements(step.made[signal])
            self._finite(signal.path, elements(step.made[signal]))
        return _Matrices(self._stack(rows), self._stack(made), _values(rows), _values(made)), step.tangent.ties

    def _stack(self, rows: Sequence[Dual]) -> Array:
        none = np.zeros(self.seeds)
        made = np.array([none if d.slope is None else d.slope for d in rows]).reshape(len(rows), self.seeds)
        return np.asarray(made + 0.0)  # no -0.0

    def _finite(self, path: str, duals: Sequence[Dual]) -> None:
        for d in duals:
            if not np.isfinite(d.value):
                raise DiagramError(f"it is {d.value} at the point", path, "give another point with `at`")
            if d.slope is not None and not np.isfinite(d.slope).all():
                raise DiagramError(
                    "its slope is infinite or undefined at the point", path, "move the point away (sqrt at 0, 0 / 0)"
                )

    def matrices(self, what: str, strict: bool = True) -> _Matrices:
        """The slopes; with `strict` DiagramError at a kink: where directions of motion do not agree on them."""
        first, ties = self._once(what, None)
        if not ties:
            return first
        # At a tie the branch of the point itself may be one that no motion leads into: somewhere beside it, then.
        random = np.random.Generator(np.random.PCG64(1))
        beside, _ = self._once(what, random.standard_normal(self.seeds))
        if not strict:
            return beside
        trials: list[tuple[Slope, Tie]] = []
        for tie in {t.slope.tobytes(): t for t in ties}.values():
            normal = tie.slope / np.linalg.norm(tie.slope)
            noise = 1e-3 * random.standard_normal(self.seeds)
            trials += [(normal + noise, tie), (-normal + noise, tie)]
        trials += [(random.standard_normal(self.seeds), ties[0]) for _ in range(DIRECTIONS)]
        for direction, tie in trials:
            other, _ = self._once(what, direction)
            if not (_agree(beside, other) and _close(first.made, other.made) and _close(first.value, other.value)):
                raise DiagramError(
                    f"the point is on a kink: {tie.what}, and beside it the slopes differ",
                    tie.where,
                    "move the point off it with `at`, or take out the limit, friction or switch that makes it",
                )
        return beside

    def is_continuous(self, time: str) -> bool:
        """Whether the model is dx/dt; DiagramError where that is asked for and cannot be."""
        if time == "discrete":
            return False
        problem = self._sampled()
        if time == "continuous" and problem:
            raise DiagramError(problem, self.name, 'ask for the step map: time="discrete"')
        return not problem

    def _sampled(self) -> str:
        """What keeps the diagram from being a continuous one; "" if nothing does."""
        if not self.program.integrated:
            return "it has no continuous states"
        for node, name in self.states:
            if not any(s.name == name for s in node.continuous):
                return f"the state {node.path}.{name} is discrete"
        step = self._seeded_step()
        for node in self.program.integrated:
            for s in node.drivers.values():
                if s not in step.read:
                    continue  # computed at the stages of the integration only
                d = step.read[s]
                held = s.node is not None and s not in self.program.moving and s not in step.cut
                for item in elements(d):
                    if held and item.slope is not None and item.slope[: self.size].any():
                        return f"{s.path} samples a continuous state"
        return ""

    def _manifold(self) -> tuple[list[int], Array] | None:
        """The states that projections keep, and all states by these; None if projections do more than that.

        A projection may set states from others (the sine of an angle that is integrated beside it). Those are not
        states in their own right.
        """
        p = self.matrices("projection").change[:, : self.size]
        kept = [j for j in range(self.size) if p[:, j].any()]
        if not np.array_equal(p[np.ix_(kept, kept)], np.eye(len(kept))):
            return None
        return kept, p[:, kept]

    def model(self, time: str, keep_all: bool) -> LinearModel:
        """The model, checked at other phases of what goes round."""
        continuous = self.is_continuous(time)
        found = self.matrices("slope" if continuous else "next")
        n = self.size
        names = self._state_names()
        left_out: dict[str, str] = {}
        a, b = found.change[:, :n], found.change[:, n:]
        c, d = found.output[:, :n], found.output[:, n:]
        keep = list(range(n))
        if continuous:
            manifold = self._manifold()
            if manifold is None:
                if time == "continuous":
                    raise DiagramError(
                        "a projection (stop, friction) acts at the point", self.name, 'use time="discrete"'
                    )
                return self.model("discrete", keep_all)
            keep, reach = manifold
            left_out |= {names[j]: "set from other states at each step" for j in range(n) if j not in keep}
            a, c, b = a[keep] @ reach, c @ reach, b[keep]
        else:
            self._check_phases(found)
        names = [names[j] for j in keep]
        values = _values_of(self.point, self.states, self.whole)[keep]
        if not keep_all:
            staying = _needed(a, b, c, names, continuous, left_out)
            a, b, c = a[np.ix_(staying, staying)], b[staying], c[:, staying]
            names, values = [names[j] for j in staying], values[staying]
        inputs = [e for name, s in self.inputs.items() for e in element_names(name, s)]
        outputs = [e for name, s in self.outputs.items() for e in element_names(name, s)]
        point = dict(zip(names, map(float, values), strict=True))
        for name, s in self.inputs.items():
            point |= dict(zip(element_names(name, s), self._input_values(s), strict=True))
        return LinearModel(
            a,
            b,
            c,
            d,
            None if continuous else self.program.dt * self.divider,
            tuple(names),
            tuple(inputs),
            tuple(outputs),
            point,
            dict(zip(outputs, map(float, found.made), strict=True)),
            left_out,
            self.name,
        )

    def _input_values(self, s: FlatSignal) -> list[float]:
        if s.node is None:
            return self.point.input_values([s])
        return [float(m.value) for m in elements(self._plain_step().made[s])]

    def _check_phases(self, found: _Matrices) -> None:
        """DiagramError if the model changes while something goes round (a write index, a counter)."""
        for shift in self.whole.phases():
            with self.whole.turned(shift):
                other = self.matrices("next", strict=False)
            if not _agree(found, other):
                raise DiagramError(
                    "a whole-number state moves, and the model with it",
                    self.whole.guilty(),
                    "a linear model is the same at every step: hold it with `at`, or linearize around this block",
                )

    def _state_names(self) -> list[str]:
        return [name for key in self.states for name in self.whole.names(key)]

    def trim(self, free: Sequence[str]) -> None:
        """Move the states, and the inputs in `free`, to an equilibrium; DiagramError if none is found."""
        for name in free:
            if name not in self.inputs or self.inputs[name].node is not None:
                raise DiagramError(f"{name!r} is not an input to free", self.name, "name a real input")
        continuous = self.is_continuous("auto") and self._manifold() is not None
        what = "slope" if continuous else "next"
        moving: list[int] = []  # the states' columns; those that are named stay, if an input can hold them
        at = 0
        for key in self.states:
            width = self.point.width(key)
            moving += [] if free and key in self.point.given else range(at, at + width)
            at += width
        columns = list(moving)
        for name, s in self.inputs.items():
            columns += range(at, at + (s.width or 1)) if name in free else []
            at += s.width or 1
        freed = [s for name, s in self.inputs.items() if name in free]
        states = _values_of(self.point, self.states, self.whole)

        def evaluated(z: Array) -> tuple[Array, Array]:
            states[moving] = z[: len(moving)]
            _put_values(self.point, self.states, self.whole, states)
            self.point.put_inputs(freed, z[len(moving) :])
            found = self.matrices(what, strict=False)
            if continuous:
                return found.value, found.change[:, columns]
            return found.value - states, (found.change - np.eye(self.size, self.seeds))[:, columns]

        start = np.concatenate([states[moving], self.point.input_values(freed)])
        if start.size and self.size:
            from scipy.optimize import least_squares  # imported late: most commands start without it

            best = least_squares(
                lambda z: evaluated(z)[0], start, lambda z: evaluated(z)[1], xtol=1e-15, ftol=1e-15, gtol=1e-15
            )
            left = np.abs(evaluated(best.x)[0])
            # A residual is a difference of numbers of this size, each rounded some tens of times.
            if not left.max() <= 1e-9 * (1.0 + float(np.abs(best.x).max())):
                worst = int(np.argmax(left))
                raise DiagramError(
                    f"no equilibrium was found: {self._state_names()[worst]} still changes by {left[worst]:.3g}",
                    self.name,
                    "start nearer to one with `at`, or free an input that can hold it",
                )
        self.settle()


def _refuse_triggers(program: FlatProgram) -> None:
    for condition in {c for node in program.nodes for c in node.conditions}:
        if condition.trigger is not None:
            raise DiagramError(
                "it acts at the edges of a trigger alone: no linear model does that",
                condition.path,
                "linearize the sub-diagram by itself, or the diagram without it",
            )


def _single_rate(program: FlatProgram) -> Rate:
    """The rate of all blocks that do something; DiagramError if there are several."""
    ordered = [s for g in program.tick for a in g.actions for s in a.signals]
    rateless = constants(ordered)
    live = {s.node for s in ordered if s not in rateless} | {n for n in program.nodes if n.block.states}
    nodes = [n for n in program.nodes if n in live]
    rates = {n.rate: n for n in nodes}
    if len(rates) > 1:
        (one, a), (two, b) = list(rates.items())[:2]
        raise DiagramError(
            f"it has several rates: {a.path} runs at {tuple(one)} and {b.path} at {tuple(two)}",
            program.name,
            "a linear model has one: linearize a sub-diagram, or give all parts one rate",
        )
    return next(iter(rates), BASE)


def _needed(
    a: Array, b: Array, c: Array, names: Sequence[str], continuous: bool, left_out: dict[str, str]
) -> list[int]:
    """The states that stay: not those that never move, always come back at once, or that nothing reads."""
    staying = list(range(len(a)))
    while True:
        drop: dict[int, str] = {}
        for j in staying:
            others = [i for i in staying if i != j]
            still = not a[j, others].any() and not b[j].any()
            if still and a[j, j] == (0.0 if continuous else 1.0):
                drop[j] = "stays at the point's value"
            elif still and a[j, j] == 0.0:
                drop[j] = "comes back to the point's value at once"
            elif not a[others, j].any() and not c[:, j].any():
                drop[j] = "nothing depends on it"
            if drop:
                break
        if not drop:
            return staying
        staying = [j for j in staying if j not in drop]
        left_out |= {names[j]: why for j, why in drop.items()}


def _agree(a: _Matrices, b: _Matrices) -> bool:
    pairs = ((a.change, b.change), (a.output, b.output), (a.value, b.value), (a.made, b.made))
    return all(_close(x, y) for x, y in pairs)


def _close(a: Array, b: Array) -> bool:
    return np.allclose(a, b, rtol=SAME, atol=SAME * (1e-3 + float(np.abs(a).max(initial=0.0))))


def _values(duals: Sequence[Dual]) -> Array:
    return np.array([float(d.value) for d in duals], dtype=np.float64)


def _values_of(point: OperatingPoint, states: Sequence[Key], whole: IntegerStates) -> Array:
    found = [float(elements(point.states[key])[i]) for key in states for i in whole.order(key)]
    return np.array(found, dtype=np.float64)


def _put_values(point: OperatingPoint, states: Sequence[Key], whole: IntegerStates, z: Array) -> None:
    at = 0
    for key in states:
        places = whole.order(key)
        point.put_numbers(key, places, z[at : at + len(places)])
        at += len(places)
