"""The result of a fit: values with units and uncertainty, how well the model reproduces the data, and the checks."""

import json
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError
from twodof.identify.validate import Comparison, deviations

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Estimate:
    """What a fit found.

    `values`, `covariance` and `robust` are in the order of `labels` (SI units, `units`); an unknown held by a bound
    has NaN variance; `local` are the labels that belong to one record (initial states, trim, bias). `covariance`
    supposes white residuals and is then the Cramer-Rao bound at the estimate; `robust` holds for coloured ones too.
    `noise` is each output's residual standard deviation. `identification` and `validation` compare model and data,
    one entry an output of a record.
    """

    structure: str
    labels: tuple[str, ...]
    units: tuple[str, ...]
    local: frozenset[str]
    values: Array
    covariance: Array
    robust: Array
    noise: dict[str, float]
    fixed: dict[str, float]
    at_bound: tuple[str, ...]
    condition_number: float
    identification: tuple[Comparison, ...]
    validation: tuple[Comparison, ...]
    iterations: int
    converged: bool
    domain: str

    def __getitem__(self, label: str) -> float:
        """The value of an unknown. Raises IdentificationError for an unknown name."""
        return float(self.values[self._index(label)])

    @property
    def white(self) -> bool:
        """Whether the residuals of every identification record passed the whiteness test."""
        return all(c.whiteness is None or c.whiteness.passed for c in self.identification)

    @property
    def wanders(self) -> bool:
        """Whether the residual of an identification record wanders (`Comparison.wanders`): all sigma are too small."""
        return any(c.wanders for c in self.identification)

    @property
    def quoted(self) -> Array:
        """The covariance to quote: `covariance` if the residuals are white, else `robust`."""
        return self.covariance if self.white else self.robust

    def sigma(self, label: str) -> float:
        """The standard deviation to quote (see `quoted`)."""
        return math.sqrt(float(np.diag(self.quoted)[self._index(label)]))

    def cramer_rao(self, label: str) -> float:
        """The Cramer-Rao bound on the standard deviation, at the estimate and for white noise of the size found."""
        return math.sqrt(float(np.diag(self.covariance)[self._index(label)]))

    def interval(self, label: str, level: float = 0.95) -> tuple[float, float]:
        """The confidence interval at `level` (normal distribution, standard deviation as quoted).

        Raises IdentificationError for an unknown name and for a level that is not between 0 and 1.
        """
        half = deviations(level) * self.sigma(label)
        return self[label] - half, self[label] + half

    @property
    def correlation(self) -> Array:
        """Correlation matrix of the estimates, from the quoted covariance."""
        deviation = np.sqrt(np.diag(self.quoted))
        return np.asarray(self.quoted / np.outer(deviation, deviation))

    @property
    def held(self) -> dict[str, float]:
        """The unknowns that had a given value other than 0 in this fit."""
        return {name: value for name, value in self.fixed.items() if value != 0.0}

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a reader should know before using the figures, one sentence each with what to do about it."""
        found = []
        if not self.converged:
            found.append("the search did not converge: give better first guesses or fix unknowns")
        found.extend(f"{label} is held by its bound: widen the bound or fix it" for label in self.at_bound)
        if "xi" in self.labels and self["xi"] < 0.0:
            found.append(
                "xi is negative, a swing that grows by itself: the record does not show the damping. "
                "Hold w_n and xi at those of a free response"
            )
        for i, label in enumerate(self.labels):
            deviation = math.sqrt(self.quoted[i, i])
            if label not in self.local and deviation > abs(self.values[i]):
                found.append(f"the data hardly tell {label}: {self.values[i]:.3g} +- {deviation:.2g}")
        correlation = self.correlation
        for i in range(len(self.labels)):
            found.extend(
                f"{self.labels[j]} and {self.labels[i]} are hardly told apart "
                f"(correlation {correlation[i, j]:.3f}): fix one or add an experiment"
                for j in range(i)
                if abs(correlation[i, j]) > 0.98
            )
        if not self.white:
            found.append(
                "the residuals are not white, so the robust standard deviations are quoted: "
                "the structure or the noise model leaves something out"
            )
        found.extend(
            f"the residual of {c.output} in '{c.record}' wanders, so the standard deviations are too small by an "
            "unknown factor: something pushes the drone itself, as a gust does, or the structure is wrong. Repeat the "
            "flight and believe the spread of the estimates"
            for c in self.identification
            if c.wanders
        )
        for c in self.identification:
            found.extend(
                f"the residual of {c.output} in '{c.record}' still depends on {name}: the structure leaves out a part "
                "of the response"
                for name, test in c.inputs.items()
                if not test.passed
            )
        return tuple(found)

    def table(self) -> str:
        """Values, standard deviations (white, robust), fits and remarks as text for a terminal."""
        width = max(12, *(len(label) for label in self.labels)) + 1
        lines = [f"{self.structure} ({self.domain}), condition number {self.condition_number:.3g}"]
        lines.append(f"{'':{width}}{'estimate':>12}{'1 sigma':>11}{'robust':>11}  unit")
        for i, label in enumerate(self.labels):
            white, robust = math.sqrt(self.covariance[i, i]), math.sqrt(self.robust[i, i])
            # Of residuals that wander all that is known is that it is more.
            least = f"{'> ' if self.wanders and not math.isnan(robust) else ''}{robust:.2g}"
            lines.append(f"{label:{width}}{self.values[i]:12.5g}{white:11.2g}{least:>11}  {self.units[i] or '-'}")
        if self.held:
            lines.append(f"held: {', '.join(f'{name} {value:.5g}' for name, value in self.held.items())}")
        for title, comparisons in (("identification", self.identification), ("validation", self.validation)):
            lines.extend(
                f"{title}: {c.output} in '{c.record}': FIT {c.fit_percent:.2f} %, VAF {c.vaf:.2f} %, RMSE {c.rmse:.3g}"
                for c in comparisons
            )
        lines.extend(f"note: {remark}" for remark in self.remarks)
        return "\n".join(lines)

    def to_json(self) -> str:
        """Everything but the signals as JSON text; NaN is null."""
        return json.dumps(
            {
                "structure": self.structure,
                "domain": self.domain,
                "estimates": {
                    label: {
                        "value": float(self.values[i]),
                        "unit": self.units[i],
                        "sigma": _number(self.covariance[i, i]),
                        "sigma_robust": _number(self.robust[i, i]),
                    }
                    for i, label in enumerate(self.labels)
                },
                "fixed": self.fixed,
                "noise": self.noise,
                "condition_number": self.condition_number,
                "correlation": [[_plain(v) for v in row] for row in self.correlation],
                "identification": [c.to_json() for c in self.identification],
                "validation": [c.to_json() for c in self.validation],
                "converged": self.converged,
                "iterations": self.iterations,
                "remarks": list(self.remarks),
            },
            indent=2,
            allow_nan=False,
        )

    def _index(self, label: str) -> int:
        if label not in self.labels:
            raise IdentificationError(
                f"'{label}' was not estimated", f"structure '{self.structure}'", f"were: {', '.join(self.labels)}"
            )
        return self.labels.index(label)


def _number(variance: float) -> float | None:
    return math.sqrt(variance) if variance >= 0.0 else None


def _plain(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
