"""The target "wasm": modules that any engine loads, run by wasmtime, bounded in memory and time."""

from __future__ import annotations

import atexit
import ctypes
import functools
import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.compile.target import EmittedProgram
from twodof.compile.wasm.module import PAGE, WasmModule, compile_module, find_wasm_compiler, step_fuel
from twodof.errors import CompileError, ControllerFault

INSTALL = "run `pip install wasmtime ziglang` where twodof is installed"
"""Remedy of an error: how to install the sandbox."""


def check_ready(compiler: str | None = None) -> None:
    """Raise CompileError that names everything missing for the sandbox: wasmtime, a compiler (`compiler`, or any).

    Each call searches again, so that a running program finds a new installation without a restart.
    """
    importlib.invalidate_caches()
    missing = [] if find_spec("wasmtime") is not None else ["the package wasmtime"]
    try:
        find_wasm_compiler(compiler)
    except CompileError:
        if compiler is not None:  # one that was named: the remedy is another name
            raise
        missing.append("a compiler for WebAssembly (the package ziglang)")
    if missing:
        lack = "are" if len(missing) > 1 else "is"
        raise CompileError(
            f"the sandbox in which your own controllers fly cannot be set up: {' and '.join(missing)} {lack} "
            "not installed",
            "target wasm",
            INSTALL,
        )


@dataclass(frozen=True)
class Wasm:
    """WebAssembly run by wasmtime. `compiler` is "zig", "clang" or a path to a clang.

    `fuel` limits one step, about one unit per instruction; by default it is that of `step_fuel`.
    """

    compiler: str | None = None
    optimise: str = "-O3"
    fuel: int | None = None
    name = "wasm"

    def compile(self, programs: Sequence[EmittedProgram]) -> list[WasmBackend]:
        """Compile the programs of one source into one module. Raises CompileError, also without wasmtime."""
        check_ready(self.compiler)
        module = compile_module(programs, self.compiler, self.optimise)
        return backends(module, self.fuel)


CHUNK_FUEL = 10**10  # seconds: after this much at most Python looks whether the user wants to stop
MOST_FUEL = 2**62


def wasmtime() -> Any:
    """Return the package wasmtime, imported at the first call. Raises CompileError if it is not installed."""
    try:
        return importlib.import_module("wasmtime")
    except ImportError as error:
        raise CompileError("the package wasmtime is not installed", "target wasm", INSTALL) from error


@functools.cache
def _engine() -> Any:
    atexit.register(_engine.cache_clear)  # while wasmtime can still free it
    config = wasmtime().Config()
    config.consume_fuel = True
    for feature in ("wasm_threads", "wasm_simd", "wasm_relaxed_simd", "wasm_memory64", "wasm_multi_memory"):
        setattr(config, feature, False)
    return wasmtime().Engine(config)


def backends(module: WasmModule, fuel: int | None = None) -> list[WasmBackend]:
    """Return the programs of `module`, in its order; `fuel` as in `Wasm`.

    Raises CompileError if wasmtime is not installed or refuses the module.
    """
    if fuel is not None and not 0 < fuel <= MOST_FUEL:
        raise CompileError(f"a step cannot have {fuel!r:.40} units of fuel", "target wasm", "give a positive number")
    engine = _engine()
    try:
        compiled = wasmtime().Module(engine, module.data)
    except wasmtime().WasmtimeError as error:
        raise CompileError(
            f"wasmtime refuses the module: {str(error)[:2000]}", next(iter(module.programs)), "report this as a fault"
        ) from error
    if compiled.imports:
        imports = ", ".join(f"{one.module}.{one.name}" for one in compiled.imports)
        raise CompileError(f"the module imports {imports}", next(iter(module.programs)), "report this as a fault")
    return [WasmBackend(p, module, compiled, fuel or step_fuel(p)) for p in module.programs.values()]


class WasmBackend:
    """A program in a compiled module. `module.data` is the .wasm; `fuel` limits one call, and each step of a run."""

    def __init__(self, program: EmittedProgram, module: WasmModule, compiled: Any, fuel: int) -> None:
        self.program = program
        self.module = module
        self.compiled = compiled
        self.fuel = fuel

    def interface(self) -> dict[str, Any]:
        """Return the interface for another host of the module; see `WasmModule.interface`."""
        return self.module.interface(self.program.name)

    def instance(self) -> WasmInstance:
        """Return a fresh instance with a memory of its own."""
        return WasmInstance(self)


class WasmInstance:
    """One running instance, with its structs in a linear memory of its own.

    Fuel is checked at the beginning of a function and at each turn of a loop, so a call exceeds its fuel by at most one
    pass through its code. After a fault (a trap, or no fuel left) each call raises the same ControllerFault. The
    structs can still be read, as the fault left them.
    """

    def __init__(self, backend: WasmBackend) -> None:
        api, name = wasmtime(), backend.program.name
        self.fuel = backend.fuel
        self._name = name
        self._places = places = backend.module.places[name]
        self._fault: ControllerFault | None = None
        self._stops = (api.Trap, api.WasmtimeError)
        self._store = store = api.Store(_engine())
        store.set_limits(memory_size=backend.module.pages * PAGE, instances=1, memories=1, tables=1, table_elements=1)
        exports = api.Instance(store, backend.compiled, []).exports(store)
        memory = exports["memory"]
        # Arrays on the memory keep what they stand on: they hold this buffer, and it holds the store.
        kind: Any = type("LinearMemory", (ctypes.c_ubyte * memory.data_len(store),), {})
        self._memory = kind.from_address(ctypes.addressof(memory.data_ptr(store).contents))
        self._memory.owner = store
        self.structs = {k: self._array(places.structs[k], 1, t) for k, t in backend.program.dtypes.items()}
        rows = places.rows
        self._u = self._array(places.inputs, rows, backend.program.dtypes["U"])
        self._y = self._array(places.outputs, rows, backend.program.dtypes["Y"])
        p, s = places.structs["P"], places.structs["S"]
        self.defaults = self._bound(exports, "defaults", p)
        self.prepare = self._bound(exports, "prepare", p)
        self.init = self._bound(exports, "init", p, s)
        self.step = self._bound(exports, "tick")
        self._run = functools.partial(exports[f"{name}_run"], store, p, s)
        self._chunk = max(1, min(rows, CHUNK_FUEL // self.fuel))

    def _array(self, place: int, rows: int, dtype: np.dtype[Any]) -> NDArray[Any]:
        return np.ndarray(rows, dtype, buffer=self._memory, offset=place)

    def _bound(self, exports: Any, what: str, *arguments: int) -> Callable[[], None]:
        function = functools.partial(exports[f"{self._name}_{what}"], self._store, *arguments)
        return functools.partial(self._call, function, self.fuel, what)

    def _call(self, function: Callable[[], None], fuel: int, what: str) -> None:
        if self._fault is not None:
            raise ControllerFault(self._fault.what, self._fault.where, self._fault.remedy)
        self._store.set_fuel(fuel)
        try:
            function()
        except self._stops as error:
            self._fault = self._described(error, what, fuel)
            raise self._fault from error

    def _described(self, error: Exception, what: str, fuel: int) -> ControllerFault:
        where = f"{self._name}_{what}, tick {int(self.structs['S']['tick'][0])}"
        code = getattr(error, "trap_code", None)
        if code is not None and code.name == "OUT_OF_FUEL":
            return ControllerFault(
                f"it used up its fuel of {fuel} instructions", where, "compute less in a step, or give it more fuel"
            )
        said = (getattr(error, "message", None) or str(error)).strip().splitlines()
        reason = code.name.lower().replace("_", " ") if code is not None else said[-1][:200] if said else "a trap"
        what = f"the program was stopped: {reason}"
        return ControllerFault(what, where, "report this as a fault of twodof, with the diagram")

    def run(self, steps: int, u: NDArray[Any], y: NDArray[Any]) -> None:
        """Run `steps` ticks, in pieces that fit into the memory; see `TargetInstance.run`. Each step has its fuel."""
        places, one_u, one_y = self._places, len(u) == 1, len(y) == 1
        if one_u:
            self._u[0] = u[0]
        for start in range(0, steps, self._chunk):
            n = min(self._chunk, steps - start)
            if not one_u:
                self._u[:n] = u[start : start + n]
            call = functools.partial(self._run, places.inputs, int(not one_u), places.outputs, int(not one_y), n)
            self._call(call, n * self.fuel, "run")
            if not one_y:
                y[start : start + n] = self._y[:n]
        if one_y and steps:
            y[0] = self._y[0]
