"""Stepwise regression: which of many terms an equation needs, entered and removed one by one (as SIDPAC does)."""

import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.errors import IdentificationError, listed, shown
from twodof.identify.covariance import ResidualRows, robust_covariance

Array = NDArray[np.float64]

MAX_TERMS = 200
_CONSTANT = "1"
_SMALLEST, _LARGEST = 1e-100, 1e100


@dataclass(frozen=True)
class RegressionStep:
    """What happened: a term `entered` or was `removed` ("" for none), and R^2 [%], PSE and the partial F after it."""

    entered: str
    removed: str
    r_squared: float
    pse: float
    partial_f: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Stepwise:
    """response = sum of coefficients times terms + noise.

    `terms` in the order in which they entered, the constant "1" first; `coefficients` and `sigma` follow them. `sigma`
    holds for coloured residuals too. `steps` is the history, `candidates` what could have entered.
    """

    terms: tuple[str, ...]
    coefficients: Array
    sigma: Array
    steps: tuple[RegressionStep, ...]
    candidates: tuple[str, ...]
    residual: Array

    def __getitem__(self, term: str) -> float:
        """The coefficient of a term, 0 for a candidate that did not enter. Raises IdentificationError for others."""
        if term in self.terms:
            return float(self.coefficients[self.terms.index(term)])
        if term in self.candidates:
            return 0.0
        raise IdentificationError(
            f"there is no term {shown(term)}", "stepwise", f"there are: {listed(self.candidates)}"
        )

    def table(self) -> str:
        """The terms with their standard deviations and partial F, and how they came in, as text."""
        last = self.steps[-1]
        width = max(8, *(len(name) for name in self.candidates)) + 1
        lines = [f"{'':{width}}{'estimate':>12}{'1 sigma':>11}{'partial F':>11}"]
        lines.extend(
            f"{name:{width}}{self.coefficients[i]:12.5g}{self.sigma[i]:11.2g}"
            + (f"{last.partial_f[name]:11.3g}" if name in last.partial_f else "")
            for i, name in enumerate(self.terms)
        )
        for one in self.steps[1:]:
            sign = f"+ {one.entered}" if one.entered else f"- {one.removed}"
            lines.append(f"{sign:{width + 2}} R^2 {one.r_squared:6.2f} %, PSE {one.pse:.4g}")
        return "\n".join(lines)

    def to_json(self) -> str:
        """Terms and history as JSON text."""
        return json.dumps(
            {
                "terms": {
                    name: {"value": float(self.coefficients[i]), "sigma": float(self.sigma[i])}
                    for i, name in enumerate(self.terms)
                },
                "steps": [
                    {"entered": one.entered, "removed": one.removed, "r_squared": one.r_squared, "pse": one.pse}
                    for one in self.steps
                ],
            }
        )


def stepwise(
    response: ArrayLike,
    candidates: Mapping[str, ArrayLike],
    *,
    always: Collection[str] = (),
    enter: float = 4.0,
    remove: float = 4.0,
    noise: float | None = None,
    coloured: bool = True,
) -> Stepwise:
    """Choose the terms of a linear regression among `candidates`, arrays of the shape (n,) of the response.

    The constant and the terms in `always` are in from the start. In each round the candidate with the largest partial
    correlation with what is left enters, then each term whose partial F is below `remove` leaves. It ends when the next
    one's F would be below `enter`. It also ends when the predicted squared error PSE = SS/n + s^2 p/n no longer falls.
    Here p is the number of terms, and s^2 = `noise`^2. By default s^2 is the variance of the response about its mean,
    which is cautious (Barron 1984). F = 4 is the 95 % bound of one term for n above 100.

    Partial F is (coefficient / standard deviation)^2. With `coloured` that deviation is the one for the colour that the
    residuals show (Morelli and Klein 1997); white residuals are what textbooks suppose, and flights hardly ever have.

    For equation error the response is a derivative, as q', which has to come from smoothed data; noise in a term makes
    its coefficient small. Source: Klein and Morelli, Aircraft System Identification, section 5.4.

    Raises IdentificationError for arrays of other shapes or with NaN, and for terms that are constant or repeat each
    other. It is also raised for names in `always` that are not there, and for fewer rows than terms.
    """
    y, columns = _checked(response, candidates)
    always = (always,) if isinstance(always, str) else always
    if noise is not None and not (math.isfinite(noise) and noise >= 0.0):
        raise IdentificationError(f"noise is {noise:g}", "stepwise", "give a standard deviation of 0 or more")
    for name in always:
        if name not in columns:
            raise IdentificationError(f"there is no term {shown(name)}", "always", f"there are: {listed(columns)}")
    if not (enter > 0.0 and 0.0 < remove <= enter):
        raise IdentificationError(
            f"enter {enter:g}, remove {remove:g}", "stepwise", "give 0 < remove <= enter, else a term comes and goes"
        )
    spread = float(np.var(y)) if noise is None else float(noise) ** 2
    fixed = [_CONSTANT, *always]
    held = list(fixed)
    steps = [_step(y, columns, held, spread, coloured, "", "")]
    seen = {tuple(sorted(held))}
    while len(held) - 1 < len(columns):
        best = _next(y, columns, held)
        if best is None:
            break
        trial = _step(y, columns, [*held, best], spread, coloured, best, "")
        if trial.partial_f[best] < enter or trial.pse >= steps[-1].pse:
            break
        held.append(best)
        steps.append(trial)
        while True:
            weak = min(
                (name for name in held if name not in fixed), key=lambda name: steps[-1].partial_f[name], default=None
            )
            if weak is None or steps[-1].partial_f[weak] >= remove:
                break
            held.remove(weak)
            steps.append(_step(y, columns, held, spread, coloured, "", weak))
        state = tuple(sorted(held))
        if state in seen:  # the same terms again: it would go round
            break
        seen.add(state)
    coefficients, sigma, residual = _solve(y, columns, held, coloured)
    return Stepwise(tuple(held), coefficients, sigma, tuple(steps), tuple(columns), residual)


def _checked(response: ArrayLike, candidates: Mapping[str, ArrayLike]) -> tuple[Array, dict[str, Array]]:
    y = _array("response", response)
    if not isinstance(candidates, Mapping):
        raise IdentificationError(
            f"a {type(candidates).__name__} is not terms by name", "stepwise", 'give {"q": q, "theta^3": theta**3}'
        )
    if not 1 <= len(candidates) <= MAX_TERMS:
        raise IdentificationError(f"{len(candidates)} candidates", "stepwise", f"give 1 to {MAX_TERMS}")
    columns = {}
    for name, value in candidates.items():
        column = _array(name, value)
        if column.shape != y.shape:
            raise IdentificationError(f"{name!r:.80} has {column.size} rows, the response {y.size}", "stepwise")
        if name == _CONSTANT or float(np.ptp(column)) == 0.0:
            raise IdentificationError(
                f"the term {name!r:.80} is constant", "stepwise", "leave it out: 1 is always there"
            )
        columns[name] = column
    if y.size <= len(columns) + 2:
        raise IdentificationError(f"{y.size} rows for {len(columns)} candidates", "stepwise", "use more data")
    if float(np.ptp(y)) == 0.0:
        raise IdentificationError("the response is constant", "stepwise", "choose a window with excitation")
    return y, columns


def _array(name: str, value: ArrayLike) -> Array:
    try:
        found = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as reason:
        raise IdentificationError(f"{name!r:.80} is not an array of numbers", "stepwise") from reason
    if found.ndim != 1 or not found.size:
        raise IdentificationError(f"{name!r:.80} has the shape {found.shape}", "stepwise", "give (n,)")
    if not np.isfinite(found).all():
        raise IdentificationError(f"{name!r:.80} holds NaN or infinity", "stepwise", "leave those rows out")
    size = float(np.abs(found).max())
    if size and not _SMALLEST < size < _LARGEST:
        raise IdentificationError(
            f"{name!r:.80} reaches {size:.3g}", "stepwise", "scale it: its squares must be numbers"
        )
    return found


def _matrix(columns: Mapping[str, Array], held: Sequence[str], rows: int) -> Array:
    return np.column_stack([np.ones(rows) if name == _CONSTANT else columns[name] for name in held])


def _solve(y: Array, columns: Mapping[str, Array], held: Sequence[str], coloured: bool) -> tuple[Array, Array, Array]:
    """Coefficients, their standard deviations, and what is left."""
    matrix = _matrix(columns, held, y.size)
    length = np.linalg.norm(matrix, axis=0)
    unit = matrix / length
    if np.linalg.svd(unit, compute_uv=False)[-1] < 1e-8:
        raise IdentificationError(f"{listed(held)} repeat each other", "stepwise", "leave one of them out")
    solved = np.linalg.lstsq(unit, y, rcond=None)[0]
    left = y - unit @ solved
    deviation = math.sqrt(float(left @ left) / max(1, y.size - len(held)))
    if deviation <= 1e-12 * float(np.abs(y).max()):  # an exact equation leaves rounding
        return solved / length, np.full(len(held), 1e-12 * float(np.abs(y).max())) / length, left
    if coloured:
        block = ResidualRows(0, "response", slice(0, y.size), np.arange(y.size))
        spread = robust_covariance(unit / deviation, left / deviation, [block], spectral=False)
    else:
        spread = deviation**2 * np.linalg.inv(unit.T @ unit)
    return solved / length, np.sqrt(np.maximum(np.diag(spread), 1e-300)) / length, left


def _next(y: Array, columns: Mapping[str, Array], held: Sequence[str]) -> str | None:
    """The candidate with the largest partial correlation; None where the rest repeat what is in."""
    basis, _ = np.linalg.qr(_matrix(columns, held, y.size))
    left = y - basis @ (basis.T @ y)
    best, highest = None, 0.0
    for name, column in columns.items():
        if name in held:
            continue
        own = column - basis @ (basis.T @ column)
        own = own - basis @ (basis.T @ own)
        size = float(np.linalg.norm(own))
        if size <= 1e-7 * float(np.linalg.norm(column - column.mean())):
            continue
        share = abs(float(own @ left)) / size
        if share > highest:
            best, highest = name, share
    return best


def _step(
    y: Array,
    columns: Mapping[str, Array],
    held: Sequence[str],
    spread: float,
    coloured: bool,
    entered: str,
    removed: str,
) -> RegressionStep:
    coefficients, sigma, left = _solve(y, columns, held, coloured)
    squares = float(left @ left)
    total = float(((y - y.mean()) ** 2).sum())
    partial = {name: float((coefficients[i] / sigma[i]) ** 2) for i, name in enumerate(held) if name != _CONSTANT}
    pse = squares / y.size + spread * len(held) / y.size
    return RegressionStep(entered, removed, 100.0 * (1.0 - squares / total), pse, partial)
