"""Exact linear model of a diagram at a point, by differentiation of its expression graph.

See docs/how-to/check-a-diagram.md for the assumptions on delays, rates, counters, noise and kinks.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.declarations import element_names, unknown_name
from twodof.blocks.diagram import Diagram
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.numbers import FLOATS
from twodof.compile.linear.linear_model import LinearModel
from twodof.compile.linear.operating_point import OperatingPoint, elements, flat, put_flat
from twodof.compile.linear.slopes import Matrices, Slopes, observed, spread
from twodof.compile.program.flat_program import FlatProgram, FlatSignal
from twodof.compile.program.lower import lower
from twodof.errors import DiagramError

Array = NDArray[np.float64]

TIME = ("auto", "continuous", "discrete")
OTHER_PERIODS = (1, 63, 1000)  # at which a model must be the same, if anything reads the tick


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
    """Return the linear model of `diagram`, with the base tick `dt` [s], at a point.

    `at` gives the values of inputs, states, parameters and "tick" (default 0) at the point, by name or path. The
    default is the initial value, the parameter's default or 0. With `trim` the states are moved to an equilibrium near
    the point; with inputs in `free`, these inputs and the states that `at` does not name are moved. `inputs` and
    `outputs` are those of the model: inputs of the diagram, or signals by path, by default the diagram's real inputs
    and outputs. A signal that is an input is *cut*: its readers read the input instead. States without influence on any
    output are left out.

    `time` is "continuous" (dx/dt), "discrete" (x[k+1], the step map) or "auto": continuous if all states are. A diagram
    with any discrete state, delay or rate of its own is discrete. With several rates the model is that over their
    common period, with the inputs held over it. Outputs of slower rates that are held at its start are states.
    `keep_all` keeps the states that have no influence or always return to the point's value.

    Raises DiagramError for a diagram that does not compile, and for one whose common period is over 1000 ticks. Also
    at a kink, where the diagram is not differentiable, if the model changes with an integer state or the tick, and if
    no equilibrium is found.
    """
    if time not in TIME:
        raise DiagramError(f"time={time!r} is unknown", diagram.name, f"use one of {', '.join(TIME)}")
    wanted = [*(outputs or []), *(inputs or [])]
    paths = [p for p in dict.fromkeys(wanted) if not diagram.gives(p) and p not in diagram.inputs]
    program = lower(diagram, dt, paths)
    _refuse_triggers(program)
    point = OperatingPoint(program, at or {})
    ports = {**program.inputs, **program.outputs}
    own = {name: s for name, s in program.outputs.items() if name in program.own}
    sources, ends = _signals(program, inputs, program.inputs, program.inputs), _signals(program, outputs, ports, own)
    with numbers.precision("float64"):
        work = _Linearization(program, point, sources, ends, keep_all)
        work.settle()
        if trim:
            continuous = work.is_continuous("auto") and work.manifold() is not None
            move_to_equilibrium(work, free, continuous)
            work.settle()
        elif free:
            raise DiagramError("free inputs have no effect without trim", diagram.name, "ask for trim too")
        return work.model(time, keep_all)


def _signals(
    program: FlatProgram, names: Sequence[str] | None, ports: Mapping[str, FlatSignal], usual: Mapping[str, FlatSignal]
) -> dict[str, FlatSignal]:
    """Return the signals of these names, ports or paths; without names the real ones of the `usual`."""
    if names is None:
        return {name: s for name, s in usual.items() if s.kind in FLOATS}
    found = {}
    for name in names:
        signal = ports.get(name) or program.signals.get(name)
        if signal is None:
            raise unknown_name("signal", name, [*ports, *program.signals], program.name)
        if signal.kind not in FLOATS:
            what = f"the signal {name!r} is {signal.kind}"
            raise DiagramError(what, program.name, "a linear model has real inputs and outputs")
        found[name] = signal
    return found


class _Linearization(Slopes):
    """Slopes of a program at a point, and the linear model that they make."""

    held: Mapping[str, str]

    def settle(self) -> None:
        """Let integer and bool states settle, and set continuous states to where projections put them.

        Signals of slower rates get the values that they would have after some time at the point.
        """
        self._rest()
        self.whole.settle(lambda: self.step(rested=True, slopes=False))
        self.held = self.whole.check_held(self.step(rested=True, slopes=False))
        step = self.step(slopes=False)
        self.point.put(step.projected(step.continuous()))
        self._rest()

    def _rest(self) -> None:
        self.point.held = self.step(rested=True, slopes=False).made_plain()

    def is_continuous(self, time: str) -> bool:
        """Return True if the model for `time` is dx/dt. Raises DiagramError if "continuous" is impossible."""
        if time == "discrete":
            return False
        problem = self._sampled()
        if time == "continuous" and problem:
            raise DiagramError(problem, self.name, 'ask for the step map: time="discrete"')
        return not problem

    def _sampled(self) -> str:
        """Return the reason why the diagram is not continuous, or ""."""
        if self.parts.several_rates:
            return f"it has several rates: {self.parts.several_rates}"
        if not self.parts.integrated:
            return "it has no continuous states"
        for node, name in self.coordinates.keys:
            if not any(s.name == name for s in node.continuous):
                return f"the state {node.path}.{name} is discrete"
        step = self.step()
        for node in self.parts.integrated:
            for s in node.drivers.values():
                if s not in step.read:
                    continue  # computed at the stages of the integration only
                d = step.read[s]
                held = s.node is not None and s not in self.program.moving and s not in step.cut
                for item in elements(d):
                    if held and item.slope is not None and item.slope[: self.coordinates.size].any():
                        return f"{s.path} samples a continuous state"
        return ""

    def manifold(self) -> tuple[list[int], Array] | None:
        """Return the indices of the states that projections keep, and the slopes of all states by these, (size, kept).

        The other states are set from these, as the sine of an angle that is integrated beside it, and are not states of
        the model. Return None if projections also change the states that they keep.
        """
        size = self.coordinates.size
        p = self._ordered(self.matrices("projection"), 0).change[:, :size]
        kept = [j for j in range(size) if p[:, j].any()]
        if not np.array_equal(p[np.ix_(kept, kept)], np.eye(len(kept))):
            return None
        return kept, p[:, kept]

    def _ordered(self, found: Matrices, ahead: int) -> Matrices:
        """Return the matrices in the model's order of states, of the next states `ahead` periods on."""
        return found.ordered(self.coordinates.order(ahead), self.coordinates.order())

    def model(self, time: str, keep_all: bool) -> LinearModel:
        """Return the model, after a check that it is the same at other phases of integer states that repeat."""
        continuous = self.is_continuous(time)
        found = self._ordered(self.matrices("slope" if continuous else "next"), 0 if continuous else 1)
        n = self.coordinates.size
        names = self.coordinates.names()
        left_out = self._elsewhere()
        a, b = found.change[:, :n], found.change[:, n:]
        c, d = found.output[:, :n], found.output[:, n:]
        keep = list(range(n))
        manifold = None if keep_all and not continuous else self.manifold()
        if continuous and manifold is None:
            if time == "continuous":
                raise DiagramError("a projection (stop, friction) acts at the point", self.name, 'use time="discrete"')
            return self.model("discrete", keep_all)
        if manifold is not None:
            keep, reach = manifold
            left_out |= {names[j]: "set from other states at each step" for j in range(n) if j not in keep}
            a, c, b = a[keep] @ reach, c @ reach, b[keep]
        if not continuous:
            self._check_phases(found)
        self._check_ticks(found, "slope" if continuous else "next")
        names = [names[j] for j in keep]
        values = self.coordinates.values()[self.coordinates.order()][keep]
        if not keep_all:
            staying = _needed(a, b, c, names, continuous, left_out)
            a, b, c = a[np.ix_(staying, staying)], b[staying], c[:, staying]
            names, values = [names[j] for j in staying], values[staying]
        inputs = [e for name, s in self.inputs.items() for e in element_names(name, s)]
        outputs = [e for name, s in self.outputs.items() for e in element_names(name, s)]
        point = dict(zip(names, map(float, values), strict=True))
        read: Mapping[FlatSignal, Any] = self.point.inputs | self.step(slopes=False).made_plain()
        for name, s in self.inputs.items():
            point |= dict(zip(element_names(name, s), flat(read, [s]), strict=True))
        return LinearModel(
            a,
            b,
            c,
            d,
            None if continuous else self.program.dt * self.parts.period,
            tuple(names),
            tuple(inputs),
            tuple(outputs),
            point,
            dict(zip(outputs, map(float, found.made), strict=True)),
            left_out,
            self.name,
            {**self.held, **_idle(a, b, c, d, inputs, outputs, sorted(self.rounded))},
        )

    def _elsewhere(self) -> dict[str, str]:
        """Return the states that may move in nodes that no output depends on."""
        here = set(self.parts.nodes)
        return {
            f"{node.path}.{s.name}": "no output depends on it"
            for node in self.program.nodes
            for s in node.block.states
            if node not in here and s.kind in FLOATS
        }

    def _check_phases(self, found: Matrices) -> None:
        """Raise DiagramError if the model changes while a write index or a counter goes round."""
        for shift in self.whole.phases():
            with self.whole.turned(shift):
                other = self._ordered(self.matrices("next", strict=False), 1)
            if not found.agree(other):
                remedy = "hold the state with `at`, or linearize around this block"
                what = "this integer or bool state changes, and the linear model with it"
                raise DiagramError(what, self.whole.cycling(), remedy)

    def _check_ticks(self, found: Matrices, what: str) -> None:
        """Raise DiagramError if the model changes with the tick, unless `at` gives the tick."""
        readers = self.parts.read_tick()
        for periods in OTHER_PERIODS if readers and not self.point.tick_given else ():
            with self.point.kept():
                self.point.tick += periods * self.parts.period
                other = self._ordered(self.matrices(what, strict=False), 0 if what == "slope" else 1)
            if not (np.allclose(found.change, other.change) and np.allclose(found.output, other.output)):
                raise DiagramError(
                    f"the linear model changes with the tick: it differs {periods} periods later",
                    ", ".join(readers),
                    'give the tick in `at`, {"tick": 0}, for the model at that tick alone; to keep samples in a ring, '
                    "count its places in a state",
                )


def _refuse_triggers(program: FlatProgram) -> None:
    for condition in {c for node in program.nodes for c in node.conditions}:
        if condition.trigger is not None:
            what = "it acts only at the edges of a trigger, which has no linear model"
            raise DiagramError(what, condition.path, "linearize the sub-diagram by itself, or the diagram without it")


def _idle(
    a: Array, b: Array, c: Array, d: Array, inputs: Sequence[str], outputs: Sequence[str], rounded: Sequence[str]
) -> dict[str, str]:
    """Return the inputs that move no output and the outputs that nothing moves, each with the reason."""
    moved = (d != 0.0) | ((c != 0.0) @ spread(b != 0.0, a != 0.0))
    where = f"; numbers are rounded in {', '.join(rounded)}" if rounded else ""
    why = f" (see what it passes: a limit, a switch, a product with 0{where})"
    idle = [name for name, any_ in zip(inputs, moved.any(axis=0), strict=True) if not any_]
    still = [name for name, any_ in zip(outputs, moved.any(axis=1) | c.any(axis=1), strict=True) if not any_]
    found = dict.fromkeys(idle, f"this input has no effect on any output at the point{why}")
    return found | dict.fromkeys(still, f"no state and no input has an effect on this output at the point{why}")


def _needed(
    a: Array, b: Array, c: Array, names: Sequence[str], continuous: bool, left_out: dict[str, str]
) -> list[int]:
    """Return the states to keep: without states that never move, come back at once, or are never read."""
    staying = list(range(len(a)))
    why: str | None = ""
    while why is not None:
        why = None
        for j in staying:
            others = [i for i in staying if i != j]
            still = not a[j, others].any() and not b[j].any()
            if still and a[j, j] == (0.0 if continuous else 1.0):
                why = "stays at the point's value"
            elif still and a[j, j] == 0.0:
                why = "comes back to the point's value at once"
            elif not a[others, j].any() and not c[:, j].any():
                why = "nothing depends on it"
            if why:
                staying.remove(j)
                left_out[names[j]] = why
                break
    if not len(c):
        return staying
    seen = observed(a, c)
    left_out |= {names[j]: "no output depends on it" for j in staying if not seen[j]}
    return [j for j in staying if seen[j]]


def move_to_equilibrium(slopes: Slopes, free: Sequence[str], continuous: bool) -> None:
    """Move the point's states, and the inputs in `free`, to an equilibrium nearby: of dx/dt, or of the step map.

    With free inputs, the states that `at` gives stay. Raises DiagramError if no equilibrium is found.
    """
    point, coordinates, inputs = slopes.point, slopes.coordinates, slopes.inputs
    for own in free:
        if own not in inputs or inputs[own].node is not None:
            raise DiagramError(f"{own!r} is not a real input of the model", slopes.name, "name one in `free`")
    size = coordinates.size
    moving = [j for j, given in enumerate(coordinates.given()) if not (free and given)]
    columns = list(moving)
    at = size
    for own, s in inputs.items():
        columns += range(at, at + (s.width or 1)) if own in free else []
        at += s.width or 1
    freed = [s for own, s in inputs.items() if own in free]
    states = coordinates.values()
    now, after = coordinates.order(), coordinates.order(1)

    @lru_cache(maxsize=1)  # of a point both the residual and its slopes are asked for
    def evaluated(place: tuple[float, ...]) -> tuple[Array, Array]:
        z = np.array(place)
        states[moving] = z[: len(moving)]
        coordinates.put(states)
        put_flat(point.inputs, freed, iter(place[len(moving) :]))
        try:
            found = slopes.matrices("slope" if continuous else "next", strict=False)
        except DiagramError as error:
            what = f"the search for an equilibrium reached a point where {error.what}"
            remedy = "start nearer to one with `at`, or cut a signal of this block as an input"
            raise DiagramError(what, error.where, remedy) from error
        if continuous:
            return found.value, found.change[:, columns]
        stay = np.eye(size, slopes.seeds)
        return found.value[after] - states[now], (found.change[after] - stay[now])[:, columns]

    start = np.concatenate([states[moving], flat(point.inputs, freed)])
    if not (start.size and size):
        return
    from scipy.optimize import least_squares  # imported late: most commands start without it

    tight = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
    best = least_squares(lambda z: evaluated(tuple(z))[0], start, lambda z: evaluated(tuple(z))[1], **tight)
    left = np.abs(evaluated(tuple(best.x))[0])
    # A residual is a difference of numbers of this size, each rounded some tens of times.
    if not left.max() <= 1e-9 * (1.0 + float(np.abs(best.x).max())):
        worst = int(np.argmax(left))
        place = coordinates.order().index(worst if continuous else now[worst])
        what = f"no equilibrium was found: {coordinates.names()[place]} still changes by {left[worst]:.3g}"
        raise DiagramError(what, slopes.name, "start nearer to one with `at`, or free an input that can hold it")
