"""How well a model reproduces a record: FIT, VAF, RMSE, and what the residuals still hold."""

import math
from dataclasses import dataclass, field
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.errors import IdentificationError, is_number, shown

Array = NDArray[np.float64]

_WANDERING_LAGS, _WANDERING = 10, 0.15
_ROUNDING = 1e-11
"""Residual over the signal that an exact model of data without noise leaves."""


def fit_percent(measured: ArrayLike, simulated: ArrayLike) -> float:
    """FIT = 100 (1 - |y - y_sim| / |y - mean(y)|), 100 is perfect, 0 no better than the mean (MATLAB's compare)."""
    y, error = _pair(measured, simulated, moving=True)
    return 100.0 * (1.0 - float(np.linalg.norm(error)) / float(np.linalg.norm(y - y.mean())))


def vaf(measured: ArrayLike, simulated: ArrayLike) -> float:
    """Variance accounted for, 100 (1 - var(y - y_sim) / var(y)) [%]; blind to a constant offset."""
    y, error = _pair(measured, simulated, moving=True)
    return 100.0 * (1.0 - float(error.var()) / float(y.var()))


def rmse(measured: ArrayLike, simulated: ArrayLike) -> float:
    """Root of the mean squared error, in the signal's unit."""
    return math.sqrt(float(np.mean(_pair(measured, simulated)[1] ** 2)))


@dataclass(frozen=True, eq=False)
class Correlation:
    """Normalised correlation at `lags` [samples] with the `level` bound beside it (an array, one for each lag).

    `passed`: no more lags lie outside than chance explains at the same level, and none lies further out than the
    largest of so many would by chance.
    """

    lags: NDArray[np.int64] = field(repr=False)
    value: Array = field(repr=False)
    bound: Array = field(repr=False)
    level: float

    @property
    def outside(self) -> int:
        """Number of lags outside the bound."""
        return int(np.count_nonzero(np.abs(self.value) > self.bound))

    @property
    def allowed(self) -> int:
        """Number of lags that may lie outside by chance."""
        from scipy.special import bdtr  # imported late: most commands start without it

        counts = np.arange(self.lags.size + 1)
        return int(np.argmax(bdtr(counts, self.lags.size, 1.0 - self.level) >= self.level))

    @property
    def passed(self) -> bool:
        """Return True if the residuals pass this test."""
        quantile = NormalDist().inv_cdf
        ratio = quantile(0.5 * (1.0 - self.level) / self.lags.size) / quantile(0.5 * (1.0 - self.level))
        return self.outside <= self.allowed and bool((np.abs(self.value) <= ratio * self.bound).all())

    @property
    def causal(self) -> "Correlation":
        """The same at lags >= 0 only, at which the residual follows the input."""
        return self.later(0)

    def later(self, first: int) -> "Correlation":
        """Return the same from the lag `first` on."""
        later = self.lags >= first
        return Correlation(self.lags[later], self.value[later], self.bound[later], self.level)


def deviations(level: float) -> float:
    """Within how many standard deviations a normal variable lies with the probability `level`.

    Raises IdentificationError for a level that is not between 0 and 1.
    """
    check_level(level)
    return NormalDist().inv_cdf(0.5 + level / 2.0)


def check_level(level: float) -> None:
    """Raise IdentificationError for a confidence level that is not between 0 and 1."""
    if not (is_number(level) and 0.0 < level < 1.0):
        raise IdentificationError(f"the level is {shown(level)}", "confidence", "give one between 0 and 1, as 0.95")


def whiteness(residual: ArrayLike, lags: int = 25, level: float = 0.99) -> Correlation:
    """Autocorrelation of residuals at lags 1..`lags`; white ones stay within z/sqrt(N) (Ljung, section 16.6)."""
    e = _residual(residual, lags)
    variance = float(e @ e)
    value = np.array([e[:-k] @ e[k:] for k in range(1, lags + 1)]) / variance
    bound = np.full(lags, deviations(level) / math.sqrt(e.size))
    return Correlation(np.arange(1, lags + 1), value, bound, level)


def cross_correlation(residual: ArrayLike, applied: ArrayLike, lags: int = 25, level: float = 0.99) -> Correlation:
    """Correlation of residuals with the input `applied` at lags -`lags`..`lags`, positive when the residual is later.

    What the model leaves unexplained of the input shows at lags >= 0, feedback at negative ones. The bound holds
    for coloured residuals too: z sqrt(sum R_e R_u / N) (Ljung, System Identification, equation 16.74). A record that
    is mostly rest (one doublet) has few independent pieces, which the bound takes into account.
    """
    e, u = _residual(residual, lags), np.asarray(applied, dtype=float)
    if u.shape != e.shape:
        raise IdentificationError(f"residual {e.shape} and input {u.shape} differ in length", "cross_correlation")
    u = u - u.mean()
    n, spread = e.size, math.sqrt(float(e @ e) * float(u @ u))
    if spread == 0.0:
        raise IdentificationError("the input is constant", "cross_correlation", "choose a window with excitation")
    size = 2 * n
    ef, uf = np.fft.rfft(e, size), np.fft.rfft(u, size)
    both = np.fft.irfft(ef * uf.conj(), size) / spread
    value = np.concatenate([both[-lags:], both[: lags + 1]])
    ree, ruu = np.fft.irfft(abs(ef) ** 2, size) / (e @ e), np.fft.irfft(abs(uf) ** 2, size) / (u @ u)
    # Far lags of R_e are noise themselves; they are cut where a real correlation has died out.
    reach = min(n - 1, 10 * lags)
    total = ree[0] * ruu[0] + 2.0 * float(ree[1 : reach + 1] @ ruu[1 : reach + 1])
    width = deviations(level) * math.sqrt(max(total, 1.0) / n)
    return Correlation(np.arange(-lags, lags + 1), value, np.full(2 * lags + 1, width), level)


def is_rounding(residual: Array, measured: Array) -> bool:
    """Return True if a residual is no more than the rounding of an exact model."""
    return float(np.abs(residual).max()) <= _ROUNDING * float(np.abs(measured).max())


@dataclass(frozen=True, eq=False)
class Comparison:
    """One output of one record beside the model: figures, signals (for plots) and residual tests.

    `inputs` holds the cross-correlation with each input; tests are None for records too short for them. With a noise
    model the tests are of the prediction error, of which the model has taken the colour. `ahead` is then the FIT of
    model and noise predict one sample ahead [%]. In closed loop it is the one to read: the input answers gusts,
    of which `simulated` knows nothing.
    """

    record: str
    output: str
    time: Array = field(repr=False)
    measured: Array = field(repr=False)
    simulated: Array = field(repr=False)
    fit_percent: float
    vaf: float
    rmse: float
    whiteness: Correlation | None
    inputs: dict[str, Correlation]
    ahead: float | None = None

    @property
    def residual(self) -> Array:
        """Measured less simulated."""
        return self.measured - self.simulated

    @property
    def wanders(self) -> bool:
        """Return True if the residual correlates by more than .15 over each of ten lags, and by more than chance.

        The robust covariance is too small then. What is slower than its window is not in it, and the fit has absorbed a
        part (docs/explanation/identification.md, section 4). Ten lags keep white noise of the sensor from hiding it.
        The limit .15 leaves out a colour of some samples (e[i] = .8 e[i-1] + white), which that covariance knows.
        """
        if self.whiteness is None:
            return False
        first = self.whiteness.value[:_WANDERING_LAGS]
        return bool((first > np.maximum(self.whiteness.bound[:_WANDERING_LAGS], _WANDERING)).all())

    def to_json(self) -> dict[str, object]:
        """Return the figures as plain numbers (no signals)."""
        return {
            "record": self.record,
            "output": self.output,
            "samples": int(self.time.size),
            "fit_percent": self.fit_percent,
            "fit_percent_ahead": self.ahead,
            "vaf": self.vaf,
            "rmse": self.rmse,
            "residual_wanders": self.wanders,
            "residual_white": None if self.whiteness is None else self.whiteness.passed,
            "residual_independent_of": {name: test.passed for name, test in self.inputs.items()},
        }


def comparison(
    record: str,
    output: str,
    time: Array,
    measured: Array,
    simulated: Array,
    applied: dict[str, Array],
    lags: int = 25,
    prediction_error: Array | None = None,
    unpredicted: float | None = None,
) -> Comparison:
    """Figures and residual tests of one output; `applied` are the inputs at the same times.

    Tested is the `prediction_error`, which a noise model has made of the residual, or else the residual itself.
    `unpredicted` is the root mean square of the noise model's prediction errors. An input that is constant, and a
    record shorter than 4 `lags`, have no test.
    """
    error = measured - simulated if prediction_error is None else prediction_error
    long_enough = measured.size >= 4 * lags and float(np.ptp(error)) > 0.0
    long_enough &= not is_rounding(measured - simulated, measured)
    return Comparison(
        record,
        output,
        time,
        measured,
        simulated,
        fit_percent(measured, simulated),
        vaf(measured, simulated),
        rmse(measured, simulated),
        whiteness(error, lags) if long_enough else None,
        {
            name: cross_correlation(error, signal, lags)
            for name, signal in applied.items()
            if long_enough and float(np.ptp(signal)) > 0.0
        },
        None if unpredicted is None else 100.0 * (1.0 - unpredicted / float(measured.std())),
    )


def _pair(measured: ArrayLike, simulated: ArrayLike, moving: bool = False) -> tuple[Array, Array]:
    """Return the measured signal, and measured less simulated. If asked, the measured one must move."""
    y, model = np.asarray(measured, dtype=float), np.asarray(simulated, dtype=float)
    if y.shape != model.shape or y.size == 0:
        raise IdentificationError(f"measured {y.shape} and simulated {model.shape} differ or are empty", "validate")
    if not (np.isfinite(y).all() and np.isfinite(model).all()):
        raise IdentificationError("a signal holds NaN or infinity", "validate")
    if moving and float(np.ptp(y)) == 0.0:
        raise IdentificationError("the measured signal is constant", "validate", "choose a signal that moves")
    return y, y - model


def _residual(residual: ArrayLike, lags: int) -> Array:
    e = np.asarray(residual, dtype=float)
    if e.ndim != 1 or e.size <= 2 * lags:
        raise IdentificationError(
            f"{e.size} residuals are too few for {lags} lags", "residual test", "use a longer record or fewer lags"
        )
    if not np.isfinite(e).all():
        raise IdentificationError("the residuals hold NaN or infinity", "residual test")
    e = e - e.mean()
    if not float(e @ e) > 0.0:
        raise IdentificationError("the residuals are all equal", "residual test", "there is nothing left to test")
    return np.asarray(e)
