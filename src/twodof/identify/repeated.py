"""The same estimate from several flights, each by itself: how far they spread beside what each of them claims."""

import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twodof.errors import IdentificationError, finite
from twodof.identify.disturbance.disturbance_model import Disturbance
from twodof.identify.estimate import Estimate
from twodof.identify.greybox import fit
from twodof.identify.record import Record, check_record
from twodof.models.polynomial import PolynomialModel
from twodof.models.structure import Structure


@dataclass(frozen=True)
class Spread:
    """Standard deviation of an estimate among `count` repetitions."""

    value: float
    count: int

    def exceeds(self, sigma: float) -> bool:
        """Return True if it is too large for chance, given `sigma` (chi-square, once in a thousand)."""
        from scipy.special import chdtri  # imported late: most commands start without it

        return (self.count - 1) * (self.value / sigma) ** 2 > float(chdtri(self.count - 1, 0.001))


@dataclass(frozen=True, eq=False)
class Repeated:
    """One fit a flight: `names` and `estimates` in the same order, at least two; all found the same unknowns."""

    names: tuple[str, ...]
    estimates: tuple[Estimate, ...]

    def __post_init__(self) -> None:
        check_repetitions(self.names)

    @property
    def labels(self) -> tuple[str, ...]:
        """The unknowns that are the machine's and not one record's, and the sums of them."""
        first = self.estimates[0]
        return (*(label for label in first.labels if label not in first.local), *first.summed)

    @property
    def converged(self) -> bool:
        """Return True if all fits converged."""
        return all(one.converged for one in self.estimates)

    def mean(self, label: str) -> float:
        """Return the mean over the flights."""
        return float(np.mean([one[label] for one in self.estimates]))

    def spread(self, label: str) -> Spread:
        """Return the spread of the flights' estimates."""
        return Spread(float(np.std([one[label] for one in self.estimates], ddof=1)), len(self.estimates))

    def claimed(self, label: str) -> float:
        """Return the standard deviation that one flight claims: root mean square of the quoted ones."""
        return math.sqrt(float(np.mean([one.sigma(label) ** 2 for one in self.estimates])))

    @property
    def remarks(self) -> tuple[str, ...]:
        """Return the remarks on the spread, and those of the flights."""
        found = [
            f"{label}: the flights spread {self.spread(label).value / self.claimed(label):.1f} times as far as the "
            "standard deviation that one of them claims: what differs from flight to flight acts on the drone and not "
            "on the sensor, where output error looks for it. Believe the spread"
            for label in self.labels
            if self.spread(label).exceeds(self.claimed(label))
        ]
        flights: dict[str, list[str]] = {}
        for name, one in zip(self.names, self.estimates, strict=True):
            for remark in one.remarks:
                if f"'{name}'" in remark:
                    if not one.wanders or "wanders" not in remark:  # what it asks for is here: the spread
                        found.append(remark)
                else:
                    flights.setdefault(remark, []).append(f"'{name}'")
        found.extend(
            remark if len(names) == len(self.names) else f"{', '.join(names)}: {remark}"
            for remark, names in flights.items()
        )
        return tuple(found)

    def table(self) -> str:
        """Return the estimates by flight with mean, spread and the claim of one flight, as text for a terminal."""
        first, labels = self.estimates[0], self.labels
        width = max(18, *(len(name) for name in self.names)) + 2
        lines = [f"{first.structure} ({first.domain}), each of {len(self.names)} flights by itself"]
        lines.append(" " * width + "".join(f"{label:>22}" for label in labels))
        lines.append(" " * width + "".join(f"{first.unit(label) or '-':>22}" for label in labels))
        for name, one in zip(self.names, self.estimates, strict=True):
            cells = [f"{one[label]:.5g} +- {one.sigma(label):.2g}" for label in labels]
            lines.append(f"{name:{width}}" + "".join(f"{cell:>22}" for cell in cells))
        for title, value in (
            ("mean", [f"{self.mean(label):.5g}" for label in labels]),
            ("spread", [f"+- {self.spread(label).value:.2g}" for label in labels]),
            ("claimed by one", [f"+- {self.claimed(label):.2g}" for label in labels]),
        ):
            lines.append(f"{title:{width}}" + "".join(f"{cell:>22}" for cell in value))
        # All flights share priors and held values, so the spread does not show errors in those.
        lines.extend(first.supposed)
        lines.extend(f"note: {remark}" for remark in self.remarks)
        return "\n".join(lines)

    def to_json(self) -> str:
        """Return everything but the signals as JSON text; NaN is null."""
        figures = {
            label: {"mean": self.mean(label), "spread": self.spread(label).value, "claimed": self.claimed(label)}
            for label in self.labels
        }
        flights = {name: json.loads(one.to_json()) for name, one in zip(self.names, self.estimates, strict=True)}
        document = {"repeated": figures, "flights": flights, "converged": self.converged, "remarks": self.remarks}
        return json.dumps(finite(document), indent=2)


def repeat(
    structure: Structure | PolynomialModel,
    records: Sequence[Record],
    *,
    estimate: Collection[str] | None = None,
    values: Mapping[str, float] | None = None,
    disturbance: Disturbance = "auto",
    prior: Mapping[str, tuple[float, float]] | None = None,
) -> Repeated:
    """`fit` of each of `records`, repetitions of one experiment, by itself; the other arguments as there.

    Raises IdentificationError as `fit` does, and for fewer than two records or two of one name.
    """
    for one in records:
        check_record(one)
    names = tuple(one.name for one in records)
    check_repetitions(names)
    options: dict[str, Any] = {"estimate": estimate, "values": values, "disturbance": disturbance, "prior": prior}
    return Repeated(names, tuple(fit(structure, one, **options) for one in records))


def check_repetitions(names: Sequence[str]) -> None:
    """Raise IdentificationError for fewer than two flights, and for two of one name."""
    if len(names) < 2 or len(set(names)) < len(names):
        what = f"records {', '.join(names) or 'none'}"
        raise IdentificationError(what, "repetitions", "give two or more, each with a name of its own")
