"""Instances of one compiled program that run one after another, with parameters, states and inputs of their own."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.declarations import Param, State, check_steps
from twodof.blocks.machine import axes
from twodof.blocks.reference.interpreter import Reference
from twodof.compile.machine import CompiledMachine, CompiledProgram
from twodof.errors import CompileError, DiagramError

Values = NDArray[Any]


class Instances:
    """`count` machines of `program`.

    A value is the same for all machines, or a list or array whose first axis is the machine. The first axis of returned
    values is the machine; for `run` it is the second one, after the step. Methods raise the errors of a single machine,
    and DiagramError for values of another number of machines. Raises CompileError for a program that was built without
    a C compiler.
    """

    def __init__(self, program: CompiledProgram | Reference, count: int) -> None:
        if not isinstance(program, CompiledProgram):
            what = "many instances need a C compiler"
            raise CompileError(what, program.diagram.name, "install gcc, or the wheel ziglang")
        if count < 1:
            raise DiagramError(f"{count} instances are too few", program.flat.name, "ask for one or more")
        self.program = program
        self.machines: list[CompiledMachine] = [program.machine() for _ in range(count)]
        self._places = range(count)

    def set_many(self, values: Mapping[str, Any]) -> None:
        """Set parameters by path; if one is refused, none changes in any machine."""
        declared = self.program.parameters
        own = [{path: self._own(v, declared.get(path), k) for path, v in values.items()} for k in self._places]
        before = [machine.instance.structs["P"].copy() for machine in self.machines]
        try:
            for machine, changes in zip(self.machines, own, strict=True):
                machine.set_many(changes)
        except BaseException:
            for machine, memory in zip(self.machines, before, strict=True):
                machine.instance.structs["P"][:] = memory
            raise

    def set(self, path: str, value: Any) -> None:
        """Set a parameter."""
        self.set_many({path: value})

    def get(self, path: str) -> Values:
        """Return the parameter at `path` of each machine, (machines,)."""
        return np.array([machine.get(path) for machine in self.machines])

    def state(self, path: str) -> Values:
        """Return the state at `path` of each machine, (machines,)."""
        return np.array([machine.state(path) for machine in self.machines])

    def set_state(self, path: str, value: Any) -> None:
        """Set a state."""
        declared = self.program.states[path][0] if path in self.program.states else None
        own = [self._own(value, declared, k) for k in self._places]
        for machine, one in zip(self.machines, own, strict=True):
            machine.set_state(path, one)

    def reset(self) -> None:
        """Set all machines to their initial states and to tick 0."""
        for machine in self.machines:
            machine.reset()

    def run(self, steps: int, inputs: Mapping[str, Any] | None = None) -> dict[str, Values]:
        """Run `steps` steps and return all outputs, (steps, machines).

        An input has the shape (), (steps,) or (steps, machines); an array's own axes follow these.
        """
        ports = {port.name: port for port in self.program.flat.ports}
        results: dict[str, Values] = {}
        for k, machine in enumerate(self.machines):
            own = {}
            for name, value in (inputs or {}).items():
                data = np.asarray(value)
                inner = axes(ports[name]) if name in ports else ()
                own[name] = data[:, self._place(data.shape[1], k)] if data.ndim == len(inner) + 2 else data
            for path, column in machine.run(steps, own).items():
                if k == 0:
                    results[path] = np.empty((steps, len(self.machines), *column.shape[1:]), column.dtype)
                results[path][:, k] = column
        return results

    def skip(self, steps: int) -> None:
        """Run `steps` steps with the last inputs, without keeping the outputs."""
        steps = check_steps(steps, self.program.flat.name)
        for machine in self.machines:
            structs = machine.instance.structs
            machine.instance.run(steps, structs["U"], structs["Y"])

    def _own(self, value: Any, declared: Param | State | None, k: int) -> Any:
        """Return the value of machine `k`."""
        data = np.asarray(value)
        inner = () if declared is None else axes(declared)
        return value if data.ndim == 0 or data.shape == inner else data[self._place(len(data), k)].tolist()

    def _place(self, given: int, k: int) -> int:
        """Return `k`, of as many values `given` as there are machines."""
        if given != len(self.machines):
            what = f"{given} values for {len(self.machines)} instances"
            raise DiagramError(what, self.program.flat.name, "give one value, or one for each instance")
        return k
