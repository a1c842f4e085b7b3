"""One linear output error fit by four programs: this one, scipy, Octave (leasqr of its package optim) and sippy.

y = (b1 z^-1 + b2 z^-2) / (1 + f1 z^-1 + f2 z^-2) u + e, 1500 samples, from one first guess. Octave and sippy are not
Python packages that the benchmarks can ask for: without them their lines say how they are installed.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import lfilter

from bench.measure import Figure, one_core, timed
from twodof.identify import Estimate, Record, fit, subspace
from twodof.models import linear_model

SAMPLES, NOISE = 1500, 0.3
TRUE = {"f1": -1.8151, "f2": 0.9025, "b1": 0.1, "b2": 0.05}
GUESS = {"f1": -1.6, "f2": 0.8, "b1": 0.05, "b2": 0.05}
PEERS = Path(__file__).with_name("peers")
WAIT_S = 120.0
AGREE = 0.02
"""Largest difference between the minima of one sum that two programs find, in standard deviations of the estimate."""

Array = NDArray[np.float64]


def data(samples: int = SAMPLES) -> tuple[Array, Array]:
    """Input and output."""
    generator = np.random.default_rng(0)
    u = np.repeat(np.sign(generator.standard_normal(samples // 3 + 1)), 3)[:samples]
    return u, response(u, np.array(list(TRUE.values()))) + NOISE * generator.standard_normal(samples)


def response(u: Array, values: Array) -> Array:
    """The model's output, from rest."""
    f1, f2, b1, b2 = values
    return np.asarray(lfilter([0.0, b1, b2], [1.0, f1, f2], u))


def ours(record: Record) -> Estimate:
    """Our fit, with covariance and residual tests."""
    return fit(STRUCTURE, record, estimate=tuple(TRUE))


# Observer form: x1[k+1] = -f1 x1 + x2 + b1 u, x2[k+1] = -f2 x1 + b2 u, y = x1.
STRUCTURE = linear_model(
    [["-f1", 1], ["-f2", 0]], [["b1"], ["b2"]], [[1, 0]], inputs=["u"], outputs=["y"], guess=GUESS, discrete=True
)


def by_scipy(u: Array, y: Array) -> tuple[Array, Array]:
    """scipy's estimates and standard deviations."""
    found: Any = least_squares(lambda x: response(u, x) - y, list(GUESS.values()), method="lm")
    covariance = np.linalg.inv(found.jac.T @ found.jac) * 2.0 * found.cost / (y.size - found.x.size)
    return np.asarray(found.x), np.sqrt(np.diag(covariance))


def peer(command: list[str], answer: str, u: Array, y: Array) -> list[float] | str:
    """The numbers that a program writes into the file `answer`, or why there are none."""
    with tempfile.TemporaryDirectory() as folder:
        np.savetxt(Path(folder, "data.txt"), np.column_stack([u, y]))
        np.savetxt(Path(folder, "start.txt"), list(GUESS.values()))
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
        try:
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=WAIT_S, env=environment)
        except (OSError, subprocess.TimeoutExpired) as error:
            return f"{command[0]} failed: {error}"
        file = Path(folder, answer)
        if not file.is_file():
            return f"{command[0]} gave no result: {(done.stderr or done.stdout).strip()[-200:]}"
        return [float(one) for one in file.read_text().split()]


def told(x: Array, sigma: Array | None = None) -> str:
    """The estimates, with standard deviations if there are any."""
    errors = [""] * len(TRUE) if sigma is None else [f" +- {one:.2g}" for one in sigma]
    return ", ".join(f"{name} {one:.5f}{error}" for name, one, error in zip(TRUE, x, errors, strict=True))


def octave(u: Array, y: Array, x: Array, sigma: Array) -> list[Figure]:
    """Octave's figures beside the estimates `x` and standard deviations `sigma`."""
    program = shutil.which("octave-cli")
    found = (
        peer([program, "--no-gui", "--quiet", str(PEERS / "output_error.m")], "octave.txt", u, y)
        if program
        else "octave-cli is not here: apt-get install octave octave-control octave-optim"
    )
    if isinstance(found, str):
        print(f"Octave is left out: {found}", file=sys.stderr)
        return []
    theirs, errors = np.array(found[:4]), np.array(found[4:8])
    return [
        Figure("Octave leasqr with filter", 1e3 * found[8], "ms", remark=told(theirs, errors)),
        Figure("Octave moen4 (subspace)", 1e3 * found[9], "ms", remark="a start value, no intervals"),
        Figure("difference to Octave's minimum", float(np.abs((theirs - x) / sigma).max()), "sigma", AGREE, True),
        Figure("interval over Octave's", float(np.mean(sigma / errors)), "", remark="mean of the four"),
    ]


def sippy(u: Array, y: Array, x: Array, sigma: Array) -> list[Figure]:
    """sippy's figures beside the estimates `x` and standard deviations `sigma`."""
    program = os.environ.get("TWODOF_SIPPY_PYTHON", "")
    found = (
        peer([program, str(PEERS / "output_error_sippy.py")], "sippy.txt", u, y)
        if program
        else "let TWODOF_SIPPY_PYTHON name a Python with it (pip install sippy_unipi: 700 MB, so none of ours)"
    )
    if isinstance(found, str):
        print(f"sippy is left out: {found}", file=sys.stderr)
        return []
    theirs = np.array(found[:4])
    return [
        Figure("sippy OE by optimisation", 1e3 * found[4], "ms", remark=f"{told(theirs)}; no intervals"),
        Figure("difference to sippy's minimum", float(np.abs((theirs - x) / sigma).max()), "sigma"),
    ]


def run(quick: bool = False) -> list[Figure]:
    """All figures; `quick` only shows that everything runs, without the programs that are not Python's."""
    u, y = data(400 if quick else SAMPLES)
    record = Record.from_columns(np.arange(float(u.size)), {"u": u, "y": y}, ["u"], ["y"])
    found = ours(record)
    x, sigma = found.values, np.array([found.cramer_rao(name) for name in TRUE])
    theirs, errors = by_scipy(u, y)
    with one_core():
        mine, subspaces, scipys = timed(
            [partial(ours, record), partial(subspace, record, order=2), partial(by_scipy, u, y)], 1 if quick else 15
        )
    error = max(abs(one - true) / s for one, true, s in zip(x, TRUE.values(), sigma, strict=True))
    return [
        Figure(
            f"linear fit, {u.size} samples, 4 unknowns",
            1e3 * mine.median,
            "ms",
            remark=f"{told(x, sigma)}; at most {error:.1f} sigma from the truth; with residual tests",
        ),
        Figure("our subspace model", 1e3 * subspaces.median, "ms", remark="a start value, no intervals"),
        Figure("scipy least_squares with lfilter", 1e3 * scipys.median, "ms", remark=told(theirs, errors)),
        Figure("fit over scipy", scipys.median / mine.median, "times as fast", remark="which has no residual tests"),
        Figure("difference to scipy's minimum", float(np.abs((theirs - x) / sigma).max()), "sigma", AGREE, True),
        Figure("interval over scipy's", float(np.mean(sigma / errors)), "", remark="mean of the four"),
        *([] if quick else octave(u, y, x, sigma)),
        *([] if quick else sippy(u, y, x, sigma)),
    ]
