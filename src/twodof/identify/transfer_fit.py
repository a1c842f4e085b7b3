"""A transfer function fitted to a measured frequency response (what CIFER's NAVFIT does)."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.errors import IdentificationError, nearest, shown
from twodof.identify.frequency_response import FrequencyResponse
from twodof.identify.validate import deviations

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

MAX_ORDER = 10
_DEGREES_IN_DECIBEL = 0.01745
"""Weight of a squared degree beside a squared decibel: 1 dB counts as 7.57 degrees (Tischler and Remple)."""
_DELAYS = 25
"""Dead times from which the search starts."""
_STEP = 1e-6


@dataclass(frozen=True)
class TransferFactor:
    """One factor of a transfer function: the `gain`, a `zero` or `pole` [rad/s], or a pair of them.

    `value` is the gain, 1/T of (s + 1/T), or w of (s^2 + 2 zeta w s + w^2), whose damping is `zeta`.
    """

    kind: str
    value: float
    sigma: float
    zeta: float = math.nan
    zeta_sigma: float = math.nan


@dataclass(frozen=True, eq=False)
class TransferFit:
    """T(s) = s^n (b_m s^m + ... + b_0) / (s^k + ... + a_0) exp(-tau s), n < 0 for integrators.

    `values` and `covariance` follow `labels` (the estimated ones among b_0, ..., a_0, ..., tau); `fixed` holds the
    others. `cost` is the J of Tischler and Remple: below 100 is acceptable, below 50 hardly to be told from the data.
    `omega` [rad/s] are the frequencies that were used.
    """

    labels: tuple[str, ...]
    values: Array
    covariance: Array
    fixed: Mapping[str, float]
    orders: tuple[int, int]
    power: int
    cost: float
    omega: Array
    converged: bool

    def __getitem__(self, label: str) -> float:
        """Return a coefficient. Raises IdentificationError for an unknown one."""
        found = self._all(self.values)
        if label not in found:
            raise IdentificationError(
                f"there is no coefficient {shown(label)}", "transfer fit", f"of {', '.join(found)}"
            )
        return found[label]

    def sigma(self, label: str) -> float:
        """Return the standard deviation of a coefficient; 0 for a held one."""
        return 0.0 if label in self.fixed else math.sqrt(float(self.covariance[self._index(label), self._index(label)]))

    def interval(self, label: str, level: float = 0.95) -> tuple[float, float]:
        """Return the confidence interval of a coefficient at `level`. Raises IdentificationError as `sigma` does."""
        half = deviations(level) * self.sigma(label)
        return self[label] - half, self[label] + half

    @property
    def numerator(self) -> Array:
        """Coefficients by falling powers of s, the free factors s included."""
        return _numerator(self._all(self.values), self.orders[0], self.power)

    @property
    def denominator(self) -> Array:
        """Coefficients by falling powers of s, the first one 1, the integrators included."""
        return _denominator(self._all(self.values), self.orders[1], self.power)

    @property
    def dead_time(self) -> float:
        """Return tau [s]."""
        return self["tau"]

    def response(self, omega: ArrayLike) -> Complex:
        """Return the fitted T(j omega), without a hold, at `omega` [rad/s], shape (k,)."""
        return _transfer(self._all(self.values), self.orders, self.power, np.asarray(omega, dtype=float))

    @property
    def factors(self) -> tuple[TransferFactor, ...]:
        """Return the gain of the highest powers, zeros and poles with their standard deviations (first order)."""
        highest = f"b{self.orders[0]}"
        found = [TransferFactor("gain", self[highest], self.sigma(highest))]
        for kind, order, letter in (("zero", self.orders[0], "b"), ("pole", self.orders[1], "a")):
            roots = _sorted_roots(self._all(self.values), letter, order)
            found.extend(self._factor(kind, letter, order, k) for k in range(order) if roots[k].imag <= 0.0)
        return tuple(found)

    def table(self) -> str:
        """Coefficients and factors with standard deviations, and J, as text."""
        free = f"s^{self.power} " if self.power > 0 else f"1/s^{-self.power} " if self.power < 0 else ""
        form = f"{free}{_polynomial('b', self.orders[0])} / {_polynomial('a', self.orders[1])}"
        span = f"{self.omega.size} points from {self.omega[0]:.3g} to {self.omega[-1]:.3g} rad/s"
        lines = [
            f"{form} exp(-tau s), {span}, J = {self.cost:.3g}",
            f"{'':12}{'estimate':>12}{'1 sigma':>11}",
        ]
        lines.extend(f"{label:12}{self[label]:12.5g}{self.sigma(label):11.2g}" for label in self.labels)
        for one in self.factors[1:]:
            name = f"{one.kind}" if math.isnan(one.zeta) else f"{one.kind}s, w"
            lines.append(f"{name:12}{one.value:12.5g}{one.sigma:11.2g}  rad/s")
            if not math.isnan(one.zeta):
                lines.append(f"{'  zeta':12}{one.zeta:12.5g}{one.zeta_sigma:11.2g}")
        if self.fixed:
            lines.append(f"held: {', '.join(f'{name} {value:.5g}' for name, value in self.fixed.items())}")
        if self.cost > 100.0:
            lines.append(f"note: J = {self.cost:.0f} is above 100: the form is too simple, or the band too wide")
        if not self.converged:
            lines.append("note: the search did not converge: hold a coefficient, or ask for a lower order")
        return "\n".join(lines)

    def to_json(self) -> str:
        """Coefficients, standard deviations and cost as JSON text."""
        return json.dumps(
            {
                "estimates": {label: {"value": self[label], "sigma": self.sigma(label)} for label in self.labels},
                "fixed": dict(self.fixed),
                "numerator": self.numerator.tolist(),
                "denominator": self.denominator.tolist(),
                "dead_time": self.dead_time,
                "cost": self.cost,
                "band_rad_s": [float(self.omega[0]), float(self.omega[-1])],
                "converged": self.converged,
            }
        )

    def _all(self, values: Array) -> dict[str, float]:
        return {**self.fixed, **dict(zip(self.labels, values.tolist(), strict=True))}

    def _index(self, label: str) -> int:
        if label not in self.labels:
            raise IdentificationError(
                f"{shown(label)} was not estimated", "transfer fit", f"of {', '.join(self.labels)}"
            )
        return self.labels.index(label)

    def _factor(self, kind: str, letter: str, order: int, k: int) -> TransferFactor:
        """Return the factor of root `k`, a pair if the root is complex."""
        pair = _sorted_roots(self._all(self.values), letter, order)[k].imag != 0.0

        def figures(x: Array) -> Array:
            root = _sorted_roots(self._all(x), letter, order)[k]
            size = abs(root)
            return np.array([size, -root.real / size]) if pair else np.array([-root.real])

        slope = _jacobian(figures, self.values)
        sigma = np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", slope, self.covariance, slope), 0.0))
        both = zip(figures(self.values).tolist(), sigma.tolist(), strict=True)
        return TransferFactor(kind, *(figure for value_and_sigma in both for figure in value_and_sigma))


def fit_transfer(
    response: FrequencyResponse,
    numerator: int = 0,
    denominator: int = 1,
    *,
    power: int = 0,
    dead_time: bool = True,
    values: Mapping[str, float] | None = None,
    held: bool = True,
    band: tuple[float, float] | None = None,
    coherence: float = 0.6,
) -> TransferFit:
    """Fit s^power (b_m s^m + ... + b_0) / (s^k + a_k-1 s^k-1 + ... + a_0) exp(-tau s) of the orders m and k.

    The pitch rate's G_q is `fit_transfer(response, 0, 2, power=1)`: mu is b0, w_n^2 a0, 2 xi w_n a1. `power` -1 is an
    integrator. Without `dead_time` tau is 0. `values` holds coefficients at given values. `held`: the response is that
    of an input held over the record's step, so the hold (1 - exp(-j w T)) / (j w T) is part of the model. `band`: from
    and to these frequencies [rad/s]; points below `coherence` are left out.

    Minimised is J = 20/n sum W ((dB error)^2 + 0.01745 (degrees of phase error)^2), W = (1.58 (1 - exp(-coherence)))^2
    with the squared coherence that a `FrequencyResponse` holds. Start values come from linear least squares (Sanathanan
    and Koerner 1963) at several dead times. The standard deviations follow from the response's own error bars,
    neighbouring points counted as the share of an independent one that they are. Source: Tischler and Remple, Aircraft
    and Rotorcraft System Identification, chapter 11.

    Raises IdentificationError for orders outside 0 to 10, fewer points than unknowns, an unknown name in `values`, and
    coefficients that the data cannot tell apart.
    """
    if not isinstance(response, FrequencyResponse):
        raise IdentificationError(
            f"a {type(response).__name__} is not a frequency response", "fit_transfer", "call frequency_response first"
        )
    if band is not None and not (isinstance(band, Sequence) and len(band) == 2):
        raise IdentificationError(f"the band is {shown(band)}", "fit_transfer", "give (from, to) in rad/s")
    for name, order in (("numerator", numerator), ("denominator", denominator)):
        if isinstance(order, bool) or not isinstance(order, int) or not 0 <= order <= MAX_ORDER:
            raise IdentificationError(f"the {name}'s order is {shown(order)}", "fit_transfer", f"give 0 to {MAX_ORDER}")
    if isinstance(power, bool) or not isinstance(power, int) or abs(power) > MAX_ORDER:
        raise IdentificationError(f"power is {shown(power)}", "fit_transfer", f"give -{MAX_ORDER} to {MAX_ORDER}")
    names = (*(f"b{i}" for i in range(numerator + 1)), *(f"a{i}" for i in range(denominator)), "tau")
    fixed = {} if dead_time else {"tau": 0.0}
    for name, value in (values or {}).items():
        if name not in names:
            raise IdentificationError(f"there is no coefficient {shown(name)}", "values", f"of {nearest(name, names)}")
        if not (isinstance(value, (int, float)) and math.isfinite(value)):
            raise IdentificationError(f"{name} is {shown(value)}", "values", "give a finite number")
        fixed[name] = float(value)
    data = _Points.of(response, held, band, coherence, len(names) - len(fixed))
    labels = tuple(name for name in names if name not in fixed)
    if not labels:
        raise IdentificationError("every coefficient is held", "values", "leave one of them out")
    search = _Search(data, labels, fixed, (numerator, denominator), power)
    return search.fit()


@dataclass(frozen=True, eq=False)
class _Points:
    """Points to fit: logarithms of gain and phase, their weights, and their standard deviations."""

    omega: Array
    measured: Complex
    hold: Complex
    weight: Array
    relative: Array
    spacing: Array

    @classmethod
    def of(
        cls, response: FrequencyResponse, held: bool, band: tuple[float, float] | None, coherence: float, unknowns: int
    ) -> "_Points":
        low, high = (0.0, math.inf) if band is None else band
        use = response.trusted(coherence) & (response.omega >= low) & (response.omega <= high)
        use &= np.isfinite(response.sigma) & (abs(response.response) > 0.0)
        if 2 * np.count_nonzero(use) <= unknowns:
            raise IdentificationError(
                f"{np.count_nonzero(use)} points with a coherence of {coherence:g} and more",
                f"response {response.output} / {response.input}",
                "widen the band, lower the coherence asked for, or take a longer record",
            )
        w, h, gamma = response.omega[use], response.response[use], response.coherence[use]
        hold = -np.expm1(-1j * w * response.dt) / (1j * w * response.dt) if held else np.ones_like(h)
        weight = 1.58 * -np.expm1(-gamma)
        return cls(w, h, np.asarray(hold), weight, response.sigma[use] / abs(h), response.spacing[use])

    def rows(self, model: Complex) -> Array:
        """Residuals whose sum of squares is J: decibels, then degrees with their weight."""
        ratio = self.measured / (model * self.hold)
        factor = math.sqrt(20.0 / self.omega.size) * self.weight
        decibel = 20.0 * np.log10(np.maximum(abs(ratio), 1e-300))
        degrees = np.degrees(np.angle(ratio))
        return np.concatenate([factor * decibel, factor * math.sqrt(_DEGREES_IN_DECIBEL) * degrees])

    def deviation(self) -> Array:
        """Return the standard deviations of `rows`, larger for points that are not independent."""
        shared = np.sqrt(np.maximum(self.spacing, 1.0))
        factor = math.sqrt(20.0 / self.omega.size) * self.weight * self.relative * shared
        decibel = 20.0 / math.log(10.0)
        return np.concatenate([factor * decibel, factor * math.sqrt(_DEGREES_IN_DECIBEL) * math.degrees(1.0)])


@dataclass(frozen=True, eq=False)
class _Search:
    data: _Points
    labels: tuple[str, ...]
    fixed: dict[str, float]
    orders: tuple[int, int]
    power: int

    def fit(self) -> TransferFit:
        from scipy.optimize import least_squares  # imported late: most commands start without it

        start = self._start()
        # Coefficients of different powers differ by many decades: each is searched in units of its own size.
        size = np.array([self._size(label) for label in self.labels])
        found = least_squares(lambda z: self._rows(z * size), start / size, x_scale="jac", method="trf", max_nfev=400)
        x = np.asarray(found.x * size)
        slope = _jacobian(self._rows, x)
        return TransferFit(
            self.labels,
            x,
            self._covariance(slope),
            self.fixed,
            self.orders,
            self.power,
            float(found.fun @ found.fun),
            self.data.omega,
            bool(found.status > 0),
        )

    def _rows(self, x: Array) -> Array:
        with np.errstate(all="ignore"):
            rows = self.data.rows(_transfer(self._all(x), self.orders, self.power, self.data.omega))
        return np.where(np.isfinite(rows), rows, 1e6)

    def _all(self, x: Array) -> dict[str, float]:
        return {**self.fixed, **dict(zip(self.labels, x.tolist(), strict=True))}

    def _size(self, label: str) -> float:
        middle = math.exp(float(np.log(self.data.omega).mean()))
        if label == "tau":
            return 1.0 / float(self.data.omega[-1])
        k = self.orders[1]
        if label[0] == "a":
            return middle ** (k - int(label[1:]))
        level = math.exp(float(np.log(abs(self.data.measured)).mean()))
        return float(level * middle ** (k - self.power - int(label[1:])))

    def _start(self) -> Array:
        """Return the best of the linear solutions at several dead times."""
        longest = 2.0 * math.pi / float(self.data.omega[-1])
        delays = [self.fixed["tau"]] if "tau" in self.fixed else np.linspace(0.0, 2.0 * longest, _DELAYS).tolist()
        best, lowest = np.array([self._size(label) for label in self.labels]), math.inf
        for delay in delays:
            x = self._linear(delay)
            rows = self._rows(x)
            cost = float(rows @ rows)
            if cost < lowest:
                best, lowest = x, cost
        return best

    def _linear(self, delay: float) -> Array:
        """Solve B - H A = 0 for b and a by least squares at one dead time, re-weighted by the last 1 / A."""
        s = 1j * self.data.omega
        h = self.data.measured / (self.data.hold * np.exp(-s * delay) * s**self.power)
        names = [label for label in self.labels if label != "tau"]
        values = dict.fromkeys((f"a{i}" for i in range(self.orders[1])), 0.0) | self.fixed | {"tau": delay}
        last = np.ones_like(h)
        for _ in range(8):
            scale = self.data.weight / np.maximum(abs(h * last), 1e-300)
            target = h * s ** self.orders[1]
            columns = []
            for i in range(self.orders[0] + 1):
                if f"b{i}" in self.fixed:
                    target = target - self.fixed[f"b{i}"] * s**i
                else:
                    columns.append(s**i)
            for i in range(self.orders[1]):
                if f"a{i}" in self.fixed:
                    target = target + self.fixed[f"a{i}"] * h * s**i
                else:
                    columns.append(-h * s**i)
            if not columns:
                break
            matrix = np.array(columns).T * scale[:, None]
            size = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
            both = np.concatenate([(matrix / size).real, (matrix / size).imag])
            right = np.concatenate([(target * scale).real, (target * scale).imag])
            solved = np.linalg.lstsq(both, right, rcond=None)[0] / size
            values |= dict(zip(names, solved.tolist(), strict=True))
            last = np.polyval(_denominator(values, self.orders[1], 0), s)
        return np.array([values[label] for label in self.labels])

    def _covariance(self, slope: Array) -> Array:
        """(J'J)^-1 J' R J (J'J)^-1 with R of the error bars; neighbours that are not independent count as a share."""
        length = np.linalg.norm(slope, axis=0)
        if not (np.isfinite(length).all() and (length > 0.0).all()):
            raise IdentificationError("the fit is not finite", "fit_transfer", "ask for a lower order or narrower band")
        unit = slope / length
        if np.linalg.svd(unit, compute_uv=False)[-1] < 1e-7:
            raise IdentificationError(
                "the response cannot tell the coefficients apart",
                "fit_transfer",
                "lower the order, or hold one of them",
            )
        bread = np.linalg.inv(unit.T @ unit)
        spread = unit * self.data.deviation()[:, None]
        inner = bread @ (spread.T @ spread) @ bread
        return np.asarray(inner / np.outer(length, length))


def _numerator(values: Mapping[str, float], order: int, power: int) -> Array:
    return np.array([values[f"b{i}"] for i in range(order, -1, -1)] + [0.0] * max(power, 0))


def _denominator(values: Mapping[str, float], order: int, power: int) -> Array:
    return np.array([1.0, *(values[f"a{i}"] for i in range(order - 1, -1, -1))] + [0.0] * max(-power, 0))


def _transfer(values: Mapping[str, float], orders: tuple[int, int], power: int, omega: Array) -> Complex:
    s = 1j * omega
    top, bottom = (
        np.polyval(_numerator(values, orders[0], power), s),
        np.polyval(_denominator(values, orders[1], power), s),
    )
    return np.asarray(top / bottom * np.exp(-s * values["tau"]))


def _jacobian(function: Callable[[Array], Array], x: Array) -> Array:
    """Central differences, shape (rows, unknowns)."""
    columns = []
    for i in range(x.size):
        step = np.zeros_like(x)
        step[i] = _STEP * max(abs(float(x[i])), 1e-6)
        columns.append((function(x + step) - function(x - step)) / (2.0 * step[i]))
    return np.array(columns).T


def _sorted_roots(values: Mapping[str, float], letter: str, order: int) -> Complex:
    """Roots by size, pairs beside each other."""
    row = _numerator(values, order, 0) if letter == "b" else _denominator(values, order, 0)
    roots = np.roots(row).astype(np.complex128)
    return roots[np.lexsort((roots.imag, np.round(abs(roots), 9)))]


def _polynomial(letter: str, order: int) -> str:
    terms = [f"{letter}{i}" + (f" s^{i}" if i > 1 else " s" if i else "") for i in range(order, -1, -1)]
    if letter == "a":
        terms[0] = f"s^{order}" if order > 1 else "s" if order else "1"
    return f"({' + '.join(terms)})"
