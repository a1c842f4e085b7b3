"""One grey-box fit of G_q with fractional delay to 1500 samples, beside scipy's least squares on two simulations."""

from collections.abc import Callable
from functools import partial
from typing import Any

import control
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.signal import lfilter

from bench.measure import Figure, one_core, timed
from twodof.identify import Record, fit
from twodof.identify.record_simulator import program_of
from twodof.models import pitch_rate

MILLISECONDS = 20.0
SAMPLES, DT = 1500, 0.004
NOISE = 0.06
TRUE = {"w_n": 3.437, "xi": 0.0836, "mu": 358.5, "tau": 0.0183, "theta_0": 0.01, "q_0": 0.05}
GUESS = {"w_n": 5.0, "xi": 0.2, "mu": 250.0, "tau": 0.012, "theta_0": 0.0, "q_0": 0.0}
SCALE = (1.0, 0.1, 100.0, 0.01, 0.1, 1.0)
AGREE = 1e-2
"""Largest difference between the two minima of the same problem, in standard deviations of the estimate.

Both stop where another step changes little: ours below .05 standard deviations, and then by what is left of a
quadratic convergence.
"""

Array = NDArray[np.float64]
Simulation = Callable[[Array], Array]


def doublets(samples: int) -> Array:
    """Doublets of 0.6 s and .03 from 0.4 s on, every 2 s, shape (samples,)."""
    t = DT * np.arange(samples) % 2.0
    return 0.03 * (((t >= 0.4) & (t < 0.7)).astype(float) - ((t >= 0.7) & (t < 1.0)))


def exact(u: Array, values: Array) -> Array:
    """q of G_q with an exact zero-order hold, the step split at the delay's edge, as one digital filter (scipy)."""
    w_n, xi, mu, tau, theta_0, q_0 = values
    a = np.array([[0.0, 1.0, 0.0], [-(w_n**2), -2.0 * xi * w_n, mu], [0.0, 0.0, 0.0]])
    whole = int(tau / DT)
    part = tau - whole * DT
    full, late = expm(a * DT), expm(a * (DT - part))
    phi = full[:2, :2]
    new, old = late[:2, 2], full[:2, 2] - late[:2, 2]
    trace, determinant = phi[0, 0] + phi[1, 1], phi[0, 0] * phi[1, 1] - phi[0, 1] * phi[1, 0]
    denominator = [1.0, -trace, determinant]

    def numerator(b: Array) -> Array:
        # Second row of adj(z I - phi) b, over z^2.
        return np.array([0.0, b[1], phi[1, 0] * b[0] - phi[0, 0] * b[1]])

    held = np.concatenate((np.full(whole + 1, u[0]), u))
    forced = lfilter(numerator(new), denominator, held[1 : 1 + u.size]) + lfilter(
        numerator(old), denominator, held[: u.size]
    )
    impulse = np.zeros(u.size)
    impulse[0] = 1.0
    # q of x[k] = phi^k x[0]: z times the transfer from an impulse in x.
    free = lfilter([q_0, phi[1, 0] * theta_0 - phi[0, 0] * q_0], denominator, impulse)
    return np.asarray(forced + free)


def sampled(u: Array, values: Array) -> Array:
    """The same in python-control: the sampled model, the input shifted by linear interpolation."""
    w_n, xi, mu, tau, theta_0, q_0 = values
    plant = control.ss([[0.0, 1.0], [-(w_n**2), -2.0 * xi * w_n]], [[0.0], [mu]], [[0.0, 1.0]], [[0.0]])
    time = DT * np.arange(u.size)
    shifted = np.interp(time - tau, time, u)
    response = control.forced_response(control.c2d(plant, DT), time, shifted, [theta_0, q_0])
    return np.asarray(response.outputs)


def peer(simulation: Callable[[Array, Array], Array], u: Array, q: Array) -> Array:
    """scipy's Levenberg-Marquardt on that simulation from `GUESS`; the parameters found."""

    def residual(x: Array) -> Array:
        return simulation(u, x) - q

    found: Any = least_squares(residual, list(GUESS.values()), method="lm", x_scale=SCALE)
    return np.asarray(found.x)


def run(quick: bool = False) -> list[Figure]:
    """All figures; `quick` only shows that everything runs."""
    samples, repeats = (400, 1) if quick else (SAMPLES, 21)
    u = doublets(samples)
    q = exact(u, np.array(list(TRUE.values()))) + NOISE * np.random.default_rng(1).standard_normal(samples)
    record = Record.from_columns(DT * np.arange(samples), {"M": u, "q": q}, ["M"], ["q"])
    structure = pitch_rate().with_guess(**GUESS)
    program_of(structure, record.dt)
    wanted = tuple(TRUE)
    with one_core():
        (ours,) = timed([partial(fit, structure, record, estimate=wanted)], repeats)
        filters, responses = timed([partial(peer, exact, u, q), partial(peer, sampled, u, q)], 1 if quick else 3)
    found, theirs = fit(structure, record, estimate=wanted), peer(exact, u, q)
    gap = max(float(abs(found[name] - x) / found.sigma(name)) for name, x in zip(wanted, theirs, strict=True))
    error = max(abs(found[name] - TRUE[name]) / found.sigma(name) for name in wanted)
    return [
        Figure(
            f"grey-box fit, {samples} samples, 6 unknowns",
            1e3 * ours.median,
            "ms",
            MILLISECONDS,
            at_most=True,
            remark=f"best {1e3 * ours.best:.2f} ms; with covariance, residual tests; {found.iterations} iterations; "
            f"at most {error:.1f} sigma from the truth",
        ),
        Figure(
            "scipy least_squares, same model by expm and lfilter",
            1e3 * filters.median,
            "ms",
            remark="estimate only, numerical Jacobian",
        ),
        Figure(
            "scipy least_squares on python-control's forced_response",
            1e3 * responses.median,
            "ms",
            remark="estimate only; the delay by interpolating the input",
        ),
        Figure("fit over scipy with lfilter", filters.median / ours.median, "times as fast", 1.0),
        Figure("difference to scipy's minimum", gap, "sigma", AGREE, at_most=True, remark="both minimise one sum"),
    ]
