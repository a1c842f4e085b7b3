"""ProgramGraph: the expressions of all blocks over the signals, states and parameters of the whole program."""

from collections.abc import Sequence

from twodof.blocks.expressions.expr import Expr
from twodof.blocks.expressions.expr import node as make
from twodof.blocks.expressions.graph import walk
from twodof.compile.program.flat_program import FlatProgram, FlatSignal, Node


class ProgramGraph:
    """Rewrites a block's expressions over leaves that are unique in the program.

    The `data` of an `input` leaf is a FlatSignal, of a `state` leaf (node, name), of a `param` leaf a FlatParameter or,
    if it is derived, (node, name). `dt` becomes a constant.
    """

    def __init__(self, program: FlatProgram) -> None:
        self.program = program
        self._owners: dict[int, Node] = {}
        self._made: dict[Node, dict[int, Expr]] = {}

    def of(self, node: Node, root: Expr) -> Expr:
        """Return an expression of the block `node` over the program's leaves."""
        made = self._made.setdefault(node, {})
        for item in walk([root], known=made):
            new = self._rewritten(node, item, [made[id(a)] for a in item.args])
            made[id(item)] = new
            self._owners.setdefault(id(new), node)
        return made[id(root)]

    def output(self, signal: FlatSignal) -> Expr:
        """Return the expression of a signal that a block gives."""
        if signal.node is None:
            raise ValueError(f"{signal.path} is an input of the program")
        return self.of(signal.node, signal.node.trace.outputs[signal.port])

    def owner(self, item: Expr) -> Node | None:
        """Return the block that an expression was first made for."""
        return item.data.node if item.op == "input" else self._owners.get(id(item))

    def _rewritten(self, node: Node, item: Expr, args: Sequence[Expr]) -> Expr:
        if item.op == "input":
            return leaf(node.drivers[item.data])
        if item.op == "state":
            return make("state", item.kind, (), (node, item.data), item.width)
        if item.op == "param":
            given = node.parameters.get(item.data)
            return make("param", item.kind, (), given or (node, item.data), item.width)
        if item.op == "dt":
            seconds = self.program.dt * (node.rate.divider if item.data == "dt" else 1)
            return make("const", item.kind, (), seconds)
        return make(item.op, item.kind, tuple(args), item.data, item.width)


def leaf(signal: FlatSignal) -> Expr:
    """Return the leaf that stands for a signal's value."""
    return make("input", signal.kind, (), signal, signal.width)
