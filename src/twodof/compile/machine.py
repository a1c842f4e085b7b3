"""Compiled diagram and its running instances, on any target."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.machine import Machine
from twodof.compile.target import Backend, EmittedProgram


class CompiledProgram:
    """A diagram compiled for a target.

    `source` is its C; `flat` the flattened diagram; `parameters` and `states` the declarations by path.
    """

    def __init__(self, emitted: EmittedProgram, backend: Backend) -> None:
        self.emitted = emitted
        self.backend = backend
        self.flat = flat = emitted.flat
        self.source = emitted.source
        self.layout = emitted.layout
        self.precision = emitted.precision
        self.dt = flat.dt
        self.parameters: dict[str, Param] = {path: q.declared for path, q in flat.parameters.items()}
        self.dtypes = emitted.dtypes
        self.states = {
            f"{node.path}.{s.name}": (s, emitted.layout.states[node, s.name].name)
            for node in flat.nodes
            for s in node.block.states
        }

    def machine(self) -> CompiledMachine:
        """Return a fresh instance in its initial state."""
        return CompiledMachine(self)


class CompiledMachine(Machine):
    """One running instance, in the memory of the C structs.

    `instance` has the target's structs and calls.
    """

    def __init__(self, program: CompiledProgram) -> None:
        layout, flat = program.layout, program.flat
        states = {path: found[0] for path, found in program.states.items()}
        shapes = {path: s.shape for path, s in flat.outputs.items()}
        super().__init__(flat.name, program.precision, program.parameters, flat.ports, states, shapes)
        self._states = program.states
        self._members = {path: layout.parameters[q].name for path, q in flat.parameters.items()}
        self._inputs = {name: layout.inputs[s].name for name, s in flat.inputs.items()}
        self._outputs = {path: (s, layout.outputs[path].name) for path, s in flat.outputs.items()}
        self.program = program
        self._plain_floats = program.precision == "float64"
        self.instance = instance = program.backend.instance()
        self._p, self._s, self._u, self._y = (instance.structs[k] for k in "PSUY")
        self._advance = instance.step
        self._wide = [path for path, (signal, _) in self._outputs.items() if signal.width is not None]
        instance.defaults()
        instance.prepare()
        self.reset()

    @property
    def tick(self) -> int:
        """Base ticks since the start, modulo 2^32."""
        return int(self._s["tick"][0])

    def reset(self) -> None:
        """Return to tick 0, with the initial states by the present parameters and held outputs 0."""
        self.instance.init()

    def _store_parameters(self, values: Mapping[str, Any]) -> None:
        before = self._p.copy()
        try:
            with np.errstate(over="ignore"):  # what float32 does not hold is infinite
                for path, value in values.items():
                    self._p[self._members[path]][0] = value
            self.instance.prepare()
        except BaseException:  # Ctrl-C too: all or none
            self._p[:] = before
            raise

    def _parameter(self, path: str) -> Any:
        return self._p[self._members[path]][0].tolist()

    def _state(self, path: str, declared: State) -> Any:
        return self._state_memory(path, declared)[0].tolist()

    def _store_state(self, path: str, declared: State, value: Any) -> None:
        self._state_memory(path, declared)[0] = value

    def _state_memory(self, path: str, declared: State) -> NDArray[Any]:
        struct = self._s["x"] if declared.continuous else self._s
        memory: NDArray[Any] = struct[self._states[path][1]]
        return memory

    def _store_input(self, port: Port, value: Any) -> None:
        self._u[self._inputs[port.name]][0] = value

    def _write(self, name: str, value: Any) -> None:
        if type(value) is float and self._plain_floats:  # what nearly all are, at a tenth of the cost
            port = self._input(name)
            if port.kind == "real" and port.width is None:
                self._u[self._inputs[name]] = value
                return
        super()._write(name, value)

    def _step(self) -> dict[str, Any]:
        self._advance()
        # All at once, in Y's order, which is that of the outputs: member by member takes several times as long.
        values: dict[str, Any] = dict(zip(self._outputs, self._y.item(), strict=False))
        for path in self._wide:
            values[path] = values[path].tolist()
        return values

    def _run(self, steps: int, columns: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
        u: NDArray[Any] = self._u
        if columns and steps:
            u = np.repeat(self._u, steps)
            with np.errstate(over="ignore"):
                for name, data in columns.items():
                    u[self._inputs[name]] = data
            self._u[0] = u[-1]
        y: NDArray[Any] = np.empty(max(steps, 1), self._y.dtype)
        self.instance.run(steps, u, y)
        return {path: np.ascontiguousarray(y[member][:steps]) for path, (_, member) in self._outputs.items()}
