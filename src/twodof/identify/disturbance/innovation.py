"""A linear model in innovation form: a predictor that corrects its states by what it mispredicted.

x[k+1] = Phi x[k] + Gamma u[k] + K e[k], y[k] = C x[k] + D u[k] + e[k], with the gains K found along with the unknowns.
It is a prediction error method (Ljung, System Identification, sections 4.3 and 7.4; ssest and greyest of MATLAB). The
predictor is stable although the plant is not, and it holds in closed loop as in open loop.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twodof.compile.linear.linear_model import LinearModel
from twodof.compile.linear.linearize import linearize
from twodof.errors import DiagramError
from twodof.identify.problem import Problem
from twodof.identify.record import Record
from twodof.models.structure import Structure

Array = NDArray[np.float64]

_RATIOS = (1.0, 1e-2, 1e2)
"""Variance of the push at the inputs over that of the input itself, with which the first gains are computed."""


def can_predict(structure: Structure, records: Sequence[Record]) -> bool:
    """Return True if `structure` has an innovation form and each record held inputs, and outputs at each step."""
    return structure.predictor is not None and not any(
        record.hold
        or name not in record.outputs
        or not record.outputs[name].on_grid
        or record.outputs[name].value.size < record.steps
        for record in records
        for name in structure.outputs
    )


def with_measured(structure: Structure, record: Record) -> Record:
    """Return the record with its outputs as further inputs."""
    measured = {f"{name}_measured": record.outputs[name].value for name in structure.outputs}
    return replace(record, inputs={**record.inputs, **measured})


def is_unstable(structure: Structure, values: dict[str, float], dt: float) -> bool:
    """Return True if the plant has a pole outside the unit circle."""
    model = _linear(structure, values, dt)
    return model is not None and bool(np.abs(model.poles()).max() > 1.0)


def first_gains(structure: Structure, record: Record, values: dict[str, float]) -> list[dict[str, float]]:
    """Return steady-state Kalman gains for pushes of several sizes at the inputs, as far as there are such gains."""
    from scipy.linalg import solve_discrete_are  # imported late: most commands start without it

    model, found = _linear(structure, values, record.dt), list[dict[str, float]]()
    if model is None:
        return found
    moves = np.array([float(record.inputs[name].std()) or 1.0 for name in structure.inputs])
    noise = np.diag([0.01 * float(record.outputs[name].value.var()) + 1e-12 for name in structure.outputs])
    for ratio in _RATIOS:
        push = ratio * (model.b * moves**2) @ model.b.T
        push += 1e-9 * np.trace(push) * np.eye(push.shape[0])
        try:
            spread = solve_discrete_are(model.a.T, model.c.T, push, noise)
        except (np.linalg.LinAlgError, ValueError):
            continue
        gain = model.a @ spread @ model.c.T @ np.linalg.inv(model.c @ spread @ model.c.T + noise)
        if np.isfinite(gain).all():
            found.append({f"K_{i + 1}_{j + 1}": float(gain[i, j]) for i, j in np.ndindex(gain.shape)})
    return found


def without_gains(jacobian: Array, wanted: int) -> Array:
    """Return the sensitivities of the first `wanted` unknowns less what the gains behind them explain."""
    own, gains = jacobian[:, :wanted], jacobian[:, wanted:]
    return np.asarray(own - gains @ np.linalg.lstsq(gains, own, rcond=None)[0])


def _linear(structure: Structure, values: dict[str, float], dt: float) -> LinearModel | None:
    """Return the sampled plant; None if its numbers overflow in a step."""
    try:
        return linearize(structure.diagram, dt / structure.substeps, at=values, time="discrete", keep_all=True)
    except DiagramError:
        return None


def gains_of(problem: Problem, x: Array) -> dict[str, float]:
    """Return the gains of a predictor's problem at x."""
    return {
        n: value for n, value in problem.values(x, 0).items() if n.startswith("K_") and n in problem.structure.estimate
    }
