"""Kalman filters of 6, 12 and 24 states and chained products: compiled by twodof, by hand in C, and in numpy."""

import ctypes
import subprocess
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.computing.hand_loop import FLAGS, FOLDER
from bench.measure import Figure, one_core, timed
from twodof.blocks import Block, Diagram, Param, Port, State, outer
from twodof.compile import CompiledProgram, build
from twodof.compile.toolchain.compilers import find_compiler
from twodof.errors import CompileError

STATES = (6, 12, 24)
MEASURED = 3
OF_HAND = 1.3
AGREEMENT = 1e-9
"""Largest difference from numpy of any element after 200 steps, over the largest: rounding, in another order."""
CHAIN = (3, 6, 12)
GROWTH = 1.25
"""How much longer a product in a chain of 12 may take than one in a chain of 6: what a chain costs grows as it does."""

Array = NDArray[np.float64]


class KalmanFilter(Block):
    """x and P of a linear model from `MEASURED` independent measurements, taken in one after the other.

    Source: Grewal, Andrews, Kalman Filtering (4th ed., 2015), section 5.2.
    """

    def __init__(self, model: dict[str, Array]) -> None:
        n = len(model["A"])
        self.inputs = [Port("z", width=MEASURED)]
        self.outputs = [Port("x", width=n)]
        self.states = [State("x", width=n), State("P", np.eye(n), shape=(n, n))]
        self.params = [
            Param("A", model["A"], shape=(n, n)),
            Param("Q", model["Q"], shape=(n, n)),
            Param("H", model["H"], shape=(MEASURED, n)),
            Param("R", model["R"], width=MEASURED),
        ]

    def filtered(self, u: Any, x: Any, p: Any) -> tuple[Any, Any]:
        """The state and its covariance after this tick's measurements."""
        state, covariance = p.A @ x.x, p.A @ x.P @ p.A.T + p.Q
        for c in range(MEASURED):
            h = p.H[c]
            cross = covariance @ h
            gain = cross / (h @ cross + p.R[c])
            state, covariance = state + gain * (u.z[c] - h @ state), covariance - outer(gain, cross)
        return state, covariance

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return self.filtered(u, x, p)[0]

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return dict(zip(("x", "P"), self.filtered(u, x, p), strict=True))


class Powers(Block):
    """y = a b^count of matrices."""

    def __init__(self, size: int, count: int) -> None:
        self.count = count
        self.inputs = [Port("a", shape=(size, size)), Port("b", shape=(size, size))]
        self.outputs = [Port("y", shape=(size, size))]

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        found = u.a
        for _ in range(self.count):
            found = found @ u.b
        return found


def model(states: int) -> dict[str, Array]:
    """A stable system with random couplings."""
    rng = np.random.default_rng(states)
    a = rng.normal(size=(states, states))
    return {
        "A": 0.95 * a / np.max(np.abs(np.linalg.eigvals(a))),
        "Q": 1e-3 * np.eye(states),
        "H": rng.normal(size=(MEASURED, states)),
        "R": np.array([0.1, 0.2, 0.3]),
    }


def numpy_filter(m: dict[str, Array], z: Array, steps: int) -> Array:
    """The same filter on numpy's arrays, all measurements at once."""
    x, covariance = np.zeros(len(m["A"])), np.eye(len(m["A"]))
    for _ in range(steps):
        x, covariance = m["A"] @ x, m["A"] @ covariance @ m["A"].T + m["Q"]
        cross = covariance @ m["H"].T
        gain = np.linalg.solve(m["H"] @ cross + np.diag(m["R"]), cross.T).T
        x, covariance = x + gain @ (z - m["H"] @ x), covariance - gain @ cross.T
    return x


class HandFilter:
    """The hand-written C with the same model. Raises CompileError if there is no C compiler."""

    def __init__(self, m: dict[str, Array]) -> None:
        with tempfile.TemporaryDirectory() as folder:
            library = Path(folder) / "kalman.so"
            sizes = (f"-DN={len(m['A'])}", f"-DM={MEASURED}", "-Dreal=double")
            command = [*find_compiler().command, "-std=c99", "-shared", "-fPIC", *FLAGS, *sizes, "-o", str(library)]
            done = subprocess.run([*command, str(FOLDER / "kalman.c")], capture_output=True, text=True, timeout=60)
            if done.returncode:
                raise CompileError(f"kalman.c does not compile: {done.stderr:.400}", "bench", "mend it")
            self._library = ctypes.CDLL(str(library))
        self._library.kalman_run.argtypes = [ctypes.c_void_p] * 3 + [ctypes.c_size_t]
        self._model = np.concatenate([m[name].ravel(order="F") for name in ("A", "Q", "H", "R")])
        n = len(m["A"])
        self.state = np.concatenate([np.zeros(n), np.eye(n).ravel()])

    def run(self, z: Array, steps: int) -> None:
        """`steps` steps with the same measurements."""
        self._library.kalman_run(self._model.ctypes.data, self.state.ctypes.data, z.ctypes.data, steps)


def compiled(block: Block, inputs: dict[str, int | tuple[int, int]], output: str) -> CompiledProgram:
    """A diagram of one block as machine code. Raises CompileError if there is no C compiler."""
    d = Diagram("bench")
    for name, shape in inputs.items():
        d.input(name, **({"width": shape} if isinstance(shape, int) else {"shape": shape}))
    d.add("block", block, inputs={name: name for name in inputs})
    d.output("y", f"block.{output}")
    program = build(d, 0.01)
    if not isinstance(program, CompiledProgram):
        raise CompileError("no C compiler was found", "bench", "install cc, or the wheel ziglang")
    return program


class Spun:
    """The compiled code alone, at the same inputs, keeping only the last outputs."""

    def __init__(self, program: CompiledProgram, inputs: dict[str, Array]) -> None:
        self._instance = program.backend.instance()
        structs = self._instance.structs
        for parameter in program.flat.parameters.values():
            member = program.layout.parameters[parameter].name
            structs["P"][member] = (
                np.asarray(parameter.declared.value).ravel(order="F").reshape(structs["P"][member].shape)
            )
        self._instance.prepare()
        self._instance.init()
        for name, value in inputs.items():
            structs["U"][program.layout.inputs[program.flat.inputs[name]].name] = value.ravel(order="F")
        self._structs = structs

    def run(self, steps: int) -> Array:
        """`steps` steps; the output."""
        self._instance.run(steps, self._structs["U"], self._structs["Y"])
        return np.array(self._structs["Y"]["y"]).ravel()


def run(quick: bool = False) -> list[Figure]:
    """All figures; `quick` only shows that everything runs. Raises CompileError without a compiler."""
    repeats = 2 if quick else 11
    figures = []
    z = np.array([0.3, -0.2, 0.1])
    with one_core():
        for n in STATES:
            m = model(n)
            program = compiled(KalmanFilter(m), {"z": MEASURED}, "x")
            wanted = numpy_filter(m, z, 200)
            gap = float(np.max(np.abs(Spun(program, {"z": z}).run(200) - wanted)) / np.max(np.abs(wanted)))
            steps = (20_000 if quick else 2_000_000) // n**2
            ours, hand = Spun(program, {"z": z}), HandFilter(m)
            mine, theirs, arrays = timed(
                [partial(ours.run, steps), partial(hand.run, z, steps), partial(numpy_filter, m, z, 50)], repeats
            )
            name, micro = f"Kalman filter, {n} states", 1e6 / steps
            paired = float(np.median(np.array(mine.seconds) / np.array(theirs.seconds)))
            figures += [
                Figure(f"{name}: difference to numpy", gap, "of largest value", AGREEMENT, at_most=True),
                Figure(f"{name}: compiled", mine.median * micro, "us/step"),
                Figure(f"{name}: by hand in C", theirs.median * micro, "us/step"),
                Figure(f"{name}: in numpy", arrays.median * 1e6 / 50, "us/step"),
                Figure(
                    f"{name}: compiled over by hand",
                    paired,
                    "",
                    OF_HAND if n < max(STATES) else None,
                    at_most=True,
                    remark="median of pairs",
                ),
            ]
        figures += _chains(quick, repeats)
    return figures


def _chains(quick: bool, repeats: int) -> list[Figure]:
    rng = np.random.default_rng(1)
    a, b = rng.uniform(-0.4, 0.4, (2, 3, 3))
    steps = 200 if quick else 100_000
    spun = [Spun(compiled(Powers(3, count), {"a": (3, 3), "b": (3, 3)}, "y"), {"a": a, "b": b}) for count in CHAIN]
    times = [t.median / steps for t in timed([partial(s.run, steps) for s in spun], repeats)]
    found = [
        Figure(f"{count} chained products of 3 x 3 matrices", seconds * 1e6, "us/step")
        for count, seconds in zip(CHAIN, times, strict=True)
    ]
    growth = (times[2] - times[1]) / 6 / (times[1] / 6)
    return [*found, Figure("a product in a chain of 12 over one in a chain of 6", growth, "", GROWTH, at_most=True)]
