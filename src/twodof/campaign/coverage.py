"""Coverage of the default fit: flights of known truth, each identified as `twodof identify` does, and what holds it."""

import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from types import MappingProxyType
from typing import Any

import numpy as np

from twodof.campaign.plan import Row, Run
from twodof.errors import ExperimentError
from twodof.excitation import Multisine, ThreeTwoOneOne
from twodof.experiment.experiments import EXPERIMENTS, Experiment
from twodof.experiment.flight import Flight, Laboratory
from twodof.identify.identified_flight import identify_flight
from twodof.identify.ready_made import true_values
from twodof.identify.validate import deviations
from twodof.parameters import ParameterSet
from twodof.rig.parameters import TABLE, load_rig

LEVEL = 0.95
"""Of the intervals."""

_OWN = (
    Experiment("3-2-1-1", "open-loop", ThreeTwoOneOne(0.03, 0.1, lead=0.2), rings=True, hold=20.0, rest=0.4),
    Experiment(
        "multisine",
        "open-loop",
        # 1 to 6 Hz: lines below the pendulum's frequency would swing it to its stop.
        Multisine.schroeder(0.05, 2.0, range(2, 13), lead=0.2, repeat=2),
        rings=True,
        hold=20.0,
        rest=0.4,
    ),
)
WITH_IMPULSE = "doublet and impulse"
"""Its poles come from an impulse that is flown before."""

FLOWN: Mapping[str, Experiment] = MappingProxyType(
    {**EXPERIMENTS, **{one.name: one for one in _OWN}, WITH_IMPULSE: EXPERIMENTS["doublet"]}
)
"""The experiments of a coverage campaign."""

_IMPULSE_SEEDS = 1 << 20
"""The impulse's seed beyond that of its doublet."""

_TOLD = 0.9
"""Share of the prior's standard deviation; an estimate with more has repeated its prior."""


@dataclass(frozen=True)
class IdentifiedByDefault:
    """Figures of a run, whose case is an experiment of `FLOWN`: flown on `rig` and identified as the command does.

    The figures are those of the unknowns with a known truth: `value`, `sigma`, `true`, and the width of the prior.
    """

    rig: str

    def __call__(self, run: Run) -> dict[str, Any]:
        laboratory = _laboratory(self.rig, tuple(run.parameters.items()))
        flight = _good(laboratory.fly(FLOWN[run.case], run.seed))
        impulse = None
        if run.case == WITH_IMPULSE:
            impulse = _good(laboratory.fly("impulse", run.seed + _IMPULSE_SEEDS)).log
        kind = None if run.case in EXPERIMENTS else "doublet"
        found = identify_flight(flight.log, kind, impulse=impulse)
        record, fit = found.record, found.greybox
        rig = laboratory.parameters.snapshot()
        truth = true_values(rig, found.experiment, flight.log, record.start, float(record.time[-1]))
        figures: dict[str, Any] = {"converged": fit.converged, "trusted": found.sufficiency.trusted}
        for name in (*fit.labels, *fit.summed):
            if name in truth:
                width = fit.prior[name][1] if name in fit.prior else None
                figures[name] = {"value": fit[name], "sigma": fit.sigma(name), "true": truth[name], "prior": width}
        return figures


@functools.lru_cache(maxsize=2)
def _laboratory(rig: str, changed: tuple[tuple[str, float], ...]) -> Laboratory:
    return Laboratory(ParameterSet({**load_rig(rig).snapshot(), **dict(changed)}, TABLE) if changed else rig)


def _good(flight: Flight) -> Flight:
    failed = [f"{one.name}: {one.seen}" for one in flight.checks if not one.passed]
    if failed:
        raise ExperimentError(f"the flight is not good: {'; '.join(failed)}")
    return flight


@dataclass(frozen=True)
class UnknownCoverage:
    """How an unknown of `experiment` was found in `flights`: the share `covered` of its intervals that hold the truth.

    `p_value` is that of the exact binomial test against `LEVEL`. `claim` is the median standard deviation that a flight
    claims. `bias` and `spread` are mean and standard deviation of the errors, each over its own flight's claim.
    `silent` flights claim none, as the unknown lies at its bound.
    `prior_left` is the claim over the prior's standard deviation, 0 without a prior.
    """

    experiment: str
    unknown: str
    flights: int
    silent: int
    truth: float
    claim: float
    covered: int
    p_value: float
    bias: float
    spread: float
    prior_left: float

    @property
    def repeats_prior(self) -> bool:
        """Return True if the data do not tell the unknown; it does not count then."""
        return self.prior_left > _TOLD

    @property
    def text(self) -> tuple[str, ...]:
        """Return the cells of a table: experiment, unknown, truth, claim, covered, p-value, bias, spread, remark."""
        told = self.flights - self.silent
        left = f"{100.0 * self.prior_left:.0f} % of its prior left" if self.prior_left else ""
        bound = f"{self.silent} at its bound" if self.silent else ""
        remark = ", ".join(filter(None, ["repeats its prior" if self.repeats_prior else left, bound]))
        share = f"{self.covered} of {told}" + (f" ({100.0 * self.covered / told:.0f} %)" if told else "")
        figures = (f"{self.p_value:.2g}", f"{self.bias:+.2f}", f"{self.spread:.2f}")
        return (self.experiment, self.unknown, f"{self.truth:.4g}", f"{self.claim:.2g}", share, *figures, remark)


COLUMNS = ("experiment", "unknown", "truth", "claim", "covered", "p", "bias/claim", "spread/claim", "")


def coverage(rows: Sequence[Row]) -> Iterator[UnknownCoverage]:
    """Yield the coverage of each experiment's unknowns in the `rows` of a campaign with `IdentifiedByDefault`."""
    from scipy.stats import binomtest  # it takes half a second to load

    grouped: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in rows:
        for name, one in row.get("figures", {}).items():
            if isinstance(one, dict):
                grouped.setdefault((row["case"], name), []).append(one)
    for (experiment, name), found in grouped.items():
        told = [one for one in found if one["sigma"] is not None]
        truth = float(np.mean([one["true"] for one in found]))
        if not told:
            yield UnknownCoverage(
                experiment, name, len(found), len(found), truth, math.nan, 0, 1.0, math.nan, math.nan, 0.0
            )
            continue
        error = np.array([one["value"] - one["true"] for one in told])
        sigma = np.array([one["sigma"] for one in told])
        scaled = error / sigma
        covered = int(np.count_nonzero(np.abs(error) <= deviations(LEVEL) * sigma))
        left = median(one["sigma"] / one["prior"] if one["prior"] else 0.0 for one in told)
        yield UnknownCoverage(
            experiment,
            name,
            len(found),
            len(found) - len(told),
            truth,
            float(np.median(sigma)),
            covered,
            float(binomtest(covered, len(told), LEVEL).pvalue),
            float(scaled.mean()),
            float(scaled.std(ddof=1)) if len(told) > 1 else math.nan,
            left,
        )


def failures(rows: Sequence[Row]) -> list[str]:
    """Return the reason of each run that failed."""
    return [f"{row['case']}, seed {row['seed']}: {row['failed']}" for row in rows if "failed" in row]
