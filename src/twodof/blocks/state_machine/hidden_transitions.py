"""The checks of the ways between modes: modes that nothing leads to, and transitions that are never taken."""

from __future__ import annotations

from collections.abc import Sequence

from twodof.blocks.expressions.expr import Expr
from twodof.blocks.expressions.graph import leaves
from twodof.blocks.state_machine.chart import Chart, Leaf, Route
from twodof.blocks.state_machine.machine_graph import ELAPSED, MachineGraph
from twodof.errors import DiagramError, listed


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
                raise DiagramError(
                    f"the transition {route.transition.text} is never taken: its guard is never true",
                    "",
                    "remove it, or correct its guard",
                )
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
    """Whether b certainly holds wherever a does. Equal expressions are one node."""
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
        raise DiagramError(
            f"no transition leads to {listed(never)} from {chart.leaves[0].mode.name}, where the machine starts",
            "",
            "add a transition to it, or remove it",
        )
