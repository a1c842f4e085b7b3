"""The closed loop on the `lab` rig: compiled by twodof, by hand in C, in MuJoCo, and linear in python-control."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.computing.hand_loop import HandLoop
from bench.computing.linear_loop import linear_loop_seconds
from bench.computing.mujoco_loop import MujocoLoop
from bench.measure import Figure, Timing, one_core, timed
from twodof.blocks import Diagram
from twodof.blocks.block import Clock
from twodof.compile import CompiledMachine, CompiledProgram, build
from twodof.compile.toolchain import compilers
from twodof.errors import CompileError
from twodof.rig.dynamics import Turbulence
from twodof.rig.parameters import lab
from twodof.rig.rig import BASE_DT
from twodof.rig.sensors import NoiseSource
from twodof.signals import MODES
from twodof.sim.closed_loop import closed_loop

STEPS_PER_SECOND = 5e6
OF_HAND = 0.8
PRECISIONS = ("float64", "float32")

FLIGHT: tuple[tuple[float, dict[str, Any]], ...] = (
    (2.0, {"mode": "attitude", "thrust": 0.4, "theta0": 0.0}),
    (2.0, {"mode": "attitude", "thrust": 0.4, "theta0": 0.1}),
    (1.0, {"mode": "rate", "thrust": 0.4, "q0": -0.1}),
    (3.0, {"mode": "attitude", "thrust": 0.4, "theta0": 0.0}),
    (0.4, {"mode": "open-loop", "thrust": 0.4, "M_open": 0.03, "use_trim": True}),
    (0.4, {"mode": "open-loop", "thrust": 0.4, "M_open": -0.03, "use_trim": True}),
    (3.0, {"mode": "velocity", "v0": 0.2}),
    (3.0, {"mode": "position", "x0": -0.2}),
    (4.0, {"mode": "position", "x0": 0.25}),
    (0.6, {"mode": "open-loop", "thrust": 0.5, "M_open": 0.2, "use_trim": False}),
    (0.6, {"mode": "off"}),
)
"""Seconds and set-points of the flight in which the two loops are compared: all modes, the end stops too."""

AGREEMENT = {"float64": 1e-11, "float32": 1e-3}
"""Largest difference, without noise, of any output over its largest value.

The two round differently (fused multiply-add, libm), by half a unit in the last place an operation: 1e-16, and 6e-8 in
float32. Feedback forgets such errors, the estimator's integrations and each bounce at a stop enlarge them; 5e-15 and
3e-6 are seen, other compilers may choose other roundings. Any coefficient that acts on this flight, wrong in its sixth
digit, moves an output by 1e-8 or more (the estimator's first variance of x alone by less).
"""

UNPACKED = ("-fno-tree-slp-vectorize",)
OURS = tuple(flag for flag in compilers.FLAGS if flag.startswith("-f"))
"""What decides over the machine code of the compiled loop: with -O3 and the processor's options as for both."""

OF_HAND_WITH_OURS = 1.0
NOISES = {"its own noise": (), "our noise": ("-DCOUNTER",), "no noise": ("-DSILENT",)}
"""How the hand-written loop makes its noise, and the options that say so.

Its own generator is sequential: a number depends on how many were drawn before. Ours depends on (seed, stream, tick)
alone, so that all targets and resimulations have the same; hand-written C that gives as much is the second row.
"""

HOVER: dict[str, Any] = {"mode": "position", "x0": 0.1}
"""What is timed: holding a position, with all noise."""


class Silence(NoiseSource):
    """No noise, at no cost."""

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return dict.fromkeys(("n0", "n1", "n2", "n3"), 0.0)


class Calm(Turbulence):
    """A gust that nothing drives."""

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return p.keep * x.gust


def silent_loop() -> Diagram:
    """The closed loop without generators of noise."""
    diagram = closed_loop()
    inner = diagram.parts["rig"].item
    assert isinstance(inner, Diagram)
    inner.parts["noise_source"].item, inner.parts["turbulence"].item = Silence(), Calm()
    return diagram


class CompiledLoop:
    """The compiled closed loop with the `lab` parameters.

    `noise` scales the sensors' noise and the gust; with None nothing draws any.
    """

    def __init__(self, precision: str, noise: float | None = 1.0, target: str = "native") -> None:
        made = silent_loop() if noise is None else closed_loop()
        program = build(made, BASE_DT, precision, target=target)
        if not isinstance(program, CompiledProgram):
            raise CompileError("no C compiler was found", "bench", "install cc, or the wheel ziglang")
        self.program = program
        self.machine: CompiledMachine = program.machine()
        self.machine.set_many({f"rig.{name}": value for name, value in lab().snapshot().items()})
        self.machine.set("rig.noise", 1.0 if noise is None else noise)
        self.machine.reset()
        self._instance = program.backend.instance()
        structs = self._instance.structs
        for path, parameter in program.flat.parameters.items():
            structs["P"][program.layout.parameters[parameter].name] = self.machine.get(path)
        self._instance.prepare()
        self._instance.init()

    def run(self, ticks: int, setpoints: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
        """As a user runs it: all outputs of `ticks` ticks as arrays."""
        return self.machine.run(ticks, setpoints)

    def spin(self, ticks: int, setpoints: Mapping[str, Any]) -> None:
        """The compiled code alone, keeping only the last outputs."""
        structs = self._instance.structs
        for name, value in setpoints.items():
            structs["U"][self.program.layout.inputs[self.program.flat.inputs[name]].name] = value
        self._instance.run(ticks, structs["U"], structs["Y"])


def numbered(setpoints: Mapping[str, Any]) -> dict[str, Any]:
    """The set-points with the mode as its number."""
    return {name: MODES.index(value) if name == "mode" else value for name, value in setpoints.items()}


def difference(precision: str, noise: float = 0.0) -> tuple[float, str]:
    """Return the largest difference between the compiled and the hand-written loop over `FLIGHT`, and its output.

    The difference of an output is relative to its largest magnitude, or to 1 if that is smaller. With `noise` above 0
    both loops draw the same numbers. Nothing is quantised, as a rounding error may turn into a whole step.
    """
    ours = CompiledLoop(precision, noise=noise)
    machine = ours.machine
    machine.set_many(dict.fromkeys(("rig.acc_step", "rig.gyro_step", "rig.tof_step"), 0.0))
    machine.reset()
    flags = NOISES["our noise"] if noise else ()
    hand = HandLoop(machine, precision, seed=int(machine.get("rig.seed")), flags=flags)
    gap: dict[str, float] = {}
    size: dict[str, float] = {}
    for seconds, setpoints in FLIGHT:
        ticks, values = round(seconds / BASE_DT), numbered(setpoints)
        left, right = ours.run(ticks, values), hand.run(ticks, values)
        if left.keys() != right.keys():
            raise CompileError(f"outputs of one loop only: {left.keys() ^ right.keys()}", "bench", "write them by hand")
        for name in left:
            a, b = left[name].astype(np.float64), right[name].astype(np.float64)
            gap[name] = max(gap.get(name, 0.0), float(np.max(np.abs(a - b))))
            size[name] = max(size.get(name, 1.0), float(np.max(np.abs(a))))
    worst = max(gap, key=lambda name: gap[name] / size[name])
    return gap[worst] / size[worst], worst


def _rate(timing: Timing, ticks: int) -> tuple[float, str]:
    """Steps a second at the median, and the rest in words."""
    spread = f"best {ticks / timing.best / 1e6:.2f} M/s"
    return ticks / timing.median, spread + (f", wall {timing.stretch:.1f} x CPU time" if timing.stretch > 1.1 else "")


def _over(peer: Timing, ours: Timing) -> float:
    """How many times as fast as its peer ours is: the median of pairs."""
    return float(np.median(np.array(peer.seconds) / np.array(ours.seconds)))


def run(quick: bool = False) -> list[Figure]:
    """All figures; `quick` only shows that everything runs. Raises CompileError without a compiler."""
    ticks, repeats = (2_000, 2) if quick else (1_000_000, 11)
    figures = []
    for precision in PRECISIONS:
        gap, where = difference(precision)
        figures.append(
            Figure(
                f"{precision}: difference to hand-written C, no noise",
                gap,
                "of largest value",
                AGREEMENT[precision],
                at_most=True,
                remark=f"largest in {where}; {sum(s for s, _ in FLIGHT):.0f} s through all modes and both end stops",
            )
        )
    hover = numbered(HOVER)
    with one_core():
        for precision in PRECISIONS:
            ours, kept = CompiledLoop(precision), CompiledLoop(precision)
            hand = HandLoop(ours.machine, precision)
            tuned = HandLoop(ours.machine, precision, flags=UNPACKED)
            same = {how: HandLoop(ours.machine, precision, flags=(*OURS, *flags)) for how, flags in NOISES.items()}
            silent = CompiledLoop(precision, noise=None)
            mine, theirs, unpacked, arrays, still, *alike = timed(
                [
                    partial(ours.spin, ticks, hover),
                    partial(hand.spin, ticks, hover),
                    partial(tuned.spin, ticks, hover),
                    partial(kept.run, ticks // 10, hover),
                    partial(silent.spin, ticks, hover),
                    *(partial(loop.spin, ticks, hover) for loop in same.values()),
                ],
                repeats,
            )
            speed, words = _rate(mine, ticks)
            peer, peer_words = _rate(theirs, ticks)
            paired = _over(theirs, mine)
            figures += [
                Figure(f"{precision}: compiled diagram", speed, "steps/s", STEPS_PER_SECOND, remark=words),
                Figure(f"{precision}: hand-written C", peer, "steps/s", remark=peer_words),
                Figure(f"{precision}: compiled over hand-written", paired, "", OF_HAND, remark="median of pairs"),
                *(
                    Figure(
                        f"{precision}: compiled over hand-written, the same options, {how}",
                        _over(timing, still if how == "no noise" else mine),
                        "",
                        OF_HAND_WITH_OURS,
                        remark=f"both with {' '.join(OURS)}",
                    )
                    for how, timing in zip(same, alike, strict=True)
                ),
                Figure(
                    f"{precision}: hand-written C, {' '.join(UNPACKED)}",
                    ticks / unpacked.median,
                    "steps/s",
                    remark="for comparison: an option of the compiled code that helps this one too",
                ),
                Figure(
                    f"{precision}: compiled, all outputs as arrays",
                    ticks // 10 / arrays.median,
                    "steps/s",
                    remark="Machine.run, 26 signals a step",
                ),
            ]
        figures += _mujoco(quick) + _linear(quick)
    return figures


def _mujoco(quick: bool) -> list[Figure]:
    ticks, repeats = (80, 2) if quick else (20_000, 5)
    loop = MujocoLoop(lab())
    bare, flown = timed([partial(loop.physics, ticks), partial(loop.fly, ticks, 0.1)], repeats)
    return [
        Figure(
            "MuJoCo, physics alone",
            ticks / bare.median,
            "steps/s",
            remark="slide + hinge, RK4 1 ms, stops, friction, rotor lag; constant command, mj_step(nstep=4)",
        ),
        Figure(
            "MuJoCo with the cascade in Python at 250 Hz",
            ticks / flown.median,
            "steps/s",
            remark="the same laws on the true state; no sensors, noise, estimator or delay",
        ),
    ]


def _linear(quick: bool) -> list[Figure]:
    ticks, repeats = (100, 2) if quick else (20_000, 5)
    seconds = linear_loop_seconds(ticks, repeats)
    return [
        Figure(
            "python-control, linear loop",
            ticks / seconds,
            "steps/s",
            remark="forced_response; continuous cascade on the linearised rig, no noise, stops or friction",
        )
    ]
