"""The search for the structure's unknowns and the gust that pushed it, in turn, until both stand."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from twodof.identify.disturbance.autoregression import Autoregression
from twodof.identify.disturbance.gust import Gust, GustModel, answers_at_once, impulse_response
from twodof.identify.problem import Problem
from twodof.identify.search.least_squares import LeastSquaresMinimum, minimise

Array = NDArray[np.float64]

_ROUNDS = 5
_STANDS = 0.05


@dataclass(frozen=True, eq=False)
class Pushed:
    """Where a search ended: `models` and `gusts` are in the order of the problem's blocks."""

    minimum: LeastSquaresMinimum
    models: tuple[Autoregression, ...]
    gusts: tuple[Gust, ...]
    jacobian: Array
    prediction_error: Array
    cost: float


def can_be_pushed(problem: Problem, x: Array, sure: bool = False) -> bool:
    """Whether the gust's model exists: one input, one output a record sampled at each step, and a linear structure.

    With `sure`: and whether the structure has the actuator's lag, without which the model is not to be trusted.
    """
    if len(problem.blocks) != len(problem.records):
        return False
    for block in problem.blocks:
        response = impulse_response(problem, x, block.record, block.output)
        if response is None or (sure and answers_at_once(response)):
            return False
    return True


def pushed(problem: Problem, x: Array) -> Pushed:
    """The most likely unknowns under a gust, from the guess `x`."""
    thetas: list[Array | None] = [None] * len(problem.blocks)
    stands = False
    for turn in range(_ROUNDS):
        gusts = [GustModel(problem, x, k, theta) for k, theta in enumerate(thetas)]
        models = tuple(gust.improve(15 if turn else 40) for gust in gusts)
        thetas = [gust.theta for gust in gusts]

        whiten = partial(_whiten, problem, models, [gust.pieces for gust in gusts])
        minimum = minimise(
            partial(_residual, problem, whiten),
            partial(_jacobian, problem, whiten),
            x,
            problem.lower,
            problem.upper,
            tolerance=1e-6,
        )
        jacobian = whiten(problem.central_jacobian(minimum.x))
        moved = float(np.linalg.norm(jacobian @ (minimum.x - x)))
        x = minimum.x
        if moved < _STANDS or not math.isfinite(minimum.cost):
            stands = True
            break
    error = whiten(problem.residual(x))
    logs = sum(model.log_deviations(gust.pieces) for model, gust in zip(models, gusts, strict=True))
    # After the last turn the unknowns moved by less than a fifth of a standard deviation or so in all trials.
    converged = minimum.converged and (stands or moved < 0.5)
    ended = LeastSquaresMinimum(x, error, minimum.cost, minimum.iterations, converged, minimum.at_bound)
    found = tuple(gust.gust for gust in gusts)
    return Pushed(ended, models, found, jacobian, error, 0.5 * float(error @ error) + logs)


def _whiten(
    problem: Problem, models: Sequence[Autoregression], pieces: Sequence[Sequence[slice]], rows: Array
) -> Array:
    parts = zip(models, problem.blocks, pieces, strict=True)
    white = [model.whiten(rows[block.rows], own) for model, block, own in parts]
    return np.concatenate([*white, rows[problem.size :]])


def _residual(problem: Problem, whiten: Callable[[Array], Array], x: Array) -> Array:
    return whiten(problem.residual(x))


def _jacobian(problem: Problem, whiten: Callable[[Array], Array], x: Array, _: Array) -> Array:
    return whiten(problem.jacobian(x, problem.residual(x)))
