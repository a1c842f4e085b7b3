"""The problem of a fit with coloured noise: residual and sensitivities, prefiltered by what the residual shows."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twodof.identify.disturbance.autoregression import MAX_ORDER, Autoregression, autoregression
from twodof.identify.disturbance.loudness import Loudness
from twodof.identify.disturbance.noise_rows import NoiseRows
from twodof.identify.problem import Problem
from twodof.identify.search.least_squares import LeastSquaresMinimum, minimise

Array = NDArray[np.float64]

_ROUNDS = 4
"""How often the orders are chosen again; they stand after two or three."""

_A_COEFFICIENT = 40
"""Samples for each coefficient of a model that is not chosen by its predictions."""

_LITTLE = 1e-3
"""An increase of the log likelihood that ends the search: a step of 4 % of a standard deviation."""


class ColouredProblem:
    """Prediction errors of a `Problem` whose noise is an autoregression of its own for each output of each flight.

    The coefficients are not entries of x. At each x they are those of the residual there, which are the most likely
    ones. The cost is the likelihood that is left. It joins the sum of squares and the logarithms of the deviations:
    exp(2 mean log deviation) |prefiltered residual|^2. The Jacobian is that of Kaufman's variable projection (1975):
    the prefiltered sensitivities less what a change of the coefficients would do to the same rows. So it holds in
    closed loop too, where input and earlier noise go together.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self._noises = [NoiseRows(problem, noise) for noise in problem.noises]
        self._orders: list[int | None] = [None] * len(self._noises)
        self._last: tuple[Array, Array, tuple[Autoregression, ...]] | None = None

    def minimise(self, x: Array, iterations: int = 100) -> LeastSquaresMinimum:
        """The most likely x from a first guess, the orders chosen on the way; its residual is `residual(x)`."""
        before: list[int | None] = []
        for _ in range(_ROUNDS):
            raw = self.problem.residual(x)
            if not np.isfinite(raw).all():
                return LeastSquaresMinimum(x, raw, math.inf, 0, False, np.zeros(x.shape, dtype=bool))
            self._orders = [None] * len(self._orders)
            orders: list[int | None] = [model.order for model in self._models(raw)]
            self._orders = orders
            self._last = None
            if orders == before:
                break
            minimum = minimise(
                self.residual,
                self.jacobian,
                x,
                self.problem.lower,
                self.problem.upper,
                tolerance=_LITTLE / self.problem.size,
                iterations=iterations,
            )
            x, before = minimum.x, orders
        return minimum

    def choose(self, x: Array) -> None:
        """Choose the orders anew, by the residual at x."""
        self._orders, self._last = [None] * len(self._orders), None
        self._orders = [model.order for model in self.at(x)[1]]

    def lengthen(self, x: Array) -> None:
        """Take longer models from now on: one coefficient for 40 samples, `MAX_ORDER` at most.

        The order that predicts best may be too short to claim by, because it leaves out the slow part of the noise. On
        the rig `lab` a pseudo-random flight of 9 s claimed 5 % too little with order 12. The estimates gain nothing.
        """
        orders = [model.order for model in self.at(x)[1]]
        self._orders = [
            max(own, min(MAX_ORDER, noise.size // _A_COEFFICIENT))
            for own, noise in zip(orders, self._noises, strict=True)
        ]
        self._last = None

    def residual(self, x: Array) -> Array:
        """Rows whose sum of squares falls as the likelihood rises."""
        raw = self.problem.residual(x)
        if not np.isfinite(raw).all():
            return raw
        models = self._models(raw)
        self._last = (x.copy(), raw, models)
        return self.whiten(raw, models) * self._spread(models)

    def jacobian(self, x: Array, residual: Array) -> Array:
        """Derivatives of `residual` by x."""
        raw, models = self.at(x)
        return self._projected(self.problem.jacobian(x, raw), raw, models) * self._spread(models)

    def sensitivities(self, x: Array) -> Array:
        """Two-sided prefiltered sensitivities in units of the noise, less what the coefficients' errors explain."""
        raw, models = self.at(x)
        return self._projected(self.problem.central_jacobian(x), raw, models)

    def whitened(self, x: Array) -> Array:
        """The prediction errors at x, over their standard deviations."""
        raw, models = self.at(x)
        return self.whiten(raw, models)

    def at(self, x: Array) -> tuple[Array, tuple[Autoregression, ...]]:
        """The weighted residual at x and its noise models, in the order of `Problem.noises`."""
        if self._last is None or not np.array_equal(self._last[0], x):
            raw = self.problem.residual(x)
            self._last = (x.copy(), raw, self._models(raw))
        return self._last[1], self._last[2]

    def cost(self, x: Array) -> float:
        """-2 log likelihood with Akaike's corrected penalty, for comparing searches; the orders are chosen anew."""
        self.choose(x)
        raw, models = self.at(x)
        white = self.whiten(raw, models)
        unknowns = sum(model.order + 1 for model in models) + x.size
        penalty = 2.0 * unknowns * self.problem.size / max(1, self.problem.size - unknowns - 1)
        return float(white @ white) + 2.0 * self._log_deviations(models) + penalty

    def whiten(self, rows: Array, models: Sequence[Autoregression]) -> Array:
        """Rows of all blocks, each prefiltered by its own model; those of the prior as they are."""
        white = rows.copy()
        for model, noise in zip(models, self._noises, strict=True):
            own = model.whiten(rows[noise.rows], noise.pieces)
            white[noise.rows] = own if noise.loud is None else (own.T / noise.deviation).T
        return white

    def listen(self, x: Array) -> bool:
        """Find where each noise is louder, by the prediction errors at x; whether one is.

        A search begins with even noise. Far from the truth the response that is missed would pass for noise.
        """
        raw, models = self.at(x)
        for model, noise in zip(models, self._noises, strict=True):
            noise.listen(model.whiten(raw[noise.rows], noise.pieces))
        self._last = None
        return any(noise.loud is not None for noise in self._noises)

    def louder(self) -> dict[str, Loudness]:
        """Where a noise is louder, by the names of the noises that are not even."""
        found = ((self.problem.noise_label(k), noise.loud) for k, noise in enumerate(self._noises))
        return {label: loud for label, loud in found if loud is not None}

    def unit(self, noise: int) -> float:
        """The weight of the rows of a noise, in the output's unit."""
        block = self.problem.blocks[self.problem.noises[noise][0]]
        return self.problem.sigma[block.record, block.output]

    def _models(self, raw: Array) -> tuple[Autoregression, ...]:
        parts = zip(self._noises, self._orders, strict=True)
        spent = len(self.problem.slots)
        return tuple(autoregression(raw[noise.rows], noise.pieces, order, spent) for noise, order in parts)

    def _log_deviations(self, models: Sequence[Autoregression]) -> float:
        even = sum(model.log_deviations(noise.pieces) for model, noise in zip(models, self._noises, strict=True))
        return even + sum(float(np.log(noise.deviation).sum()) for noise in self._noises if noise.loud is not None)

    def _spread(self, models: Sequence[Autoregression]) -> float:
        return math.exp(self._log_deviations(models) / self.problem.size)

    def _projected(self, jacobian: Array, raw: Array, models: Sequence[Autoregression]) -> Array:
        white = self.whiten(jacobian, models)
        for model, noise in zip(models, self._noises, strict=True):
            if not model.order:
                continue
            own = raw[noise.rows]
            # Prediction errors change with coefficient k as the residual k samples earlier.
            earlier = np.zeros((own.size, model.order))
            for piece in noise.pieces:
                part = own[piece]
                if part.size > model.order:
                    windows = np.lib.stride_tricks.sliding_window_view(part[:-1], model.order)
                    earlier[piece.start + model.order : piece.stop] = windows[:, ::-1]
            if noise.loud is not None:
                earlier /= noise.deviation[:, None]
            share = np.linalg.lstsq(earlier.T @ earlier, earlier.T @ white[noise.rows], rcond=1e-12)[0]
            white[noise.rows] -= earlier @ share
        return white
