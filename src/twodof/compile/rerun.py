"""Rerun: a machine run again and again on the same inputs from its start, each time with some parameters changed."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.declarations import unknown_name
from twodof.compile.machine import CompiledMachine
from twodof.errors import DiagramError


class Rerun:
    """Runs `machine`, whose memory it shares, for `steps` steps on `inputs`, arrays of shape (steps,) by name.

    `outputs` names those that are wanted. An estimation needs thousands of runs, of which each takes as long as the
    checks and copies of `machine.run` do: they are done once here. Raises DiagramError as `machine.run` does, and for
    outputs that are not there or not scalars.
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
                    raise DiagramError(f"{data.shape} values for {steps} steps", name, "give one value a step")
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
        """Sets parameters, starts afresh and runs; the outputs, shape (steps,), which the next run overwrites.

        Raises ParameterError for values that are refused, and then has set none.
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
