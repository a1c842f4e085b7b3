"""DecisionObserver: watches the reference run, and notes which sides of each condition were taken."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.expr import LOOPS, Expr
from twodof.blocks.expressions.graph import walk
from twodof.blocks.expressions.matrix import flat_of
from twodof.blocks.matrix_views import matrices, with_matrices
from twodof.blocks.reference.places import Cell
from twodof.blocks.state_machine import StateMachine
from twodof.blocks.state_machine.reaction import followed
from twodof.blocks.trace import by_method, computed
from twodof.compile.diagram_test.coverage.decisions import Decision, bare, conditions, machine_decisions
from twodof.errors import DiagramError


class DecisionObserver:
    """Recomputes what each method of a block gave from its recorded expressions, on the numbers of the run.

    A condition counts where its result is used: of a `where` within the side that another one does not take, nothing
    counts. `taken` holds the sides (0: true, 1: false) by decision. Call it as a `Watch` of a reference machine.
    """

    def __init__(self, cells: Iterable[Cell]) -> None:
        self.taken: dict[Decision, set[int]] = {}
        self._conditions: dict[str, dict[int, Decision]] = {}
        self._machines: dict[str, tuple[list[Decision], list[Decision]]] = {}
        self._roots: dict[tuple[str, str], dict[str, tuple[Expr, ...]]] = {}
        for cell in cells:
            if cell.path.rpartition(".")[2].startswith("_"):
                continue  # what the language adds to decide over a sub-diagram: that is a decision of its own
            if isinstance(cell.block, StateMachine):
                modes, ways = self._machines[cell.path] = machine_decisions(cell.block, cell.path)
                self.taken |= {decision: set() for decision in (*modes, *ways)}
            found = conditions(cell.block, cell.path)
            self.taken |= {decision: set() for decision in found.values()}
            self._conditions[cell.path] = found
            for method, exprs in by_method(cell.block.trace).items():
                if any(_chooses(item, found) for roots in exprs.values() for item in walk(roots)):
                    self._roots[cell.path, method] = exprs

    def __call__(self, cell: Cell, method: str, values: Mapping[str, Any], seen: tuple[Any, Any, Any, Any]) -> None:
        """What a method of a running block gave. Raises DiagramError if its recorded expressions give another value."""
        if method == "update" and isinstance(cell.block, StateMachine):
            self._machine(cell.block, cell.path, seen)
        exprs = self._roots.get((cell.path, method))
        if exprs is None:
            return
        sight = _Sight(self._conditions[cell.path])
        roots = [root for name in values for root in exprs[name]]
        again = computed(roots, *seen, sight)
        given = [v for value in values.values() for v in (value if method == "edges" else (value,))]
        if list(map(_bits, again)) != list(map(_bits, given)):
            raise DiagramError(
                f"{method} gives another value than what it recorded when it was traced",
                cell.path,
                "let it depend on u, x, p and t only",
            )
        for decision, side in sight.taken(roots):
            self.taken[decision].add(side)

    def _machine(self, machine: StateMachine, path: str, seen: tuple[Any, Any, Any, Any]) -> None:
        modes, ways = self._machines[path]
        shapes = matrices(machine.inputs), matrices(machine.states), matrices(machine.params, machine.derived)
        u, x, p = (with_matrices(view, some) for view, some in zip(seen[:3], shapes, strict=True))
        way, mode = followed(machine, u, x, p, seen[3])
        self.taken[modes[mode]].add(0)
        if way is not None:
            self.taken[ways[way]].add(0)


def _bits(value: Any) -> str:
    """Equal for equal bits; of NaN there is one."""
    return repr(numbers.plain(flat_of(value)))


class _Sight:
    """What one evaluation took. Bodies of loops are evaluated first, so what they took waits until the loop counts."""

    def __init__(self, known: Mapping[int, Decision]) -> None:
        self._known = known
        self._waiting: dict[tuple[int, ...], _Turns] = {}

    def __call__(self, roots: Sequence[Expr], order: Sequence[Expr], values: Mapping[int, Any]) -> None:
        """The nodes computed for `roots`, arguments first, and all values by id."""
        bodies = {id(item): _key(item.bodies) for item in order if item.op in LOOPS}
        within = {key: self._waiting.pop(key, _Turns()) for key in set(bodies.values())}
        turns = self._waiting.setdefault(_key(roots), _Turns())
        counts = set(map(id, roots))
        for item in reversed(order):
            if id(item) not in counts:
                continue
            if id(item) in self._known:
                turns.taken.add((self._known[id(item)], 0 if values[id(item)] else 1))
            if id(item) in bodies:
                turns.taken |= within[bodies[id(item)]].taken
                counts |= within[bodies[id(item)]].before
            if item.op == "where":
                counts.add(id(item.args[0]))
                counts.add(id(item.args[1] if values[id(item.args[0])] else item.args[2]))
            else:
                counts.update(map(id, item.outside))
        turns.before |= counts.difference(map(id, order))

    def taken(self, roots: Sequence[Expr]) -> set[tuple[Decision, int]]:
        """What the evaluation of `roots` took."""
        return self._waiting.get(_key(roots), _Turns()).taken


@dataclass
class _Turns:
    """What the turns of a loop took, and the ids of what they used of the values computed before the loop."""

    taken: set[tuple[Decision, int]] = field(default_factory=set)
    before: set[int] = field(default_factory=set)


def _key(roots: Sequence[Expr]) -> tuple[int, ...]:
    return tuple(map(id, roots))


def _chooses(item: Expr, known: Mapping[int, Decision]) -> bool:
    return item.op in ("where", "and", "or") and any(id(bare(a)) in known for a in item.args)
