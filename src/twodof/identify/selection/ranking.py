"""Fits of several structures to the same data, ranked by information criteria and compared by nested F-tests."""

import json
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError, listed, shown
from twodof.identify.disturbance.disturbance_model import Disturbance
from twodof.identify.estimate import Estimate
from twodof.identify.greybox import fit
from twodof.identify.record import Record
from twodof.identify.validate import Comparison, whiteness
from twodof.models.structure import Structure

Array = NDArray[np.float64]

MAX_OPTIONAL = 6
"""Unknowns that `select` leaves out in turn: 64 fits."""
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
class NestedTest:
    """F-test of a `small` structure against a `large` one that contains it: `p` is the chance of so large an F.

    A small p says that what the large one has in addition is in the data.
    """

    small: str
    large: str
    f: float
    freedom: tuple[int, int]
    p: float


@dataclass(frozen=True)
class Ranking:
    """Candidates, the best first by `criterion`, and the F-tests of all pairs that are nested.

    `order` is that of the autoregressive filter which made the residuals of the largest candidate white (0: they were);
    `samples` is the number of residuals that were compared.
    """

    candidates: tuple[Candidate, ...]
    tests: tuple[NestedTest, ...]
    criterion: str
    order: int
    samples: int
    remarks: tuple[str, ...] = ()

    @property
    def best(self) -> str:
        """The name of the first candidate."""
        return self.candidates[0].name

    def table(self) -> str:
        """Criteria, as differences from the lowest, and tests as text."""
        width = max(9, *(len(one.name) for one in self.candidates)) + 1
        lines = [
            f"{self.samples} residuals, whitened by a filter of order {self.order}, ranked by {self.criterion}",
            f"{'':{width}}{'unknowns':>9}{'AIC':>10}{'AICc':>10}{'BIC':>10}{'weight':>9}",
        ]
        low = {name: min(getattr(one, name) for one in self.candidates) for name in ("aic", "aicc", "bic")}
        lines.extend(
            f"{one.name:{width}}{one.unknowns:9d}"
            + "".join(f"{getattr(one, name) - low[name]:10.1f}" for name in low)
            + f"{one.weight:9.3f}"
            for one in self.candidates
        )
        lines.extend(
            f"{one.small} in {one.large}: F({one.freedom[0]}, {one.freedom[1]}) = {one.f:.3g}, p = {one.p:.2g}"
            for one in self.tests
        )
        lines.extend(f"note: {remark}" for remark in self.remarks)
        return "\n".join(lines)

    def to_json(self) -> str:
        """All figures as JSON text."""
        return json.dumps(
            {
                "criterion": self.criterion,
                "samples": self.samples,
                "order": self.order,
                "candidates": [vars(one) for one in self.candidates],
                "tests": [vars(one) for one in self.tests],
                "remarks": list(self.remarks),
            }
        )


def rank(fits: Mapping[str, Estimate], *, nested: Iterable[tuple[str, str]] = (), criterion: str = "aicc") -> Ranking:
    """Rank `fits` of the same records by `criterion` ("aic", "aicc" or "bic"), and test what is nested.

    The likelihood supposes white residuals. Those of the candidate with the most unknowns may be coloured. Then an
    autoregressive filter is fitted to them (order by AIC, at most 25), and the residuals of all candidates pass it.
    Without that every small improvement would look significant. Fit with disturbance="ar" then. A short record does not
    tell the slow part of its noise: with 400 samples of e[i] = .9 e[i-1] + white a trim that is 0 has p < .05 in 15 %.

    Fits of one structure are nested where one has estimated everything the other has. For fits of other structures say
    so, `nested=[("plain", "lag")]`.
    Sources: Ljung, System Identification, section 16.4; Burnham and Anderson, Model Selection and Multimodel Inference,
    chapter 2; Seber and Wild, Nonlinear Regression, section 5.3 (F).

    Raises IdentificationError for fewer than two fits, fits of different data or in the frequency domain, a name in
    `nested` that is not there, and another criterion.
    """
    if criterion not in ("aic", "aicc", "bic"):
        raise IdentificationError(f"the criterion is {shown(criterion)}", "rank", "take aic, aicc or bic")
    _check(fits)
    sizes = {name: _unknowns(one) for name, one in fits.items()}
    largest = max(fits, key=lambda name: sizes[name])
    filters = [_whitening(one) for one in fits[largest].identification]
    residuals = {
        name: [_filtered(one.residual, taps) for one, taps in zip(found.identification, filters, strict=True)]
        for name, found in fits.items()
    }
    count = sum(one.size for one in residuals[largest])
    if count <= sizes[largest] + len(filters) + 1:
        raise IdentificationError(
            f"{count} residuals for {sizes[largest]} unknowns", "rank", "use longer records or fewer unknowns"
        )
    rows = {name: _criteria(residuals[name], sizes[name], count) for name in fits}
    lowest = min(row["aicc"] for row in rows.values())
    shares = {name: math.exp(-0.5 * (row["aicc"] - lowest)) for name, row in rows.items()}
    candidates = [
        Candidate(name, sizes[name] + len(filters), **row, weight=shares[name] / sum(shares.values()))
        for name, row in rows.items()
    ]
    pairs = [(a, b) for a in fits for b in fits if sizes[a] < sizes[b] and _inside(fits[a], fits[b])]
    for small, large in nested:
        if small not in fits or large not in fits or sizes[small] >= sizes[large]:
            raise IdentificationError(
                f"{small!r:.80} in {large!r:.80}",
                "nested",
                f"name two of {listed(fits)}, the one with fewer unknowns first",
            )
        if (small, large) not in pairs:
            pairs.append((small, large))
    tests = [_test(a, b, residuals, sizes, count) for a, b in pairs]
    order = max(taps.size for taps in filters)
    remarks = []
    if order and any(one.disturbance.kind == "white" for one in fits.values()):
        remarks.append(
            "the residuals are coloured and the fits took them for white, so a small p is less rare than it says: "
            "fit with disturbance='ar'"
        )
    best_first = sorted(candidates, key=lambda one: getattr(one, criterion))
    return Ranking(tuple(best_first), tuple(tests), criterion, order, count, tuple(remarks))


def select(
    structure: Structure,
    records: Record | Sequence[Record],
    always: Collection[str],
    optional: Sequence[str],
    *,
    values: Mapping[str, float] | None = None,
    disturbance: Disturbance = "auto",
    criterion: str = "aicc",
    progress: Callable[[int, int, str], None] | None = None,
) -> tuple[Ranking, dict[str, Estimate]]:
    """Fit every subset of the `optional` unknowns beside those estimated `always`, and rank them.

    `values` and `disturbance` as in `fit`. An optional unknown that is not estimated keeps its value (`values`, else
    the structure's own): a friction or trim of 0 is left out by that. Candidates are named "+ a + b" after what they
    estimate in addition, "-" without. Subsets that the data cannot tell are left out. `progress(done, all, name)` is
    called before each fit.
    Raises IdentificationError for more than 6 optional unknowns, where fewer than two subsets can be fitted, and as
    `fit` does for wrong names.
    """
    if not isinstance(structure, Structure):
        raise IdentificationError(
            f"a {type(structure).__name__} is not a structure", "select", "give a twodof.models.Structure: pitch_rate()"
        )
    always = (always,) if isinstance(always, str) else always
    optional = (optional,) if isinstance(optional, str) else optional
    if not 1 <= len(optional) <= MAX_OPTIONAL:
        raise IdentificationError(
            f"{len(optional)} optional unknowns", "select", f"name 1 to {MAX_OPTIONAL}: each doubles the number of fits"
        )
    known = structure.unknowns
    for name in (*always, *optional):
        if name not in known:
            raise IdentificationError(
                f"there is no unknown {shown(name)}", f"structure '{structure.name}'", f"there are: {listed(known)}"
            )
    subsets = [part for size in range(len(optional) + 1) for part in combinations(optional, size)]
    fits: dict[str, Estimate] = {}
    refused = ""
    for done, part in enumerate(subsets):
        name = " ".join(f"+ {one}" for one in part) or "-"
        if progress is not None:
            progress(done, len(subsets), name)
        if not (*always, *part):
            continue
        try:
            fits[name] = fit(structure, records, estimate=(*always, *part), values=values, disturbance=disturbance)
        except IdentificationError as error:
            refused = error.what
    if len(fits) < 2:
        raise IdentificationError(
            f"{len(fits)} of {len(subsets)} subsets could be fitted" + (f": {refused}" if refused else ""),
            f"structure '{structure.name}'",
            "name other unknowns, or give better first values",
        )
    return rank(fits, criterion=criterion), fits


def _check(fits: Mapping[str, Estimate]) -> None:
    if not isinstance(fits, Mapping):
        raise IdentificationError(
            f"a {type(fits).__name__} is not fits by name", "rank", 'give {"plain": fit(...), "lag": fit(...)}'
        )
    if len(fits) < 2 or not all(isinstance(one, Estimate) for one in fits.values()):
        raise IdentificationError(
            f"{len(fits)} fits", "rank", 'give two or more, as {"plain": fit(...), "lag": fit(...)}'
        )
    first_name, first = next(iter(fits.items()))
    for name, one in fits.items():
        if one.domain != "time domain":
            raise IdentificationError(f"{name!r:.80} is a fit in the {one.domain}", "rank", "fit without `band`")
        pairs = list(zip(first.identification, one.identification, strict=False))
        if len(first.identification) != len(one.identification) or not all(_same(a, b) for a, b in pairs):
            raise IdentificationError(
                f"{first_name!r:.80} and {name!r:.80} were fitted to different data",
                "rank",
                "fit all candidates to the same records and outputs",
            )


def _same(one: Comparison, other: Comparison) -> bool:
    return (one.record, one.output) == (other.record, other.output) and np.array_equal(one.measured, other.measured)


def _unknowns(found: Estimate) -> int:
    return len(found.labels) - len(found.at_bound)


def _inside(small: Estimate, large: Estimate) -> bool:
    """Whether `small` is `large` with some of its unknowns held, all else equal."""
    extra = set(large.labels) - set(small.labels)
    names = {label.partition("[")[0] for label in extra}
    both = (small.fixed.keys() & large.fixed.keys()) - names
    return (
        small.structure == large.structure
        and set(small.labels) < set(large.labels)
        and all(small.fixed[name] == large.fixed[name] for name in both)
    )


def _whitening(one: Comparison) -> Array:
    """Coefficients of the autoregressive model of a residual, none where it is white."""
    e = one.residual
    if e.size < 8 * _LARGEST_ORDER or whiteness(e).passed:
        return np.zeros(0)
    e = e - e.mean()
    best, lowest = np.zeros(0), math.inf
    target = e[_LARGEST_ORDER:]
    columns = np.array([e[_LARGEST_ORDER - k : -k] for k in range(1, _LARGEST_ORDER + 1)]).T
    for order in range(1, _LARGEST_ORDER + 1):
        taps = np.linalg.lstsq(columns[:, :order], target, rcond=None)[0]
        left = target - columns[:, :order] @ taps
        score = target.size * math.log(float(left @ left)) + 2.0 * order
        if score < lowest:
            best, lowest = taps, score
    return np.asarray(best)


def _filtered(residual: Array, taps: Array) -> Array:
    if not taps.size:
        return residual
    return np.convolve(residual, np.concatenate([[1.0], -taps]))[taps.size : residual.size]


def _criteria(residuals: Sequence[Array], unknowns: int, count: int) -> dict[str, float]:
    deviance = sum(one.size * (math.log(2.0 * math.pi * float(one @ one) / one.size) + 1.0) for one in residuals)
    k = unknowns + len(residuals)
    aic = deviance + 2.0 * k
    return {
        "aic": aic,
        "aicc": aic + 2.0 * k * (k + 1.0) / (count - k - 1.0),
        "bic": deviance + k * math.log(count),
    }


def _test(
    small: str, large: str, residuals: Mapping[str, Sequence[Array]], sizes: Mapping[str, int], count: int
) -> NestedTest:
    from scipy.special import fdtrc  # imported late: most commands start without it

    # Outputs of different units are comparable by the noise that the large one leaves.
    scale = [float(one @ one) / one.size for one in residuals[large]]
    rest = {
        name: sum(float(one @ one) / size for one, size in zip(residuals[name], scale, strict=True))
        for name in (small, large)
    }
    freedom = (sizes[large] - sizes[small], count - sizes[large])
    f = max(rest[small] - rest[large], 0.0) / freedom[0] / (rest[large] / freedom[1])
    return NestedTest(small, large, f, freedom, float(fdtrc(*freedom, f)))
