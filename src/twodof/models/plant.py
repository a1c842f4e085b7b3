"""The platform's linear plants by name: pitch rate G_q, velocity G_v, the course's three-state longitudinal model."""

import math
from dataclasses import dataclass

from twodof.errors import ParameterError
from twodof.models.lti import DelayedStateSpace
from twodof.signals import GRAVITY


@dataclass(frozen=True)
class PitchRate:
    """G_q = q / M = mu s exp(-tau s) / (s^2 + 2 xi w_n s + w_n^2), paper equation (5).

    `w_n` [rad/s], `xi` [-], `mu` [rad/s2 per unit of normalised moment], `tau` [s]. States are theta and q, so the
    outputs are theta [rad] and q [rad/s]. Raises ParameterError for w_n <= 0 or tau < 0.
    """

    w_n: float
    xi: float
    mu: float
    tau: float

    def __post_init__(self) -> None:
        if not self.w_n > 0.0:
            raise ParameterError(f"natural frequency {self.w_n} rad/s is not positive", "PitchRate.w_n")
        if not self.tau >= 0.0:
            raise ParameterError(f"delay {self.tau} s is negative", "PitchRate.tau")

    def state_space(self) -> DelayedStateSpace:
        """Return the state space with input M and outputs (theta, q)."""
        return DelayedStateSpace.of(
            [[0.0, 1.0], [-(self.w_n**2), -2.0 * self.xi * self.w_n]],
            [0.0, self.mu],
            [[1.0, 0.0], [0.0, 1.0]],
            [[0.0], [0.0]],
            self.tau,
        )

    @property
    def period(self) -> float:
        """Period of the damped oscillation [s], paper equation (7); NaN when there is none (xi >= 1)."""
        return 2.0 * math.pi / (self.w_n * math.sqrt(1.0 - self.xi**2)) if self.xi < 1.0 else math.nan

    @property
    def settling_time(self) -> float:
        """Time [s] in which the envelope falls to one per cent, paper equation (8)."""
        return 4.6 / (self.xi * self.w_n)


@dataclass(frozen=True)
class Velocity:
    """G_v = v / theta = -k_v / (s + p_v), paper section 4.2; `k_v` [m/s2 per rad], `p_v` [1/s].

    States are x and v, so the outputs are x [m] and v [m/s] (G_x = 1/s).
    """

    k_v: float
    p_v: float

    def state_space(self) -> DelayedStateSpace:
        """Return the state space with input theta [rad] and outputs (x, v)."""
        return DelayedStateSpace.of(
            [[0.0, 1.0], [0.0, -self.p_v]], [0.0, -self.k_v], [[1.0, 0.0], [0.0, 1.0]], [[0.0], [0.0]]
        )


@dataclass(frozen=True)
class Longitudinal:
    """The course's three-state model: states u (velocity, body axis) [m/s], q [rad/s], theta [rad]; input M.

    u' = Xu u + Xq q - g theta + Xd M, q' = Mu u + Mq q + Md M, theta' = q. Outputs u, q, theta and the accelerometer's
    Xu u + Xq q + Xd M [m/s2]. `tau` [s] delays the input. Defaults are the course simulator's numbers.
    """

    x_u: float = -0.1068
    x_q: float = 0.1192
    m_u: float = -5.9755
    m_q: float = -2.6478
    x_d: float = -10.1647
    m_d: float = 450.71
    tau: float = 0.0

    def state_space(self) -> DelayedStateSpace:
        """Return the state space with input M and outputs (u, q, theta, a_x)."""
        return DelayedStateSpace.of(
            [[self.x_u, self.x_q, -GRAVITY], [self.m_u, self.m_q, 0.0], [0.0, 1.0, 0.0]],
            [self.x_d, self.m_d, 0.0],
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [self.x_u, self.x_q, 0.0]],
            [[0.0], [0.0], [0.0], [self.x_d]],
            self.tau,
        )


def thrust_curve(mu_idle: float, mu_run: float, moment: float = 0.1, thrust: float = 0.4) -> float:
    """Return the quadratic share a of the thrust curve (1 - a) u + a u^2, from two values of mu [rad/s2].

    `mu_idle` is found by a pulse of `moment` with the rotors off, where only one pair gives thrust: it is proportional
    to 1 - a + a moment. `mu_run` is found around the command `thrust`: it is proportional to 2 (1 - a + 2 a thrust).
    Raises ParameterError for a gain that is not positive, or gains whose ratio no curve gives.
    """
    if not (mu_idle > 0.0 and mu_run > 0.0):
        raise ParameterError(f"gains {mu_idle} and {mu_run} are not both positive", "thrust_curve")
    ratio = mu_run / mu_idle
    below = 2.0 - 4.0 * thrust - ratio * (1.0 - moment)
    share = (2.0 - ratio) / below if below != 0.0 else math.nan
    if not 0.0 <= share <= 1.0:
        what = f"no thrust curve has mu {mu_idle:g} with the rotors off and {mu_run:g} at T = {thrust:g}"
        raise ParameterError(what, "thrust_curve", "identify both gains again")
    return share


PAPER_PITCH_RATE = PitchRate(w_n=3.437, xi=0.0836, mu=358.5, tau=0.020)
"""Paper section 4.1: the simple method's result on the authors' drone."""

PAPER_VELOCITY_SIMPLE = Velocity(k_v=4.041, p_v=0.7387)
"""Paper Table 1, "our method"."""

PAPER_VELOCITY_GREYBOX = Velocity(k_v=4.748, p_v=1.168)
"""Paper Table 1, "greyest"."""
