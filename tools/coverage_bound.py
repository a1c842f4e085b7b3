"""The Cramer-Rao bound of a flight on a virtual rig: with the gusts, vibration and white noise that the rig really has.

The noise of all samples together is normal: y = f(p) + H gust + e. With its covariance R the information is
J' R^-1 J (Ljung, System Identification, section 7.4). In a closed loop the input is taken as it came: what is not
explained by the past is the same innovation. What the structure knows of the machine before a flight
(`Structure.prior`) counts as information, as it does in the fit.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, expm, toeplitz
from scipy.signal import lfilter

from twodof.identify.problem import Problem
from twodof.identify.record import Record
from twodof.models.structure import Structure

Array = NDArray[np.float64]


def pitch_information(
    structure: Structure, unknowns: Sequence[str], values: Mapping[str, float], record: Record, rig: Mapping[str, float]
) -> Array:
    """The information (unknowns, unknowns) that q of `record` holds on a rig with these parameters."""
    steps, dt = record.steps, record.dt
    a = np.array([[0.0, 1.0], [-(values["w_n"] ** 2), -2.0 * values["xi"] * values["w_n"]]])
    step = expm(dt * np.block([[a, np.array([[0.0], [1.0]])], [np.zeros((1, 3))]]))
    response, state = np.zeros(steps), step[:2, 2]
    for k in range(1, steps):
        response[k], state = state[1], step[:2, :2] @ state
    spread = toeplitz(response, np.zeros(steps))
    keep = np.exp(-dt / rig["gust_time"])
    gust = (rig["gust"] / rig["inertia"]) ** 2 * keep ** np.arange(steps)
    covariance = spread @ toeplitz(gust) @ spread.T + toeplitz(gyro_covariance(rig, steps, dt))
    seen = np.rint(record.outputs["q"].position).astype(int)
    covariance = covariance[np.ix_(seen, seen)]
    return _information(structure, unknowns, values, record, "q", covariance)


def rail_information(
    structure: Structure,
    unknowns: Sequence[str],
    values: Mapping[str, float],
    record: Record,
    rig: Mapping[str, float],
    prior: Mapping[str, tuple[float, float]],
) -> Array:
    """The information that the range in `record` and the `prior` hold, its input q with the gyro's noise."""
    steps, dt = record.steps, record.dt
    k_v, p_v = values["k_v"], values["p_v"]
    t = dt * np.arange(steps)
    # A sample's error turns the pitch by `dt` for good: v' = -k_v dt - p_v v.
    late = np.maximum(t - values["tau"], 0.0)
    moved = -k_v * dt * (late / p_v + np.expm1(-p_v * late) / p_v**2)
    position = record.outputs["x"].position
    age = position[:, None] - np.arange(steps)[None, :]
    spread = np.where(age > 0.0, np.interp(age, np.arange(steps), moved), 0.0)
    covariance = spread @ toeplitz(gyro_covariance(rig, steps, dt)) @ spread.T
    covariance += (rig["tof_noise"] ** 2 + rig["tof_step"] ** 2 / 12.0) * np.eye(position.size)
    return _information(structure, unknowns, values, record, "x", covariance, prior)


def gyro_covariance(rig: Mapping[str, float], steps: int, dt: float) -> Array:
    """Autocovariance (steps,) of the gyro in hover: white noise, rounding, and vibration in a band (`rig.sensors`)."""
    radius, turn = rig["vibration_r2"], (1.0 + rig["vibration_r2"]) * np.cos(2.0 * np.pi * rig["vibration_hz"] * dt)
    pulse = np.zeros(steps + 2000)
    pulse[0] = np.sqrt(0.5 * (1.0 - radius))
    band = lfilter([1.0, 0.0, -1.0], [1.0, -turn, radius], pulse)
    covariance = np.array([band[: pulse.size - k] @ band[k:] for k in range(min(steps, 400))])
    full = np.zeros(steps)
    full[: covariance.size] = rig["gyro_hover"] ** 2 * covariance
    full[0] += rig["gyro_idle"] ** 2 + rig["gyro_step"] ** 2 / 12.0
    return full


def _information(
    structure: Structure,
    unknowns: Sequence[str],
    values: Mapping[str, float],
    record: Record,
    output: str,
    covariance: Array,
    prior: Mapping[str, tuple[float, float]] | None = None,
) -> Array:
    problem = Problem(structure, [record], unknowns, values, {}, prior=prior)
    problem.set_noise({output: 1.0})
    rows = problem.central_jacobian(problem.x0)
    jacobian, known = rows[: problem.size], rows[problem.size :]
    return np.asarray(jacobian.T @ cho_solve(cho_factor(covariance), jacobian) + known.T @ known)
