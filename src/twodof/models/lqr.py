"""LQR: state feedback of the pitch axis with the moments under way as states, and an integral; gains by Riccati."""

from dataclasses import dataclass
from math import radians

import numpy as np
from numpy.typing import NDArray

from twodof.errors import ParameterError
from twodof.models.lti import DelayedStateSpace
from twodof.models.plant import PAPER_PITCH_RATE, PitchRate
from twodof.signals import PERIOD

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LqrGains:
    """M = -state . x - integral * (sum of T y) - history . (M of the steps before, the latest first).

    `state` (n,) are the gains on the plant's states. `history` are those on the past moments that have not yet reached
    the plant, as many as the delay has steps. `integral` is the gain on the backward-Euler integral of the output y.
    """

    state: tuple[float, ...]
    integral: float
    history: tuple[float, ...]


def lqr(
    plant: DelayedStateSpace, output: int, largest: tuple[float, ...], largest_integral: float, largest_moment: float
) -> LqrGains:
    """Return the LQR gains on the states, on the integral of one output and on the moments within the delay.

    They minimise the sum of (x_i / largest_i)^2 + (integral / largest_integral)^2 + (M / largest_moment)^2 over the
    samples. Each weight is one over the square of an acceptable value (Bryson's rule), 0 if that is infinite.
    `plant` has one input and its states as outputs; `output` is the index of the integrated one. It is sampled every
    4 ms. Its delayed inputs become states, so that the feedback predicts over the delay. See Astrom and Wittenmark,
    Computer-Controlled Systems, sec. 2.3 and 11.4. Raises ParameterError if no feedback stabilises the plant with the
    integral.
    """
    from scipy.linalg import solve_discrete_are  # imported late: most commands start without it

    a, b, c, _ = plant.zero_order_hold(PERIOD).augmented()
    n, size = len(plant.a), len(a)
    y = c[output]
    # The integral of a step has that step's own sample in it, as the controller's has: I' = I + T y'.
    phi = np.block([[a, np.zeros((size, 1))], [PERIOD * (y @ a), np.ones((1, 1))]])
    gamma = np.vstack([b, [PERIOD * (y @ b)]])
    weights = np.zeros(size + 1)
    weights[:n] = 1.0 / np.square(largest)
    weights[-1] = 1.0 / largest_integral**2
    moment = np.array([[1.0 / largest_moment**2]])
    try:
        cost = solve_discrete_are(phi, gamma, np.diag(weights), moment)
    except np.linalg.LinAlgError as reason:
        raise _unstable(str(reason)) from reason
    gains = np.linalg.solve(moment + gamma.T @ cost @ gamma, gamma.T @ cost @ phi)[0]
    radius = float(np.abs(np.linalg.eigvals(phi - gamma @ gains[None])).max())
    # A mode that the moment does not reach stays on the unit circle, up to rounding.
    if not radius < 1.0 - 1e-6:
        raise _unstable(f"a pole stays at {radius:.9g}")
    return LqrGains(tuple(gains[:n].tolist()), float(gains[-1]), tuple(gains[n:size].tolist()))


def attitude_lqr(plant: PitchRate = PAPER_PITCH_RATE) -> LqrGains:
    """Return gains on theta, q and the integral of theta, weighted by 5 deg, 2 rad/s, .3 rad s and a moment of .1."""
    return lqr(plant.state_space(), 0, (radians(5.0), 2.0), 0.3, 0.1)


def rate_lqr(plant: PitchRate = PAPER_PITCH_RATE) -> LqrGains:
    """Return gains on q and its integral, weighted by 1 rad/s, .2 rad and a moment of .06.

    The plant's spring is left out: with it no constant moment holds a rate, and no feedback stabilises both q and its
    integral.
    """
    rigid = DelayedStateSpace.of([[0.0]], [plant.mu], [[1.0]], [[0.0]], plant.tau)
    return lqr(rigid, 0, (1.0,), 0.2, 0.06)


def _unstable(why: str) -> ParameterError:
    return ParameterError(
        f"no state feedback stabilises the plant with the integral of its output: {why}",
        "lqr",
        "choose an output whose integral the input can move",
    )


def kalman_gain(a: Array, c: Array, push: Array, noise: Array, cross: Array | None = None) -> Array:
    """Return the gain with which a stable steady-state predictor corrects the states by its errors.

    `push` is the covariance of what moves the states x' = a x, `noise` that of the outputs c x, `cross` that between
    the two. Raises LinAlgError where there is no such gain.
    """
    from scipy.linalg import solve_discrete_are  # imported late: most commands start without it

    both = np.zeros((len(a), len(c))) if cross is None else cross
    spread = solve_discrete_are(a.T, c.T, push, noise, s=both)
    return np.asarray((a @ spread @ c.T + both) @ np.linalg.inv(c @ spread @ c.T + noise))
