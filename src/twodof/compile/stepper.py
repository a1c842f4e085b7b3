"""Fast ways to run one machine many times: `Stepper` step by step, `Rerun` from its start on the same inputs."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.declarations import unknown_name
from twodof.compile.machine import CompiledMachine
from twodof.errors import DiagramError


class Stepper:
    """Fast steps of `machine`, with inputs and outputs by position.

    `inputs` names all inputs of the machine and `outputs` the wanted outputs; values are passed and returned as tuples
    in these orders. The memory is the machine's. `machine.step`, by name, takes several times as long. Values are not
    checked: a real, float32 or float64 is a float, an integer an int within its range, a bool any truth value. Raises
    DiagramError for an unknown name, an array, and an input that is left out. Methods that compute raise
    ControllerFault if the program faults.
    """

    def __init__(self, machine: CompiledMachine, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        self.machine = machine
        instance, lowered = machine.instance, machine.program.flat
        if missing := sorted(lowered.inputs.keys() - set(inputs)):
            raise DiagramError(f"the inputs {', '.join(missing)} are left out", lowered.name, "name every input")
        for names, ports in ((inputs, lowered.inputs), (outputs, lowered.outputs)):
            scalars = [name for name, signal in ports.items() if signal.width is None]
            for name in names:
                if name not in scalars:
                    raise unknown_name("scalar called", name, scalars, lowered.name)
        self._u, self._y = instance.structs["U"], instance.structs["Y"]
        self._singles = any(dtype == np.float32 for dtype, *_ in (self._u.dtype.fields or {}).values())
        # By the order of the structs, which is that of the program's inputs and outputs.
        self._ins = [inputs.index(name) for name in lowered.inputs]
        self._outs = [list(lowered.outputs).index(name) for name in outputs]
        self._step = instance.step
        self._state = instance.structs["S"].view(np.uint8)
        self._kept = np.empty_like(self._state)

    def step(self, values: Sequence[Any]) -> tuple[Any, ...]:
        """Write the inputs, step once and return the outputs."""
        self._write(values)
        self._step()
        return self._read()

    def run(self, steps: int, values: Sequence[Any]) -> None:
        """Write the inputs and make `steps` steps with them."""
        self._write(values)
        step = self._step
        for _ in range(steps):  # a few: one call of `Instance.run` costs as much as ten steps
            step()

    def _write(self, values: Sequence[Any]) -> None:
        row = tuple([values[i] for i in self._ins])
        if self._singles:  # alone, as it takes as long as a whole step
            with np.errstate(over="ignore"):  # what float32 does not hold is infinite
                self._u[0] = row
        elif row:
            self._u[0] = row

    def peek(self) -> tuple[Any, ...]:
        """Return the outputs that a next step with the inputs written last would have, without advancing."""
        self._kept[:] = self._state
        try:
            self._step()
        finally:
            self._state[:] = self._kept
        return self._read()

    def _read(self) -> tuple[Any, ...]:
        values = self._y.item()
        return tuple([values[i] for i in self._outs])


class Rerun:
    """Runs of `machine` for `steps` steps on `inputs`, arrays of shape (steps,) by name, in the machine's memory.

    `outputs` names the wanted outputs. An estimation needs thousands of runs, and the checks and copies of
    `machine.run` take as long as a run, so they are done only once. Raises DiagramError as `machine.run` does, and for
    an unknown output or an array.
    """

    def __init__(
        self, machine: CompiledMachine, steps: int, inputs: Mapping[str, NDArray[Any]], outputs: Sequence[str]
    ) -> None:
        self.machine, self.steps = machine, steps
        program, instance = machine.program, machine.instance
        layout, flat = program.layout, program.flat
        machine.run(0, {name: data[:0] for name, data in inputs.items()})  # says what does not fit
        self._instance = instance
        self._u = np.repeat(instance.structs["U"], steps)
        with np.errstate(over="ignore"):
            for name, data in inputs.items():
                if data.shape != (steps,):
                    what = f"the input has the shape {data.shape} for {steps} steps"
                    raise DiagramError(what, name, "give one value per step")
                self._u[layout.inputs[flat.inputs[name]].name] = data
        self._y: NDArray[Any] = np.empty(max(steps, 1), instance.structs["Y"].dtype)
        self._outputs = {}
        for path in outputs:
            if path not in flat.outputs or flat.outputs[path].width is not None:
                raise unknown_name("scalar output", path, flat.outputs, flat.name)
            self._outputs[path] = self._y[layout.outputs[path].name][:steps]
        # Real scalars are compared with their bounds here; all else goes the way of `set_many`.
        memory = instance.structs["P"]
        self._reals = {
            path: (memory[layout.parameters[q].name], q.declared.low, q.declared.high)
            for path, q in flat.parameters.items()
            if q.declared.kind == "real" and q.declared.width is None
        }

    def run(self, values: Mapping[str, float]) -> dict[str, NDArray[Any]]:
        """Set parameters by path, reset, run, and return the outputs (steps,) by path, which the next run overwrites.

        Raises ParameterError for a value that is refused; then no parameter has changed.
        """
        reals = self._reals
        plain = True
        for name, value in values.items():
            if name not in reals or not reals[name][1] <= value <= reals[name][2]:
                plain = False
                break
        if plain:
            for name, value in values.items():
                reals[name][0][0] = value
            self._instance.prepare()
        else:
            self.machine.reset()
            self.machine.set_many(values)
        self._instance.init()
        self._instance.run(self.steps, self._u, self._y)
        return self._outputs
