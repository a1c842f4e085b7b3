"""64 rigs side by side in the processor's vectors, and 64 closed loops, beside the scalar program in the same run."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.computing.closed_loop import HOVER, numbered
from bench.measure import Figure, one_core, timed
from twodof.blocks import Diagram
from twodof.compile import CompiledProgram, build
from twodof.compile.lanes.lanes_program import SIMD, LanesMachine, best_simd, build_lanes
from twodof.compile.program.lower import lower
from twodof.errors import CompileError
from twodof.rig.parameters import lab
from twodof.rig.rig import BASE_DT, rig
from twodof.sim.closed_loop import closed_loop

if TYPE_CHECKING:
    from bench.computing.numba_rig import NumbaRig

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

FLOWN = ((2_000, 0.4, 0.4), (1_000, 0.45, 0.38), (1_000, 0.38, 0.44), (500, 0.0, 0.0), (3_000, 0.5, 0.39))
"""Ticks and commands of the flight in which the rig and its loop in numba are compared: both stops of the pitch."""

AGREEMENT = 1e-11
OF_NUMBA = 1.0
INSTALL = "make bench, or pip install --require-hashes -r requirements/bench.txt"

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


def numba_rig(given: Mapping[str, Any]) -> NumbaRig | None:
    """One rig in numba, with the program's defaults in place of the parameters that are not given.

    None, and a line on what to install, where numba is not.
    """
    if importlib.util.find_spec("numba") is None:
        print(f"numba is not here, its loop is left out: {INSTALL}", file=sys.stderr)
        return None
    from bench.computing.numba_rig import NumbaRig

    return NumbaRig({path: q.declared.value for path, q in lower(rig(), BASE_DT).parameters.items()} | {**given})


def _difference(given: Mapping[str, Any]) -> float:
    """The largest difference of any output of the rig and its loop in numba, without noise, over its largest value."""
    program = build(rig(), BASE_DT)
    ours, peer = program.machine(), numba_rig({**given, "noise": 0.0})
    if peer is None:
        return 0.0
    ours.set_many({**given, "noise": 0.0})
    ours.reset()
    gap: dict[str, float] = {}
    for ticks, fore, aft in FLOWN:
        right = peer.run(ticks, fore, aft)
        for name, left in ours.run(ticks, {"fore": fore, "aft": aft}).items():
            off = np.abs(left.astype(np.float64) - right[name]).max() / max(1.0, np.abs(right[name]).max())
            gap[name] = max(gap.get(name, 0.0), float(off))
    return max(gap.values())


def _against_numba(quick: bool) -> list[Figure]:
    given = {path: values[0] for path, values in parameters("", delays=False).items()}
    peer = numba_rig(given)
    if peer is None:
        return []
    ticks, repeats = (200, 2) if quick else (100_000, 11)
    ours = alone("rig", "float64")
    mine, theirs = timed([partial(ours, ticks), partial(peer.spin, ticks, **HOVERING)], repeats)
    paired = np.median(np.array(theirs.seconds) / np.array(mine.seconds))
    return [
        Figure("difference to numba, no noise", _difference(given), "of largest value", AGREEMENT, at_most=True),
        Figure("float64: one rig in numba", ticks / theirs.median, "steps/s", remark="a loop written by hand"),
        Figure("float64: one rig, over numba", float(paired), "", OF_NUMBA, remark="median of pairs"),
    ]


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
        figures += _against_numba(quick)
    return figures
