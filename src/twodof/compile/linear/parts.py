"""Parts: which nodes a linear model is about, and the period after which all their rates are due again."""

import math
from collections import Counter
from collections.abc import Container, Iterable, Mapping
from functools import cached_property

from twodof.blocks.diagram import BASE, Rate
from twodof.blocks.expressions.graph import leaves
from twodof.blocks.expressions.kinds import FLOATS
from twodof.compile.program.flat_program import FlatProgram, FlatSignal, Node
from twodof.compile.program.flatten import constants
from twodof.errors import DiagramError

MAX_PERIOD = 1000  # base ticks


class Parts:
    """The nodes that `outputs` depend on, signals in `cut` not followed; all nodes with `everything`."""

    def __init__(
        self, program: FlatProgram, outputs: Mapping[str, FlatSignal], cut: Container[FlatSignal], everything: bool
    ) -> None:
        self.program = program
        self._below = {name: _depended_on(s, cut) for name, s in outputs.items()}
        needed = set().union(*self._below.values())
        everything = everything or not outputs
        self.nodes = [n for n in program.nodes if everything or n in needed]

    def outputs_of(self, node: Node) -> list[str]:
        """The outputs that depend on a node; the diagram's name if none does."""
        return [name for name, nodes in self._below.items() if node in nodes] or [self.program.name]

    def free_outputs(self, node: Node) -> list[str]:
        """The outputs that do not depend on a node."""
        return [name for name, nodes in self._below.items() if node not in nodes]

    @cached_property
    def integrated(self) -> list[Node]:
        """Those with continuous states."""
        return [n for n in self.nodes if n.continuous]

    @cached_property
    def _rates(self) -> dict[Rate, str]:
        """The rates of the nodes that do something, each with the path of one."""
        ordered = [s for g in self.program.tick for a in g.actions for s in a.signals]
        rateless = constants(ordered)
        live = {s.node for s in ordered if s not in rateless} | {n for n in self.nodes if n.block.states}
        return {n.rate: n.path for n in reversed(self.nodes) if n in live} or {BASE: self.program.name}

    @cached_property
    def period(self) -> int:
        """Base ticks until all rates are due again. Raises DiagramError where they are too many."""
        ticks = math.lcm(*(rate.divider for rate in self._rates))
        if len(self._rates) > 1 and ticks > MAX_PERIOD:
            (one, a), (two, b), *_ = sorted(self._rates.items(), reverse=True)
            raise DiagramError(
                f"its rates come round together after {ticks} ticks only: {a} runs at {tuple(one)} and {b} "
                f"at {tuple(two)}",
                self.program.name,
                f"at most {MAX_PERIOD} ticks: cut a signal between them as an input, or ask for fewer outputs",
            )
        return ticks

    def steps(self, node: Node) -> int:
        """How often a node runs in a period."""
        return self.period // math.gcd(self.period, node.rate.divider)

    @property
    def several_rates(self) -> str:
        """Two parts of different rates, in words; "" if there is one rate."""
        if len(self._rates) == 1:
            return ""
        (one, a), (two, b), *_ = self._rates.items()
        return f"{a} runs at {tuple(one)} and {b} at {tuple(two)}"

    def start(self, tick: int) -> int:
        """The first tick from `tick` on at which the most of the nodes are due."""
        if len(self._rates) == 1:
            (rate,) = self._rates
            return tick + (rate.offset - tick) % rate.divider
        sizes = Counter(n.rate for n in self.nodes)
        window = range(tick, tick + self.period)
        return max(window, key=lambda k: sum(size for r, size in sizes.items() if k % r.divider == r.offset))

    def due(self, tick: int) -> frozenset[Rate]:
        """The rates that are due at a tick."""
        return frozenset(r for r in self._rates if tick % r.divider == r.offset)

    def held(self, outputs: Iterable[FlatSignal]) -> list[FlatSignal]:
        """The real signals of slower rates that are read, or given out, between their own ticks."""
        if not self.several_rates:
            return []
        read = {s for n in self.nodes for s in n.drivers.values()} | set(outputs)
        slow = [s for n in self.nodes for s in n.outputs.values() if n.rate != BASE and s in read]
        return [s for s in slow if s.kind in FLOATS]

    def read_tick(self) -> list[str]:
        """The paths of the nodes that read the tick."""
        return [n.path for n in self.nodes if _reads_tick(n)]


def _reads_tick(node: Node) -> bool:
    t = node.trace
    edges = [e for pair in t.edges.values() for e in pair]
    roots = [*t.outputs.values(), *edges, *t.update.values(), *t.derivative.values(), *t.project.values()]
    return bool(leaves(roots, "tick"))


def _depended_on(signal: FlatSignal, cut: Container[FlatSignal]) -> set[Node]:
    """The nodes that a signal depends on, the one that makes it included."""
    found: set[Node] = set()
    stack = [signal]
    while stack:
        node = stack.pop().node
        if node is not None and node not in found:
            found.add(node)
            conditions = [s for c in node.conditions for s in c.signals]
            stack += [s for s in (*node.drivers.values(), *conditions) if s not in cut]
    return found
