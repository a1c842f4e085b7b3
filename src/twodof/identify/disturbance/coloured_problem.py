"""The problem of a fit with coloured noise: residual and sensitivities, prefiltered by what the residual shows."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.identify.disturbance.autoregression import MAX_ORDER, Autoregression, autoregression, pieces_of
from twodof.identify.least_squares import LeastSquaresMinimum, minimise
from twodof.identify.problem import Problem

Array = NDArray[np.float64]

_WINDOWS = (8, 16, 32)
"""Samples in which an input counts as having just moved: 32 to 128 ms at 250 Hz."""

_CERTAIN = 12.0
"""Gain of the log likelihood from which on the noise is not even. Twice it is chi-square with the strength, the move
that halves it, input and window to choose: less than one in 10,000 by chance."""

_STRENGTHS = 2.0 ** np.arange(-2.0, 5.5, 0.5)
_HALVES = 2.0 ** np.arange(-6.0, 0.5, 0.5)
"""Strengths (variance over the even one, less 1) and moves, as shares of the largest, that are tried."""

_ALIKE = 1024
"""Sizes of a move that are told apart: 16 of them up to the smallest half."""


@dataclass(frozen=True)
class NoiseIncrease:
    """The variance of the noise is 1 + `strength` m^2 / (m^2 + `half`^2) times that at rest.

    m is how far the input moved within the `window` samples before: its largest less its smallest value.
    """

    input: str
    window: int
    strength: float
    half: float

    @property
    def times(self) -> float:
        """Standard deviation after the largest moves, over that at rest."""
        return float(np.sqrt(1.0 + self.strength))

    def variance(self, moved: Array) -> Array:
        """Over that at rest, for moves of these sizes."""
        square = moved**2
        return np.asarray(1.0 + self.strength * square / (square + self.half**2))


def moves(problem: Problem, blocks: Sequence[int]) -> Iterator[tuple[str, int, Array]]:
    """Each input that changes, each window, and how far the input had moved before each row of these blocks.

    A row's own sample does not count. A controller's output answers it, and weights that answer the noise would make
    the estimates wrong.
    """
    for name in problem.structure.inputs:
        whole = [problem.records[problem.blocks[k].record].inputs[name] for k in blocks]
        if not any(float(np.ptp(one)) > 0.0 for one in whole):
            continue
        for window in _WINDOWS:
            ranges = (_range_before(one, window)[problem.blocks[k].when] for k, one in zip(blocks, whole, strict=True))
            yield name, window, np.concatenate(list(ranges))


def noise_increase(error: Array, moved: Sequence[tuple[str, int, Array]]) -> NoiseIncrease | None:
    """Return the likeliest increase of white `error` (samples,) by inputs that `moved`; None if it may be even."""
    square = error**2
    power = float(square.mean())
    best, gain = None, _CERTAIN
    for name, window, size in moved:
        largest = float(size.max())
        # An error that is 0 throughout is the rounding of an exact model, and nothing is louder in it.
        if not (power > 0.0 and largest > 0.0):
            continue
        count, sizes, powers = _by_size(size / largest, square / power)
        for half in _HALVES:
            variance = 1.0 + np.outer(_STRENGTHS, sizes**2 / (sizes**2 + half**2))
            logs = -0.5 * error.size * np.log((powers / variance).sum(axis=1) / error.size)
            logs -= 0.5 * np.log(variance) @ count
            k = int(np.argmax(logs))
            if float(logs[k]) > gain:
                gain = float(logs[k])
                best = NoiseIncrease(name, window, float(_STRENGTHS[k]), float(half) * largest)
    return best


def _by_size(size: Array, square: Array) -> tuple[Array, Array, Array]:
    """Rows that moved alike, taken together: how many they are, their mean size, and the sum of their squares.

    So a record of a million samples takes as long as one of a thousand.
    """
    place = np.minimum((size * _ALIKE).astype(np.int64), _ALIKE - 1)
    count, sizes, squares = (
        np.asarray(np.bincount(place, weights, _ALIKE), dtype=np.float64) for weights in (None, size, square)
    )
    there = count > 0.0
    return count[there], sizes[there] / count[there], squares[there]


def _range_before(values: Array, window: int) -> Array:
    """Largest less smallest of the `window` values before each one, shape as `values`."""
    before = np.concatenate([np.full(window, values[0]), values[:-1]])
    seen = np.lib.stride_tricks.sliding_window_view(before, window)[-values.size :]
    return np.asarray(seen.max(axis=1) - seen.min(axis=1))


_LINES = 16
"""Samples of memory of what is louder after a move: two periods of the rotors' vibration. Its colour is its own, as a
line of the rotors that moves with M is narrow. Taken for white noise of its size, steps on the rig `lab` claimed 1.7
times what mu and tau spread by."""

SWING = ("w_n", "xi")
_REMEMBERED_S = 4.0
"""Time over which the inverse of a swing integrates [s]: longer than the swing lasts."""

_SWING_STEP = 1e-5
"""Step of the differences by w_n [rad/s] and xi."""


def swings(problem: Problem) -> bool:
    """Return True if w_n and xi have priors, so that the noise may push the swing that they describe."""
    return set(SWING) <= set(problem.known)


class NoiseRows:
    """The rows of the blocks of one noise. `pieces` (of them) have no gap inside.

    `deviation` (size,) is the standard deviation of the prediction errors over their root mean square. Where an input
    has moved, they follow from earlier ones by `_colour` (lags,) times the `_share` (size,) of what is louder there.
    """

    def __init__(self, problem: Problem, blocks: Sequence[int]) -> None:
        self._problem, self._blocks = problem, tuple(blocks)
        own = [problem.blocks[k] for k in blocks]
        rows = np.concatenate([np.arange(block.rows.start, block.rows.stop) for block in own])
        # A slice is a view: most flights are one record.
        self.rows = own[0].rows if len(own) == 1 else rows
        self.size = int(rows.size)
        found, start = [], 0
        for block in own:
            position = problem.records[block.record].outputs[block.output].position
            found += [slice(start + piece.start, start + piece.stop) for piece in pieces_of(position)]
            start += position.size
        self.pieces = tuple(found)
        self.loud: NoiseIncrease | None = None
        self.deviation, self._share = np.ones(self.size), np.zeros(self.size)
        self._colour: Array = np.zeros(0)

    def pushes(self, rows: Array, x: Array) -> Array:
        """Return `rows` (samples, ...) behind the inverse of the swing at x; each piece begins at rest."""
        from scipy.signal import lfilter  # imported late: most commands start without it

        record = self._problem.blocks[self._blocks[0]].record
        w_n, xi = (self._problem.values(x, record)[name] for name in SWING)
        dt = self._problem.records[record].dt
        turn = np.sqrt(complex(xi * xi - 1.0))
        one, two = np.exp(dt * w_n * np.array([-xi + turn, -xi - turn]))
        inverse = [1.0, -(one + two).real, (one * two).real], [1.0, -math.exp(-dt / _REMEMBERED_S)]
        return np.concatenate([lfilter(*inverse, rows[piece], axis=0) for piece in self.pieces])

    def listen(self, error: Array) -> None:
        """Find how loud the noise is where an input has moved, and its colour there, from its white `error`."""
        self._colour, variance = np.zeros(0), self._rate(error)
        if self.loud is None:
            return
        self._share = 1.0 - 1.0 / variance
        target = error / self.deviation
        earlier = self.earlier(error, _LINES) * (self._share / self.deviation)[:, None]
        found = [np.linalg.lstsq(earlier[:, :lags], target, rcond=None)[0] for lags in range(_LINES + 1)]
        left = [float(np.sum((target - earlier[:, : one.size] @ one) ** 2)) for one in found]
        best = int(np.argmin(self.size * np.log(left) + 2.0 * np.arange(_LINES + 1)))
        self._colour = np.asarray(-found[best], dtype=np.float64)
        self._rate(self._second(error))

    def even(self, rows: Array) -> Array:
        """Return prediction errors or sensitivities (samples, ...) less what is louder after a move."""
        return rows if self.loud is None else (self._second(rows).T / self.deviation).T

    def _rate(self, error: Array) -> Array:
        """Find how loud the noise is; return its variance over that at rest."""
        self.loud, variance = noise_increase(error, self._moves), np.ones(self.size)
        if self.loud is not None:
            place = self.loud.input, self.loud.window
            variance = self.loud.variance(next(size for name, window, size in self._moves if (name, window) == place))
        level = float(np.mean(error**2 / variance)) / max(float(np.mean(error**2)), 1e-300)
        self.deviation = np.asarray(np.sqrt(variance * level))
        return variance

    def _second(self, rows: Array) -> Array:
        return rows + (self._share * (self.earlier(rows, self._colour.size) @ self._colour).T).T

    def earlier(self, rows: Array, lags: int) -> Array:
        """Return the `lags` rows before each one, latest first, shape (samples, ..., lags); 0 where a piece begins."""
        found = np.zeros((*rows.shape, lags))
        for piece in self.pieces:
            if 0 < lags < piece.stop - piece.start:
                windows = np.lib.stride_tricks.sliding_window_view(rows[piece][:-1], lags, axis=0)
                found[piece.start + lags : piece.stop] = windows[..., ::-1]
        return found

    @cached_property
    def _moves(self) -> tuple[tuple[str, int, Array], ...]:
        return tuple(moves(self._problem, self._blocks))


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
    closed loop too, where input and earlier noise go together. With `given` noises, autoregressions or walks, one for
    each block, the colour is known: the cost is the sum of squares, and the Jacobian is prefiltered only.

    With `swing` the autoregression is that of pushes at the plant. Rows first pass the inverse of the swing by the w_n
    and xi of x. A pendulum that a gust pushes swings on for seconds, which an autoregression of .24 s does not see.
    """

    def __init__(self, problem: Problem, given: Sequence[Any] = (), swing: bool = False) -> None:
        self.problem, self._given, self._swing = problem, tuple(given), swing
        groups = [(k,) for k in range(len(given))] if given else problem.noises
        self._noises = [NoiseRows(problem, noise) for noise in groups]
        self._orders: list[int | None] = [None] * len(self._noises)
        self._last: tuple[Array, Array, Array, tuple[Autoregression, ...]] | None = None

    def minimise(self, x: Array, iterations: int = 100) -> LeastSquaresMinimum:
        """Search the most likely x from a first guess, with the orders chosen on the way."""
        before: list[int | None] = []
        for _ in range(_ROUNDS):
            raw = self.problem.residual(x)
            if not np.isfinite(raw).all():
                return LeastSquaresMinimum(x, raw, math.inf, 0, False, np.zeros(x.shape, dtype=bool))
            self.choose(x)
            if self._orders == before:
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
            x, before = minimum.x, self._orders
        return minimum

    def choose(self, x: Array) -> None:
        """Choose the orders by the residual at x."""
        self._orders, self._last = [None] * len(self._orders), None
        self._orders = [model.order for model in self.at(x)[2]]

    def lengthen(self, x: Array, samples: int = _A_COEFFICIENT, most: int = MAX_ORDER) -> None:
        """Take longer models from now on: one coefficient for so many `samples`, and no more than `most`.

        The order that predicts best may be too short to claim by, because it leaves out the slow part of the noise. On
        the rig `lab` a pseudo-random flight of 9 s claimed 5 % too little with order 12. The estimates gain nothing.
        """
        orders = [model.order for model in self.at(x)[2]]
        self._orders = [
            max(own, min(most, noise.size // samples)) for own, noise in zip(orders, self._noises, strict=True)
        ]
        self._last = None

    def residual(self, x: Array) -> Array:
        """Rows whose sum of squares falls as the likelihood rises."""
        _, pushes, models = self.at(x)
        return self._whiten(pushes, models) * self._spread(models) if models else pushes

    def jacobian(self, x: Array, residual: Array) -> Array:
        """Return the derivatives of `residual` by x."""
        raw, _, models = self.at(x)
        return self._projected(self.problem.jacobian(x, raw), x) * self._spread(models)

    def sensitivities(self, x: Array) -> Array:
        """Two-sided prefiltered sensitivities in units of the noise, less what the coefficients' errors explain."""
        return self._projected(self.problem.central_jacobian(x), x)

    def whitened(self, x: Array) -> Array:
        """Return the prediction errors at x, over their standard deviations."""
        return self._whiten(*self.at(x)[1:])

    def whiten(self, rows: Array) -> Array:
        """Return rows of all blocks, prefiltered by the `given` noise; those of the prior as they are."""
        return self._whiten(rows, self._given)

    def at(self, x: Array) -> tuple[Array, Array, tuple[Autoregression, ...]]:
        """Return the weighted residual at x, the pushes behind it and their noise models, by noise.

        There are no models if the residual is not finite.
        """
        if self._last is None or not np.array_equal(self._last[0], x):
            raw = self.problem.residual(x)
            pushes = self._pushes(raw, x)
            self._last = (x.copy(), raw, pushes, self._models(pushes) if np.isfinite(pushes).all() else ())
        return self._last[1:]

    def cost(self, x: Array) -> float:
        """Return -2 log likelihood with Akaike's corrected penalty, to compare searches; the orders follow from x."""
        self.choose(x)
        white, models = self.whitened(x), self.at(x)[2]
        unknowns = sum(model.order + 1 for model in models) + x.size
        penalty = 2.0 * unknowns * self.problem.size / max(1, self.problem.size - unknowns - 1)
        return float(white @ white) + 2.0 * self.log_deviations(models) + penalty

    def _pushes(self, rows: Array, x: Array) -> Array:
        """Return rows of all blocks behind the inverse of the swing at x; those of the prior as they are."""
        if not self._swing:
            return rows
        pushed = rows.copy()
        for noise in self._noises:
            pushed[noise.rows] = noise.pushes(rows[noise.rows], x)
        return pushed

    def _whiten(self, pushes: Array, models: Sequence[Autoregression]) -> Array:
        """Rows of all blocks, each prefiltered by its own model; those of the prior as they are."""
        white = pushes.copy()
        for model, noise in zip(models, self._noises, strict=True):
            own = model.whiten(pushes[noise.rows], noise.pieces)
            white[noise.rows] = noise.even(own)
        return white

    def listen(self, x: Array) -> bool:
        """Find where each noise is louder, by the prediction errors at x; whether one is.

        A search begins with even noise. Far from the truth the response that is missed would pass for noise.
        """
        _, pushes, models = self.at(x)
        for model, noise in zip(models, self._noises, strict=True):
            noise.listen(model.whiten(pushes[noise.rows], noise.pieces))
        self._last = None
        return any(noise.loud is not None for noise in self._noises)

    def louder(self) -> dict[str, NoiseIncrease]:
        """Where a noise is louder, by the names of the noises that are not even."""
        found = ((self.problem.noise_label(k), noise.loud) for k, noise in enumerate(self._noises))
        return {label: loud for label, loud in found if loud is not None}

    def _models(self, pushes: Array) -> tuple[Autoregression, ...]:
        parts = zip(self._noises, self._orders, strict=True)
        spent = len(self.problem.slots)
        return self._given or tuple(autoregression(pushes[n.rows], n.pieces, order, spent) for n, order in parts)

    def log_deviations(self, models: Sequence[Autoregression]) -> float:
        """Return half the logarithm of the determinant of the noises' covariance."""
        even = sum(model.log_deviations(noise.pieces) for model, noise in zip(models, self._noises, strict=True))
        return even + sum(float(np.log(noise.deviation).sum()) for noise in self._noises if noise.loud is not None)

    def _spread(self, models: Sequence[Autoregression]) -> float:
        return 1.0 if self._given else math.exp(self.log_deviations(models) / self.problem.size)

    def _projected(self, jacobian: Array, x: Array) -> Array:
        """Return the sensitivities `jacobian` of the residual, prefiltered, less what the coefficients explain."""
        raw, pushes, models = self.at(x)
        slopes = self._pushes(jacobian, x)
        for i, slot in enumerate(self.problem.slots):
            if self._swing and slot.unknown.name in SWING:  # the filter's own derivative
                step = _SWING_STEP * np.eye(x.size)[i]
                slopes[:, i] += (self._pushes(raw, x + step) - self._pushes(raw, x - step)) / (2.0 * _SWING_STEP)
        white = self._whiten(slopes, models)
        for model, noise in zip(models, self._noises, strict=True):
            if self._given or not model.order:
                continue
            # Prediction errors change with coefficient k as the residual k samples earlier.
            earlier = noise.even(noise.earlier(pushes[noise.rows], model.order))
            share = np.linalg.lstsq(earlier.T @ earlier, earlier.T @ white[noise.rows], rcond=1e-12)[0]
            white[noise.rows] -= earlier @ share
        return white
