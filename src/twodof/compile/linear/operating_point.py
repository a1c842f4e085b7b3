"""Point: the values of a program's parameters, inputs and states at which it is linearized."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.declarations import check_value, numeric, unknown_parameter
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.derivative import plain
from twodof.blocks.expressions.numbers import Vector
from twodof.compile.linear.tangent import States, elements
from twodof.compile.program.flat_program import FlatProgram, FlatSignal, Key, initial_states, parameter_values

Array = NDArray[np.float64]


class OperatingPoint:
    """Parameters, inputs, states and tick. `at` overrides defaults and initial values, by name or path.

    Raises DiagramError or ParameterError for an unknown name, and for a value of another type or out of bounds.
    """

    def __init__(self, program: FlatProgram, at: Mapping[str, Any]) -> None:
        keys = {f"{n.path}.{s.name}": (n, s) for n in program.nodes for s in n.block.states}
        known = {*program.inputs, *program.parameters, *keys, "tick"}
        for name in at:
            if name not in known:
                raise unknown_parameter(name, known)
        for path, parameter in program.parameters.items():
            if path in at:
                check_value(parameter.declared, at[path], path)
        self.parameters = parameter_values(program, {p: at[p] for p in program.parameters if p in at})
        self.states: dict[Key, Any] = initial_states(program, self.parameters)
        self.given: set[Key] = set()
        with numbers.precision("float64"):
            self.inputs: dict[FlatSignal, Any] = {
                s: numeric(at.get(name, 0), s.kind, s.width, name, s.shape) for name, s in program.inputs.items()
            }
            for path, (node, state) in keys.items():
                if path in at:
                    self.states[node, state.name] = numeric(at[path], state.kind, state.width, path, state.shape)
                    self.given.add((node, state.name))
        self.tick = int(at.get("tick", 0))
        self.tick_given = "tick" in at
        self.held: dict[FlatSignal, Any] = {}  # of slower rates, as they stand before the point's tick
        self._widths = {(n, s.name): s.width or 1 for n in program.nodes for s in n.block.states}

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Within the block the point may move; then its states, held signals and tick are what they were."""
        before = dict(self.states), dict(self.held), self.tick
        try:
            yield
        finally:
            self.states, self.held, self.tick = before

    def width(self, key: Key) -> int:
        """How many numbers a state has."""
        return self._widths[key]

    def put(self, states: States) -> None:
        """Overwrite states."""
        self.states |= {key: plain(value) for key, value in states.items()}

    def input_values(self, signals: Iterable[FlatSignal]) -> list[float]:
        """The present values of some inputs, one after the other."""
        return [float(v) for s in signals for v in elements(self.inputs[s])]

    def put_inputs(self, signals: Sequence[FlatSignal], values: Array) -> None:
        """Overwrite inputs by numbers, one after the other."""
        at = 0
        for s in signals:
            part = [np.float64(v) for v in values[at : at + (s.width or 1)]]
            self.inputs[s] = part[0] if s.width is None else Vector(part)
            at += s.width or 1
