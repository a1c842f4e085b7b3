"""64 rigs side by side in the processor's vectors, and 64 closed loops, beside the scalar program in the same run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from bench.computing.closed_loop import HOVER, numbered
from bench.measure import Figure, one_core, timed
from twodof.blocks import Diagram
from twodof.compile import CompiledProgram, build
from twodof.compile.lanes.lanes_program import SIMD, LanesMachine, best_simd, build_lanes
from twodof.errors import CompileError
from twodof.rig.parameters import lab
from twodof.rig.rig import BASE_DT, rig
from twodof.sim.closed_loop import closed_loop

LANES = 64
PRECISIONS = ("float64", "float32")
TIMES_SCALAR: Mapping[tuple[str, str], float] = {
    ("avx512", "float64"): 6.0,
    ("avx512", "float32"): 10.0,
    ("avx2", "float64"): 3.0,
    ("avx2", "float32"): 5.0,
}
"""How many times the scalar program's steps per second 64 rigs are to make, by vectors and precision."""

HOVERING: dict[str, Any] = {"fore": 0.4, "aft": 0.4}
DIAGRAMS: Mapping[str, tuple[Callable[[], Diagram], str, dict[str, Any]]] = {
    "rig": (rig, "", HOVERING),
    "closed loop": (closed_loop, "rig.", numbered(HOVER)),
}
"""What runs: the diagram, the prefix of the rig's parameters in it, and its inputs."""

VARIED = ("mass_drone", "mass_cart", "inertia", "arm", "pair_thrust", "lag")


def parameters(prefix: str, delays: bool) -> dict[str, list[Any]]:
    """The `lab` rig's parameters in 64 lanes: seeds, masses and the like of each its own, and with `delays` these too.

    Where all delays are alike, all lanes read one place of the delay lines at a time.
    """
    rng = np.random.default_rng(1)
    values = {f"{prefix}{name}": [value] * LANES for name, value in lab().snapshot().items()}
    for name in (*VARIED, *(("delay", "tof_age") if delays else ())):
        values[f"{prefix}{name}"] = (np.array(values[f"{prefix}{name}"]) * rng.uniform(0.9, 1.1, LANES)).tolist()
    values[f"{prefix}seed"] = list(range(LANES))
    return values


def lanes_of(what: str, precision: str, simd: str, delays: bool = False) -> LanesMachine:
    """64 instances, their inputs set."""
    make, prefix, inputs = DIAGRAMS[what]
    machine = build_lanes(make(), BASE_DT, LANES, precision, simd=simd).machine()
    machine.set_many(parameters(prefix, delays))
    machine.reset()
    machine.step(inputs)
    return machine


def alone(what: str, precision: str) -> Callable[[int], None]:
    """The scalar program of one instance: a function that runs so many steps."""
    make, prefix, inputs = DIAGRAMS[what]
    program = build(make(), BASE_DT, precision)
    if not isinstance(program, CompiledProgram):
        raise CompileError("there is no C compiler", "bench", "install cc, or the wheel ziglang")
    machine = program.machine()
    machine.set_many({path: values[0] for path, values in parameters(prefix, delays=False).items()})
    instance = program.backend.instance()
    p, u, y = (instance.structs[kind] for kind in "PUY")
    for path, parameter in program.flat.parameters.items():
        p[program.layout.parameters[parameter].name] = machine.get(path)
    for name, value in inputs.items():
        u[program.layout.inputs[program.flat.inputs[name]].name] = value
    instance.prepare()
    instance.init()
    return lambda steps: instance.run(steps, u, y)


def run(quick: bool = False) -> list[Figure]:
    """All figures; `quick` only shows that everything runs. Raises CompileError without a compiler."""
    ticks, repeats = (200, 2) if quick else (20_000, 11)
    here = [name for name in ("avx512", "avx2") if list(SIMD).index(name) >= list(SIMD).index(best_simd())]
    figures = []
    with one_core():
        for what in DIAGRAMS:
            for precision in PRECISIONS:
                single = alone(what, precision)
                many = {simd: lanes_of(what, precision, simd) for simd in here or [best_simd()]}
                apart = lanes_of(what, precision, best_simd(), delays=True)
                tasks = [partial(single, 4 * ticks), *(partial(m.skip, ticks) for m in (*many.values(), apart))]
                scalar, *timings, own = timed(tasks, repeats)
                lone = scalar.median / (4 * ticks)
                figures.append(Figure(f"{precision}: one {what}", 1.0 / lone, "steps/s", remark="the scalar program"))
                for (simd, machine), timing in zip(many.items(), timings, strict=True):
                    each = timing.median / (ticks * LANES)
                    figures.append(
                        Figure(
                            f"{precision}, {simd}: {LANES} of {what}",
                            lone / each,
                            "times scalar",
                            TIMES_SCALAR.get((simd, precision)) if what == "rig" else None,
                            remark=f"{1e-6 / each:.1f} M steps/s on one core; "
                            f"{machine.program.lane_bytes:.0f} bytes each",
                        )
                    )
                figures.append(
                    Figure(
                        f"{precision}, {best_simd()}: {LANES} of {what}, delays of each its own",
                        lone / (own.median / (ticks * LANES)),
                        "times scalar",
                        remark="each lane reads its own place (AVX-512: a gather)",
                    )
                )
    return figures
