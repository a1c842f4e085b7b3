"""How much an expression graph costs to compile and to compute: known before anything is compiled or computed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from twodof.blocks.expressions.expr import Expr
from twodof.blocks.expressions.graph import outside
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

    A body that two loops share is compiled and computed in each of them. So a few hundred nested loops can stand for
    more operations than there are atoms. The numbers grow so fast only for nested loops, whose depth is bounded.
    """

    def __init__(self, most: int | None = MAX_SIZE) -> None:
        self.most = most  # the largest size; None: any, and loops of any depth
        self._loops: dict[int, tuple[ExpressionCost, int]] = {}
        self._kept: list[Expr] = []  # so that an identity stays that of one node
        self._visited = 0

    def measure(self, roots: Iterable[Expr]) -> ExpressionCost:
        """The effort of evaluating `roots` once. Raises DiagramError if it is beyond what any diagram may cost."""
        return self._measure(roots)[0]

    def _measure(self, roots: Iterable[Expr]) -> tuple[ExpressionCost, int]:
        """The effort, and how deep loops are nested. Loops are entered innermost first, without recursion."""
        order = self._walk(roots)
        pending = [item for item in order if item.op in ("build", "fold") and id(item) not in self._loops]
        while pending:
            loop = pending[-1]
            if id(loop) in self._loops:
                pending.pop()
                continue
            body = self._walk(loop.args[len(outside(loop)) :])
            inner = [n for n in body if n.op in ("build", "fold") and id(n) not in self._loops]
            if inner:
                pending += inner
                self._check(len(pending))
                continue
            effort, depth = self._sum(body)
            length = loop.data[0]
            if self.most is not None and depth + 1 > MAX_LOOP_DEPTH:
                raise DiagramError(
                    f"loops are nested more than {MAX_LOOP_DEPTH} deep", "", "use fewer loops within one another"
                )
            self._loops[id(loop)] = (ExpressionCost(1 + effort.size, 1 + length * (1 + effort.operations)), depth + 1)
            self._kept.append(loop)
            pending.pop()
        return self._sum(order)

    def _walk(self, roots: Iterable[Expr]) -> list[Expr]:
        """Every node below `roots` once, loops not entered."""
        found: list[Expr] = []
        seen: set[int] = set()
        stack = list(roots)
        while stack:
            item = stack.pop()
            if id(item) not in seen:
                seen.add(id(item))
                found.append(item)
                stack.extend(outside(item))
        self._visited += len(found)
        self._check(self._visited // 10)  # the sum of all bodies: this bounds the time of measuring itself
        return found

    def _check(self, size: int) -> None:
        if self.most is not None and size > self.most:
            raise too_large()

    def _sum(self, nodes: Iterable[Expr]) -> tuple[ExpressionCost, int]:
        size = operations = depth = 0
        for item in nodes:
            if item.op in ("build", "fold"):
                inner, below = self._loops[id(item)]
                size += inner.size
                operations += inner.operations
                depth = max(depth, below)
                continue
            elements = (
                (item.width or 0) // COPIED if item.op == "store" else len(item.args) if item.op == "vector" else 0
            )
            size += 1 + (len(item.args) if item.op == "vector" else 0)
            operations += elements + (CALL if item.op == "call" else 1)
        self._check(size)
        return ExpressionCost(size, operations), depth


def too_large() -> DiagramError:
    """The error for what is more than MAX_SIZE."""
    return DiagramError(f"expressions of more than {MAX_SIZE} operations", "", "compute less, or in loops")
