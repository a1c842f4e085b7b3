"""Margins of 50 random loops by three programs: this one, python-control and Octave (its package control).

Stable and unstable in open loop, resonant, with integrators, sampled with delays. What the others find must be among
our crossings with the same figure. Octave is not a Python package: without it its lines say how it is installed.
"""

import math
import os
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import tf2ss

from bench.computing.random_loops import COUNT, RandomLoop, random_loop
from bench.measure import Figure, one_core, timed
from twodof.design import LoopMargins, LoopTransfer, margins

PEERS = Path(__file__).with_name("peers")
SAME = 1e-5
"""Share by which figures may differ: the others work with polynomials, which lose half of the digits."""

WAIT_S = 300.0


def ours(loop: RandomLoop) -> LoopMargins:
    """Our margins of a loop."""
    a, b, c, d = tf2ss(loop.numerator, loop.denominator)
    return margins(LoopTransfer(a, b, c, float(d[0, 0]), loop.dt))


def by_control(loop: RandomLoop) -> Any:
    """All that python-control's stability_margins finds: factors, phases [deg], distances, and where."""
    import control  # imported here: it takes seconds

    system = control.tf(loop.numerator, loop.denominator, 0 if loop.dt is None else loop.dt)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return control.stability_margins(system, returnall=True, method="poly")


def near(value: float, others: Iterable[float]) -> bool:
    """Return True if one of `others` equals `value`."""
    return any(math.isclose(value, one, rel_tol=SAME, abs_tol=SAME) for one in others)


def inside(loop: RandomLoop, omega: float) -> bool:
    """Return True for a frequency above 0 and below Nyquist's: rounding decides if polynomials have a root there."""
    top = math.inf if loop.dt is None else math.pi / loop.dt
    return 1e-6 < omega < top * (1.0 - 1e-6)


def agrees_with_control(loop: RandomLoop, mine: LoopMargins, theirs: Any) -> bool:
    """Return True if both find the same crossings."""
    factors, phases, _, at_gain, at_phase, _ = theirs
    gains = [(f, w) for f, w in zip(factors, at_gain, strict=True) if inside(loop, w) and f < 1e4]
    turns = [(p, w) for p, w in zip(phases, at_phase, strict=True) if inside(loop, w)]
    own = [g for g in mine.gains if inside(loop, g.omega)]
    return (
        len(own) == len(gains)
        and len(mine.phases) == len(turns)
        and all(near(f, [g.factor]) and near(w, [g.omega]) for (f, w), g in zip(gains, own, strict=True))
        and all(
            near(p, [math.degrees(q.phase)]) and near(w, [q.omega])
            for (p, w), q in zip(turns, mine.phases, strict=True)
        )
    )


def agrees_with_octave(loop: RandomLoop, mine: LoopMargins, row: Sequence[float]) -> bool:
    """Return True if Octave's margins are among our crossings, and its verdict and Ms equal ours."""
    gamma, phi, at_gain, at_phase, stable, ms, _ = row
    gain = not inside(loop, at_gain) or near(gamma, [g.factor for g in mine.gains if near(at_gain, [g.omega])])
    here = [math.degrees(p.phase) for p in mine.phases if near(at_phase, [p.omega])]
    phase = not inside(loop, at_phase) or near(phi % 360.0, [angle % 360.0 for angle in here])
    return gain and phase and mine.stable == bool(stable) and (not stable or near(ms, [mine.ms]))


def octave(loops: Sequence[RandomLoop]) -> list[list[float]] | str:
    """Return Octave's row of figures for each loop, or the reason why there are none."""
    program = shutil.which("octave-cli")
    if program is None:
        return "octave-cli is not here: apt-get install octave octave-control"
    widest = max(len(loop.numerator) + len(loop.denominator) for loop in loops)
    rows = np.zeros((len(loops), 3 + widest))
    for row, loop in zip(rows, loops, strict=True):
        parts = [[loop.dt or 0.0, len(loop.numerator), len(loop.denominator)], loop.numerator, loop.denominator]
        numbers = np.concatenate([np.asarray(part, dtype=float) for part in parts])
        row[: numbers.size] = numbers
    with tempfile.TemporaryDirectory() as folder:
        np.savetxt(Path(folder, "loops.txt"), rows, fmt="%.17g")
        command = [program, "--no-gui", "--quiet", str(PEERS / "margins.m")]
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
        try:
            done = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, timeout=WAIT_S, env=environment, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            return f"{program} failed: {error}"
        file = Path(folder, "octave.txt")
        if not file.is_file():
            return f"{program} gave no result: {(done.stderr or done.stdout).strip()[-200:]}"
        numbers = np.array([float(one) for one in file.read_text().split()])
    return [list(row) for row in numbers.reshape(len(loops), 7)]


def run(quick: bool = False) -> list[Figure]:
    """All figures; `quick` only shows that everything runs, on five loops and without Octave."""
    loops = [random_loop(seed) for seed in range(5 if quick else COUNT)]
    count = len(loops)
    with one_core():
        mine, controls = timed(
            [lambda: [ours(loop) for loop in loops], lambda: [by_control(loop) for loop in loops]], 1 if quick else 3
        )
    found = [ours(loop) for loop in loops]
    same = sum(agrees_with_control(*pair, by_control(pair[0])) for pair in zip(loops, found, strict=True))
    figures = [
        Figure("twodof, a loop", 1e3 * mine.median / count, "ms", remark="crossings, peaks, disk margin, poles"),
        Figure("python-control, a loop", 1e3 * controls.median / count, "ms", remark="crossings and distances only"),
        Figure("all crossings as python-control's", same, f"of {count} loops", count),
    ]
    told = "quick: left out" if quick else octave(loops)
    if isinstance(told, str):
        print(f"Octave is left out: {told}", file=sys.stderr)
        return figures
    agree = sum(agrees_with_octave(*three) for three in zip(loops, found, told, strict=True))
    return [
        *figures,
        Figure("Octave, a loop", 1e3 * told[0][6], "ms", remark="margin, isstable, norm of S"),
        Figure("margins, stability and Ms as Octave's", agree, f"of {count} loops", count),
    ]
