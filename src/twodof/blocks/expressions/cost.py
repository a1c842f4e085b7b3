"""How much an expression graph costs to compile and to compute: known before anything is compiled or computed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from twodof.blocks.expressions.expr import LOOPS, Expr
from twodof.blocks.expressions.graph import unchanging, walk
from twodof.errors import DiagramError

MAX_SIZE = 50_000
"""Nodes of a graph, each loop's body counted where it stands: what a compiler gets to see."""
MAX_OPERATIONS = 1_000_000
"""Elementary operations of one step."""
MAX_LOOP_DEPTH = 8

CALL = 30  # an elementary function in operations, about the longest of them
COPIED = 64  # elements of an array that are copied in the time of one operation


@dataclass(frozen=True)
class ExpressionCost:
    """`size` [nodes]: what is compiled; `operations`: what one evaluation computes."""

    size: int = 0
    operations: int = 0

    def __add__(self, other: ExpressionCost) -> ExpressionCost:
        return ExpressionCost(self.size + other.size, self.operations + other.operations)


class CostMeter:
    """Measures graphs; those of one meter may share loops, which are then measured once.

    A body that two loops share is compiled and computed in each of them. What a loop does not change is computed once,
    before it. So a few hundred nested loops can stand for more operations than there are atoms. The
    numbers grow so fast only for nested loops, whose depth is bounded.
    """

    def __init__(self, most: int | None = MAX_SIZE) -> None:
        self.most = most  # the largest size; None: any, and loops of any depth
        self._loops: dict[int, tuple[ExpressionCost, int]] = {}
        self._before: dict[int, list[Expr]] = {}
        self._kept: list[Expr] = []  # so that an identity stays that of one node
        self._visited = 0

    def measure(self, roots: Iterable[Expr]) -> ExpressionCost:
        """Measure the effort of evaluating `roots` once. Raises DiagramError if it is beyond any diagram's limit."""
        roots = list(roots)
        nodes = self._scope(roots, {})
        new = any(n.op in LOOPS and id(n) not in self._loops for n in nodes)
        for loop in walk(roots) if new else ():  # inner loops come before those around them
            if loop.op not in LOOPS or id(loop) in self._loops:
                continue
            before = {id(e): None for e in self._unchanging(loop)}
            effort, depth = self._sum(self._scope(loop.bodies, before))
            if self.most is not None and depth + 1 > MAX_LOOP_DEPTH:
                raise DiagramError(
                    f"loops are nested more than {MAX_LOOP_DEPTH} deep", "", "use fewer loops within one another"
                )
            length, copied = loop.data[0], sum(e.width or 0 for e in loop.bodies)
            operations = 1 + length * (1 + copied + effort.operations)
            self._loops[id(loop)] = (ExpressionCost(1 + effort.size, operations), depth + 1)
            self._kept.append(loop)
        return self._sum(nodes)[0]

    def _scope(self, roots: Iterable[Expr], known: Mapping[int, None]) -> list[Expr]:
        """As `graph.scope`, in any order and so in half the time."""
        nodes: dict[int, Expr] = {}
        stack = list(roots)
        while stack:
            item = stack.pop()
            if id(item) not in nodes and id(item) not in known:
                nodes[id(item)] = item
                stack.extend(item.outside)
                if item.op in LOOPS:
                    stack.extend(self._unchanging(item))
        self._visit(len(nodes))
        return list(nodes.values())

    def _unchanging(self, loop: Expr) -> list[Expr]:
        """Return the nodes computed once before a loop; the time of finding them is bounded too."""
        if id(loop) not in self._before:

            def counted(item: Expr) -> Expr:
                self._visit(1)
                return item

            self._before[id(loop)] = unchanging(loop, counted)
            self._kept.append(loop)
        return self._before[id(loop)]

    def _visit(self, nodes: int) -> None:
        """Bounds the time of measuring itself by the sum of all bodies."""
        self._visited += nodes
        self._check(self._visited // 10)

    def _sum(self, nodes: Iterable[Expr]) -> tuple[ExpressionCost, int]:
        """Return the effort of `nodes`, a loop as one of them, and how deep loops are nested."""
        size = operations = depth = 0
        for item in nodes:
            if item.op in LOOPS:
                inner, below = self._loops[id(item)]
                size += inner.size
                operations += inner.operations
                depth = max(depth, below)
            else:
                elements = len(item.args) if item.op == "vector" else 0
                size += 1 + elements
                operations += CALL if item.op == "call" else 1
                operations += (item.width or 0) // COPIED if item.op == "store" else elements
        self._check(size)
        return ExpressionCost(size, operations), depth

    def _check(self, size: int) -> None:
        if self.most is not None and size > self.most:
            raise too_large()


def too_large() -> DiagramError:
    """Return the error for an expression of more than MAX_SIZE."""
    return DiagramError(f"expressions of more than {MAX_SIZE} operations", "", "compute less, or in loops")
