"""A fit from several first guesses: a cost with several minima shows them, and the best one is kept."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError, is_number, shown
from twodof.identify.disturbance.disturbance_model import Disturbance
from twodof.identify.estimate import Estimate
from twodof.identify.greybox import fit
from twodof.identify.problem import number_pair
from twodof.identify.record import Record
from twodof.models.structure import Structure, check_structure

MAX_STARTS = 10_000


@dataclass(frozen=True, eq=False)
class LocalMinimum:
    """Where a search ended: its unknowns by label, its cost and how many of the starts (`starts`) ended there.

    The cost is a sum over outputs and records. Each adds the samples' number times the logarithm of the residual's RMS.
    Without its constant, the negative logarithm of the likelihood is this sum (Ljung, System Identification, section
    7.4).
    """

    values: Mapping[str, float]
    cost: float
    starts: int


@dataclass(frozen=True, eq=False)
class MultiStart:
    """The best fit, all minima (the best first), and the first guesses that failed, with the reason."""

    best: Estimate
    minima: tuple[LocalMinimum, ...]
    failed: tuple[tuple[Mapping[str, float], str], ...]
    seed: int

    @property
    def share(self) -> float:
        """The share of the starts that found the best minimum."""
        return self.minima[0].starts / (sum(one.starts for one in self.minima) + len(self.failed))


def fit_from_several(
    structure: Structure,
    records: Record | Sequence[Record],
    within: Mapping[str, tuple[float, float]],
    *,
    starts: int = 20,
    seed: int = 0,
    **options: Any,
) -> MultiStart:
    """Fit from the structure's own first guess and from `starts` - 1 random ones, and keep the best.

    `within` says from where to where the first guess of an unknown is drawn: (low, high). If both are positive and a
    factor of ten or more apart, the draw is uniform in the logarithm. Otherwise it is uniform. The draws are a Latin
    hypercube: each unknown's range is in `starts` equal parts, and each part has one draw. `options` are those of
    `fit`; the `bounds` of the search are not narrowed. The searches are by output error, or in innovation form if that
    is asked for; another noise model (`disturbance`, see `fit`) is fitted from the best end alone. Two ends are one
    minimum if their costs differ by less than .1, or 1e-6 of the samples.

    Raises IdentificationError for names, ranges or numbers that are not possible, and the last fit's error if all
    starts fail.
    """
    _check(structure, within, starts)
    generator = np.random.default_rng(seed)
    own = dict(options.pop("values", None) or {})
    disturbance = options.pop("disturbance", "auto")
    searched: Disturbance = "innovation" if disturbance == "innovation" else "white"
    guesses = [own, *({**own, **one} for one in _drawn(within, starts, generator)[1:])]
    ends: list[tuple[float, dict[str, float]]] = []
    best: Estimate | None = None
    failed: list[tuple[Mapping[str, float], str]] = []
    for done, guess in enumerate(guesses):
        try:
            found = fit(structure, records, values=guess, disturbance=searched, **options)
        except IdentificationError as error:
            failed.append((guess, str(error)))
            if done == starts - 1 and not ends:
                raise
            continue
        cost = _cost(found)
        if best is None or cost < min(end[0] for end in ends):
            best = found
        ends.append((cost, dict(zip(found.labels, found.values.tolist(), strict=True))))
    assert best is not None
    ends.sort(key=lambda end: end[0])
    near = max(0.1, 1e-6 * sum(c.measured.size for c in best.identification))
    minima: list[LocalMinimum] = []
    for cost, values in ends:
        if minima and cost - minima[-1].cost <= near:
            minima[-1] = replace(minima[-1], starts=minima[-1].starts + 1)
        else:
            minima.append(LocalMinimum(values, cost, 1))
    if disturbance != searched:
        start = {**own, **ends[0][1]}
        best = fit(structure, records, values=start, disturbance=disturbance, **options)
    return MultiStart(best, tuple(minima), tuple(failed), seed)


def _cost(found: Estimate) -> float:
    # A perfect model leaves rounding errors, of which the logarithm would make a difference.
    return sum(
        c.measured.size * float(np.log(max(c.rmse, 1e-12 * float(np.ptp(c.measured)), 1e-300)))
        for c in found.identification
    )


def _drawn(
    within: Mapping[str, tuple[float, float]], starts: int, generator: np.random.Generator
) -> list[dict[str, float]]:
    columns: dict[str, NDArray[np.float64]] = {}
    for name, (low, high) in within.items():
        share = (generator.permutation(starts) + generator.random(starts)) / starts
        wide = low > 0.0 and high >= 10.0 * low
        columns[name] = low * (high / low) ** share if wide else low + (high - low) * share
    return [{name: float(column[k]) for name, column in columns.items()} for k in range(starts)]


def _check(structure: Structure, within: Mapping[str, tuple[float, float]], starts: int) -> None:
    check_structure(structure)
    if not isinstance(within, Mapping):
        raise structure.error(f"the ranges are {shown(within)}", "give {name: (low, high)}")
    structure.check_names(within)
    if not is_number(starts, 1, MAX_STARTS, whole=True):
        raise structure.error(f"{shown(starts)} starts", f"give 1 to {MAX_STARTS}")
    for name, ends in within.items():
        lower, upper = structure.unknowns[name].lower, structure.unknowns[name].upper
        low, high = number_pair(ends)
        if not (math.isfinite(high - low) and lower <= low < high <= upper):
            what = f"the first guess of '{name}' cannot be drawn from {shown(ends)}"
            raise structure.error(what, f"give a range, low first, within {lower:g} to {upper:g}")
