"""build: from a diagram to something that runs. Machine: one running instance of a compiled program."""

from __future__ import annotations

import ctypes
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks import numbers
from twodof.blocks.block import Param, check_bounds, check_steps, numeric, unknown_parameter
from twodof.blocks.diagram import Diagram
from twodof.blocks.numbers import Integer, Vector
from twodof.blocks.reference import Reference
from twodof.compile import flat, native
from twodof.compile.c99 import emit
from twodof.compile.layout import Layout
from twodof.compile.lower import lower
from twodof.errors import CompileError, DiagramError, ParameterError


def build(
    diagram: Diagram,
    dt: float,
    precision: str = "float64",
    log: Iterable[str] = (),
    integrator: str = "rk4",
    compiler: str | None = None,
    optimise: str = "-O3",
    native_cpu: bool = True,
) -> Program | Reference:
    """`diagram` as a program of base tick `dt` [s] that also returns the signals whose paths are in `log`.

    `compiler` is "cc", "gcc", "clang", "zig" or a path; None takes the first that is there and, if none is, gives the
    reference interpreter (same results, thousands of times slower) with a warning. `optimise` is a compiler option,
    `native_cpu` tunes for this processor. Raises DiagramError for a faulty diagram, CompileError for a compiler that
    was named and is missing, or that fails.
    """
    log = tuple(log)
    source = emit_program(diagram, dt, precision, log, integrator)
    try:
        found = native.find_compiler(compiler)
    except CompileError:
        if compiler is not None:
            raise
        warnings.warn(
            f"no C compiler is here: {diagram.name!r} runs on the reference interpreter, thousands of times slower; "
            "install cc, or the wheel ziglang",
            RuntimeWarning,
            stacklevel=2,
        )
        return Reference(diagram, dt, precision, log, integrator)
    library = native.load(source.source, found, optimise, native_cpu)
    return Program(source.flat, source.source, source.layout, precision, library)


@dataclass(frozen=True)
class Emitted:
    """A diagram's C, and what it was made from."""

    flat: flat.Program
    source: str
    layout: Layout


def emit_program(
    diagram: Diagram,
    dt: float,
    precision: str = "float64",
    log: Iterable[str] = (),
    integrator: str = "rk4",
) -> Emitted:
    """`diagram` as C source; arguments and errors as `build`'s."""
    with numbers.precision(precision):  # refuses an unknown one
        lowered = lower(diagram, dt, log, integrator)
        emitted = emit([lowered], precision)
    return Emitted(lowered, emitted.text, emitted.layouts[lowered.name])


class Program:
    """A compiled diagram. `source` is its C; `flat` what was lowered; `parameters` the declarations by path."""

    def __init__(
        self, lowered: flat.Program, source: str, layout: Layout, precision: str, library: ctypes.CDLL
    ) -> None:
        self.flat = lowered
        self.source = source
        self.layout = layout
        self.precision = precision
        self.library = library
        self.dt = lowered.dt
        self.parameters: dict[str, Param] = {path: q.declared for path, q in lowered.parameters.items()}
        self.dtypes = layout.dtypes(precision)
        self.states = {
            f"{node.path}.{s.name}": (s, layout.states[node, s.name].name)
            for node in lowered.nodes
            for s in node.block.states
        }
        sizes = (ctypes.c_size_t * 5).in_dll(library, f"{lowered.name}_sizes")
        ours = [np.dtype(precision).itemsize, *(self.dtypes[k].itemsize for k in "PSUY")]
        if list(sizes) != ours:
            raise CompileError(
                f"its structs have the sizes {list(sizes)}, expected {ours}", lowered.name, "report this as a fault"
            )
        pointer, size = ctypes.c_void_p, ctypes.c_size_t
        self.c_defaults = self._function("defaults", pointer)
        self.c_prepare = self._function("prepare", pointer)
        self.c_init = self._function("init", pointer, pointer)
        self.c_step = self._function("step", pointer, pointer, pointer, pointer)
        self.c_run = self._function("run", pointer, pointer, pointer, size, pointer, size, size)

    def _function(self, name: str, *arguments: Any) -> Any:
        function = getattr(self.library, f"{self.flat.name}_{name}")
        function.argtypes, function.restype = arguments, None
        return function

    def machine(self) -> Machine:
        """A fresh instance in its initial state."""
        return Machine(self)


class Machine:
    """One running instance: parameters, states and inputs of its own, in the memory of the C structs."""

    def __init__(self, program: Program) -> None:
        self.program = program
        self.parameters = program.parameters
        kinds = program.dtypes
        self._plain = program.precision == "float64"
        self._p, self._s, self._u, self._y = (np.zeros(1, kinds[k]) for k in "PSUY")
        self._at = tuple(a.ctypes.data for a in (self._p, self._s, self._u, self._y))
        layout, lowered = program.layout, program.flat
        self._members = {path: layout.parameters[q].name for path, q in lowered.parameters.items()}
        self._inputs = {name: (s, layout.inputs[s].name) for name, s in lowered.inputs.items()}
        self._outputs = {path: layout.outputs[path].name for path in lowered.outputs}
        program.c_defaults(self._at[0])
        program.c_prepare(self._at[0])
        self.reset()

    @property
    def tick(self) -> int:
        """Base ticks since the start, modulo 2^32."""
        return int(self._s["tick"][0])

    def reset(self) -> None:
        """To the initial states of the present parameters, tick 0, held outputs 0."""
        self.program.c_init(self._at[0], self._at[1])

    def set(self, path: str, value: Any) -> None:
        """Set one parameter; see `set_many`."""
        self.set_many({path: value})

    def set_many(self, values: Mapping[str, Any]) -> None:
        """Set several parameters before the next step, or, if one is refused with ParameterError, none."""
        with numbers.precision("float64"):  # bounds are compared with what is given, then it is rounded
            new = {self._member(path): self._checked(path, value) for path, value in values.items()}
            for member, value in new.items():
                self._p[member][0] = value
        self.program.c_prepare(self._at[0])

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
        self.program.c_step(*self._at)
        return {path: self._y[member][0].tolist() for path, member in self._outputs.items()}

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
        stride = 1 if columns and steps else 0
        if stride:
            u = np.repeat(self._u, steps)
            with np.errstate(over="ignore"):
                for member, data in columns.items():
                    u[member] = data
            self._u[0] = u[-1]
        y: NDArray[Any] = np.empty(max(steps, 1), self._y.dtype)
        p, s, *_ = self._at
        self.program.c_run(p, s, u.ctypes.data, stride, y.ctypes.data, 1, steps)
        return {path: np.ascontiguousarray(y[member][:steps]) for path, member in self._outputs.items()}

    def _input(self, name: str) -> tuple[flat.Signal, str]:
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


def _fitting(data: NDArray[Any], signal: flat.Signal) -> NDArray[Any]:
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
