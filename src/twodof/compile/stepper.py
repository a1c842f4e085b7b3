"""Stepper: a machine's steps with its inputs and outputs by position, for who steps it hundreds of times a second."""

import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.declarations import unknown_name
from twodof.compile.machine import CompiledMachine
from twodof.errors import DiagramError

_LETTERS = {
    "float64": "d",
    "float32": "f",
    "bool": "?",
    "int32": "i",
    "uint32": "I",
    "int16": "h",
    "uint16": "H",
    "int8": "b",
    "uint8": "B",
}
"""The letters of `struct` by numpy's names of types."""


class Stepper:
    """Steps `machine`, whose memory it shares: `inputs` names all its inputs, `outputs` those that are wanted.

    Both are names of scalars, and values come and go as tuples in their order. A machine's `step`, by name, costs
    some twenty times as much. Values are not checked: a real, float32 or float64 is a float, an integer an int within
    its range, a bool anything that is true or false. Raises DiagramError for a name that is not there or is an array,
    and for an input that is left out. Methods that compute raise ControllerFault where the target can fault.
    """

    def __init__(self, machine: CompiledMachine, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        self.machine = machine
        instance = machine.instance
        program = machine.program
        layout, lowered = program.layout, program.flat
        if missing := sorted(lowered.inputs.keys() - set(inputs)):
            raise DiagramError(f"the inputs {', '.join(missing)} are left out", lowered.name, "name every input")
        ins = {name: layout.inputs[signal].name for name, signal in lowered.inputs.items() if signal.width is None}
        outs = {name: layout.outputs[name].name for name, signal in lowered.outputs.items() if signal.width is None}
        self._ins = _Members(instance.structs["U"], inputs, ins, lowered.name)
        self._outs = _Members(instance.structs["Y"], outputs, outs, lowered.name)
        self._step = instance.step
        self._state = instance.structs["S"].view(np.uint8)
        self._kept = np.empty_like(self._state)

    def step(self, values: Sequence[Any]) -> tuple[Any, ...]:
        """Writes the inputs, steps once and reads the outputs."""
        self._ins.write(values)
        self._step()
        return self._outs.read()

    def run(self, steps: int, values: Sequence[Any]) -> None:
        """Writes the inputs and makes `steps` steps with them; the outputs are not read."""
        self._ins.write(values)
        step = self._step
        for _ in range(steps):  # a few: one call of `Instance.run` costs as much as ten steps
            step()

    def peek(self) -> tuple[Any, ...]:
        """The outputs that a step would give with the inputs as they were written last; nothing advances."""
        self._kept[:] = self._state
        try:
            self._step()
        finally:
            self._state[:] = self._kept
        return self._outs.read()


class _Members:
    """Scalar members of a struct, read and written together in the order of `names`."""

    def __init__(self, array: NDArray[Any], names: Sequence[str], members: Mapping[str, str], where: str) -> None:
        self._buffer = array.view(np.uint8).data
        fields: Mapping[str, Any] = array.dtype.fields or {}
        places: list[tuple[int, str, int]] = []
        for name in names:
            if name not in members:
                raise unknown_name("scalar called", name, members, where)
            dtype, offset = fields[members[name]][:2]
            places.append((offset, _LETTERS[dtype.name], dtype.itemsize))
        order = sorted(range(len(places)), key=lambda i: places[i])
        form, end = "=", 0
        for offset, letter, size in (places[i] for i in order):
            form += f"{offset - end}x{letter}"
            end = offset + size
        self._struct = struct.Struct(form)
        self._sorted = order == list(range(len(order)))
        self._order = order
        self._back = [order.index(i) for i in range(len(order))]

    def write(self, values: Sequence[Any]) -> None:
        """Writes the values; what is too large for float32 becomes infinite. What lies between the members is lost."""
        ordered = values if self._sorted else [values[i] for i in self._order]
        try:
            self._struct.pack_into(self._buffer, 0, *ordered)
        except OverflowError:
            with np.errstate(over="ignore"):
                single = [float(np.float32(v)) if type(v) is float else v for v in ordered]
            self._struct.pack_into(self._buffer, 0, *single)

    def read(self) -> tuple[Any, ...]:
        """The present values."""
        values = self._struct.unpack_from(self._buffer, 0)
        return values if self._sorted else tuple([values[i] for i in self._back])
