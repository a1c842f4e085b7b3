"""The Cramer-Rao bound of a flight on a virtual rig: with the gusts, vibration and white noise that the rig really has.

The noise of all samples together is normal: y = f(p) + H gust + e. With its covariance R the information is
J' R^-1 J (Ljung, System Identification, section 7.4). In a closed loop the input is taken as it came: what is not
explained by the past is the same innovation. What the structure knows of the machine before a flight
(`Structure.prior`) counts as information, as it does in the fit.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, toeplitz

from twodof.experiment.expected_accuracy import gyro_covariance, pushed_rate, rail_covariance
from twodof.identify.problem import Problem
from twodof.identify.record import Record
from twodof.models.structure import Structure

Array = NDArray[np.float64]


def pitch_information(
    structure: Structure,
    unknowns: Sequence[str],
    values: Mapping[str, float],
    record: Record,
    rig: Mapping[str, float],
    prior: Mapping[str, tuple[float, float]] | None = None,
) -> Array:
    """The information (unknowns, unknowns) that q of `record` and the `prior` hold on a rig with these parameters."""
    steps, dt = record.steps, record.dt
    spread = toeplitz(pushed_rate(values, steps, dt), np.zeros(steps))
    keep = np.exp(-dt / rig["gust_time"])
    gust = (rig["gust"] / rig["inertia"]) ** 2 * keep ** np.arange(steps)
    covariance = spread @ toeplitz(gust) @ spread.T + toeplitz(gyro_covariance(rig, steps, dt))
    seen = np.rint(record.outputs["q"].position).astype(int)
    covariance = covariance[np.ix_(seen, seen)]
    return _information(structure, unknowns, values, record, "q", covariance, prior)


def rail_information(
    structure: Structure,
    unknowns: Sequence[str],
    values: Mapping[str, float],
    record: Record,
    rig: Mapping[str, float],
    prior: Mapping[str, tuple[float, float]],
) -> Array:
    """The information that the range in `record` and the `prior` hold, its input q with the gyro's noise."""
    covariance = rail_covariance(rig, values, record.outputs["x"].position, record.steps, record.dt)
    return _information(structure, unknowns, values, record, "x", covariance, prior)


def _information(
    structure: Structure,
    unknowns: Sequence[str],
    values: Mapping[str, float],
    record: Record,
    output: str,
    covariance: Array,
    prior: Mapping[str, tuple[float, float]] | None,
) -> Array:
    problem = Problem(structure, [record], unknowns, values, {}, prior=prior)
    problem.set_noise({output: 1.0})
    rows = problem.central_jacobian(problem.x0)
    jacobian, known = rows[: problem.size], rows[problem.size :]
    return np.asarray(jacobian.T @ cho_solve(cho_factor(covariance), jacobian) + known.T @ known)
