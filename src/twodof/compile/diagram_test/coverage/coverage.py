"""Coverage: which sides of a diagram's decisions were taken over all tests, measured on the reference."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.diagram import Diagram
from twodof.blocks.reference.interpreter import Reference
from twodof.blocks.reference.places import DiagramLevel, PortOf
from twodof.compile.diagram_test.coverage.decisions import Decision
from twodof.compile.diagram_test.coverage.observer import DecisionObserver
from twodof.compile.diagram_test.judgement import ScenarioResult
from twodof.compile.diagram_test.plan import Plan, plan
from twodof.compile.diagram_test.run_scenarios import DT, run_plan
from twodof.compile.diagram_test.scenario import Scenario
from twodof.errors import ControllerFault

Bools = NDArray[np.bool_]


@dataclass
class Coverage:
    """The decisions of a diagram, and of each the sides that were taken: their positions in `Decision.sides`."""

    taken: dict[Decision, set[int]] = field(default_factory=dict)

    def add(self, other: "Coverage") -> None:
        """Take in what other tests of the same diagram took."""
        for decision, sides in other.taken.items():
            self.taken.setdefault(decision, set()).update(sides)

    @property
    def sides(self) -> int:
        """How many sides there are."""
        return sum(len(decision.sides) for decision in self.taken)

    @property
    def share(self) -> float:
        """Which share of all sides was taken; 1 for a diagram that decides nothing."""
        return sum(map(len, self.taken.values())) / self.sides if self.taken else 1.0

    @property
    def missing(self) -> list[tuple[Decision, str]]:
        """The sides that were never taken, in the order of the diagram."""
        return [(d, side) for d, taken in self.taken.items() for i, side in enumerate(d.sides) if i not in taken]


def measure_coverage(
    diagram: Diagram,
    scenarios: Sequence[Scenario],
    dt: float = DT,
    precision: str = "float64",
    integrator: str = "rk4",
    results: Iterable[ScenarioResult] = (),
) -> Coverage:
    """What the scenarios take of the diagram's decisions, at the base tick `dt` [s], in this precision.

    `results` are those of a run of the same scenarios (on any target): each signal must be the same to the bit. Raises
    ControllerFault if one is not, DiagramError as `run_scenarios` does.
    """
    plans = [plan(diagram, scenario, dt) for scenario in scenarios]
    hierarchy = Reference(diagram, dt, precision, (), integrator).hierarchy
    levels = [level for level in _levels(hierarchy.root) if level.signals]
    deciding = {str(s) for level in levels for s in level.signals if isinstance(s, PortOf)}
    paths = sorted(deciding.union(*(p.paths for p in plans)))
    program = Reference(diagram, dt, precision, paths, integrator)
    observer = DecisionObserver(program.hierarchy.cells)
    found = Coverage(observer.taken)
    compared = iter(results)
    for planned in plans:
        signals = run_plan(planned, program.machine(observer))
        result = next(compared, None)
        if result is not None:
            _compare(signals, result)
        columns = {name: np.asarray(values) for name, values in {**planned.inputs, **signals}.items()}
        for level in levels:
            found.add(_of_level(level, columns, planned))
    return found


def _compare(signals: dict[str, NDArray[np.generic]], result: ScenarioResult) -> None:
    for name, values in result.signals.items():
        if name in signals and not _same(signals[name].astype(values.dtype), values):
            raise ControllerFault(
                "the target's values differ from the reference's", f"{result.name}, {name}", "report it: they never may"
            )


def _same(a: NDArray[np.generic], b: NDArray[np.generic]) -> bool:
    """Equal to the bit; NaN is one value."""
    if a.dtype.kind == "f":
        a, b = np.where(np.isnan(a), np.nan, a), np.where(np.isnan(b), np.nan, b)
    return a.shape == b.shape and a.tobytes() == b.tobytes()


def _levels(level: DiagramLevel) -> Iterator[DiagramLevel]:
    for child in level.children.values():
        if isinstance(child, DiagramLevel):
            yield child
            yield from _levels(child)


def _of_level(level: DiagramLevel, columns: dict[str, NDArray[np.generic]], planned: Plan) -> Coverage:
    """What decides over a sub-diagram: at the ticks at which it is due and those around it act."""
    zeros = np.zeros(planned.steps, dtype=bool)

    def column(signal: PortOf | str | None) -> Bools:
        return columns.get(str(signal), zeros).astype(bool)

    ticks = np.arange(planned.steps)
    due: Bools = ticks % level.rate.divider == level.rate.offset
    for outer in level.around:
        for above in outer.enables:
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
