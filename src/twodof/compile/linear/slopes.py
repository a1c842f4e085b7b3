"""Slopes of a program at a point, as matrices over one tick or over the common period of its rates; and its kinks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.derivative import Dual, Slope, Tie
from twodof.blocks.expressions.numbers import FLOATS
from twodof.compile.linear.integer_states import Coordinates, IntegerStates
from twodof.compile.linear.operating_point import OperatingPoint, Parts, States, elements
from twodof.compile.linear.tangent import TangentStep, seeded
from twodof.compile.program.flat_program import FlatProgram, FlatSignal, Key
from twodof.errors import DiagramError

Array = NDArray[np.float64]

WHAT = ("next", "slope", "projection")  # of the states: after a period, their derivatives, after the jumps
MAX_STATES = 1500
DIRECTIONS = 8  # tried at a tie beside those across each
SAME = 1e-9  # relative: what two branches that agree may differ by, rounded on their ways
REST = 1e-12  # relative: what two ticks at rest may differ by
NEAR = 0.9  # the cosine of the angle between two borders that count as one


@dataclass(frozen=True)
class Matrices:
    """Slopes by the seeds (states, then inputs): `change` [A B] (states, seeds), `output` [C D] (outputs, seeds)."""

    change: Array
    output: Array
    value: Array  # the states' next values or derivatives
    made: Array  # the outputs' values

    def ordered(self, rows: Sequence[int], columns: Sequence[int]) -> "Matrices":
        """Return the matrices with the states in other orders: `rows` of next states, `columns` of states."""
        n = len(columns)
        to = [*columns, *range(n, self.change.shape[1])]
        return Matrices(self.change[np.ix_(rows, to)], self.output[:, to], self.value[list(rows)], self.made)

    def then(self, other: "Matrices") -> "Matrices":
        """Return the matrices over this step and then `other`, with the same inputs and the outputs of this one."""
        n = len(self.change)
        change = other.change[:, :n] @ self.change
        change[:, n:] += other.change[:, n:]
        return Matrices(change, self.output, other.value, self.made)

    def agree(self, other: "Matrices") -> bool:
        """Return True if slopes and values of both are equal up to rounding."""
        return close(self.change, other.change) and close(self.output, other.output) and self.meet(other)

    def agree_along(self, other: "Matrices", direction: Slope) -> bool:
        """Return True if both have the same slopes in this direction, and the same values."""
        states = close(self.change @ direction, other.change @ direction)
        return states and close(self.output @ direction, other.output @ direction) and self.meet(other)

    def meet(self, other: "Matrices") -> bool:
        """Return True if the values of both are equal."""
        return close(self.value, other.value) and close(self.made, other.made)


@dataclass(frozen=True)
class _Visit:
    """A tick of the period: its slopes, its ties, and where the point was."""

    found: Matrices
    ties: list[Tie]
    states: dict[Key, Any]
    held: dict[FlatSignal, Any]
    tick: int


class Slopes:
    """Slopes of a program at a point by its seeds, which are the coordinates, then the inputs.

    With `everything` all nodes are included, not only those on which `outputs` depend.
    """

    def __init__(
        self,
        program: FlatProgram,
        point: OperatingPoint,
        inputs: Mapping[str, FlatSignal],
        outputs: Mapping[str, FlatSignal],
        everything: bool,
    ) -> None:
        self.program = program
        self.name = program.name
        self.point = point
        self.inputs = inputs
        self.outputs = outputs
        cut = {s for s in inputs.values() if s.node is not None}
        self.parts = Parts(program, outputs, cut, everything)
        point.tick = self.parts.start(point.tick)
        self.whole = IntegerStates(program, point, self.parts)
        self.coordinates = Coordinates(point, self.whole, self.parts, self.parts.held(outputs.values()))
        self.size = self.coordinates.size
        if self.size > MAX_STATES:
            remedy = f"at most {MAX_STATES}: shorten the delays, or cut signals"
            raise DiagramError(f"its model has {self.size} states, too many", self.name, remedy)
        self.seeds = self.size + sum(s.width or 1 for s in inputs.values())
        self._whole = [(n, s) for n in self.parts.nodes for s in n.block.states if s.kind not in FLOATS]
        self._paths = {n.path for n in self.parts.nodes}
        self.rounded: set[str] = set()  # the paths of blocks in which a slope ended in a rounding

    def step(self, direction: Slope | None = None, rested: bool = False, slopes: bool = True) -> TangentStep:
        """Return a step whose outputs are computed; with `slopes` the coordinates and inputs have unit slopes.

        With `rested` all rates are due.
        """
        step = TangentStep(self.program, self.point, self.parts.nodes, rested, direction)
        if slopes:
            rows = iter(np.eye(self.seeds))
            for key in self.coordinates.keys:
                step.states[key] = seeded(step.states[key], rows)
            for s in self.coordinates.held:
                step.held[s] = seeded(step.held[s], rows)
            for s in self.inputs.values():
                if s.node is None:
                    step.read[s] = seeded(step.read[s], rows)
                elif s.width is None:
                    step.cut[s] = next(rows)
                else:
                    raise DiagramError("an array cannot be cut", s.path, "cut its elements behind a Demux")
        step.compute_outputs()
        return step

    def matrices(self, what: str = "next", strict: bool = True) -> Matrices:
        """Return the slopes of `what` (one of WHAT) and of the outputs by the seeds.

        With `strict`, raises DiagramError at a kink: a point at which the slopes depend on the direction of motion.
        """
        visits = self._visits(what)
        total = visits[0].found
        for visit in visits[1:]:
            total = total.then(visit.found)
        if strict:
            self._check(what, visits, total)
        return total

    def _visits(self, what: str) -> list[_Visit]:
        """Return the ticks of a period at which a rate is due; only the first one unless `what` is "next"."""
        start = self.point.tick
        # At a tie the branch of the point itself may be one that no motion leads into: somewhere beside it, then.
        direction = np.random.Generator(np.random.PCG64(1)).standard_normal(self.seeds)
        visits: list[_Visit] = []
        with self.point.kept():
            for tick in range(start, start + self.parts.period):
                if visits and (what != "next" or not self.parts.due(tick)):
                    continue
                self.point.tick = tick
                found, step, new = self._once(what, direction)
                self.rounded |= step.tangent.rounded & self._paths
                ties = [t for t in step.tangent.ties if t.where in self._paths]
                visits.append(_Visit(found, ties, dict(self.point.states), dict(self.point.held), tick))
                if what == "next":
                    self._follow(step, new)
        return visits

    def _check(self, what: str, visits: Sequence[_Visit], total: Matrices) -> None:
        """Raise DiagramError if one of the ticks is on a kink. Of ticks that are alike the first is checked."""
        read = self.coordinates.of_read_states(observed(total.change[:, : self.size], total.output[:, : self.size]))
        rings = self.whole.rings()  # a kink does not move with the place at which a ring is written
        whole = [(n, s.name) for n, s in self._whole if (n, s.name) not in rings]
        checked: list[tuple[Any, Array]] = []
        with self.point.kept():
            for visit in visits:
                self.point.states, self.point.held, self.point.tick = visit.states, visit.held, visit.tick
                chosen = self.parts.due(visit.tick), [numbers.plain(visit.states[key]) for key in whole]
                values = self.coordinates.values()[read]
                if not visit.ties or any(chosen == c and np.allclose(values, v, REST, REST) for c, v in checked):
                    continue
                first, *_ = self._once(what, None)
                self._check_kinks(what, first, visit.found, visit.ties)
                checked.append((chosen, values))

    def _follow(self, step: TangentStep, new: States) -> None:
        """Move the point to the tick after `step`, with its `new` states; what `at` holds stays."""
        held = {(n, s.name): self.point.states[n, s.name] for n, s in self._whole if (n, s.name) in self.point.given}
        self.point.put(new)
        self.point.states |= held
        self.point.held = step.made_plain()

    def _check_kinks(self, what: str, first: Matrices, beside: Matrices, ties: Sequence[Tie]) -> None:
        random = np.random.Generator(np.random.PCG64(2))
        different = _different(ties)
        trials: list[tuple[Slope, Tie]] = []
        for tie, normal in different:
            noise = 1e-3 * random.standard_normal(self.seeds)
            trials += [(normal + noise, tie), (-normal + noise, tie)]
        trials += [(random.standard_normal(self.seeds), ties[0]) for _ in range(DIRECTIONS)]
        for direction, tie in trials:
            other, *_ = self._once(what, direction)
            if not (beside.agree(other) and first.meet(other)):
                raise _kink(tie, "beside it the slopes differ", "limit, friction or switch")
        for tie, normal in different:
            if not tie.single:
                continue
            # A motion within the border: friction that holds goes on holding, whatever else moves.
            direction = random.standard_normal(self.seeds)
            direction -= (normal @ direction) * normal
            other, *_ = self._once(what, direction)
            if not beside.agree_along(other, direction):
                raise _kink(tie, "a state at rest there stays at rest (dry friction, a stop)", "friction or stop")

    def _once(self, what: str, direction: Slope | None) -> tuple[Matrices, TangentStep, States]:
        """Return the slopes over one tick, ties resolved by `direction`, with the step and the new states."""
        step = self.step(direction)
        if what == "slope":
            new = step.derivative(step.continuous())
        elif what == "projection":
            new = step.states | step.projected(step.continuous())
        else:
            new = step.following()
        rows: list[Dual] = []
        for key in self.coordinates.keys:
            self._finite(key[0].path, elements(new[key]))
            rows += elements(new[key])
        for s in self.coordinates.held:
            rows += elements(step.held[s] if what == "projection" else step.made[s])
        made: list[Dual] = []
        for s in self.outputs.values():
            self._finite(s.path, elements(step.made[s]))
            made += elements(step.made[s])
        return Matrices(self._stack(rows), self._stack(made), _values(rows), _values(made)), step, new

    def _stack(self, rows: Sequence[Dual]) -> Array:
        none = np.zeros(self.seeds)
        made = np.array([none if d.slope is None else d.slope for d in rows]).reshape(len(rows), self.seeds)
        return np.asarray(made + 0.0)  # no -0.0

    def _finite(self, path: str, duals: Sequence[Dual]) -> None:
        for d in duals:
            if not np.isfinite(d.value):
                raise DiagramError(f"its value is {d.value} at the point", path, "give another point with `at`")
            if d.slope is not None and not np.isfinite(d.slope).all():
                raise DiagramError(
                    "its slope is infinite or undefined at the point", path, "move the point away (sqrt at 0, 0 / 0)"
                )


def observed(a: Array, c: Array) -> NDArray[np.bool_]:
    """Return a mask of the states that have an effect on an output at some time."""
    return spread((c != 0.0).any(axis=0), (a != 0.0).T)


def spread(start: NDArray[np.bool_], edges: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return `start` (n, ...) with each row joined by `or` with all rows that `edges` (n, n) reach from it."""
    found = start
    while (further := found | (edges @ found)).sum() > found.sum():
        found = further
    return found


def _kink(tie: Tie, why: str, cause: str) -> DiagramError:
    remedy = f"move the point off it with `at`, or take out the {cause} that makes it"
    return DiagramError(f"the point is on a kink: {tie.what}, and {why}", tie.where, remedy)


def _different(ties: Sequence[Tie]) -> list[tuple[Tie, Slope]]:
    """Return one tie of each group so near to one another that a motion across one crosses them all, and its normal.

    Each stage of an integration meets the borders of the first, somewhat turned.
    """
    found: list[tuple[Tie, Slope]] = []
    for tie in ties:
        normal = tie.slope / np.linalg.norm(tie.slope)
        kind = tie.where, tie.what, tie.single
        if not any(kind == (t.where, t.what, t.single) and abs(n @ normal) > NEAR for t, n in found):
            found.append((tie, normal))
    return found


def close(a: Array, b: Array) -> bool:
    """Return True if two arrays are equal up to rounding."""
    return np.allclose(a, b, rtol=SAME, atol=SAME * (1e-3 + float(np.abs(a).max(initial=0.0))))


def _values(duals: Sequence[Dual]) -> Array:
    return np.array([float(d.value) for d in duals], dtype=np.float64)
