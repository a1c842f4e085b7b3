"""The problem of a fit with coloured noise: residual and sensitivities, prefiltered by what the residual shows."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twodof.identify.disturbance.autoregression import MAX_ORDER, Autoregression, autoregression, pieces_of
from twodof.identify.problem import Problem
from twodof.identify.search.levenberg_marquardt import LeastSquaresMinimum, minimise

Array = NDArray[np.float64]

_ROUNDS = 4
"""How often the orders are chosen again; they stand after two or three."""

_A_COEFFICIENT = 40
"""Samples for each coefficient of a model that is not chosen by its predictions."""

_LITTLE = 1e-3
"""An increase of the log likelihood that ends the search: a step of 4 % of a standard deviation."""


class ColouredProblem:
    """Prediction errors of a `Problem` whose noise is an autoregression of its own for each output of each record.

    The coefficients are not entries of x. At each x they are those of the residual there, which are the most likely
    ones. The cost is the likelihood that is left. It joins the sum of squares and the logarithms of the deviations:
    exp(2 mean log deviation) |prefiltered residual|^2. The Jacobian is that of Kaufman's variable projection (1975):
    the prefiltered sensitivities less what a change of the coefficients would do to the same rows. So it holds in
    closed loop too, where input and earlier noise go together.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.pieces = [pieces_of(problem.records[b.record].outputs[b.output].position) for b in problem.blocks]
        self._orders: list[int | None] = [None] * len(problem.blocks)
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
        sizes = [block.rows.stop - block.rows.start for block in self.problem.blocks]
        self._orders = [
            max(own, min(MAX_ORDER, size // _A_COEFFICIENT)) for own, size in zip(orders, sizes, strict=True)
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
        """The weighted residual at x and its noise models, one for each block of rows."""
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
        parts = zip(models, self.problem.blocks, self.pieces, strict=True)
        white = [model.whiten(rows[block.rows], pieces) for model, block, pieces in parts]
        return np.concatenate([*white, rows[self.problem.size :]])

    def _models(self, raw: Array) -> tuple[Autoregression, ...]:
        parts = zip(self.problem.blocks, self.pieces, self._orders, strict=True)
        spent = len(self.problem.slots)
        return tuple(autoregression(raw[block.rows], pieces, order, spent) for block, pieces, order in parts)

    def _log_deviations(self, models: Sequence[Autoregression]) -> float:
        return sum(model.log_deviations(pieces) for model, pieces in zip(models, self.pieces, strict=True))

    def _spread(self, models: Sequence[Autoregression]) -> float:
        return math.exp(self._log_deviations(models) / self.problem.size)

    def _projected(self, jacobian: Array, raw: Array, models: Sequence[Autoregression]) -> Array:
        white = self.whiten(jacobian, models)
        for model, block, pieces in zip(models, self.problem.blocks, self.pieces, strict=True):
            if not model.order:
                continue
            own = raw[block.rows]
            # Prediction errors change with coefficient k as the residual k samples earlier.
            earlier = np.zeros((own.size, model.order))
            for piece in pieces:
                part = own[piece]
                if part.size > model.order:
                    windows = np.lib.stride_tricks.sliding_window_view(part[:-1], model.order)
                    earlier[piece.start + model.order : piece.stop] = windows[:, ::-1]
            share = np.linalg.lstsq(earlier.T @ earlier, earlier.T @ white[block.rows], rcond=1e-12)[0]
            white[block.rows] -= earlier @ share
        return white
