"""Compiled diagram and its running instances on any target, and fast ways to run one many times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.declarations import Param, Port, State, check_steps, unknown_name
from twodof.blocks.machine import Machine, axes
from twodof.blocks.reference.interpreter import Reference
from twodof.compile.target import Backend, EmittedProgram
from twodof.errors import CompileError, DiagramError


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
                    raise unknown_name("scalar", name, scalars, lowered.name)
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
