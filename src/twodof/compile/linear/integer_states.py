"""Integer and bool states at an operating point: they settle, or repeat in a cycle, such as a ring's write index."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.declarations import element_names
from twodof.blocks.expressions.derivative import Value, plain
from twodof.blocks.expressions.graph import leaves
from twodof.blocks.expressions.numbers import FLOATS, KINDS, Integer
from twodof.compile.linear.operating_point import OperatingPoint, Parts, flat, put_flat
from twodof.compile.linear.tangent import TangentStep
from twodof.compile.program.flat_program import FlatProgram, FlatSignal, Key, Node
from twodof.errors import DiagramError

MAX_STEPS = 20_000  # of an integer or bool state, after which it must have repeated
MAX_SWEEPS = 20
ALL_PHASES = 100  # a cycle up to here is checked at each of its places

Whole_ = tuple[Any, ...]


@dataclass
class Cycle:
    """Cycle of the values of a node's integer and bool states; `ring` names the state that is a write index, or ""."""

    names: tuple[str, ...]
    values: list[Whole_]
    ring: str = ""

    @property
    def moving(self) -> list[str]:
        """The states that change."""
        columns = zip(self.names, zip(*self.values, strict=True), strict=True)
        return [name for name, column in columns if len(set(map(_key, column))) > 1]


class IntegerStates:
    """Integer and bool states of a program at a point."""

    def __init__(self, program: FlatProgram, point: OperatingPoint, parts: Parts) -> None:
        self.program = program
        self.point = point
        self.parts = parts
        self.cycles: dict[Node, Cycle] = {}
        self.shift = 0

    def settle(self, step: Callable[[], TangentStep]) -> None:
        """Run each node's integer and bool states, everything else held, until they settle or repeat; leave them there.

        States given with `at` do not move. Raises DiagramError for states that do not settle or repeat.
        """
        for _ in range(MAX_SWEEPS):
            self.cycles = {}
            now = step()
            before = dict(self.point.states)
            for node in self.parts.nodes:
                names = tuple(
                    s.name
                    for s in node.discrete
                    if s.kind not in FLOATS and s.name in node.trace.update and (node, s.name) not in self.point.given
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
                cycle = Cycle(names, values[seen[key] :])
                if cycle.moving:
                    cycle.ring = self._ring(node, cycle)
                    self.cycles[node] = cycle
                for name, value in zip(names, cycle.values[0], strict=True):
                    self.point.states[node, name] = value
                return
            seen[key] = len(values)
            values.append(now)
            found = step.evaluate(node, roots, states)
            states |= {(node, name): v for name, v in zip(names, found, strict=True)}
        moving = Cycle(names, values[len(values) // 2 :]).moving
        free = self.parts.free_outputs(node)
        ask = f", or ask for the outputs {', '.join(free)} only" if free else ""
        remedy = "give them with `at`, which holds them there"
        if index := self._indexes(node, moving):
            remedy = f"let {index} wrap, as in where(i + 1 < n, i + 1, int32(0)), so that the buffer is a ring"
        raise DiagramError(
            f"its integer or bool states {', '.join(moving)} do not settle or repeat within {MAX_STEPS} steps; "
            f"these depend on them: {', '.join(self.parts.outputs_of(node))}",
            node.path,
            remedy + ask,
        )

    def _indexes(self, node: Node, names: Iterable[str], kinds: Iterable[str] = FLOATS) -> str:
        """Return the one of the states `names` that is the write index of a buffer of these kinds, or ""."""
        for e in node.trace.update.values():
            item = e
            while item.op == "store" and item.kind in kinds:
                if found := leaves([item.args[1]], "state") & set(names):
                    return min(found)
                item = item.args[0]
        return ""

    def check_held(self, step: TangentStep) -> dict[str, str]:
        """Return a remark for each integer or bool state that `at` holds and that would move otherwise, by path.

        Raises DiagramError for the write index of a buffer: with a held index the written samples are never read.
        """
        notes = {}
        for node, name in sorted(self.point.given, key=lambda k: (k[0].path, k[1])):
            e = node.trace.update.get(name)
            if node not in self.parts.nodes or e is None or e.kind in FLOATS or not step.active(node.guard):
                continue
            if _same(plain(step.evaluate(node, [e])[0]), self.point.states[node, name]):
                continue
            if self._indexes(node, [name]):
                what = "`at` holds this write index of a buffer, so written samples would never be read"
                remedy = "leave it out of `at`: the model follows an index that wraps"
                raise DiagramError(what, f"{node.path}.{name}", remedy)
            notes[f"{node.path}.{name}"] = "held by `at`; it would move otherwise"
        return notes

    def _ring(self, node: Node, cycle: Cycle) -> str:
        """Return the write index of a buffer that counts 0 .. N - 1 round and round, N the cycle's length, or ""."""
        if len(cycle.moving) != 1 or not self._indexes(node, cycle.moving, KINDS):
            return ""
        (name,) = cycle.moving
        values = [row[cycle.names.index(name)] for row in cycle.values]
        places = [v.value if isinstance(v, Integer) else -1 for v in values]
        counts = [(places[0] + i) % len(places) for i in range(len(places))]
        return name if places == counts else ""

    def rings(self) -> set[Key]:
        """Return the states that are write indices of rings."""
        return {(node, cycle.ring) for node, cycle in self.cycles.items() if cycle.ring}

    def _index(self, key: Key, ahead: int) -> tuple[int, int]:
        """Return length and write index, `ahead` periods on, of a state that is a ring; (0, 0) for other states."""
        node, name = key
        cycle = self.cycles.get(node)
        e = node.trace.update.get(name)
        if cycle is None or not cycle.ring or e is None or e.op != "store":
            return 0, 0
        length = len(cycle.values)
        if self.point.width(key) % length:
            return 0, 0
        steps = (self.shift + ahead) * self.parts.steps(node)
        return length, int(cycle.values[steps % length][cycle.names.index(cycle.ring)].value)

    def order(self, key: Key, ahead: int = 0) -> list[int]:
        """Return the indices of a state's elements in the model's order, which has a ring's newest sample first.

        They are those after `ahead` periods.
        """
        width = self.point.width(key)
        length, at = self._index(key, ahead)
        if not length:
            return list(range(width))
        each = width // length
        return [((at - 1 - age) % length) * each + i for age in range(length) for i in range(each)]

    def names(self, key: Key) -> list[str]:
        """Return the names of a state's elements in the model's order."""
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
        """Return the shifts of the cycles, in periods, at which the model is checked to be the same.

        The places of a ring are alike except for its end, so three are enough; of other cycles all values are tried.
        Raises DiagramError for other cycles of more than ALL_PHASES periods.
        """
        found: set[int] = set()
        for node, cycle in self.cycles.items():
            n = len(cycle.values) // math.gcd(len(cycle.values), self.parts.steps(node))
            if cycle.ring:
                found |= {1, n // 2, n - 1}
            elif n <= ALL_PHASES:
                found |= set(range(1, n))
            else:
                what = f"its integer or bool states {', '.join(cycle.moving)} repeat after {n} periods only"
                raise DiagramError(what, node.path, "hold them with `at`, or linearize around this block")
        return sorted(found - {0})

    @contextmanager
    def turned(self, shift: int) -> Iterator[None]:
        """Move all cycles on by `shift` periods within the `with` block, with the same samples in the buffers."""
        before = dict(self.point.states)
        orders = {
            (node, s.name): self.order((node, s.name))
            for node in self.cycles
            for s in node.discrete
            if s.width is not None
        }
        self.shift = shift
        for node, cycle in self.cycles.items():
            steps = shift * self.parts.steps(node)
            for name, value in zip(cycle.names, cycle.values[steps % len(cycle.values)], strict=True):
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

    def cycling(self) -> str:
        """Return the states that move in cycles without write indices of rings, or else in all cycles."""
        others = [n for n, c in self.cycles.items() if not c.ring] or list(self.cycles)
        return ", ".join(f"{n.path}.{name}" for n in others for name in self.cycles[n].moving)


def _key(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(_key(v) for v in value)
    return value.value if isinstance(value, Integer) else value


def _same(a: Any, b: Any) -> bool:
    return bool(a is b or _key(a) == _key(b))


Array = NDArray[np.float64]


class Coordinates:
    """Coordinates of a program: its real states that may move, element by element, then the held signals.

    This is the program's order. In the model's order the newest sample of a ring is first; see `order`.
    """

    def __init__(self, point: OperatingPoint, whole: IntegerStates, parts: Parts, held: Sequence[FlatSignal]) -> None:
        self.point = point
        self.whole = whole
        self.held = list(held)
        self.keys: list[Key] = []
        for node in parts.nodes:
            for s in node.block.states:
                e = node.trace.update.get(s.name)
                kept = e is None or (e.op == "state" and e.data == s.name)
                if s.kind in FLOATS and (s.continuous or not kept):
                    self.keys.append((node, s.name))
        self.size = sum(point.width(k) for k in self.keys) + sum(s.width or 1 for s in self.held)

    def order(self, ahead: int = 0) -> list[int]:
        """Return the indices of the coordinates in the model's order, after `ahead` periods."""
        places: list[int] = []
        for key in self.keys:
            at = len(places)
            places += [at + place for place in self.whole.order(key, ahead)]
        return places + list(range(len(places), self.size))

    def names(self) -> list[str]:
        """Return the names of the coordinates in the model's order."""
        states = [name for key in self.keys for name in self.whole.names(key)]
        return states + [name for s in self.held for name in element_names(f"{s.path} (held)", s)]

    def given(self) -> list[bool]:
        """Return for each coordinate whether `at` gives it, in program order."""
        states = [key in self.point.given for key in self.keys for _ in range(self.point.width(key))]
        return states + [False] * (self.size - len(states))

    def values(self) -> Array:
        """Return the values of the coordinates at the point, in the program's order, (n,)."""
        return np.array(flat(self.point.states, self.keys) + flat(self.point.held, self.held), dtype=np.float64)

    def of_read_states(self, read: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return a mask of the coordinates, in program order, whose state has an element among `read`."""
        found = np.array(read)
        at = 0
        for key in self.keys:
            end = at + self.point.width(key)
            found[at:end] = read[at:end].any()
            at = end
        return found

    def put(self, z: Array) -> None:
        """Set the point's states and held signals to values in the program's order."""
        numbers = iter(z.tolist())
        put_flat(self.point.states, self.keys, numbers)
        put_flat(self.point.held, self.held, numbers)
