"""Instances of one compiled program that run one after another, with parameters, states and inputs of their own."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.compile.machine import CompiledMachine, CompiledProgram
from twodof.errors import DiagramError

Values = NDArray[Any]


class Instances:
    """`count` machines of `program`.

    A value is the same for all machines, or a list or array whose first axis is the machine. Values that come back
    have the machine as their first axis, those of `run` as their second one, after the step. Methods raise as those of
    a single machine.
    """

    def __init__(self, program: CompiledProgram, count: int) -> None:
        self.program = program
        self.machines: list[CompiledMachine] = [program.machine() for _ in range(count)]

    def set_many(self, values: Mapping[str, Any]) -> None:
        """Set parameters by path."""
        widths = {path: self.program.parameters[path].width for path in values if path in self.program.parameters}
        for k, machine in enumerate(self.machines):
            machine.set_many({path: self._own(value, widths.get(path), k) for path, value in values.items()})

    def set(self, path: str, value: Any) -> None:
        """Set a parameter."""
        self.set_many({path: value})

    def get(self, path: str) -> Values:
        """Return a parameter of each machine."""
        return np.array([machine.get(path) for machine in self.machines])

    def state(self, path: str) -> Values:
        """Return a state of each machine."""
        return np.array([machine.state(path) for machine in self.machines])

    def set_state(self, path: str, value: Any) -> None:
        """Set a state."""
        width = self.program.states[path][0].width if path in self.program.states else None
        for k, machine in enumerate(self.machines):
            machine.set_state(path, self._own(value, width, k))

    def reset(self) -> None:
        """Set all machines to their initial states and to tick 0."""
        for machine in self.machines:
            machine.reset()

    def run(self, steps: int, inputs: Mapping[str, Any] | None = None) -> dict[str, Values]:
        """Run `steps` steps and return all outputs, (steps, machines).

        An input has the shape (), (steps,) or (steps, machines); that of an array has its axes behind these.
        """
        ports = {port.name: port for port in self.program.flat.ports}
        results: dict[str, Values] = {}
        for k, machine in enumerate(self.machines):
            own = {}
            for name, value in (inputs or {}).items():
                data = np.asarray(value)
                inner = 0 if name not in ports or ports[name].width is None else len(ports[name].shape or (1,))
                own[name] = data[:, k] if data.ndim == inner + 2 else data
            for path, column in machine.run(steps, own).items():
                if k == 0:
                    results[path] = np.empty((steps, len(self.machines), *column.shape[1:]), column.dtype)
                results[path][:, k] = column
        return results

    def skip(self, steps: int) -> None:
        """Run `steps` steps with the last inputs, without keeping the outputs."""
        for machine in self.machines:
            structs = machine.instance.structs
            machine.instance.run(steps, structs["U"], structs["Y"])

    def _own(self, value: Any, width: int | None, k: int) -> Any:
        """Return the value of machine `k`."""
        data = np.asarray(value)
        if data.ndim == 0 or (width is not None and data.ndim == 1):
            return value
        if len(data) != len(self.machines):
            what = f"{len(data)} values for {len(self.machines)} instances"
            raise DiagramError(what, self.program.flat.name, "give one value, or one for each instance")
        return data[k].tolist()
