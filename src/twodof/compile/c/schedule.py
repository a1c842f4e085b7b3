"""Schedule: the part of a tick in which each signal is computed, and the statements that replace each state."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from twodof.blocks.expressions.expr import Expr
from twodof.blocks.expressions.expr import node as make
from twodof.blocks.expressions.graph import ordered
from twodof.blocks.state_machine import StateMachine
from twodof.compile.c.expressions import Renderer
from twodof.compile.c.statements import Text
from twodof.compile.program.flat_program import Action, FlatProgram, FlatSignal, Group, Guard, Node, Start
from twodof.compile.program.layout import MemoryLayout
from twodof.compile.program.lower import inputs_of


def changes(node: Node) -> bool:
    """Return True if the discrete states of a block may change."""
    return any(not _keeps(k, e) for k, e in node.trace.update.items())


@dataclass
class StateChange:
    """The next value `e` of the state `name` of `node`, whose lvalue is `place`."""

    node: Node
    name: str
    e: Expr
    place: str

    @property
    def numbers(self) -> Sequence[tuple[Expr | None, Expr]]:
        """Numbers to store, each with its index in an array; none for an array made by a loop."""
        if self.e.width is None:
            return [(None, self.e)]
        if self.e.op == "vector":
            return [(make("const", "int32", (), k), element) for k, element in enumerate(self.e.args)]
        chain, e = [], self.e
        while e.op == "store":
            chain.append((e.args[1], e.args[2]))
            e = e.args[0]
        return chain[::-1] if _keeps(self.name, e) else []

    @property
    def roots(self) -> list[Expr]:
        """Expressions of the numbers, each index before its element."""
        return [e for pair in self.numbers for e in pair if e is not None]


def changed(node: Node, values: Mapping[str, Expr], place: Callable[[str], str]) -> list[StateChange]:
    """Return the changes of a block's states to `values`, by name; `place` gives the lvalue of a state."""
    return [StateChange(node, name, e, place(name)) for name, e in values.items() if not _keeps(name, e)]


def commit(renderer: Renderer, rows: Sequence[StateChange]) -> None:
    """Add the statements of changes that happen together: none reads a state that another has replaced."""
    arrays = [row for row in rows if not row.numbers]
    # The signals that arrays are made of must be computed before any state changes.
    read = [item for item in _own(row.e for row in arrays) if item.op == "signal"]
    texts = iter(renderer.texts([*(e for row in rows for e in row.roots), *read]))
    stores = []
    for row in rows:
        for index, _ in row.numbers:
            at = None if index is None else renderer.index(next(texts), index, row.e.width or 1)
            stores.append((row, at, next(texts)))
    copies: list[tuple[StateChange, Text]] = []
    for row in arrays:
        renderer.owner = row.node
        beside = _own(other.e for other in rows if other.node is row.node)
        place = row.place
        if any(item.op == "state" and _own_name(item) == row.name for item in beside):
            place = renderer.names.new(f"{row.node.path}.{row.name}_next")
            renderer.declare(place, row.e.kind, width=row.e.width)
            copies.append((row, Text.of(place)))
        renderer.assign([(place, row.e)])
    replaced: set[str] = set()
    ready: list[tuple[StateChange, Text | None, Text]] = []
    for row, at, value in stores:
        renderer.owner = row.node
        if at is not None and at.reads & replaced:
            at = _kept(renderer, row, "index", at, "int32")
        if value.reads & replaced:
            value = _kept(renderer, row, f"{row.name}_next", value, row.e.kind)
        ready.append((row, at, value))
        replaced.add(row.place)
    for row, at, value in ready:
        renderer.owner = row.node
        if at is None:
            renderer.put(row.place, value)
        else:
            renderer.put(f"{row.place}[{at.text}]", value, more=at.reads)
    for row, source in copies:
        renderer.owner = row.node
        renderer.put(row.place, source, row.e.kind, row.e.width)
    renderer.owner = None


def _kept(renderer: Renderer, row: StateChange, name: str, value: Text, kind: str) -> Text:
    """Keep a number in a variable."""
    new = renderer.names.new(f"{row.node.path}.{name}")
    renderer.declare(new, kind, value, fixed=True)
    return Text.of(new)


def _own_name(item: Expr) -> str:
    """Return the name of a state leaf, of a block's own expressions or of the program's."""
    name: str = item.data if isinstance(item.data, str) else item.data[1]
    return name


def _own(roots: Iterable[Expr]) -> list[Expr]:
    """Return the nodes of a block's own expressions, with the signals that it reads."""
    return ordered(roots, lambda item: () if item.op == "signal" else item.args)


def _keeps(name: str, e: Expr) -> bool:
    return e.op == "state" and _own_name(e) == name


@dataclass(eq=False)
class Segment:
    """Actions under one guard that are computed together, and the action `behind` that follows them, if any.

    `behind` sets states to their initial values, or is the whole tick of a state machine. `updates` are the blocks
    whose states are replaced at the end of the segment, before `behind`.
    """

    guard: Guard
    actions: list[Action] = field(default_factory=list)
    behind: Action | None = None
    updates: list[Node] = field(default_factory=list)


class Schedule:
    """Schedule of a tick: its segments in groups with the same guard, and blocks `last` that are updated at its end.

    A `fixed` signal is computed at its position in the order, any other one where it is first needed.
    """

    def __init__(self, program: FlatProgram, layout: MemoryLayout) -> None:
        self.live = dict.fromkeys(s for g in program.tick for a in g.actions for s in a.signals)
        self.machines: set[Node] = set()
        self.groups: list[list[Segment]] = []
        self._at: dict[FlatSignal | Start, int] = {}  # the first segment in which a signal may be read
        self.segments: list[Segment] = []
        for group in program.tick:
            self.groups.append(self._divided(group))
        self.end = len(self.segments)
        self.last: list[Node] = []
        self._updated: dict[Node, int] = {}
        for node in program.nodes:
            if changes(node) and node not in self.machines:
                at = self._updated[node] = self._update(node)
                (self.segments[at].updates if at < self.end else self.last).append(node)
        self.fixed = self._fixed(program, layout)

    def _divided(self, group: Group) -> list[Segment]:
        """Return a group's segments: one ends where states are set, or with a state machine."""
        made = [Segment(group.guard)]
        self.segments.append(made[0])
        for action in group.actions:
            here = len(self.segments) - 1
            behind = action.start is not None or self._switches(action)
            for s in action.signals:
                self._at[s] = here + behind
            if not behind:
                made[-1].actions.append(action)
                continue
            made[-1].behind = action
            if action.start is not None:
                self._at[action.start] = here + 1
            else:
                self.machines.add(action.node)
            made.append(Segment(group.guard))
            self.segments.append(made[-1])
        return made

    def _switches(self, action: Action) -> bool:
        """Return True if an action is the whole tick of a state machine whose inputs have all been computed."""
        node = action.node
        if not isinstance(node.block, StateMachine):
            return False
        given = {s for s in node.outputs.values() if s in self.live}
        return given == set(action.signals) and all(s in self._at for s in (*switch_inputs(node), *node.starts))

    def _update(self, node: Node) -> int:
        """Return the segment at whose end a block's states are replaced: nothing reads the old ones any more.

        Blocks that always run wait until the end of the tick.
        """
        if node.guard.always or node.continuous:
            return self.end
        read = [s for s in inputs_of(node, node.trace.update.values()) if s in self.live]
        own = [s for s in node.outputs.values() if s in self.live]
        before: list[FlatSignal | Start] = [*read, *own, *node.starts]
        first = max((self._at[x] for x in before), default=0)
        found = (k for k in range(first, self.end) if self.segments[k].guard == node.guard)
        return next(found, self.end)

    def _fixed(self, program: FlatProgram, layout: MemoryLayout) -> set[FlatSignal]:
        """Return the signals that are computed where they stand in the order: they are read in several places."""
        sites: dict[FlatSignal, set[int]] = {s: set() for s in self.live}

        def read(signals: Iterable[FlatSignal], at: int) -> None:
            for s in signals:
                if s in sites:
                    sites[s].add(at)

        read((*program.outputs.values(), *program.edged, *integrated_signals(program)), self.end)
        for node in program.nodes:
            read((s for c in node.conditions for s in c.signals), self.end)
            if node not in self.machines:
                read(inputs_of(node, node.trace.update.values()), self._updated.get(node, self.end))
        fixed: set[FlatSignal] = set()
        for k in reversed(range(self.end)):
            segment = self.segments[k]
            if segment.behind is not None and segment.behind.start is None:
                read(switch_inputs(segment.behind.node), k)
            for action in reversed(segment.actions):
                for s in reversed(action.signals):
                    home = self._home(s, k, sites[s], layout)
                    if home is None:
                        fixed.add(s)
                    trace = action.node.trace
                    roots = (trace.outputs[s.port], *trace.edges.get(s.port, ()))
                    read(inputs_of(action.node, roots), k if home is None else home)
        return fixed

    def _home(self, s: FlatSignal, at: int, sites: set[int], layout: MemoryLayout) -> int | None:
        """Return the only segment that needs a signal, so that it is computed there; None to compute it in its own."""
        if len(sites) != 1 or s in layout.stored:
            return None
        (home,) = sites
        if home == at:
            return home
        return home if self.segments[at].guard.always and home < self.end else None


def switch_inputs(node: Node) -> list[FlatSignal]:
    """Return the signals that the switch of a state machine reads, without inputs of the program."""
    assert isinstance(node.block, StateMachine)
    read = inputs_of(node, node.block.graph.expressions)
    return [s for s in dict.fromkeys(node.drivers.values()) if s in read and s.node is not None]


def integrated_signals(program: FlatProgram) -> Iterator[FlatSignal]:
    """Yield the signals that the integration reads."""
    for node in program.integrated:
        yield from inputs_of(node, (*node.trace.derivative.values(), *node.trace.project.values()))
    for group in program.stage:
        for action in group.actions:
            yield from action.signals
            yield from inputs_of(action.node, (action.node.trace.outputs[s.port] for s in action.signals))
