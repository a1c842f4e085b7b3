"""A transfer function fitted to a measured frequency response (what CIFER's NAVFIT does)."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.errors import IdentificationError, is_number, nearest, shown
from twodof.identify.frequency_response import FrequencyResponse
from twodof.identify.problem import number_pair
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
            raise IdentificationError(f"no coefficient named {shown(label)}", "transfer fit", f"of {', '.join(found)}")
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
        return _polynomials(self._all(self.values), self.orders, self.power)[0]

    @property
    def denominator(self) -> Array:
        """Coefficients by falling powers of s, the first one 1, the integrators included."""
        return _polynomials(self._all(self.values), self.orders, self.power)[1]

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
        for row, kind in enumerate(("zero", "pole")):
            roots = self._roots(self.values, row)
            found += [self._factor(kind, row, k) for k in np.flatnonzero(roots.imag <= 0.0).tolist()]
        return tuple(found)

    def table(self) -> str:
        """Coefficients and factors with standard deviations, and J, as text."""
        free = f"s^{self.power} " if self.power > 0 else f"1/s^{-self.power} " if self.power < 0 else ""
        form = f"{free}{_polynomial('b', self.orders[0])} / {_polynomial('a', self.orders[1])}"
        span = f"{self.omega.size} points from {self.omega[0]:.3g} to {self.omega[-1]:.3g} rad/s"
        lines = [f"{form} exp(-tau s), {span}, J = {self.cost:.3g}", f"{'':12}{'estimate':>12}{'1 sigma':>11}"]
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

    def _all(self, values: Array) -> dict[str, float]:
        return {**self.fixed, **dict(zip(self.labels, values.tolist(), strict=True))}

    def _index(self, label: str) -> int:
        if label not in self.labels:
            raise IdentificationError(
                f"{shown(label)} was not estimated", "transfer fit", f"estimated are: {', '.join(self.labels)}"
            )
        return self.labels.index(label)

    def _roots(self, values: Array, row: int) -> Complex:
        """Return the zeros (row 0) or poles (row 1), without the free factors s, by size, pairs beside each other."""
        roots = np.roots(_polynomials(self._all(values), self.orders, 0)[row]).astype(np.complex128)
        return roots[np.lexsort((roots.imag, np.round(abs(roots), 9)))]

    def _factor(self, kind: str, row: int, k: int) -> TransferFactor:
        """Return the factor of root `k`, a pair if the root is complex."""
        pair = self._roots(self.values, row)[k].imag != 0.0

        def figures(x: Array) -> Array:
            root = self._roots(x, row)[k]
            size = abs(root)
            return np.array([size, -root.real / size]) if pair else np.array([-root.real])

        slope = _jacobian(figures, self.values)
        sigma = np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", slope, self.covariance, slope), 0.0))
        return TransferFactor(kind, *np.column_stack([figures(self.values), sigma]).ravel().tolist())


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

    Raises IdentificationError for orders outside 0 to 10, fewer points than unknowns, an unknown name or a number that
    is not finite in `values`, and coefficients that the data cannot tell apart.
    """
    from scipy.optimize import least_squares  # imported late: most commands start without it

    if not isinstance(response, FrequencyResponse):
        remedy = "call frequency_response first"
        raise IdentificationError(f"{shown(response)} is not a frequency response", "fit_transfer", remedy)
    low, high = (0.0, math.inf) if band is None else number_pair(band)
    if not low <= high:
        raise IdentificationError(f"the band is {shown(band)}", "fit_transfer", "give (from, to) in rad/s")
    orders = (numerator, denominator)
    for what, order, least in (
        ("numerator's order", numerator, 0),
        ("denominator's order", denominator, 0),
        ("power of s", power, -MAX_ORDER),
    ):
        if not is_number(order, least, MAX_ORDER, whole=True):
            raise IdentificationError(f"the {what} is {shown(order)}", "fit_transfer", f"give {least} to {MAX_ORDER}")
    names = (*(f"b{i}" for i in range(numerator + 1)), *(f"a{i}" for i in range(denominator)), "tau")
    fixed = {**({} if dead_time else {"tau": 0.0}), **(values or {})}
    for name, value in fixed.items():
        if name not in names:
            raise IdentificationError(f"no coefficient named {shown(name)}", "values", f"of {nearest(name, names)}")
        if not is_number(value):
            raise IdentificationError(f"{name} is {shown(value)}", "values", "give a finite number")
    labels = tuple(name for name in names if name not in fixed)
    if not labels:
        raise IdentificationError("every coefficient is held", "values", "leave one of them out")
    use = response.trusted(coherence) & (response.omega >= low) & (response.omega <= high)
    use &= np.isfinite(response.sigma) & (abs(response.response) > 0.0)
    if 2 * np.count_nonzero(use) <= len(labels):
        raise IdentificationError(
            f"{np.count_nonzero(use)} points with a coherence of {coherence:g} and more",
            f"response {response.output} / {response.input}",
            "widen the band, lower the coherence asked for, or take a longer record",
        )
    w, measured = response.omega[use], response.response[use]
    turn = 1j * w * response.dt
    free = np.asarray(measured * turn / -np.expm1(-turn) if held else measured, dtype=np.complex128)
    trust = -1.58 * np.expm1(-response.coherence[use])
    # Rows are decibels, then degrees with their weight, of the logarithm's real and imaginary part.
    row = math.sqrt(20.0 / w.size) * trust
    weight = np.concatenate([20.0 / math.log(10.0) * row, math.degrees(math.sqrt(_DEGREES_IN_DECIBEL)) * row])

    def rows(x: Array) -> Array:
        with np.errstate(all="ignore"):
            error = np.log(free / _transfer(fixed | dict(zip(labels, x.tolist(), strict=True)), orders, power, w))
            found = weight * np.concatenate([error.real, error.imag])
        return np.where(np.isfinite(found), found, 1e6)

    # Coefficients of different powers differ by many decades: each is searched in units of its own size.
    middle, level = (math.exp(float(np.log(one).mean())) for one in (w, abs(measured)))
    sizes = {"tau": 1.0 / float(w[-1])}
    sizes |= {f"a{i}": middle ** (denominator - i) for i in range(denominator)}
    sizes |= {f"b{i}": level * middle ** (denominator - power - i) for i in range(numerator + 1)}
    size = np.array([sizes[label] for label in labels])
    longest = 4.0 * math.pi / float(w[-1])
    delays = [fixed["tau"]] if "tau" in fixed else np.linspace(0.0, longest, _DELAYS).tolist()
    starts = [
        _linear(w, free * np.exp(1j * w * tau), trust, labels, fixed | {"tau": tau}, orders, power) for tau in delays
    ]
    costs = [float(one @ one) for one in map(rows, starts)]
    start = starts[int(np.argmin(costs))] if np.isfinite(costs).any() else size
    found = least_squares(lambda z: rows(z * size), start / size, x_scale="jac", method="trf", max_nfev=400)
    x = np.asarray(found.x * size)
    # Neighbours that are not independent count as a share.
    deviation = weight * np.tile(
        response.sigma[use] / abs(measured) * np.sqrt(np.maximum(response.spacing[use], 1.0)), 2
    )
    covariance, cost = _covariance(_jacobian(rows, x), deviation), float(found.fun @ found.fun)
    return TransferFit(labels, x, covariance, fixed, orders, power, cost, w, bool(found.status > 0))


def _linear(
    omega: Array,
    h: Complex,
    trust: Array,
    labels: Sequence[str],
    fixed: Mapping[str, float],
    orders: tuple[int, int],
    power: int,
) -> Array:
    """Solve B - H A = 0 for b and a by least squares at the dead time in `fixed`, re-weighted by the last 1 / A."""
    s = 1j * omega
    h = np.asarray(h / s**power, dtype=np.complex128)
    columns = {f"b{i}": s**i for i in range(orders[0] + 1)} | {f"a{i}": -h * s**i for i in range(orders[1])}
    target = h * s ** orders[1] - sum(value * columns[name] for name, value in fixed.items() if name != "tau")
    names = [label for label in labels if label != "tau"]
    values, last = dict(fixed), np.ones_like(h)
    for _ in range(8 if names else 0):
        scale = trust / np.maximum(abs(h * last), 1e-300)
        matrix = np.array([columns[name] for name in names]).T * scale[:, None]
        size = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
        both = np.concatenate([(matrix / size).real, (matrix / size).imag])
        right = np.concatenate([(target * scale).real, (target * scale).imag])
        solved = np.linalg.lstsq(both, right, rcond=None)[0] / size
        values |= dict(zip(names, solved.tolist(), strict=True))
        last = np.asarray(np.polyval(_polynomials(values, orders, 0)[1], s), dtype=np.complex128)
    return np.array([values[label] for label in labels])


def _covariance(slope: Array, deviation: Array) -> Array:
    """Return (J'J)^-1 J' R J (J'J)^-1 with R of the error bars, the `deviation` of each row."""
    length = np.linalg.norm(slope, axis=0)
    unit = slope / np.where(length > 0.0, length, 1.0)
    if not np.isfinite(unit).all() or np.linalg.svd(unit, compute_uv=False)[-1] < 1e-7:
        what = "the response cannot tell the coefficients apart"
        raise IdentificationError(what, "fit_transfer", "lower the order, hold one of them, or narrow the band")
    bread = np.linalg.inv(unit.T @ unit)
    spread = unit * deviation[:, None]
    return np.asarray(bread @ (spread.T @ spread) @ bread / np.outer(length, length))


def _polynomials(values: Mapping[str, float], orders: tuple[int, int], power: int) -> tuple[Array, Array]:
    """Return numerator and denominator by falling powers of s, the free factors s included."""
    top = [values[f"b{i}"] for i in range(orders[0], -1, -1)]
    bottom = [1.0, *(values[f"a{i}"] for i in range(orders[1] - 1, -1, -1))]
    return np.array(top + [0.0] * max(power, 0)), np.array(bottom + [0.0] * max(-power, 0))


def _transfer(values: Mapping[str, float], orders: tuple[int, int], power: int, omega: Array) -> Complex:
    s = 1j * omega
    top, bottom = (np.polyval(row, s) for row in _polynomials(values, orders, power))
    return np.asarray(top / bottom * np.exp(-s * values["tau"]))


def _jacobian(function: Callable[[Array], Array], x: Array) -> Array:
    """Return central differences, shape (rows, unknowns)."""
    steps = np.diag(_STEP * np.maximum(np.abs(x), 1e-6))
    return np.array([(function(x + step) - function(x - step)) / (2.0 * step.sum()) for step in steps]).T


def _polynomial(letter: str, order: int) -> str:
    terms = [f"{letter}{i}" + (f" s^{i}" if i > 1 else " s" if i else "") for i in range(order, -1, -1)]
    if letter == "a":
        terms[0] = f"s^{order}" if order > 1 else "s" if order else "1"
    return f"({' + '.join(terms)})"
