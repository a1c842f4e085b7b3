"""One linear output error fit by four programs: this one, scipy, Octave (leasqr of its package optim) and sippy.

y = (b1 z^-1 + b2 z^-2) / (1 + f1 z^-1 + f2 z^-2) u + e, 1500 samples, from one first guess. Then a pitch under random
pushes (process noise): how many 95 % intervals of the default fit hold the truth, beside AeroID's filter error. Octave,
sippy and AeroID are not Python packages that the benchmarks can ask for: without them their lines say how they are
installed.
"""

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
from scipy.linalg import expm
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
PITCH, PITCH_GUESS = {"k": 6.0, "d": 1.0, "mu": 30.0}, {"k": 4.0, "d": 0.5, "mu": 20.0}
SENSORS = np.array([2e-3, 1e-2])
PUSHED, PUSHED_DT, RECORDS, PUSHES = 600, 0.02, 20, (0.05, 0.2)
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


def pushed(records: int, push: float) -> tuple[dict[str, Any], list[Estimate]]:
    """Return records of a pitch under pushes of this density [rad/s2 sqrt(s)], and our default fits of them."""
    a, b = np.array([[0.0, 1.0], [-PITCH["k"], -PITCH["d"]]]), np.array([[0.0], [PITCH["mu"]]])
    both = expm(PUSHED_DT * np.block([[a, b], [np.zeros((1, 3))]]))
    u = 0.1 * np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], PUSHED // 15), 15)
    theta, q, fits = np.zeros((records, u.size)), np.zeros((records, u.size)), []
    rates, eye = [[0, 1], ["-k", "-d"]], [[1, 0], [0, 1]]
    model = linear_model(rates, [[0], ["mu"]], eye, inputs=["M"], outputs=["theta", "q"], guess=PITCH_GUESS)
    time = PUSHED_DT * np.arange(u.size)
    for i in range(records):
        generator, state = np.random.default_rng(100 + i), np.zeros(2)
        for k in range(u.size):
            theta[i, k], q[i, k] = state + SENSORS * generator.standard_normal(2)
            state = both[:2, :2] @ state + both[:2, 2] * u[k]
            state[1] += push * PUSHED_DT**0.5 * generator.standard_normal()
        columns = {"M": u, "theta": theta[i], "q": q[i]}
        fits.append(fit(model, Record.from_columns(time, columns, ["M"], ["theta", "q"])))
    told = {"names": [*PITCH], "guess": [*PITCH_GUESS.values()], "measurement": SENSORS, "push": push}
    return {**told, "dt": PUSHED_DT, "u": u, "theta": theta, "q": q}, fits


def coverage(values: Array, sigma: Array) -> Array:
    """Return how many of the 95 % intervals of each unknown hold the truth."""
    return np.asarray((np.abs(values - [*PITCH.values()]) <= 1.96 * sigma).sum(axis=0))


def aeroid(records: int, push: float) -> list[Figure]:
    """Coverage under pushes, ours beside AeroID's."""
    given, fits = pushed(records, push)
    mine = coverage(
        np.array([[one[n] for n in PITCH] for one in fits]), np.array([[one.sigma(n) for n in PITCH] for one in fits])
    )
    about = f"of {', '.join(PITCH)}, {records} records each, pushes of {push:g} rad/s2 sqrt(s)"
    # Fewer than 16 of 20 are one in 400 for intervals that each hold in 95 %.
    figures = [Figure("our default fit", float(mine.min()), "intervals", 0.8 * records, remark=f"{mine} {about}")]
    program = os.environ.get("TWODOF_AEROID_PYTHON", "")
    if not program:
        print(
            "AeroID is left out: let TWODOF_AEROID_PYTHON name a Python with it (pip install aeroid)", file=sys.stderr
        )
        return figures
    with tempfile.TemporaryDirectory() as folder:
        np.savez(Path(folder, "records.npz"), **given)
        command = [program, str(PEERS / "filter_error_aeroid.py")]
        subprocess.run(command, cwd=folder, check=True, timeout=60.0 * records)
        found = dict(np.load(Path(folder, "aeroid.npz")))
    theirs = coverage(found["values"], found["sigma"])
    remark = f"{theirs} {about}, told the noises; {float(found['seconds']):.2g} s a fit"
    return [*figures, Figure("AeroID, filter error", float(theirs.min()), "intervals", remark=remark)]


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
        *(figure for push in PUSHES for figure in ([] if quick else aeroid(RECORDS, push))),
    ]
