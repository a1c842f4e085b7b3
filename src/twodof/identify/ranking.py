"""Ranking of fits of several structures to the same data, by information criteria."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError, shown
from twodof.identify.disturbance.autoregression import Autoregression, autoregression
from twodof.identify.disturbance.disturbance_model import Disturbance
from twodof.identify.estimate import Estimate
from twodof.identify.greybox import fit
from twodof.identify.record import Record
from twodof.identify.validate import Comparison, whiteness
from twodof.models.structure import Structure, check_structure

Array = NDArray[np.float64]

MAX_OPTIONAL = 6
"""Unknowns that `select` leaves out in turn: 64 fits."""

CRITERIA = ("aic", "aicc", "bic")
_LARGEST_ORDER = 25


@dataclass(frozen=True)
class Candidate:
    """One fit of a ranking.

    `unknowns` counts what was estimated, the noise of each output too. `aic`, `aicc` (for short data) and `bic`: lower
    is better. `weight` is the Akaike weight, the probability that this candidate is the best of those given (Burnham
    and Anderson 2002, section 2.9).
    """

    name: str
    unknowns: int
    aic: float
    aicc: float
    bic: float
    weight: float


@dataclass(frozen=True)
class Ranking:
    """Candidates, the best first by `criterion`.

    `order` is that of the autoregression which made the residuals of the largest candidate white (0: they were);
    `samples` is the number of residuals that were compared.
    """

    candidates: tuple[Candidate, ...]
    criterion: str
    order: int
    samples: int
    remarks: tuple[str, ...] = ()

    @property
    def best(self) -> str:
        """Return the name of the first candidate."""
        return self.candidates[0].name

    def table(self) -> str:
        """Return the criteria, as differences from the lowest, as text."""
        width = max(9, *(len(one.name) for one in self.candidates)) + 1
        lines = [
            f"{self.samples} residuals, whitened by a filter of order {self.order}, ranked by {self.criterion}",
            f"{'':{width}}{'unknowns':>9}{'AIC':>10}{'AICc':>10}{'BIC':>10}{'weight':>9}",
        ]
        low = {name: min(getattr(one, name) for one in self.candidates) for name in CRITERIA}
        for one in self.candidates:
            differences = "".join(f"{getattr(one, name) - low[name]:10.1f}" for name in CRITERIA)
            lines.append(f"{one.name:{width}}{one.unknowns:9d}{differences}{one.weight:9.3f}")
        lines.extend(f"note: {remark}" for remark in self.remarks)
        return "\n".join(lines)


def rank(fits: Mapping[str, Estimate], *, criterion: str = "aicc") -> Ranking:
    """Rank `fits` of the same records by `criterion` ("aic", "aicc" or "bic").

    The likelihood supposes white residuals. If those of the candidate with the most unknowns are coloured, the
    residuals of all candidates pass the autoregression of that candidate's (at most of order 25). Without that every
    small improvement would look significant. Sources: Ljung, System Identification, section 16.4; Burnham and Anderson,
    Model Selection and Multimodel Inference, chapter 2.

    Raise IdentificationError for fewer than two fits, fits of different data or in the frequency domain, and another
    criterion.
    """
    if criterion not in CRITERIA:
        raise IdentificationError(f"the criterion is {shown(criterion)}", "rank", "take aic, aicc or bic")
    _check(fits)
    sizes = {name: len(one.labels) - len(one.at_bound) for name, one in fits.items()}
    largest = max(fits, key=lambda name: sizes[name])
    filters = [_filter_of(one) for one in fits[largest].identification]
    outputs = len(filters)
    residuals = {
        name: [_whitened(one.residual, own) for one, own in zip(found.identification, filters, strict=True)]
        for name, found in fits.items()
    }
    count = sum(one.size for one in residuals[largest])
    if count <= sizes[largest] + outputs + 1:
        raise IdentificationError(
            f"{count} residuals for {sizes[largest]} unknowns", "rank", "use longer records or fewer unknowns"
        )
    rows = {name: _criteria(residuals[name], sizes[name] + outputs, count) for name in fits}
    lowest = min(row["aicc"] for row in rows.values())
    shares = {name: math.exp(-0.5 * (row["aicc"] - lowest)) for name, row in rows.items()}
    candidates = [
        Candidate(name, sizes[name] + outputs, **row, weight=shares[name] / sum(shares.values()))
        for name, row in rows.items()
    ]
    order = max(0 if one is None else one.order for one in filters)
    remarks = []
    if order and any(one.disturbance.kind == "white" for one in fits.values()):
        remarks.append(
            "the residuals are coloured and the fits took them for white, so a difference is less rare than it looks: "
            "fit with disturbance='ar'"
        )
    best_first = sorted(candidates, key=lambda one: float(getattr(one, criterion)))
    return Ranking(tuple(best_first), criterion, order, count, tuple(remarks))


def select(
    structure: Structure,
    records: Record | Sequence[Record],
    always: Collection[str],
    optional: Sequence[str],
    *,
    values: Mapping[str, float] | None = None,
    disturbance: Disturbance = "auto",
    criterion: str = "aicc",
) -> tuple[Ranking, dict[str, Estimate]]:
    """Fit every subset of the `optional` unknowns beside those estimated `always`, and rank them.

    `values` and `disturbance` as in `fit`. An optional unknown that is not estimated keeps its value (`values`, else
    the structure's own): a friction or trim of 0 has no effect. A candidate that also estimates a and b is called
    "+ a + b", one that estimates none "-". Subsets that the data cannot tell are left out.
    Raise IdentificationError for more than 6 optional unknowns, if fewer than two subsets can be fitted, and as `fit`
    does for wrong names.
    """
    check_structure(structure)
    always = (always,) if isinstance(always, str) else always
    optional = (optional,) if isinstance(optional, str) else optional
    if not 1 <= len(optional) <= MAX_OPTIONAL:
        raise IdentificationError(
            f"{len(optional)} optional unknowns", "select", f"name 1 to {MAX_OPTIONAL}: each doubles the number of fits"
        )
    structure.check_names((*always, *optional))
    subsets = [part for size in range(len(optional) + 1) for part in combinations(optional, size)]
    fits: dict[str, Estimate] = {}
    refused = ""
    for part in subsets:
        name = " ".join(f"+ {one}" for one in part) or "-"
        try:
            fits[name] = fit(structure, records, estimate=(*always, *part), values=values, disturbance=disturbance)
        except IdentificationError as error:
            refused = f": {error.what}"
    if len(fits) < 2:
        what = f"{len(fits)} of {len(subsets)} subsets could be fitted{refused}"
        raise structure.error(what, "name other unknowns, or give better first values")
    return rank(fits, criterion=criterion), fits


def _check(fits: Mapping[str, Estimate]) -> None:
    count = sum(isinstance(one, Estimate) for one in fits.values()) if isinstance(fits, Mapping) else 0
    if count < 2 or count < len(fits):
        remedy = 'give two or more, as {"plain": fit(...), "lag": fit(...)}'
        raise IdentificationError(f"{count} fits by name", "rank", remedy)
    data = {
        name: [(c.record, c.output, c.measured.tobytes()) for c in one.identification] for name, one in fits.items()
    }
    first = next(iter(fits))
    for name, one in fits.items():
        if one.domain != "time domain":
            raise IdentificationError(f"{name!r:.80} is a fit in the {one.domain}", "rank", "fit without `band`")
        if data[name] != data[first]:
            what = f"{first!r:.80} and {name!r:.80} were fitted to different data"
            raise IdentificationError(what, "rank", "fit all candidates to the same records and outputs")


def _filter_of(one: Comparison) -> Autoregression | None:
    """Return the autoregression of a residual; None if it is white."""
    e = one.residual
    if e.size < 8 * _LARGEST_ORDER or whiteness(e).passed:
        return None
    found = autoregression(e - e.mean(), [slice(0, e.size)])
    if found.order > _LARGEST_ORDER:
        found = autoregression(e - e.mean(), [slice(0, e.size)], _LARGEST_ORDER)
    return found.scaled(1.0 / found.sigma)


def _whitened(residual: Array, own: Autoregression | None) -> Array:
    return residual if own is None else own.whiten(residual, [slice(0, residual.size)])[own.order :]


def _criteria(residuals: Sequence[Array], k: int, count: int) -> dict[str, float]:
    deviance = sum(one.size * (math.log(2.0 * math.pi * float(one @ one) / one.size) + 1.0) for one in residuals)
    aic = deviance + 2.0 * k
    aicc = aic + 2.0 * k * (k + 1.0) / (count - k - 1.0)
    return {"aic": aic, "aicc": aicc, "bic": deviance + k * math.log(count)}
