"""The characteristic polynomial of the pitch loop over boxes of frequency and parameters, enclosed.

The plant of `PitchLoop` in closed form: the moment held, the dead time to a part of a sample, the rotors' lag, theta of
the sample before. The numerators come by series in the time of one sample, so no case (xi = 1, no spring, a lag like
the pitch's own time) is another formula.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from twodof.design.certified.affine import Affine
from twodof.design.certified.pitch_region import PitchRegion
from twodof.design.certified.resolvent import CoprimeFactors
from twodof.design.certified.zero_exclusion import Cells
from twodof.design.uncertain.pitch_loop import NO_LAG
from twodof.signals import PERIOD

Array = NDArray[np.float64]

_MOST_TERMS = 40

_GONE = 40.0
"""e^-40 is 4e-18: less than a rounding of the moment it is a part of."""


def pitch_formula(region: PitchRegion, factors: CoprimeFactors) -> Callable[[Cells], Affine]:
    """The characteristic polynomial of every member of `region` under a controller of these `factors`.

    The controller reads (theta of the sample before, q). The polynomial is times factors that are 0 nowhere on the
    circle.
    """

    def value(cells: Cells) -> Affine:
        p = region.parameters(cells)
        n, k = cells.centre.shape
        denominator, by_theta, by_q = factors.on_arc(cells.centre[:, 0], cells.half[:, 0], k)
        turned = np.zeros((n, k), complex)
        turned[:, 0] = 1j * cells.half[:, 0]
        along = Affine(1j * cells.centre[:, 0], turned, np.zeros(n))
        z, back = along.exp(), (-along).exp()
        some, lag = p["dead_time"], p["lag"].within(NO_LAG, math.inf)
        # As `PitchLoop` has it, what stands for no lag is taken off the dead time.
        least, longest = p["lag"].centre - p["lag"].spread, p["lag"].centre + p["lag"].spread
        none, maybe = longest < NO_LAG, least < NO_LAG
        short = np.where(none, NO_LAG, np.where(maybe, 0.5 * NO_LAG, 0.0))
        unsure = np.where(maybe & ~none, 0.5 * NO_LAG, 0.0)
        some = Affine(some.centre - short, some.slopes, some.rest + unsure)
        # Beyond the samples of this kind is another kind's part of the region.
        after = some - (PERIOD * cells.kind).astype(np.float64)
        empty = (after.centre + after.spread < 0.0) & (cells.kind > 0)
        empty |= (after.centre - after.spread > PERIOD) | region.beyond(cells)
        part = after.within(0.0, PERIOD)
        plant = _Sampled(p["w_n"], p["xi"], p["mu"], lag)
        theta, q, own = plant.transfer(z, back, part)
        whole = cells.kind.astype(np.float64)
        delay = Affine(-1j * whole * cells.centre[:, 0], -turned * whole[:, None], np.zeros(n)).exp()
        found = denominator * own - delay * (by_theta * back * theta + by_q * q)
        # A box without a member holds no zero.
        return Affine(
            np.where(empty, 1.0, found.centre),
            np.where(empty[:, None], 0.0, found.slopes),
            np.where(empty, 0.0, found.rest),
        )

    return value


class _Sampled:
    """The pitch, sampled: numerators and denominator of theta and q by the held M."""

    def __init__(self, w_n: Affine, xi: Affine, mu: Affine, lag: Affine) -> None:
        self.w_n, self.xi, self.mu, self.lag = w_n, xi, mu, lag
        self.double = 2.0 * (xi * w_n)
        self.spring = w_n * w_n
        self.coupling = 1.0 - self.double * lag + self.spring * lag * lag
        self.over = mu * lag * self.coupling.inverse()
        most, least = lag.centre + lag.spread, np.maximum(lag.centre - lag.spread, NO_LAG * (1.0 - 1e-9))
        self.rate = -lag.inverse().known_within(1.0 / most, 1.0 / least)

    def transfer(self, z: Affine, back: Affine, part: Affine) -> tuple[Affine, Affine, Affine]:
        """Numerators of theta and q, and the denominator, for a dead time of `part` [s] of a sample."""
        whole = Affine(
            np.full(len(part.rest), PERIOD), np.zeros_like(part.slopes, dtype=float), np.zeros_like(part.rest)
        )
        left = PERIOD - part
        h, slope_less, area = self._impulse(whole)
        decay, decay_left = self._decay(whole), self._decay(left)
        lagged_theta, lagged_q = self._lagged(h, slope_less, decay)
        theta_whole, q_whole = self.mu * area - lagged_theta, self.mu * h - lagged_q
        h_left, slope_left, area_left = self._impulse(left)
        lag_theta, lag_q = self._lagged(h_left, slope_left, decay_left)
        theta_left, q_left = self.mu * area_left - lag_theta, self.mu * h_left - lag_q
        # By the moment of now and of the sample before: rotors, theta, q.
        moment = 1.0 - decay_left + (decay_left - decay) * back
        g_theta, g_q = (now + (every - now) * back for now, every in ((theta_left, theta_whole), (q_left, q_whole)))
        first = z - decay
        v_theta, v_q = lagged_theta * moment + first * g_theta, lagged_q * moment + first * g_q
        # The matrix of the pitch over a sample is 1 + small: [[s + 2 xi w h, h], [-w^2 h, s]], s = h' - 1.
        zeta, s = z - 1.0, slope_less
        top = s + self.double * h
        second = (zeta - top) * (zeta - s) + self.spring * h * h
        theta = (zeta - s) * v_theta + h * v_q
        q = (zeta - top) * v_q - self.spring * h * v_theta
        return theta, q, first * second

    def _decay(self, t: Affine) -> Affine:
        """e^(-t / lag), between 0 and nearly 1 however wide the lag's range is."""
        return (self.rate * t).known_within(-_GONE, 0.0).exp()

    def _lagged(self, h: Affine, slope_less: Affine, decay: Affine) -> tuple[Affine, Affine]:
        """theta and q after a time by a moment of the rotors that dies away meanwhile."""
        rest = slope_less + (1.0 - decay)
        theta = self.over * ((1.0 - self.double * self.lag) * h - self.lag * rest)
        return theta, self.over * (self.spring * self.lag * h + rest)

    def _impulse(self, t: Affine) -> tuple[Affine, Affine, Affine]:
        """h, h' - 1, the integral of h at the times `t`, h'' = -2 xi w h' - w^2 h, h(0) = 0, h'(0) = 1."""
        alpha, beta = self.double * t, self.spring * t * t
        # The matrix of the scaled states has this norm, and its k-th power counts 1 / k!.
        norm = float(
            np.max(np.abs(alpha.centre) + alpha.spread + np.sqrt(np.abs(beta.centre) + beta.spread), initial=0.0)
        )
        terms = 3
        while norm**terms / math.factorial(terms) * math.exp(norm) > 1e-17 and terms < _MOST_TERMS:
            terms += 1
        beyond = norm**terms / math.factorial(terms) * math.exp(norm)
        # h = t (H_1 + H_2 + ...), of which H_k takes t to the power k - 1.
        every = [0.0 * alpha + 1.0, -0.5 * alpha]
        for k in range(3, terms + 1):
            every.append((-1.0 / (k * (k - 1))) * ((k - 1) * (alpha * every[-1]) + beta * every[-2]))
        total, area, sloped = every[0], 0.5 * every[0], 0.0 * alpha
        for k, one in enumerate(every[1:], start=2):
            total, area, sloped = total + one, area + (1.0 / (k + 1)) * one, sloped + float(k) * one
        total, area, sloped = (Affine(one.centre, one.slopes, one.rest + beyond) for one in (total, area, sloped))
        return t * total, sloped, t * t * area
