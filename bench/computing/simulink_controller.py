"""A public Simulink flight controller, imported, beside the C that Embedded Coder made of it.

The model is `controller/flightController.slx` of JakubRichardson/IGDP-DroneProj at f54bdc9 (R2023a, version 8.11): a
Parrot minidrone that holds position, height and attitude, in single precision at 200 Hz. Its C stands beside it in the
same repository. It is not ours: the benchmark takes both from the checkout that the variable TWODOF_SIMULINK_CONTROLLER
names, and measures nothing without one.
"""

import ctypes
import os
import subprocess
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.measure import Figure, timed
from twodof.compile import CompiledProgram, build
from twodof.compile.cortex_m7.image import build_image, find_cross_compiler
from twodof.compile.cortex_m7.processor import DEFAULTS, INIT, PREPARE, Processor
from twodof.compile.toolchain.compilers import find_compiler
from twodof.errors import CompileError
from twodof.slx.importer import Imported, import_system
from twodof.slx.matlab.script import run as run_script
from twodof.slx.matlab.values import Value
from twodof.slx.model import read_model

CHECKOUT = "TWODOF_SIMULINK_CONTROLLER"
MODEL = "controller/flightController.slx"
GENERATED = ("work/slprj/ert/flightController", "work/slprj/ert/_sharedutils")
WRAPPER = Path(__file__).with_name("hand") / "simulink_controller.c"
FLAGS = ("-std=gnu11", "-O3", "-march=native", "-ffp-contract=off", "-shared", "-fPIC")
STEPS, STEPS_M7 = 20_000, 400
REPEATS = 15
OF_EMBEDDED_CODER = 1.3
PERIOD = 0.005
STATES = ("X", "Y", "Z", "yaw", "pitch", "roll", "dx", "dy", "dz", "p", "q", "r")
"""Estimated states, in the order of the model's bus `statesEstim_t`."""


def bus(name: str, fields: list[tuple[str, str, int]]) -> str:
    """Return a script that defines a bus of Simulink by its fields: name, type and size."""
    lines = [
        f"e({k}) = Simulink.BusElement; e({k}).Name = '{n}'; e({k}).DataType = '{kind}'; e({k}).Dimensions = {size};"
        for k, (n, kind, size) in enumerate(fields, start=1)
    ]
    return "\n".join(["clear e;", *lines, f"{name} = Simulink.Bus; {name}.Elements = e;", ""])


# The numbers are those in the C, so that both have the same parameters.
WORKSPACE = (
    bus("CommandBus", [("controlModePosVSOrient", "boolean", 1), ("pos_ref", "single", 3),
                       ("takeoff_flag", "boolean", 1), ("orient_ref", "single", 3), ("live_time_ticks", "uint32", 1)])
    + bus("statesEstim_t", [(name, "single", 1) for name in STATES])
    + """
Ts = .005; g = 1; Vehicle.Airframe.mass = .61803; Controller.takeoffGain = .45; Controller.totalThrustMaxRelative = 1;
Controller.motorsThrustPerMotorMax = 1.20204329 / 4; Vehicle.Motor.thrustToMotorCommand = 1530.72681;
Vehicle.Motor.maxLimit = 500; Vehicle.Motor.minLimit = 10;
Controller.Q2Ts = single([.25 103.573624 -5.66592 -5.66592; .25 -103.573624 -5.66592 5.66592
                          .25 103.573624 5.66592 5.66592; .25 -103.573624 5.66592 -5.66592]);
"""
)  # fmt: skip
"""A script with the names that the model takes."""


def flight_controller(checkout: Path) -> Imported:
    """Return the whole controller as `twodof slx import` makes it."""
    names: dict[str, Value] = {}
    if skipped := run_script(WORKSPACE, names):
        raise CompileError(skipped[0].why, "WORKSPACE", "mend the script")
    return import_system(read_model(checkout / MODEL), "", names)


COMMAND, ESTIMATE = "ReferenceValueServerBus", "states_estim"
BUSES = np.dtype(
    [
        (f"{COMMAND}_controlModePosVSOrient", "?"),
        (f"{COMMAND}_pos_ref", "f4", (3,)),
        (f"{COMMAND}_takeoff_flag", "?"),
        (f"{COMMAND}_orient_ref", "f4", (3,)),
        (f"{COMMAND}_live_time_ticks", "u4"),
        *((f"{ESTIMATE}_{name}", "f4") for name in STATES),
    ],
    align=True,
)
"""The model's inputs, the buses `CommandBus` and `statesEstim_t`: one structure of both C programs."""
OUTPUTS = np.dtype([("motors_refout", "f4", (4,)), ("pose_refout", "f4", (8,))])


def flight(steps: int, mode: str) -> NDArray[Any]:
    """Return seeded sines on every input; `mode` is "position", "attitude" or "mixed", which changes each second."""
    random = np.random.default_rng(1)
    t = PERIOD * np.arange(steps)
    rows = np.zeros(steps, BUSES)

    def sine() -> NDArray[np.float64]:
        return np.asarray(random.uniform(0.2, 2.0) * np.sin(random.uniform(0.5, 9.0) * t + random.uniform(0.0, 6.0)))

    for name in STATES:
        rows[f"{ESTIMATE}_{name}"] = sine()
    for name in ("pos_ref", "orient_ref"):
        rows[f"{COMMAND}_{name}"] = np.stack([sine() for _ in range(3)], axis=1)
    rows[f"{COMMAND}_takeoff_flag"] = t < 1.0
    rows[f"{COMMAND}_controlModePosVSOrient"] = {"position": True, "attitude": False, "mixed": np.sin(np.pi * t) > 0.0}[
        mode
    ]
    return rows


class Pair:
    """Our C and Embedded Coder's in one translation unit, with the inputs of each."""

    def __init__(self, checkout: Path) -> None:
        imported = flight_controller(checkout)
        if imported.diagram is None:
            raise CompileError(imported.refused[0].why, imported.refused[0].path, "use the checkout of the revision")
        imported.diagram.name = "imported"  # the C beside it has the model's name
        program = build(imported.diagram, imported.dt, "float32")
        if not isinstance(program, CompiledProgram):
            raise CompileError("the diagram was not compiled", "flight_controller", "install a C compiler")
        self.program = program
        self.source = program.emitted.source + WRAPPER.read_text(encoding="utf-8")
        self.include = [f"-I{checkout / folder}" for folder in GENERATED]

    def sides(self, rows: NDArray[Any]) -> list[tuple[str, NDArray[Any], NDArray[Any], int, int]]:
        """Return name, inputs, outputs and bytes of P and S of each side."""
        dtypes, sizes, name = self.program.dtypes, self.program.emitted.sizes, self.program.emitted.name
        mine = (name, rows.astype(dtypes["U"]), np.zeros(len(rows), dtypes["Y"]), sizes[1], sizes[2])
        return [mine, ("peer", rows, np.zeros(len(rows), OUTPUTS), 1, 1)]

    def native(self, rows: NDArray[Any], repeats: int) -> tuple[float, float, bool]:
        """Return seconds a step of ours and of theirs on this computer, and whether every output is the same."""
        with tempfile.TemporaryDirectory() as folder:
            source, library = Path(folder) / "both.c", Path(folder) / "both.so"
            source.write_text(self.source, encoding="utf-8")
            command = [*find_compiler().command, *FLAGS, *self.include, str(source), "-o", str(library), "-lm"]
            subprocess.run(command, check=True, timeout=300)
            loaded = ctypes.CDLL(str(library))
        pointer, size = ctypes.c_void_p, ctypes.c_size_t
        runs, outputs, memory = [], [], []
        for name, u, y, p_bytes, s_bytes in self.sides(rows):
            p, s = np.zeros(p_bytes, "u1"), np.zeros(s_bytes, "u1")
            memory.append((p, s, u, y))
            for function, arguments in (("defaults", [p]), ("prepare", [p]), ("init", [p, s])):
                loaded[f"{name}_{function}"](*(pointer(a.ctypes.data) for a in arguments))
            run = loaded[f"{name}_run"]
            run.argtypes = [pointer, pointer, pointer, size, pointer, size, size]
            runs.append(partial(run, p.ctypes.data, s.ctypes.data, u.ctypes.data, 1, y.ctypes.data, 1, len(rows)))
            runs[-1]()
            outputs.append(y.copy())
        same = all(np.array_equal(outputs[0][n], outputs[1][n]) for n in OUTPUTS.names or ())
        mine, theirs = timed(runs, repeats)
        return mine.median / len(rows), theirs.median / len(rows), same

    def cortex_m7(self, rows: NDArray[Any]) -> tuple[float, float]:
        """Return the mean instructions of a step of ours and of theirs. Raises CompileError without gcc."""
        sides = self.sides(rows)
        sizes = [(name, (4, p, s, u.dtype.itemsize, y.dtype.itemsize)) for name, u, y, p, s in sides]
        image = build_image(self.source, sizes, find_cross_compiler("gcc"), "-O2", self.include, ("-lm", "-lc"))
        means = []
        with Processor(image, counting=True) as processor:
            for k, (_, u, _, p_bytes, s_bytes) in enumerate(sides):
                p, s = np.zeros(1, f"V{p_bytes}"), np.zeros(1, f"V{s_bytes}")
                for operation in (DEFAULTS, PREPARE, INIT):
                    processor.call(k, operation, p, s)
                counts, _ = processor.count(k, p, s, u, len(u))
                means.append(float(counts.mean()))
        return means[0], means[1]


def run(quick: bool = False) -> list[Figure]:
    """Return the figures; without the checkout or a compiler one that says what is missing."""
    checkout = os.environ.get(CHECKOUT, "")
    if not checkout:
        return [
            Figure("not measured", 0.0, "", remark=f"set {CHECKOUT} to a checkout of JakubRichardson/IGDP-DroneProj")
        ]
    figures = []
    try:
        pair = Pair(Path(checkout))
        for mode in ("position", "attitude", "mixed"):
            rows = flight(200 if quick else STEPS, mode)
            mine, theirs, same = pair.native(rows, 1 if quick else REPEATS)
            remark = f"{mine * 1e9:.1f} and {theirs * 1e9:.1f} ns; outputs {'equal' if same else 'DIFFER'}"
            figures.append(ratio(f"{mode}: step time over Embedded Coder's", mine / theirs, remark))
        for mode in ("position", "attitude"):
            mine, theirs = pair.cortex_m7(flight(20 if quick else STEPS_M7, mode))
            remark = f"{mine:.0f} and {theirs:.0f}"
            figures.append(ratio(f"{mode}: Cortex-M7 instructions over Embedded Coder's", mine / theirs, remark))
    except CompileError as error:
        figures.append(Figure("not measured", 0.0, "", remark=str(error)))
    return figures


def ratio(name: str, value: float, remark: str) -> Figure:
    """Return a figure with the target of this benchmark."""
    return Figure(name, value, "", OF_EMBEDDED_CODER, at_most=True, remark=remark)
