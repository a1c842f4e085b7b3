"""The stock attitude cascade in float32 on the Cortex-M7: bytes and instructions a step, beside C by hand with libm."""

import re
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.measure import Figure
from twodof.blocks import Diagram
from twodof.compile import CompiledProgram, build
from twodof.compile.cortex_m7.image import Image, build_image, find_cross_compiler
from twodof.compile.cortex_m7.processor import DEFAULTS, INIT, PREPARE, CortexM7, Processor, find_emulator
from twodof.compile.cortex_m7.report import FUNCTIONS, CortexM7Report, Usage, image_sizes, measure
from twodof.errors import CompileError
from twodof.flight.cascade import cascade
from twodof.flight.core import core
from twodof.flight.starters import starter
from twodof.signals import MODES

HAND = Path(__file__).with_name("hand")
PERIOD = 0.004
STEPS = 5000
OF_HAND = 1.1
OF_HAND_BYTES = 1.3
OPTIMISE = "-O2"
PLAIN = ("-std=gnu11", "-fhosted", "-ffp-contract=fast", "-fmath-errno", "-ftrapping-math", "-ftree-slp-vectorize")
"""What -O2 alone means to gcc, where our own options say otherwise: with fused multiply-add."""
UNFUSED = ("-ffp-contract=off",)
AGREEMENT = 2e-6
"""Largest difference of any output over its largest value.

Fused multiply-add, atanf and cosf round otherwise, each by some 6e-8 of its result; 1.3e-7 is seen, other compilers may
choose other roundings. Any gain that is wrong by 1e-4 of itself moves an output by more than twice this.
"""


@dataclass(frozen=True)
class Hand:
    """A hand-written program of `bench/hand`: its image and sizes of real, P, S, U and Y."""

    name: str
    image: Image
    sizes: tuple[int, ...]

    def structs(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """P and S, zero."""
        return np.zeros(1, f"V{self.sizes[1]}"), np.zeros(1, f"V{self.sizes[2]}")

    def own_bytes(self) -> int:
        """Flash of its four functions, without what they call in libraries."""
        return Usage(self.image).sizes([f"{self.name}_{f}" for f in FUNCTIONS]).flash

    def other_bytes(self) -> int:
        """Flash of all else: start-up, server, libraries."""
        return image_sizes(self.image).flash - self.own_bytes()

    def run(self, u: NDArray[Any], kind: np.dtype[Any]) -> tuple[NDArray[Any], NDArray[np.int64], int]:
        """Outputs of the type `kind`, instructions and stack [bytes] of a step for each row of `u`."""
        with Processor(self.image, counting=True) as processor:
            p, s = self.structs()
            for operation in (DEFAULTS, PREPARE, INIT):
                processor.call(0, operation, p, s)
            fresh = s.copy()
            y = np.zeros(len(u), kind)
            processor.run(0, p, s, u, y, len(u))
            counts, stack = processor.count(0, p, fresh, u, len(u))
        return y, counts, stack


def hand(name: str, flags: Sequence[str], words: Mapping[str, int]) -> Hand:
    """The program `name`.c; `words` are the 4-byte words of its structs P, S, U and Y."""
    sizes = (4, *(4 * words[k] for k in "PSUY"))
    source = (HAND / f"{name}.c").read_text(encoding="utf-8")
    compiler = find_cross_compiler("gcc")
    image = build_image(source, [(f"hand_{name}", sizes)], compiler, OPTIMISE, flags, ("-lm", "-lc"))
    return Hand(f"hand_{name}", image, sizes)


ATTITUDE_WORDS = {"P": 10, "S": 4, "U": 5, "Y": 1}
CASCADE_WORDS = {"P": 17, "S": 6, "U": 12, "Y": 6}


def flight(steps: int) -> dict[str, NDArray[Any]]:
    """Set-points that jump, a pitch and position that follow, noise on the rate; the integrals held for 20 steps."""
    t = np.arange(steps) * PERIOD
    r = np.random.default_rng(1)
    theta_0, x_0 = 0.1 * np.sign(np.sin(2.0 * t)), 0.2 * np.sign(np.sin(0.7 * t))
    theta = 0.1 * np.sin(2.0 * t - 0.4)
    return {
        "theta0": theta_0,
        "theta": theta,
        "q0": 0.3 * np.sin(3.0 * t),
        "q": 0.2 * np.cos(2.0 * t - 0.4) + r.normal(0.0, 0.02, steps),
        "x0": x_0,
        "x": 0.2 * np.sin(0.7 * t - 0.6),
        "v": 0.14 * np.cos(0.7 * t - 0.6),
        "v0": 0.1 * np.sin(t),
        "thrust": np.full(steps, 0.4),
        "M_open": np.zeros(steps),
        "reset": np.arange(steps) < 20,
    }


def attitude_inputs(steps: int) -> dict[str, NDArray[Any]]:
    """Return inputs of the template attitude_control."""
    f = flight(steps)
    named = {"theta_0": f["theta0"], "q_0": f["q0"], "theta": f["theta"], "q": f["q"], "FLAG_RESET_INT": f["reset"]}
    return {**named, "FLAG_ATTITUDE_ENABLED": np.full(steps, True)}


def cascade_inputs(steps: int, mode: str) -> dict[str, NDArray[Any]]:
    """Return inputs of the whole cascade."""
    f = flight(steps)
    rest = {k: v for k, v in f.items() if k != "reset"}
    return {"mode": np.full(steps, MODES.index(mode), np.int32), "in_reset": f["reset"], **rest}


def compiled(diagram: Diagram, compiler: str = "gcc", optimise: str = OPTIMISE) -> CompiledProgram:
    """Compile the diagram in float32."""
    program = build(diagram, PERIOD, "float32", target="cortex-m7", compiler=compiler, optimise=optimise)
    if not isinstance(program, CompiledProgram):
        raise CompileError("the diagram was not compiled", diagram.name, "install gcc-arm-none-eabi")
    return program


def bytes_apart(program: CompiledProgram) -> int:
    """Flash of the step without its elementary functions, put beside it as those of libm are beside the hand's."""
    source = program.emitted.source.replace("static real td_", "__attribute__((noinline)) real td_")
    (backend,) = CortexM7("gcc", OPTIMISE).compile([replace(program.emitted, source=source)])
    usage, functions = Usage(backend.processor.image), re.findall(r"(?m)^__attribute__.* (td_\w+)\(", source)
    return usage.sizes([f"{program.flat.name}_step"]).flash - usage.sizes(functions).flash


def rows(program: CompiledProgram, inputs: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
    """The inputs as structs U."""
    u = np.zeros(len(next(iter(inputs.values()))), program.dtypes["U"])
    for name, values in inputs.items():
        u[name] = values
    return u


def difference(program: CompiledProgram, peer: Hand, inputs: Mapping[str, NDArray[Any]]) -> tuple[float, str]:
    """Largest difference of an output over its largest value, and which output."""
    u = rows(program, inputs)
    theirs, _, _ = peer.run(u, program.dtypes["Y"])
    ours = program.machine().run(len(u), inputs)
    worst = (0.0, "none")
    for name, mine in ours.items():
        gap = np.abs(mine.astype(float) - theirs[name].astype(float)).max()
        worst = max(worst, (float(gap / max(np.abs(mine).max(), 1e-30)), name))
    return worst


def beside(
    title: str,
    diagram: Diagram,
    peer: str,
    words: Mapping[str, int],
    inputs: Mapping[str, NDArray[Any]],
    sized: bool = True,
) -> list[Figure]:
    """Ours, the one by hand with plain -O2 and with contraction off, their ratio, bytes (if `sized`) and difference."""
    steps = len(next(iter(inputs.values())))
    program = compiled(diagram)
    ours = measure(program, steps, inputs)
    plain, unfused = (hand(peer, flags, words) for flags in (PLAIN, UNFUSED))
    u = rows(program, inputs)
    _, counts, stack = plain.run(u, program.dtypes["Y"])
    _, fewer, _ = unfused.run(u, program.dtypes["Y"])
    gap, where = difference(program, plain, inputs)
    ours_mean, hand_mean, unfused_mean = (float(c.mean()) for c in (ours.instructions, counts, fewer))
    return [
        Figure(f"{title}: compiled", ours_mean, "instructions/step", remark=f"at most {ours.instructions.max()}"),
        Figure(f"{title}: by hand", hand_mean, "instructions/step", remark=f"at most {counts.max()}; plain {OPTIMISE}"),
        Figure(
            f"{title}: compiled over by hand",
            ours_mean / hand_mean,
            "",
            OF_HAND,
            at_most=True,
            remark=f"{ours_mean / unfused_mean:.3g} if both have {' '.join(UNFUSED)}",
        ),
        *(sizes(title, program, ours, plain, stack) if sized else ()),
        Figure(f"{title}: difference", gap, "of largest value", AGREEMENT, at_most=True, remark=f"largest in {where}"),
    ]


def sizes(title: str, program: CompiledProgram, ours: CortexM7Report, plain: Hand, stack: int) -> Iterator[Figure]:
    """Bytes of ours and of the one by hand, whose steps used `stack`."""
    library = plain.other_bytes() - hand("attitude", PLAIN, ATTITUDE_WORDS).other_bytes()
    step, apart = Usage(plain.image).sizes([f"{plain.name}_step"]).flash, bytes_apart(program)
    own = f"with init and so on {ours.flash}; RAM {ours.ram}, stack {ours.stack_seen} (bound {ours.stack})"
    hand_own = f"with init and so on {plain.own_bytes()}, libm {library} on top; RAM {sum(plain.sizes[1:])}"
    beside_it = f"{apart} bytes and {step}, without elementary functions and libm"
    both = f"; with them {ours.step.flash} and {step + library}" if library else ""
    over = f"{title}: flash of the step over by hand"
    yield Figure(f"{title}: compiled, step", ours.step.flash, "bytes of flash", remark=own)
    yield Figure(f"{title}: by hand, step", step, "bytes of flash", remark=f"{hand_own}, stack {stack}")
    yield Figure(over, apart / step, "", OF_HAND_BYTES, at_most=True, remark=beside_it + both)


def others(steps: int) -> list[Figure]:
    """The same diagram by other compilers and options, and the whole flight core."""
    made = []
    inputs = attitude_inputs(steps)
    for compiler, optimise in (("gcc", "-Os"), ("zig", "-O2")):
        r = measure(compiled(starter("stock-attitude"), compiler, optimise), steps, inputs)
        remark = f"step {r.step.flash} bytes of flash, with init and so on {r.flash}"
        name = f"attitude, {r.compiler} {optimise}: compiled"
        made.append(Figure(name, float(r.instructions.mean()), "instructions/step", remark=remark))
    f = flight(steps)
    sensed = {"acc_x": 9.81 * np.sin(f["theta"]), "acc_z": -9.81 * np.cos(f["theta"]), "gyro_y": f["q"]}
    ranged = {"dist": 0.5 + f["x"], "dist_new": np.arange(steps) % 8 == 0, "dist_age": np.full(steps, 0.02)}
    mode = {"mode": np.full(steps, MODES.index("position"), np.int32), "in_reset": f["reset"], "x0": f["x0"]}
    r = measure(compiled(core()), steps, {**sensed, **ranged, **mode})
    remark = f"at most {r.instructions.max()}; flash {r.flash}, RAM {r.ram}, stack {r.stack} bytes"
    name = "whole flight core in position mode: compiled"
    made.append(Figure(name, float(r.instructions.mean()), "instructions/step", remark=remark))
    return made


def run(quick: bool) -> list[Figure]:
    """The figures; without tool chain or emulator one that says what is missing."""
    try:
        compiler = find_cross_compiler("gcc")
        find_emulator()
    except CompileError as error:
        return [Figure("not measured", 0.0, "", remark=str(error))]
    steps = 50 if quick else STEPS
    said = subprocess.run([*compiler.command, "--version"], capture_output=True, text=True, timeout=60, check=True)
    inputs = attitude_inputs(steps)
    figures = beside("attitude", starter("stock-attitude"), "attitude", ATTITUDE_WORDS, inputs)
    for mode in MODES:
        inputs, title = cascade_inputs(steps, mode), f"whole cascade, mode {mode}"
        figures += beside(title, cascade(), "cascade", CASCADE_WORDS, inputs, sized=mode == MODES[-1])
    about = f"float32, {said.stdout.partition(chr(10))[0]}, counted by QEMU's icount"
    return [*figures, *others(steps), Figure("steps", steps, "", remark=about)]
