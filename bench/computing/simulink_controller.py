"""A public Simulink flight controller as a diagram of library blocks, block by block, to compare with its own C.

The model is `controller/flightController.slx` of JakubRichardson/IGDP-DroneProj at f54bdc9 (R2023a, version 8.11): a
Parrot minidrone that holds position, height and attitude, in single precision at 200 Hz. Embedded Coder's C for it
stands beside it in the same repository. It is not ours: the benchmark takes it from the checkout that the variable
TWODOF_SIMULINK_CONTROLLER names, and measures nothing without one.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.measure import Figure, timed
from twodof.blocks import Diagram
from twodof.blocks.library import (
    Concatenate,
    Constant,
    Demux,
    DiscreteIntegrator,
    FlipFlop,
    Gain,
    MatrixGain,
    MatrixMultiply,
    Mux,
    Product,
    Reshape,
    Saturation,
    Selector,
    Sum,
    Switch,
    Trigonometry,
    UnitDelay,
)
from twodof.compile import CompiledProgram, build
from twodof.compile.cortex_m7.image import build_image, find_cross_compiler
from twodof.compile.cortex_m7.processor import DEFAULTS, INIT, PREPARE, Processor
from twodof.compile.toolchain.compilers import find_compiler
from twodof.errors import CompileError

CHECKOUT = "TWODOF_SIMULINK_CONTROLLER"
GENERATED = ("work/slprj/ert/flightController", "work/slprj/ert/_sharedutils")
WRAPPER = Path(__file__).with_name("hand") / "simulink_controller.c"
FLAGS = ("-std=gnu11", "-O3", "-march=native", "-ffp-contract=off", "-shared", "-fPIC")
STEPS, STEPS_M7 = 20_000, 400
REPEATS = 15
OF_EMBEDDED_CODER = 1.3
PERIOD = 0.005
STATES = ("X", "Y", "Z", "yaw", "pitch", "roll", "dx", "dy", "dz", "p", "q", "r")
"""Estimated states, in the order of the model's bus `statesEstim_t`."""
HOVER = -0.61803
"""Weight of the drone, negative as z points down [N]."""
YAW, TILT = 103.573624, 5.66592
MIXER = (
    (0.25, YAW, -TILT, -TILT),
    (0.25, -YAW, -TILT, TILT),
    (0.25, YAW, TILT, TILT),
    (0.25, -YAW, TILT, -TILT),
)
"""Thrust of each motor, one row a motor, from total thrust, yaw, pitch and roll torque."""


def scaled(d: Diagram, name: str, gains: Sequence[float], source: str) -> None:
    """Add a gain for each element of `source`."""
    d.add(f"{name}_gains", Constant(gains, width=len(gains)))
    d.add(name, Product(width=len(gains)), a=f"{name}_gains", b=source)


def position() -> Diagram:
    """Pitch and roll set-points from the error of the position, turned into the body's axes."""
    d = Diagram("xy_to_attitude")
    for name in ("yaw", "dx", "dy", "X", "Y"):
        d.input(name)
    d.input("reference", width=2)
    for function in ("sin", "cos"):
        d.add(function, Trigonometry(function), u="yaw")
    d.add("minus_sin", Gain(-1.0), u="sin")
    d.add("column1", Mux(), a="cos", b="minus_sin")
    d.add("column2", Mux(), a="sin", b="cos")
    d.add("columns", Concatenate((2, 2)), a="column1", b="column2")
    d.add("rotation", Reshape((4,), (2, 2)), u="columns")
    d.add("here", Mux(), a="X", b="Y")
    d.add("error", Sum("+-", width=2), a="reference", b="here")
    d.add("turned", MatrixMultiply((2, 2), (2,)), a="rotation", b="error")
    d.add("limited", Saturation(-3.0, 3.0, width=2), u="turned")
    scaled(d, "P", [-0.24, 0.24], "limited")
    d.add("speed", Mux(), a="dx", b="dy")
    scaled(d, "D", [0.1, -0.1], "speed")
    d.add("sum", Sum("++", width=2), a="P", b="D")
    d.output("attitude", "sum")
    return d


def attitude() -> Diagram:
    """Pitch and roll torques: a PID whose integral is bounded and leaks with its own last value."""
    d = Diagram("attitude")
    for name in ("pitch", "roll", "q", "p"):
        d.input(name)
    d.input("reference", width=2)
    d.add("angles", Mux(), a="pitch", b="roll")
    d.add("rates", Mux(), a="q", b="p")
    d.add("error", Sum("+-", width=2), a="reference", b="angles")
    scaled(d, "P", [0.013, 0.01], "error")
    d.add("leak", Gain(0.001, width=2), u="last")
    d.add("driven", Sum("+-", width=2), a="error", b="leak")
    d.add("integral", DiscreteIntegrator(limits=(-2.0, 2.0), width=2, initial=[0.0, 0.0]), u="driven")
    d.add("last", UnitDelay(width=2, initial=[0.0, 0.0]), u="integral")
    d.add("I", Gain(0.01, width=2), u="integral")
    scaled(d, "D", [0.002, 0.0028], "rates")
    d.add("torque", Sum("++-", width=2), a="P", b="I", c="D")
    d.add("split", Demux(), u="torque")
    d.add("trim", Constant(0.0))
    d.add("tau_pitch", Sum("++"), a="split.a", b="trim")
    d.output("pitch", "tau_pitch")
    d.output("roll", "split.b")
    return d


def yaw() -> Diagram:
    """Yaw torque: P on the heading, D on its rate."""
    d = Diagram("yaw")
    for name in ("reference", "yaw", "r"):
        d.input(name)
    d.add("error", Sum("+-"), a="reference", b="yaw")
    d.add("P", Gain(0.004), u="error")
    d.add("D", Gain(0.0012), u="r")
    d.add("torque", Sum("+-"), a="P", b="D")
    d.output("torque", "torque")
    return d


def height() -> Diagram:
    """Total thrust: PD on the height about the weight, or a fixed climb while taking off."""
    d = Diagram("height")
    for name in ("reference", "Z", "dz"):
        d.input(name)
    d.input("taking_off", "bool")
    d.add("w0", Constant(HOVER))
    d.add("climb", Gain(0.45), u="w0")
    d.add("error", Sum("+-"), a="reference", b="Z")
    d.add("P", Gain(0.8), u="error")
    d.add("D", Gain(0.3), u="dz")
    d.add("PD", Sum("+-"), a="P", b="D")
    d.add("chosen", Switch(), condition="taking_off", a="climb", b="PD")
    d.add("total", Sum("++"), a="chosen", b="w0")
    d.add("limited", Saturation(-1.20204329, 1.20204329), u="total")
    d.output("thrust", "limited")
    return d


def motors() -> Diagram:
    """Motor commands from thrusts: scaled, bounded and signed by the sense of rotation."""
    d = Diagram("motors")
    d.input("thrusts", width=4)
    d.add("command", Gain(-1530.72681, width=4), u="thrusts")
    d.add("limited", Saturation(10.0, 500.0, width=4), u="command")
    scaled(d, "directions", [1.0, -1.0, 1.0, -1.0], "limited")
    d.output("motors", "directions")
    return d


def flight_controller() -> Diagram:
    """Return the whole controller. Inputs: the two buses, flat. Outputs: `motors` [4] and `pose` [8]."""
    d = Diagram("flight_controller")
    d.input("position_mode", "bool")
    d.input("pos_ref", width=3)
    d.input("takeoff_flag", "bool")
    d.input("orient_ref", width=3)
    for name in STATES:
        d.input(name)
    d.add("z_ref", Selector(3, (2,)), u="pos_ref")
    d.add("xy_ref", Selector(3, (0, 1)), u="pos_ref")
    d.add("yaw_ref", Selector(3, (0,)), u="orient_ref")
    d.add("tilt_ref", Selector(3, (1, 2)), u="orient_ref")
    d.add("position", position(), reference="xy_ref", yaw="yaw", dx="dx", dy="dy", X="X", Y="Y")
    d.add("switch", Switch(width=2), condition="position_mode", a="position.attitude", b="tilt_ref")
    d.add("attitude", attitude(), reference="switch", pitch="pitch", roll="roll", q="q", p="p")
    d.add("yaw_loop", yaw(), reference="yaw_ref", yaw="yaw", r="r")
    d.add("height", height(), reference="z_ref", Z="Z", dz="dz", taking_off="takeoff_flag")
    d.add("never", Constant(False, "bool"))
    d.add("flying", FlipFlop(), set="takeoff_flag", clear="never")
    d.add("no_thrust", Constant(0.0))
    d.add("thrust", Switch(), condition="flying", a="height.thrust", b="no_thrust")
    d.add("demand", Mux(4), a="thrust", b="yaw_loop.torque", c="attitude.pitch", d="attitude.roll")
    d.add("mixer", MatrixGain(MIXER), u="demand")
    d.add("motor_commands", motors(), thrusts="mixer")
    d.add("pose", Concatenate((3, 3, 2)), a="pos_ref", b="orient_ref", c="switch")
    d.output("motors", "motor_commands.motors")
    d.output("pose", "pose")
    return d


BUSES = np.dtype(
    [
        ("position_mode", "?"),
        ("pos_ref", "f4", (3,)),
        ("takeoff_flag", "?"),
        ("orient_ref", "f4", (3,)),
        ("live_time_ticks", "u4"),
        *((name, "f4") for name in STATES),
    ],
    align=True,
)
"""The model's buses `CommandBus` and `statesEstim_t`, one after the other."""
OUTPUTS = np.dtype([("motors", "f4", (4,)), ("pose", "f4", (8,))])


def flight(steps: int, mode: str) -> NDArray[Any]:
    """Return seeded sines on every input; `mode` is "position", "attitude" or "mixed", which changes each second."""
    random = np.random.default_rng(1)
    t = PERIOD * np.arange(steps)
    rows = np.zeros(steps, BUSES)

    def sine() -> NDArray[np.float64]:
        return np.asarray(random.uniform(0.2, 2.0) * np.sin(random.uniform(0.5, 9.0) * t + random.uniform(0.0, 6.0)))

    for name in STATES:
        rows[name] = sine()
    for name in ("pos_ref", "orient_ref"):
        rows[name] = np.stack([sine() for _ in range(3)], axis=1)
    rows["takeoff_flag"] = t < 1.0
    rows["position_mode"] = {"position": True, "attitude": False, "mixed": np.sin(np.pi * t) > 0.0}[mode]
    return rows


def ours(rows: NDArray[Any], kind: np.dtype[Any]) -> NDArray[Any]:
    """Return the same inputs in our structure."""
    made = np.zeros(len(rows), kind)
    for name in kind.names or ():
        made[name] = rows[name]
    return made


class Pair:
    """Our C and Embedded Coder's in one translation unit, with the inputs of each."""

    def __init__(self, checkout: Path) -> None:
        program = build(flight_controller(), PERIOD, "float32")
        if not isinstance(program, CompiledProgram):
            raise CompileError("the diagram was not compiled", "flight_controller", "install a C compiler")
        self.program = program
        self.source = program.emitted.source + WRAPPER.read_text(encoding="utf-8")
        self.include = [f"-I{checkout / folder}" for folder in GENERATED]

    def sides(self, rows: NDArray[Any]) -> list[tuple[str, NDArray[Any], NDArray[Any], int, int]]:
        """Return name, inputs, outputs and bytes of P and S of each side."""
        dtypes, sizes, name = self.program.dtypes, self.program.emitted.sizes, self.program.emitted.name
        mine = (name, ours(rows, dtypes["U"]), np.zeros(len(rows), dtypes["Y"]), sizes[1], sizes[2])
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
        same = all(np.array_equal(outputs[0][n], outputs[1][n]) for n in ("motors", "pose"))
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
