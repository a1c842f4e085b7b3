"""Coverage: the sides of a diagram's decisions that its tests took, measured on the reference.

A *condition* is a bool that chooses, with two sides: the first argument of a `where` (also inside a minimum, limit or
switch), or an operand of a bool `&` or `|`. `~c` is the same decision as c. A condition in several places of a block is
one decision. The enable, reset and trigger of a sub-diagram are decisions too; those of a state machine are not.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.block import Block
from twodof.blocks.diagram import Diagram
from twodof.blocks.expressions.expr import LOOPS, Expr, noting_lines
from twodof.blocks.expressions.graph import limit_of, text_of, walk
from twodof.blocks.reference.hierarchy import Cell, DiagramLevel, PortOf
from twodof.blocks.reference.interpreter import Reference
from twodof.blocks.state_machine import StateMachine
from twodof.blocks.trace import by_method, computed, trace_of
from twodof.compile.diagram_test.run_scenarios import DT, ScenarioPlan, plan, run_plan
from twodof.compile.diagram_test.scenario import Scenario


@dataclass(frozen=True)
class Decision:
    """One decision of the block or sub-diagram at `path`.

    `kind` is "condition", "enable", "reset" or "trigger". `place` is the line in the user's file, or the block's method
    and the output or state where the condition is first used. `sides` names the two sides; `number` distinguishes the
    decisions of one path.
    """

    kind: str
    path: str
    place: str
    text: str
    sides: tuple[str, ...] = ("true", "false")
    number: int = 0


@dataclass
class Coverage:
    """Decisions of a diagram, each with the sides that were taken, as positions in `Decision.sides`."""

    taken: dict[Decision, set[int]] = field(default_factory=dict)

    def add(self, other: "Coverage") -> None:
        """Add the sides that other tests of the same diagram have taken."""
        for decision, sides in other.taken.items():
            self.taken.setdefault(decision, set()).update(sides)

    @property
    def sides(self) -> int:
        """Number of sides of all decisions."""
        return sum(len(decision.sides) for decision in self.taken)

    @property
    def share(self) -> float:
        """Share of the sides that were taken; 1 for a diagram without decisions."""
        return sum(map(len, self.taken.values())) / self.sides if self.taken else 1.0

    @property
    def missing(self) -> list[tuple[Decision, str]]:
        """Decisions with a side that was never taken, in the order of the diagram."""
        return [(d, side) for d, taken in self.taken.items() for i, side in enumerate(d.sides) if i not in taken]


def measure_coverage(
    diagram: Diagram, scenarios: Sequence[Scenario], dt: float = DT, precision: str = "float64", integrator: str = "rk4"
) -> Coverage:
    """Run the scenarios on the reference, at the base tick `dt` [s], and return the sides that they take.

    Raises DiagramError as `run_scenarios` does.
    """
    plans = [plan(diagram, scenario, dt) for scenario in scenarios]
    hierarchy = Reference(diagram, dt, precision, (), integrator).hierarchy
    levels = list(dict.fromkeys(level for cell in hierarchy.cells for level in cell.levels))
    deciding = {str(s) for level in levels for s in level.signals if isinstance(s, PortOf)}
    paths = sorted(deciding.union(*(p.paths for p in plans)))
    program = Reference(diagram, dt, precision, paths, integrator)
    observer = _Observer(program.hierarchy.cells)
    found = Coverage(observer.taken)
    for planned in plans:
        signals = run_plan(planned, program.machine(observer))
        columns = {name: np.asarray(values) for name, values in {**planned.inputs, **signals}.items()}
        for level in levels:
            found.add(_of_level(level, columns, planned))
    return found


def _of_level(level: DiagramLevel, columns: dict[str, NDArray[np.generic]], planned: ScenarioPlan) -> Coverage:
    """Return the decisions over a sub-diagram, at the ticks at which it is due and the diagrams around it act."""
    zeros = np.zeros(planned.steps, dtype=bool)

    def column(signal: PortOf | str | None) -> NDArray[np.bool_]:
        return columns.get(str(signal), zeros).astype(bool)

    due: NDArray[np.bool_] = np.arange(planned.steps) % level.rate.divider == level.rate.offset
    for above in (signal for outer in level.around for signal in outer.enables):
        due = due & column(above)
    acts = due
    for own in level.enables:
        acts = acts & column(own)
    found = Coverage()
    trigger = next(iter(level.trigger.cell.drivers.values())) if level.trigger else None
    for kind, signal, shown, when, sides in (
        ("enable", level.enable, level.enable, due, ("on", "off")),
        ("trigger", level.trigger, trigger, due, ("edge", "no edge")),
        ("reset", level.reset, level.reset, acts, ("reset", "no reset")),
    ):
        if signal is not None:
            seen = column(signal)[when]
            decision = Decision(kind, level.path, "", str(shown), sides)
            found.taken[decision] = {i for i, side in enumerate((seen, ~seen)) if side.any()}
    return found


def _conditions(block: Block, path: str) -> dict[int, Decision]:
    """Return the decisions of a block, by the id of the condition's node."""
    if isinstance(block, StateMachine):
        return {}
    first: dict[int, tuple[Expr, str]] = {}  # by id: the condition, and its first use
    users: dict[int, list[Expr]] = {}
    for method, exprs in by_method(block.trace).items():
        for name, roots in exprs.items():
            for item in walk(roots):
                for condition in _chooses(item):
                    first.setdefault(id(condition), (condition, f"{method} {name}"))
                    users.setdefault(id(condition), []).append(item)
    lines = _lines(block) if first else {}
    found = {}
    for number, (condition, used) in enumerate(first.values()):
        text, sides = text_of(condition), ("true", "false")
        limit = next(filter(None, map(limit_of, users[id(condition)])), None)
        if limit is not None:
            # a < b chooses a of a minimum; of a maximum(a, b), which asks b < a, it is a as well.
            sides = text_of(limit[1]), text_of(limit[2])
            text = f"{limit[0]}({', '.join(sides)})"
        place = next((lines[id(e)] for e in (condition, *users[id(condition)]) if id(e) in lines), used)
        found[id(condition)] = Decision("condition", path, place, text, sides, number)
    return found


def _chooses(item: Expr) -> Iterator[Expr]:
    """Yield the conditions that a node asks, without their `not`s."""
    asked = item.args[:1] if item.op == "where" else ()
    if item.op in ("and", "or") and item.kind == "bool":
        asked = item.args
    for condition in asked:
        while condition.op == "not":
            condition = condition.args[0]
        if condition.op != "const":
            yield condition


def _lines(block: Block) -> Mapping[int, str]:
    """Return the user's file and line of each node of a user's block, by the node's id; none for the library's."""
    if type(block).__module__.startswith("twodof.blocks."):
        return {}
    lines: dict[int, str] = {}
    with noting_lines(lines):
        trace_of(block)  # the nodes of the first trace live, and so are met again
    return {
        node: f"{Path(file).name}:{line}" for node, place in lines.items() for file, _, line in [place.rpartition(":")]
    }


class _Observer:
    """Watch of a reference machine: recomputes each method from its recorded expressions and notes the sides.

    A condition counts where its result is used: inside the side of a `where` that is not taken, nothing counts.
    """

    def __init__(self, cells: Iterable[Cell]) -> None:
        self.taken: dict[Decision, set[int]] = {}
        self._known: dict[str, dict[int, Decision]] = {}
        self._roots: dict[tuple[str, str], dict[str, tuple[Expr, ...]]] = {}
        for cell in cells:
            if cell.path.rpartition(".")[2].startswith("_"):
                continue  # added by the language to decide over a sub-diagram
            known = self._known[cell.path] = _conditions(cell.block, cell.path)
            self.taken |= {decision: set() for decision in known.values()}
            for method, exprs in by_method(cell.block.trace).items():
                nodes = (item for roots in exprs.values() for item in walk(roots))
                if known and any(True for item in nodes for _ in _chooses(item)):
                    self._roots[cell.path, method] = exprs

    def __call__(self, cell: Cell, method: str, values: Mapping[str, Any], seen: tuple[Any, Any, Any, Any]) -> None:
        exprs = self._roots.get((cell.path, method))
        if exprs is not None:
            roots = [root for name in values for root in exprs[name]]
            sight = _Sight(self._known[cell.path])
            computed(roots, *seen, sight)
            for decision, side in sight.taken(roots):
                self.taken[decision].add(side)


class _Sight:
    """Sides that one evaluation took. Loop bodies are evaluated first; their sides wait until the loop counts.

    For a loop's turns there are, by the ids of its results, the sides that they took and the ids of the used values
    that were computed before the loop.
    """

    def __init__(self, known: Mapping[int, Decision]) -> None:
        self._known = known
        self._turns: dict[tuple[int, ...], tuple[set[tuple[Decision, int]], set[int]]] = {}

    def __call__(self, roots: Sequence[Expr], order: Sequence[Expr], values: Mapping[int, Any]) -> None:
        """Note the nodes computed for `roots`, arguments first, and all values by id."""
        loops = {id(item): tuple(map(id, item.bodies)) for item in order if item.op in LOOPS}
        within = {bodies: self._turns.pop(bodies, (set(), set())) for bodies in set(loops.values())}
        taken, before = self._turns.setdefault(tuple(map(id, roots)), (set(), set()))
        counts = set(map(id, roots))
        for item in reversed(order):
            if id(item) not in counts:
                continue
            if id(item) in self._known:
                taken.add((self._known[id(item)], 0 if values[id(item)] else 1))
            if id(item) in loops:
                sides, used = within[loops[id(item)]]
                taken |= sides
                counts |= used
            if item.op == "where":
                counts.add(id(item.args[0]))
                counts.add(id(item.args[1] if values[id(item.args[0])] else item.args[2]))
            else:
                counts.update(map(id, item.outside))
        before |= counts.difference(map(id, order))

    def taken(self, roots: Sequence[Expr]) -> set[tuple[Decision, int]]:
        """Return the sides that the evaluation of `roots` took."""
        return self._turns[tuple(map(id, roots))][0] if roots else set()
