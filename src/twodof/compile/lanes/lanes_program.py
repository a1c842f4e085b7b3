"""Lanes: many instances of one diagram at once, in the processor's vectors, each with the scalar program's bits."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.declarations import Param, Port, State, check_steps, numeric
from twodof.blocks.diagram import Diagram
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.kinds import dtype_of
from twodof.blocks.machine import axes, fitting
from twodof.compile.c.emitter import emit
from twodof.compile.lanes.style import LaneStyle as Style
from twodof.compile.machine import BuiltMachine, BuiltProgram
from twodof.compile.native.target import NativeBackend, load
from twodof.compile.program.layout import LaneShape
from twodof.compile.program.lower import lower
from twodof.compile.target import EmittedProgram
from twodof.compile.toolchain import compilers
from twodof.compile.toolchain.compilers import Compiler
from twodof.errors import CompileError, DiagramError, ParameterError

MOST_LANES = 65_536
MOST_RESULTS = 2**28
"""Values of all signals that one call of `run` may return."""
CHUNK = 256  # steps between two copies of outputs


@dataclass(frozen=True)
class Simd:
    """A processor's vectors: bytes in one, how many a struct holds, and what a compiler must be told."""

    name: str
    size: int
    vectors: int
    flags: tuple[str, ...]
    native: bool


SIMD = {
    simd.name: simd
    for simd in (
        Simd("avx512", 64, 2, ("-mprefer-vector-width=512",), True),
        Simd("avx2", 32, 2, ("-mavx2", "-mfma", "-mno-avx512f", "-mtune=skylake"), False),
        Simd("baseline", 16, 2, (), False),
    )
}
"""By name; "baseline" is what every processor of an architecture has (SSE2, NEON)."""


def best_simd() -> str:
    """The name of the widest vectors in SIMD that this processor has."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return "baseline"
    flags = set(text.partition("\nflags")[2].partition("\n")[0].split())
    if platform.machine() == "x86_64":
        if {"avx512f", "avx512dq", "avx512bw", "avx512vl"} <= flags:
            return "avx512"
        if {"avx2", "fma"} <= flags:
            return "avx2"
    return "baseline"


def build_lanes(
    diagram: Diagram,
    dt: float,
    lanes: int,
    precision: str = "float64",
    log: Iterable[str] = (),
    integrator: str = "rk4",
    compiler: str | None = None,
    optimise: str = "-O3",
    simd: str | None = None,
) -> LanesProgram:
    """`lanes` instances of `diagram`, side by side; the other arguments as `twodof.compile.build`'s.

    `simd` is a name in SIMD, None the best that this processor has. Raises DiagramError for a faulty diagram or number
    of lanes, CompileError for a compiler that is missing or fails, or unknown vectors.
    """
    if isinstance(lanes, bool) or not isinstance(lanes, int) or not 1 <= lanes <= MOST_LANES:
        raise DiagramError(f"{lanes!r:.40} lanes", diagram.name, f"use 1 to {MOST_LANES}")
    name = simd or best_simd()
    if name not in SIMD:
        raise CompileError(f"there are no vectors {name!r:.40}", "lanes", f"use one of {', '.join(SIMD)}")
    found = compilers.find_compiler(compiler)
    with numbers.precision(precision):
        emitted = emit([lower(diagram, dt, tuple(log), integrator)], precision, style=Style(shape(name, precision)))
    return compile_lanes(emitted, lanes, name, found, optimise)[0]


def compile_lanes(
    programs: Sequence[EmittedProgram], lanes: int, simd: str, compiler: Compiler, optimise: str
) -> list[LanesProgram]:
    """The programs of one source, which were emitted in the style of these vectors."""
    vectors = SIMD[simd]
    library = load(programs[0].source, compiler, optimise, vectors.native, vectors.flags)
    return [LanesProgram(NativeBackend(program, library), lanes, simd) for program in programs]


def shape(simd: str, precision: str) -> LaneShape:
    """The lanes of one struct."""
    return LaneShape(precision, SIMD[simd].size, SIMD[simd].vectors)


class LanesProgram(BuiltProgram):
    """A diagram compiled for `lanes` instances."""

    def __init__(self, backend: NativeBackend, lanes: int, simd: str) -> None:
        super().__init__(backend.program)
        self.backend = backend
        self.lanes = lanes
        self.simd = simd
        self.shape = shape(simd, self.precision)
        self.blocks = -(-lanes // self.shape.lanes)

    @property
    def lane_bytes(self) -> float:
        """Memory of one lane [bytes]: its parameters, states, inputs and outputs."""
        return sum(self.dtypes[k].itemsize for k in "PSUY") / self.shape.lanes

    def machine(self) -> LanesMachine:
        """Fresh instances in their initial states."""
        return LanesMachine(self)


class LanesMachine(BuiltMachine):
    """Running instances side by side, each with parameters, states and inputs of its own; they share the tick.

    A value of the shape () or (width,) is the same for all lanes. One of the shape (lanes,) or (lanes, width) has the
    lane as its first axis. A sequence for an array of one dimension is the same array in all lanes. Parameters and
    states come back as (lanes,) or (lanes, width). A parameter that is refused in one lane changes in none; the error
    names the lane.
    """

    def __init__(self, program: LanesProgram) -> None:
        super().__init__(program)
        self.program = program
        self._backend = program.backend
        self.lanes = program.lanes
        self._structs = {k: _structs(program.blocks, program.dtypes[k]) for k in "PSUY"}
        for block in self._structs["P"]:
            self._backend.defaults(block.ctypes.data)
            self._backend.prepare(block.ctypes.data)
        self.reset()

    @property
    def tick(self) -> int:
        """Base ticks since the start, modulo 2^32."""
        return int(self._structs["S"][0]["tick"][0])

    def reset(self) -> None:
        """To the initial states of the present parameters, tick 0, held outputs 0."""
        for p, s in zip(self._structs["P"], self._structs["S"], strict=True):
            self._backend.init(p.ctypes.data, s.ctypes.data)

    def run(self, steps: int, inputs: Mapping[str, Any] | None = None) -> dict[str, NDArray[Any]]:
        """`steps` steps. An input that is one value, or has the shape (steps,), is the same in all lanes. It may also
        have the shape (steps, lanes). With (1, lanes) the values stay. An array's last axis is its width.

        Returns each signal, (steps, lanes) or (steps, lanes, width). Raises DiagramError for an input that does not
        fit, or more than MOST_RESULTS results.
        """
        results = check_steps(steps, self.name) * self.lanes * sum(s.width or 1 for s, _ in self._outputs.values())
        if results > MOST_RESULTS:
            raise DiagramError(f"{steps} steps give {results} values", self.name, f"ask for {MOST_RESULTS} at most")
        return super().run(steps, inputs)

    def skip(self, steps: int) -> None:
        """`steps` steps with the last inputs, whose outputs nobody wants."""
        steps = check_steps(steps, self.name)
        for p, s, u, y in zip(*(self._structs[k] for k in "PSUY"), strict=True):
            self._backend.run(p.ctypes.data, s.ctypes.data, u.ctypes.data, 0, y.ctypes.data, 0, steps)

    def _step(self) -> dict[str, NDArray[Any]]:
        return {path: column[0] for path, column in self._run(1, {}).items()}

    def _run(self, steps: int, columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        program, wide = self.program, self.program.shape.lanes
        results = {}
        for path, (s, _) in self._outputs.items():
            inner = () if s.width is None else (s.width,)
            results[path] = np.empty((steps, self.lanes, *inner), dtype_of(s.kind, program.precision))
        y = _structs(min(CHUNK, max(steps, 1)), program.dtypes["Y"], together=True)[0]
        changing = _structs(min(CHUNK, max(steps, 1)), program.dtypes["U"], together=True)[0] if columns else None
        for b, (p, s, u) in enumerate(zip(*(self._structs[k] for k in "PSU"), strict=True)):
            mine = slice(b * wide, min((b + 1) * wide, self.lanes))
            count = mine.stop - mine.start
            for first in range(0, steps, CHUNK):
                n = min(CHUNK, steps - first)
                at, stride = u.ctypes.data, 0
                if changing is not None:
                    changing[:n] = u[0]
                    for name, column in columns.items():
                        part = column[first : first + n] if len(column) > 1 else column
                        _spread(changing[self._inputs[name]][:n], part[:, mine] if part.shape[1] > 1 else part, count)
                    at, stride = changing.ctypes.data, 1
                self._backend.run(p.ctypes.data, s.ctypes.data, at, stride, y.ctypes.data, 1, n)
                if changing is not None:
                    u[0] = changing[n - 1]
                for path, (signal, member) in self._outputs.items():
                    values = np.moveaxis(_apart(y[member][:n], signal.kind), -1, 1)
                    results[path][first : first + n, mine] = values[:, :count]
        return results

    def _checked(self, path: str, value: Any) -> Any:
        declared = self._declared(path)
        fine: set[tuple[type, float]] = set()  # what many lanes have is checked once
        for lane, given in self._each(value, declared, path):
            number = isinstance(given, int | float)
            if number and (type(given), given) in fine:
                continue
            try:
                super()._checked(path, given)
                if number:
                    fine.add((type(given), given))
            except ParameterError as error:
                if lane is None:
                    raise
                raise ParameterError(f"lane {lane}: {error.what}", path, error.remedy) from error
        with numbers.precision("float64"):  # it is rounded where it is stored
            return self._numbers(value, declared, path)

    def _store_parameters(self, values: Mapping[str, Any]) -> None:
        for path, data in values.items():
            self._put("P", self._members[path], data)
        for block in self._structs["P"]:
            self._backend.prepare(block.ctypes.data)

    def _parameter(self, path: str) -> NDArray[Any]:
        return self._read("P", self._members[path], self.parameters[path].kind)

    def _state(self, path: str, declared: State) -> NDArray[Any]:
        return self._read("S", self._states[path][1], declared.kind)

    def _store_state(self, path: str, declared: State, value: Any) -> None:
        self._put("S", self._states[path][1], value)

    def _store_input(self, port: Port, value: Any) -> None:
        self._put("U", self._inputs[port.name], value)

    def _plain(self, value: Any, declared: Port | State, where: str) -> Any:
        with numbers.precision(self.precision):
            return self._numbers(value, declared, where)

    def _column(self, port: Port, data: NDArray[Any], steps: int) -> NDArray[Any]:
        """An input's array as (steps or 1, lanes or 1[, width]), checked; integers wrap around."""
        inner = axes(port)
        if data.shape == (steps, *inner):
            data = data[:, np.newaxis]
        fits = data.shape in ((steps, self.lanes, *inner), (1, self.lanes, *inner), (steps, 1, *inner))
        room = f", {steps} steps and {self.lanes} lanes"
        remedy = "give one value, or (steps,), (steps, lanes) or (1, lanes) of them, with the width as the last axis"
        return fitting(port, data, fits, room, remedy)

    def _each(self, value: Any, declared: Port | State | Param, path: str) -> list[tuple[int | None, Any]]:
        """(lane, its value), or (None, the value) if it is one for all."""
        many = isinstance(value, (np.ndarray, Sequence)) and not isinstance(value, (str, bytes))
        try:
            data: NDArray[Any] = np.asarray(value) if many else np.zeros(())
        except ValueError as error:
            raise ParameterError("its rows differ in length", path, "give each lane the same") from error
        inner = axes(declared)
        if data.ndim == 0 or (inner and data.shape == inner):
            return [(None, value)]
        if data.shape not in ((self.lanes,), (self.lanes, *inner)) or data.dtype == object:
            raise ParameterError(
                f"a value of shape {data.shape} for {self.lanes} lanes", path, "give one value, or one for each lane"
            )
        rows: list[Any] = data.tolist()
        return list(enumerate(rows))

    def _numbers(self, value: Any, declared: Port | State | Param, path: str) -> NDArray[Any]:
        """A value's numbers, with the lane as the first axis, of length 1 if it is one for all."""
        rows, kind = [], declared.kind
        for _, given in self._each(value, declared, path):
            rows.append(numbers.plain(numeric(given, kind, declared.width, path, declared.shape)))
        return np.array(rows, dtype=dtype_of(kind, "float64"))

    def _views(self, struct: str, member: str) -> Iterable[NDArray[Any]]:
        """A member's memory in each block of lanes, ([width,] lanes of the block)."""
        for block in self._structs[struct]:
            whole = block["x"] if struct == "S" and member not in (block.dtype.names or ()) else block
            yield whole[member][0]

    def _read(self, struct: str, member: str, kind: str) -> NDArray[Any]:
        views = (_apart(view, kind) for view in self._views(struct, member))
        data = np.concatenate([np.moveaxis(view, -1, 0) for view in views])[: self.lanes]
        return data != 0 if kind == "bool" else data.astype(dtype_of(kind, self.precision), copy=False)

    def _put(self, struct: str, member: str, data: NDArray[Any]) -> None:
        wide = self.program.shape.lanes
        for b, view in enumerate(self._views(struct, member)):
            part = data[b * wide : (b + 1) * wide] if len(data) > 1 else data
            _spread(view[np.newaxis], part[np.newaxis], min(wide, self.lanes - b * wide))


def _structs(count: int, dtype: np.dtype[Any], together: bool = False) -> list[NDArray[Any]]:
    """`count` zeroed structs, in one array or in one each, aligned as vectors must be."""
    size = dtype.itemsize
    pitch = size if together else -(-size // 64) * 64
    memory = np.zeros(count * pitch + 64, np.uint8)
    start = -memory.ctypes.data % 64
    if together:
        return [memory[start : start + count * size].view(dtype)]
    return [memory[start + i * pitch : start + i * pitch + size].view(dtype) for i in range(count)]


def _spread(target: NDArray[Any], data: NDArray[Any], count: int) -> None:
    """Writes values (steps, lanes[, width]) into a member's memory (steps[, width], lanes).

    The lanes that pad the last vector do what the last lane does.
    """
    values = np.moveaxis(-data.astype(np.int8) if data.dtype == np.bool_ else data, 1, -1)
    if target.dtype == np.uint8:
        lanes = np.zeros((*target.shape[:-1], 8 * target.shape[-1]), np.bool_)
        lanes[..., :count] = values
        lanes[..., count:] = lanes[..., count - 1 : count]
        target[...] = np.packbits(lanes, axis=-1, bitorder="little")
        return
    with np.errstate(over="ignore"):
        target[..., :count] = values
    target[..., count:] = target[..., count - 1 : count]


def _apart(view: NDArray[Any], kind: str) -> NDArray[Any]:
    """A member's memory with the lane as its last axis, also where it holds eight truth values in a byte."""
    return np.unpackbits(view, axis=-1, bitorder="little") if kind == "bool" and view.dtype == np.uint8 else view
