"""Machine: one running instance of a compiled program, on whichever target."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.declarations import check_bounds, check_steps, numeric, unknown_parameter
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.numbers import Integer, Vector
from twodof.compile.program import flat_program
from twodof.errors import DiagramError, ParameterError

if TYPE_CHECKING:
    from twodof.compile.builder import CompiledProgram


class CompiledMachine:
    """One running instance: parameters, states and inputs of its own, in the memory of the C structs.

    `instance` is what the target gave: the structs, and the calls on them. Where the target can fault (see
    docs/reference/compilation.md), any method that computes may raise ControllerFault.
    One thread at a time may use it: for changes from another, queue them and apply them between two steps.
    """

    def __init__(self, program: CompiledProgram) -> None:
        self.program = program
        self.parameters = program.parameters
        self._plain = program.precision == "float64"
        self.instance = instance = program.backend.instance()
        self._p, self._s, self._u, self._y = (instance.structs[k] for k in "PSUY")
        self._step = instance.step
        layout, lowered = program.layout, program.flat
        self._members = {path: layout.parameters[q].name for path, q in lowered.parameters.items()}
        self._inputs = {name: (s, layout.inputs[s].name) for name, s in lowered.inputs.items()}
        self._outputs = {path: layout.outputs[path].name for path in lowered.outputs}
        self._wide = [path for path, signal in lowered.outputs.items() if signal.width is not None]
        instance.defaults()
        instance.prepare()
        self.reset()

    @property
    def tick(self) -> int:
        """Base ticks since the start, modulo 2^32."""
        return int(self._s["tick"][0])

    def reset(self) -> None:
        """To the initial states of the present parameters, tick 0, held outputs 0."""
        self.instance.init()

    def set(self, path: str, value: Any) -> None:
        """Set one parameter; see `set_many`."""
        self.set_many({path: value})

    def set_many(self, values: Mapping[str, Any]) -> None:
        """Set several parameters before the next step, or, if one is refused with ParameterError, none."""
        with numbers.precision("float64"):  # bounds are compared with what is given, then it is rounded
            new = {self._member(path): self._checked(path, value) for path, value in values.items()}
        before = self._p.copy()
        try:
            with np.errstate(over="ignore"):  # what float32 does not hold is infinite
                for member, value in new.items():
                    self._p[member][0] = value
            self.instance.prepare()
        except BaseException:  # Ctrl-C too: all or none
            self._p[:] = before
            raise

    def get(self, path: str) -> Any:
        """A parameter's present value as a Python number (or list)."""
        return self._p[self._member(path)][0].tolist()

    def _member(self, path: str) -> str:
        if path not in self._members:
            raise unknown_parameter(path, self._members)
        return self._members[path]

    def _checked(self, path: str, value: Any) -> Any:
        declared = self.parameters[path]
        if not declared.tunable and self.tick > 0:
            raise ParameterError(
                "it is fixed while the diagram runs", path, "set it before the first step, or after reset()"
            )
        try:
            number = numeric(value, declared.kind, declared.width, path)
        except DiagramError as error:
            raise ParameterError(error.what, path, error.remedy) from error
        check_bounds(declared, value, path)
        scalars = number if isinstance(number, Vector) else (number,)
        plain = [n.value if isinstance(n, Integer) else n.item() for n in scalars]
        return plain[0] if declared.width is None else plain

    def state(self, path: str) -> Any:
        """A state's present value by path, as a Python number (or list)."""
        array, member, _ = self._state(path)
        return array[member][0].tolist()

    def set_state(self, path: str, value: Any) -> None:
        """Overwrite a state. Raises DiagramError for an unknown path or a value of another type."""
        array, member, declared = self._state(path)
        with numbers.precision(self.program.precision):
            number = numeric(value, declared.kind, declared.width, path)
        scalars = number if isinstance(number, Vector) else (number,)
        plain = [n.value if isinstance(n, Integer) else n.item() for n in scalars]
        array[member][0] = plain[0] if declared.width is None else plain

    def _state(self, path: str) -> tuple[NDArray[Any], str, Any]:
        if path not in self.program.states:
            raise DiagramError(
                f"there is no state {path!r:.120}", self.program.flat.name, "a state's path is part.sub.state"
            )
        declared, member = self.program.states[path]
        return (self._s["x"] if declared.continuous else self._s), member, declared

    def step(self, inputs: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """One step; an input that is not given keeps its last value (0 at first). Returns values by signal name."""
        for name, value in (inputs or {}).items():
            self._write(name, value)
        self._step()
        # All at once, in Y's order, which is that of the outputs: member by member takes several times as long.
        values: dict[str, Any] = dict(zip(self._outputs, self._y.item(), strict=False))
        for path in self._wide:
            values[path] = values[path].tolist()
        return values

    def run(self, steps: int, inputs: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """`steps` steps; an input is one value, or a sequence of `steps` values. Returns arrays by signal name."""
        steps = check_steps(steps, self.program.flat.name)
        columns: dict[str, NDArray[Any]] = {}
        for name, value in (inputs or {}).items():
            signal, member = self._input(name)
            data = value if isinstance(value, np.ndarray) else np.asarray(value)
            if data.ndim == (0 if signal.width is None else 1):
                self._write(name, data.tolist())
                continue
            if data.shape[:1] != (steps,):
                raise DiagramError(f"{data.shape[0]} values for {steps} steps", name, "give one value, or one a step")
            columns[member] = _fitting(data, signal)
        u: NDArray[Any] = self._u
        if columns and steps:
            u = np.repeat(self._u, steps)
            with np.errstate(over="ignore"):
                for member, data in columns.items():
                    u[member] = data
            self._u[0] = u[-1]
        y: NDArray[Any] = np.empty(max(steps, 1), self._y.dtype)
        self.instance.run(steps, u, y)
        return {path: np.ascontiguousarray(y[member][:steps]) for path, member in self._outputs.items()}

    def _input(self, name: str) -> tuple[flat_program.FlatSignal, str]:
        if name not in self._inputs:
            known = ", ".join(self._inputs) or "none"
            raise DiagramError(f"there is no input {name!r:.80}", self.program.flat.name, f"inputs: {known}")
        return self._inputs[name]

    def _write(self, name: str, value: Any) -> None:
        signal, member = self._input(name)
        if type(value) is float and self._plain and signal.kind == "real" and signal.width is None:
            self._u[member] = value
            return
        with numbers.precision(self.program.precision):
            number = numeric(value, signal.kind, signal.width, name)
        scalars = number if isinstance(number, Vector) else (number,)
        plain = [n.value if isinstance(n, Integer) else n.item() for n in scalars]
        self._u[member][0] = plain[0] if signal.width is None else plain


_ACCEPTED = {"real": "fiu", "int32": "iu", "uint32": "iu", "bool": "b"}


def _fitting(data: NDArray[Any], signal: flat_program.FlatSignal) -> NDArray[Any]:
    """An input's array, checked; integers wrap around."""
    if data.dtype.kind not in _ACCEPTED[signal.kind] or data.shape[1:] != (
        () if signal.width is None else (signal.width,)
    ):
        raise DiagramError(
            f"an array of {data.dtype} and shape {data.shape} is given for {signal.kind} of width {signal.width or 1}",
            signal.path,
            "convert it",
        )
    return data if signal.kind in ("real", "bool") else data.astype(signal.kind)
