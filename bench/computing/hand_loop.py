"""The hand-written C loop: built with the system's compiler, loaded, and given the parameters of a compiled machine."""

import ctypes
import functools
import platform
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.compile import CompiledMachine
from twodof.compile.toolchain.compilers import find_compiler
from twodof.errors import CompileError, ParameterError

FOLDER = Path(__file__).with_name("hand")
NATIVE = "-mcpu=native" if platform.machine() in ("arm64", "aarch64") else "-march=native"
FLAGS = ("-O3", NATIVE)
SETPOINTS = ("x0", "v0", "theta0", "q0", "thrust", "M_open")
ONLY_OURS = frozenset({"rig.seed"})
"""Parameters of the compiled loop that the hand-written one does not need: it seeds its own generator."""


class HandLoop:
    """One instance of the loop, in float64 or float32, with the parameters of `machine`; `flags` are added to `FLAGS`.

    Raises CompileError if there is no C compiler, ParameterError if the two loops do not have the same parameters.
    """

    def __init__(self, machine: CompiledMachine, precision: str, seed: int = 1, flags: tuple[str, ...] = ()) -> None:
        self.library = _built(precision, flags)
        self.outputs = _names(self.library, "hand_outputs")
        real = np.dtype(precision)
        integers = [("mode", np.dtype("int32")), ("use_trim", np.dtype("int32"))]
        self._setpoints = np.zeros(1, np.dtype([*integers, *((name, real) for name in SETPOINTS)], align=True))
        self._output = np.dtype([(name, real) for name in self.outputs])
        self._one = np.zeros(1, self._output)
        self.library.hand_size.restype = ctypes.c_size_t
        pointer, size = ctypes.c_void_p, ctypes.c_size_t
        self.library.hand_init.argtypes = [pointer, pointer, ctypes.c_uint64]
        self.library.hand_run.argtypes = [pointer, pointer, pointer, size, size]
        self._loop = np.zeros(self.library.hand_size(), np.uint8)
        values = self._values(machine)
        self.library.hand_init(self._loop.ctypes.data, values.ctypes.data, seed)

    def _values(self, machine: CompiledMachine) -> NDArray[np.float64]:
        names = _names(self.library, "hand_parameters")
        paths = {path.replace(".", "_"): path for path in machine.parameters if path not in ONLY_OURS}
        if set(names) != set(paths):
            raise ParameterError(
                f"parameters of one loop only: {', '.join(sorted(set(names) ^ set(paths)))}",
                str(FOLDER),
                "write the equations that use them by hand",
            )
        return np.array([float(machine.get(paths[name])) for name in names])

    def _set(self, setpoints: Mapping[str, Any]) -> None:
        for name, value in setpoints.items():
            self._setpoints[name] = value

    def run(self, ticks: int, setpoints: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
        """`ticks` ticks of 1 ms with these set-points; all outputs, (ticks,) each."""
        self._set(setpoints)
        y = np.zeros(max(ticks, 1), self._output)
        self._run(y, 1, ticks)
        return {name: np.ascontiguousarray(y[name][:ticks]) for name in self.outputs}

    def spin(self, ticks: int, setpoints: Mapping[str, Any]) -> None:
        """The same, keeping only the last outputs."""
        self._set(setpoints)
        self._run(self._one, 0, ticks)

    def _run(self, y: NDArray[Any], stride: int, ticks: int) -> None:
        loop, setpoints = self._loop.ctypes.data, self._setpoints.ctypes.data
        self.library.hand_run(loop, setpoints, y.ctypes.data, stride, ticks)


def _names(library: ctypes.CDLL, symbol: str) -> list[str]:
    """A C array of strings that ends with a null pointer."""
    start = ctypes.cast(getattr(library, symbol), ctypes.POINTER(ctypes.c_char_p))
    names = []
    while (text := start[len(names)]) is not None:
        names.append(text.decode())
    return names


@functools.cache
def _built(precision: str, flags: tuple[str, ...]) -> ctypes.CDLL:
    compiler = find_compiler()
    single = ("-DSINGLE",) if precision == "float32" else ()
    with tempfile.TemporaryDirectory(prefix="twodof-bench-") as folder:
        made = Path(folder) / "hand.so"
        source = str(FOLDER / "closed_loop.c")
        command = [*compiler.command, *FLAGS, *flags, *single, "-shared", "-fPIC", "-o", str(made), source, "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
        if done.returncode:
            raise CompileError(done.stderr.strip()[-2000:], source, "make it compile")
        return ctypes.CDLL(str(made))  # stays mapped when its file goes
