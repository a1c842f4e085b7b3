"""Rewriting of expressions: over program leaves, short loops unrolled, `prepare` in float64, ranges of indices."""

from collections.abc import Callable, Container, Mapping, Sequence

from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.expr import LEAVES, LOOPS, Expr
from twodof.blocks.expressions.expr import node as make
from twodof.blocks.expressions.graph import OPERATIONS, ordered, walk
from twodof.blocks.expressions.numbers import FLOATS
from twodof.compile.program.flat_program import FlatProgram, FlatSignal, Node

SHORT = 4  # rounds of a loop that is written out
MOST_WRITTEN = 100  # operations that a written-out loop has at most
DEEPEST = 20  # operations within one another whose range is looked for
_LOW, _HIGH = -(2**31), 2**31 - 1
EXACT = "float64"

Span = tuple[int, int]
"""Range of an integer: its least and its largest value."""


class ProgramGraph:
    """The expressions of all blocks, connected, with short loops written out.

    A `signal` node names its argument, the value of a FlatSignal; the `data` of both it and an `input` leaf is that
    signal. The `data` of a `state` leaf is (node, name). A given parameter has a FlatParameter, a derived one
    (node, name). `dt` becomes a constant. A value that is computed at every tick is replaced by the signal that shows
    it, if that is one of `shown`.
    """

    def __init__(self, program: FlatProgram, shown: Container[FlatSignal] = ()) -> None:
        self.program = program
        self._owners: dict[int, Node] = {}
        self._made: dict[Node, dict[int, Expr]] = {}
        self._kept: list[Expr] = []  # nodes whose identities are keys
        self._shown: dict[int, Expr] = {}
        self._signals = {s: make("input", s.kind, (), s, s.width) for s in program.inputs.values()}
        for signal in (s for group in (*program.tick, *program.stage) for a in group.actions for s in a.signals):
            if signal.node is None or signal in self._signals:
                continue
            root = signal.node.trace.outputs[signal.port]
            value = self.of(signal.node, root)
            self._signals[signal] = made = make("signal", signal.kind, (value,), signal, signal.width)
            if signal in shown and value.op not in (*LEAVES, "signal"):
                self._shown[id(value)] = self._made[signal.node][id(root)] = made

    def of(self, node: Node, root: Expr) -> Expr:
        """Return an expression of the block `node` over the program's leaves."""
        made = self._made.setdefault(node, {})

        def own(item: Expr) -> Expr:
            self._owners.setdefault(id(item), node)
            self._kept.append(item)
            return item

        for item in walk([root], known=made):
            new = written_out(own(self._rewritten(node, item, [made[id(a)] for a in item.args])), own)
            made[id(item)] = self._shown.get(id(new), new)
        return made[id(root)]

    def signal(self, signal: FlatSignal) -> Expr:
        """Return the node that stands for a signal's value."""
        return self._signals[signal]

    def owner(self, item: Expr) -> Node | None:
        """Return the block that an expression was first made for."""
        return item.data.node if item.op == "signal" else self._owners.get(id(item))

    def _rewritten(self, node: Node, item: Expr, args: Sequence[Expr]) -> Expr:
        if item.op == "input":
            return self._signals[node.drivers[item.data]]
        if item.op == "state":
            return make("state", item.kind, (), (node, item.data), item.width)
        if item.op == "param":
            given = node.parameters.get(item.data)
            return make("param", item.kind, (), given or (node, item.data), item.width)
        if item.op == "dt":
            seconds = self.program.dt * (node.rate.divider if item.data == "dt" else 1)
            return make("const", item.kind, (), seconds)
        return _folded(item, tuple(args))


def written_out(loop: Expr, own: Callable[[Expr], Expr]) -> Expr:
    """Return a short loop unrolled, and any other node unchanged. `own` is called with each new node and returns it.

    The operations are the same, and so are all bits.
    """
    if loop.op not in LOOPS or loop.data[0] > SHORT:
        return loop
    length, depth = loop.data[:2]
    bodies = loop.bodies
    if loop.op == "build" and bodies[0].width is not None and bodies[0].op != "vector":
        return loop
    turning = ordered(bodies, lambda item: [a for a in item.args if a.loops >> depth & 1])
    if length * len(turning) > MOST_WRITTEN or any(item.op in LOOPS for item in turning):
        return loop
    counters = [own(make("const", "int32", (), k)) for k in range(length)]
    if loop.op == "build":
        elements: list[Expr] = []
        for counter in counters:
            (made,) = _round(bodies, turning, {(depth, 0): counter}, own)
            elements += made.args if made.op == "vector" and bodies[0].width is not None else [made]
        return own(make("vector", loop.kind, tuple(elements), None, loop.width))
    carried: Sequence[Expr] = loop.outside
    for counter in counters:
        values = {(depth, j + 1): e for j, e in enumerate(carried)}
        carried = _round(bodies, turning, {(depth, 0): counter, **values}, own)
    result: int = loop.data[2]
    return carried[result]


def _round(
    bodies: Sequence[Expr], turning: Sequence[Expr], values: Mapping[tuple[int, int], Expr], own: Callable[[Expr], Expr]
) -> list[Expr]:
    """Return a loop's bodies with these values of its variables; only the nodes `turning` depend on them."""
    made: dict[int, Expr] = {}
    for item in turning:
        args = tuple(made.get(id(a), a) for a in item.args)
        made[id(item)] = values[item.data] if item.op == "bound" and item.data in values else own(_folded(item, args))
    return [made.get(id(body), body) for body in bodies]


def _folded(item: Expr, args: tuple[Expr, ...]) -> Expr:
    """Return a node on new arguments: known whole numbers are computed, elements of vectors looked up."""
    if not args:
        return item
    if item.op in ("and", "or") and args[0] is args[1]:
        return args[0]
    if item.op in ("xor", "or", "add") and item.kind == "uint32":  # not a float: -0.0 + 0 is 0
        for zero, other in (args, args[::-1]):
            if zero.op == "const" and zero.data == 0:
                return other
    if item.op == "select" and args[0].op == "vector" and args[1].op == "const":
        at: int = min(max(args[1].data, 0), len(args[0].args) - 1)
        return args[0].args[at]
    if item.op == "where" and args[0].op == "const":
        return args[1] if args[0].data else args[2]
    exact = item.op in OPERATIONS and item.kind not in FLOATS and item.width is None
    if exact and all(a.op == "const" and a.kind not in FLOATS for a in args):
        value = OPERATIONS[item.op](*(numbers.cast(a.data, a.kind) for a in args))
        return make("const", item.kind, (), numbers.plain(value))
    return make(item.op, item.kind, args, item.data, item.width)


def index_range(item: Expr, limits: Mapping[tuple[int, int], int], depth: int = 0) -> Span | None:
    """Return the range of an int32 expression, or None if it is unknown or the value may wrap around.

    `limits` is the number of rounds of each loop around it, by the key of its counter, (depth, 0).
    """
    if item.kind != "int32" or item.width is not None or depth > DEEPEST:
        return None
    if item.op == "const":
        return item.data, item.data
    if item.op == "bound":
        return (0, limits[item.data] - 1) if item.data in limits else None
    if item.op == "where":
        return _chosen(item, limits, depth + 4)
    if item.op not in ("add", "sub", "mul", "quot", "rem"):
        return None
    a, b = (index_range(each, limits, depth + 1) for each in item.args)
    if a is None or b is None:
        return None
    if item.op in ("quot", "rem"):
        if a[0] < 0 or b[0] != b[1] or b[0] <= 0:
            return None
        return (a[0] // b[0], a[1] // b[0]) if item.op == "quot" else (0, min(a[1], b[0] - 1))
    if item.op == "sub":
        b = (-b[1], -b[0])
    ends = [x * y if item.op == "mul" else x + y for x in a for y in b]
    return (min(ends), max(ends)) if min(ends) >= _LOW and max(ends) <= _HIGH else None


def _chosen(item: Expr, limits: Mapping[tuple[int, int], int], depth: int) -> Span:
    """Return the range of a `where`: of a minimum or maximum, as in a clamp, or of either value."""
    test, a, b = item.args
    low, high = zip(*(index_range(e, limits, depth) or (_LOW, _HIGH) for e in (a, b)), strict=True)
    compared = [id(e) for e in test.args] if test.op == "lt" else []
    if compared == [id(a), id(b)]:
        return min(low), min(high)
    return (max(low) if compared == [id(b), id(a)] else min(low)), max(high)


def in_doubles(exprs: Mapping[str, Expr]) -> dict[str, Expr]:
    """Return the expressions of `prepare` with float64 arithmetic, rounded to real once at the end.

    So derived parameters have that accuracy in builds of float32 too. Nothing changes in builds of float64.
    """
    wide: dict[int, Expr] = {}
    for item in walk(exprs.values()):
        wide[id(item)] = _widened(item, wide)
    return {name: _rounded(wide[id(e)]) if e.kind == "real" else wide[id(e)] for name, e in exprs.items()}


def _widened(item: Expr, wide: Mapping[int, Expr]) -> Expr:
    """Return a node with float64 in the place of real; parameters are converted where they are read."""
    args = [wide[id(a)] for a in item.args]
    if item.op == "param":
        return _converted(item, EXACT) if item.kind == "real" else item
    if item.op == "select" and item.args[0].op == "param" and item.kind == "real":
        return make("convert", EXACT, (make("select", "real", (item.args[0], args[1])),))
    kind = EXACT if item.kind == "real" else item.kind
    if item.op == "convert" and args[0].kind == kind:
        return args[0]
    return make(item.op, kind, tuple(args), item.data, item.width)


def _rounded(item: Expr) -> Expr:
    """Return a float64, or an array of them, as real."""
    if item.op == "vector":
        return make("vector", "real", tuple(_converted(a, "real") for a in item.args), None, item.width)
    return _converted(item, "real")


def _converted(item: Expr, kind: str) -> Expr:
    """Return a number, or each element of an array, converted to another float kind."""
    if item.width is None:
        return make("convert", kind, (item,))
    # The array does not read the loop's counter, so it is made before the loop, whatever loops are around.
    element = make("select", item.kind, (item, make("bound", "int32", (), (0, 0))))
    return make("build", kind, (make("convert", kind, (element,)),), (item.width, 0), item.width)
