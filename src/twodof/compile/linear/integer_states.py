"""What integer and bool states do while the real ones rest at a point: they settle, or they go round a ring buffer."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from twodof.blocks.declarations import element_names
from twodof.blocks.expressions.derivative import Value, plain
from twodof.blocks.expressions.numbers import Integer
from twodof.compile.linear.operating_point import OperatingPoint
from twodof.compile.linear.tangent import TangentStep
from twodof.compile.program.flat_program import FlatProgram, Key, Node
from twodof.errors import DiagramError

MAX_STEPS = 20_000  # of a whole-number state until it must have come round
MAX_SWEEPS = 20
ALL_PHASES = 100  # a cycle up to here is checked at each of its places

Whole_ = tuple[Any, ...]


@dataclass
class Cycle:
    """The values through which a node's whole-number states go; `ring` tells which one is a write index."""

    names: tuple[str, ...]
    values: list[Whole_]
    ring: str = ""


class IntegerStates:
    """The integer and bool states of a program at a point."""

    def __init__(self, program: FlatProgram, point: OperatingPoint, divider: int) -> None:
        self.program = program
        self.point = point
        self.divider = divider
        self.cycles: dict[Node, Cycle] = {}
        self.shift = 0

    def settle(self, step: Callable[[], TangentStep]) -> None:
        """Run each node's whole-number states, the rest held, until they stay or come round; they are set there.

        Those given with `at` are not moved. Raises DiagramError for one that does neither.
        """
        for _ in range(MAX_SWEEPS):
            self.cycles = {}
            now = step()
            before = dict(self.point.states)
            for node in self.program.nodes:
                names = tuple(
                    s.name
                    for s in node.discrete
                    if s.kind != "real" and s.name in node.trace.update and (node, s.name) not in self.point.given
                )
                if names and now.active(node.guard):
                    self._settle(node, names, now)
            if all(_same(self.point.states[k], v) for k, v in before.items()):
                return
        raise DiagramError("its integer and bool states do not settle", self.program.name, "give them with `at`")

    def _settle(self, node: Node, names: tuple[str, ...], step: TangentStep) -> None:
        roots = [node.trace.update[name] for name in names]
        states: dict[Key, Value] = dict(step.states)
        seen: dict[Whole_, int] = {}
        values: list[Whole_] = []
        while len(values) <= MAX_STEPS:
            now = tuple(plain(states[node, name]) for name in names)
            key = tuple(_key(v) for v in now)
            if key in seen:
                cycle = values[seen[key] :]
                if len(cycle) > 1:
                    self.cycles[node] = Cycle(names, cycle, self._ring(node, names, cycle))
                for name, value in zip(names, cycle[0], strict=True):
                    self.point.states[node, name] = value
                return
            seen[key] = len(values)
            values.append(now)
            states |= {(node, name): v for name, v in zip(names, step.evaluate(node, roots, states), strict=True)}
        raise DiagramError(
            f"its integer or bool states {', '.join(names)} do not stay or come round within {MAX_STEPS} steps",
            node.path,
            "hold them with `at`, or linearize around this block",
        )

    def _ring(self, node: Node, names: tuple[str, ...], cycle: list[Whole_]) -> str:
        """The one state that counts 0 .. N - 1 round and round, N the cycle's length; "" if there is none."""
        moving = [i for i in range(len(names)) if any(_key(v[i]) != _key(cycle[0][i]) for v in cycle)]
        if len(moving) != 1:
            return ""
        (i,) = moving
        places = [v[i].value if isinstance(v[i], Integer) else -1 for v in cycle]
        n = len(cycle)
        if sorted(places) == list(range(n)) and all((a + 1) % n == b for a, b in pairwise(places)):
            return names[i]
        return ""

    def _index(self, key: Key, ahead: int) -> tuple[int, int]:
        """(length, write index `ahead` steps on) of the ring that a state is; (0, 0) if it is none."""
        node, name = key
        cycle = self.cycles.get(node)
        width = self.point.width(key)
        e = node.trace.update.get(name)
        if cycle is None or not cycle.ring or e is None or e.op != "store" or width % len(cycle.values):
            return 0, 0
        at = cycle.values[(self.shift + ahead) % len(cycle.values)][cycle.names.index(cycle.ring)]
        return len(cycle.values), int(at.value)

    def order(self, key: Key, ahead: int = 0) -> list[int]:
        """The places of a state's elements in the model's order: a ring's newest sample first."""
        width = self.point.width(key)
        length, at = self._index(key, ahead)
        if not length:
            return list(range(width))
        each = width // length
        return [((at - 1 - age) % length) * each + i for age in range(length) for i in range(each)]

    def names(self, key: Key) -> list[str]:
        """The names of a state's elements in the model's order."""
        node, name = key
        path = f"{node.path}.{name}"
        state = next(s for s in node.block.states if s.name == name)
        length = 0 if state.width is None else self._index(key, 0)[0]
        if state.width is None or not length:
            return element_names(path, state)
        each = state.width // length
        tail = [f"[{i}]" for i in range(each)] if each > 1 else [""]
        return [f"{path}[k-{age + 1}]{t}" for age in range(length) for t in tail]

    def phases(self) -> list[int]:
        """By how many steps what goes round must be turned, to see that the model stays the same.

        A ring's places are alike except for its end: some of them will do. Anything else is turned through all its
        values. Raises DiagramError where these are too many.
        """
        found: set[int] = set()
        for node, cycle in self.cycles.items():
            n = len(cycle.values)
            if cycle.ring:
                found |= {1, n // 2, n - 1}
            elif n <= ALL_PHASES:
                found |= set(range(1, n))
            else:
                raise DiagramError(
                    f"its whole-number states {', '.join(cycle.names)} come round after {n} steps only",
                    node.path,
                    "hold them with `at`, or linearize around this block",
                )
        return sorted(found - {0})

    @contextmanager
    def turned(self, shift: int) -> Iterator[None]:
        """Within the block, everything that goes round is `shift` steps on, with the same samples in its buffers."""
        before = dict(self.point.states)
        orders = {
            (node, s.name): self.order((node, s.name))
            for node in self.cycles
            for s in node.discrete
            if s.width is not None
        }
        self.shift = shift
        for node, cycle in self.cycles.items():
            for name, value in zip(cycle.names, cycle.values[shift % len(cycle.values)], strict=True):
                self.point.states[node, name] = value
        for key, old in orders.items():
            items = list(before[key])
            for source, target in zip(old, self.order(key), strict=True):
                items[target] = before[key][source]
            self.point.states[key] = type(before[key])(items)
        try:
            yield
        finally:
            self.shift = 0
            self.point.states |= before

    def guilty(self) -> str:
        """The states that go round without being the write index of a ring buffer, else every state that goes round."""
        others = [n for n, c in self.cycles.items() if not c.ring] or list(self.cycles)
        return ", ".join(f"{n.path}.{name}" for n in others for name in self.cycles[n].names)


def _key(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(_key(v) for v in value)
    return value.value if isinstance(value, Integer) else value


def _same(a: Any, b: Any) -> bool:
    return bool(a is b or _key(a) == _key(b))
