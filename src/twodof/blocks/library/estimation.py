"""Parameters estimated while the diagram runs."""

from typing import Any

from twodof.blocks.block import Block, Clock, library_block
from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.elementary.functions import exp
from twodof.blocks.elementwise import count, dot
from twodof.blocks.expressions.arrays import array_of
from twodof.blocks.expressions.expr import maximum, sqrt, where

__all__ = ["RecursiveLeastSquares"]

MAX_UNKNOWNS = 16
_SMALLEST = 1e-30
"""An excitation phi' P phi below this says nothing; it also keeps float32 away from subnormals."""


@library_block("recursive_least_squares")
class RecursiveLeastSquares(Block):
    """theta of y = phi' theta + noise by recursive least squares, and its standard deviations `sigma`.

    It takes each `every`-th sample in which `learn` is true. The error is e = y - phi' theta, and g = phi' P phi. Then
    theta becomes theta + P phi e / (1 + g). P becomes P - P phi (P phi)' c / (l (1 + g)), with c = l - (1 - l)/g. Here
    l = exp(-every T / memory): data this old [s] weigh 1/e. It forgets only in the direction of phi (Kulhavy 1987):
    without excitation nothing is forgotten, and P does not grow. With memory 0 nothing is ever forgotten, and theta is
    the least-squares solution of all data and of the start (theta = initial, with the standard deviations
    initial_sigma).

    `sigma` is sqrt(P_ii v), with v the variance of the residuals, weighted like the data. Before the first sample it is
    initial_sigma, as v starts with one sample of `noise`^2. It supposes that the noise is white at the samples that are
    taken: take `every` so large that it is. A sample that is not finite is left out. `error` is e of the last sample
    taken.
    Source: Astrom, Wittenmark, Adaptive Control, section 2.2; Kulhavy, Restricted exponential forgetting in real-time
    identification, Automatica 23, 1987.
    """

    def __init__(
        self,
        width: int = 1,
        every: int = 1,
        memory: float = 0.0,
        noise: float = 1.0,
        initial: Any = 0.0,
        initial_sigma: Any = 1.0,
    ) -> None:
        self.width = n = count(width, 1, MAX_UNKNOWNS, "width")
        self.every = count(every, 1, 1_000_000, "every")
        self.inputs = [Port("phi", width=n), Port("y"), Port("learn", "bool")]
        self.outputs = [Port("theta", width=n), Port("sigma", width=n), Port("error")]
        self.params = [
            Param("memory", memory, unit="s", low=0.0, text="data this old weigh 1/e; 0: nothing is forgotten"),
            Param("noise", noise, low=0.0, text="standard deviation of y beside phi' theta, as supposed at first"),
            Param("initial", initial, width=n),
            Param("initial_sigma", initial_sigma, width=n, text="how far initial may be off"),
        ]
        self.derived = [Port("kept"), Port("covariance", width=n * n), Port("variance")]
        self.states = [
            State("theta", "initial", width=n),
            State("P", "covariance", width=n * n),
            State("residual", "variance"),
            State("weight", 1.0),
            State("error", 0.0),
            State("phase", 0, "int32"),
        ]

    def prepare(self, p: Any, t: Clock) -> Any:
        # P is the covariance over the variance of the noise.
        floor = maximum(p.noise * p.noise, _SMALLEST)
        return {
            "kept": where(p.memory > 0.0, exp(-(float(self.every) * t.dt) / maximum(p.memory, t.dt)), 1.0),
            "covariance": array_of(
                self.width * self.width,
                lambda k: where(
                    k // self.width == k % self.width,
                    p.initial_sigma[k // self.width] * p.initial_sigma[k // self.width] / floor,
                    0.0,
                ),
            ),
            "variance": floor,
        }

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        variance = x.residual / x.weight
        sigma = array_of(self.width, lambda i: sqrt(maximum(x.P[i * (self.width + 1)], 0.0) * variance))
        return {"theta": x.theta, "sigma": sigma, "error": x.error}

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        n = self.width
        reach = array_of(n, lambda i: dot(n, lambda j: x.P[i * n + j], lambda j: u.phi[j]))  # P phi
        g = dot(n, lambda i: u.phi[i], lambda i: reach[i])
        error = u.y - dot(n, lambda i: u.phi[i], lambda i: x.theta[i])
        # NaN and infinity are neither larger nor equal to themselves less themselves.
        takes = u.learn & (x.phase == 0) & (g > _SMALLEST) & (g - g == 0.0) & (error - error == 0.0)
        divisor = 1.0 + g
        share = (p.kept - (1.0 - p.kept) / maximum(g, _SMALLEST)) / (p.kept * divisor)
        return {
            "theta": array_of(n, lambda i: where(takes, x.theta[i] + reach[i] * error / divisor, x.theta[i])),
            "P": array_of(n * n, lambda k: where(takes, x.P[k] - reach[k // n] * reach[k % n] * share, x.P[k])),
            "residual": where(takes, p.kept * x.residual + error * error / divisor, x.residual),
            "weight": where(takes, p.kept * x.weight + 1.0, x.weight),
            "error": where(takes, error, x.error),
            "phase": where(x.phase + 1 < self.every, x.phase + 1, 0),
        }
