"""Coordinates: the numbers that the states of a linear model are, and where they stand in the program."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.declarations import element_names
from twodof.blocks.expressions.derivative import Dual, Value
from twodof.blocks.expressions.kinds import FLOATS
from twodof.blocks.expressions.numbers import Vector
from twodof.compile.linear.integer_states import IntegerStates
from twodof.compile.linear.operating_point import OperatingPoint
from twodof.compile.linear.parts import Parts
from twodof.compile.linear.tangent import States, elements
from twodof.compile.program.flat_program import FlatSignal, Key

Array = NDArray[np.float64]


class Coordinates:
    """The real states that may move, element by element as the program keeps them, then the held signals.

    The model has the samples of a ring in another order, the newest first: `order` gives it.
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
        """The places in the model's order, `ahead` periods on."""
        places: list[int] = []
        for key in self.keys:
            at = len(places)
            places += [at + place for place in self.whole.order(key, ahead)]
        return places + list(range(len(places), self.size))

    def names(self) -> list[str]:
        """Their names in the model's order."""
        states = [name for key in self.keys for name in self.whole.names(key)]
        return states + [name for s in self.held for name in element_names(f"{s.path} (held)", s)]

    def given(self) -> list[bool]:
        """Whether the point has them from `at`, in the program's order."""
        states = [key in self.point.given for key in self.keys for _ in range(self.point.width(key))]
        return states + [False] * (self.size - len(states))

    def values(self) -> Array:
        """Their values at the point, in the program's order."""
        states = [float(v) for key in self.keys for v in elements(self.point.states[key])]
        return np.array(states + [float(v) for s in self.held for v in elements(self.point.held[s])], dtype=np.float64)

    def whole_arrays(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """The coordinates of states, in the program's order, of which one element at least is among `chosen`."""
        found = np.array(chosen)
        at = 0
        for key in self.keys:
            end = at + self.point.width(key)
            found[at:end] = chosen[at:end].any()
            at = end
        return found

    def put(self, z: Array) -> None:
        """Set them at the point, from values in the program's order."""
        items = [np.float64(v) for v in z]
        for key in self.keys:
            part = [items.pop(0) for _ in range(self.point.width(key))]
            self.point.states[key] = Vector(part) if isinstance(self.point.states[key], tuple) else part[0]
        for s in self.held:
            part = [items.pop(0) for _ in range(s.width or 1)]
            self.point.held[s] = part[0] if s.width is None else Vector(part)

    def seeded(self, states: States, held: dict[FlatSignal, Value], unit: Array) -> None:
        """Give each of them its row of `unit` as slope, in the states and held signals of a step."""
        rows = iter(unit)
        for key in self.keys:
            states[key] = _seeded(states[key], rows)
        for s in self.held:
            held[s] = _seeded(held[s], rows)


def _seeded(value: Value, rows: Iterator[Array]) -> Value:
    made = tuple(Dual(d.value, next(rows)) for d in elements(value))
    return made if isinstance(value, tuple) else made[0]
