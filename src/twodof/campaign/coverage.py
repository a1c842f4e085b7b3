"""Coverage of the default fit: flights of known truth, each identified as `twodof identify` does, and what holds it."""

import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median
from types import MappingProxyType
from typing import Any

import numpy as np

from twodof.campaign.plan import Row, Run, drawn, plan
from twodof.errors import ExperimentError
from twodof.excitation import Multisine, ThreeTwoOneOne
from twodof.experiment.experiments import EXPERIMENTS, Experiment
from twodof.experiment.flight import Flight, Laboratory
from twodof.flightlog.log import FlightLog
from twodof.identify.identified_flight import IdentifiedFlight, identify_flight
from twodof.identify.ready_made import true_values
from twodof.identify.validate import deviations
from twodof.parameters import ParameterSet
from twodof.rig.parameters import CONDITIONS, TABLE, load_rig
from twodof.rig.rig import stiffness

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
        laboratory, flight, found = _identified(self.rig, run)
        record, fit = found.record, found.greybox
        rig = laboratory.parameters.snapshot()
        truth = true_values(rig, found.experiment, flight, record.start, float(record.time[-1]))
        figures: dict[str, Any] = {"converged": fit.converged, "trusted": found.sufficiency.trusted}
        for name in (*fit.labels, *fit.summed):
            if name in truth:
                width = fit.prior[name][1] if name in fit.prior else None
                figures[name] = {"value": fit[name], "sigma": fit.sigma(name), "true": truth[name], "prior": width}
        return figures


def drawn_drones(rig: str, experiments: Sequence[str], seeds: Sequence[int]) -> tuple[Run, ...]:
    """Return the runs of a campaign in which each flight has a drone of its own, drawn from the priors of its fit.

    What an interval with a prior promises, it promises for the drones that the prior allows, and not for each one of
    them. Which priors an experiment's fit has is seen from a flight of `rig` itself; what has none is as in `rig`, and
    so is what `rig` does not have: friction, a lag of the rotors, and for both rigs `bend`. Rotors with a longer lag
    have a shorter delay, so that tau is that of `rig`. Raises the errors of `IdentifiedByDefault` and `plan`.
    """
    runs: list[Run] = []
    nominal = load_rig(rig).snapshot()
    for case in experiments:
        _, _, found = _identified(rig, Run(0, 1, case=case), good=False)
        own = {"lag": nominal["lag"], "coulomb": nominal[_FRICTION[found.experiment == "velocity"]]}
        priors = found.greybox.prior.items()
        known = {name: one for name, one in priors if name in _AT_LEAST and own.get(name) != 0.0}
        means, widths = ({name: one[side] for name, one in known.items()} for side in (0, 1))
        most = {"lag": nominal["delay"] + nominal["lag"]}
        bounds = {name: (_AT_LEAST[name], most.get(name, math.inf)) for name in known}
        unknowns = drawn(means, np.diag([one**2 for one in widths.values()]), len(seeds), bounds=bounds)
        members = [_rig_with(nominal, found.experiment, one) for one in unknowns] if known else [{}]
        runs += plan(seeds, members, [case])
    return tuple(replace(one, number=i) for i, one in enumerate(runs))


_FRICTION = ("coulomb_run", "rail_coulomb")
"""The rig's parameter behind `coulomb` in pitch and along the rail."""

_AT_LEAST = {"w_n": 0.05, "xi": 0.0, "coulomb": 0.0, "lag": 0.0005, "wake": -math.inf, "q_trim": -math.inf}
"""The unknowns with priors that a rig can be given, and the least that each can be."""


def _rig_with(rig: Mapping[str, float], experiment: str, unknowns: Mapping[str, float]) -> dict[str, float]:
    """Return the parameters to change in `rig` so that a flight's unknowns have these values (`model_parameters`)."""
    inertia, mass = rig["inertia"], rig["mass_drone"] + rig["mass_cart"]
    changed = {}
    if "w_n" in unknowns:
        changed["softening"] = stiffness(rig, running=0.0) - inertia * unknowns["w_n"] ** 2
        changed["viscous_run"] = 2.0 * inertia * unknowns["w_n"] * unknowns["xi"]
    if "coulomb" in unknowns:
        rail = experiment == "velocity"
        changed[_FRICTION[rail]] = (mass if rail else inertia) * unknowns["coulomb"]
    if "lag" in unknowns:
        changed |= {"lag": unknowns["lag"], "delay": rig["delay"] + rig["lag"] - unknowns["lag"]}
    factors = {"wake": ("trim", inertia), "q_trim": ("gyro_bias", 1.0)}
    return changed | {to: size * unknowns[name] for name, (to, size) in factors.items() if name in unknowns}


def _identified(rig: str, run: Run, good: bool = True) -> tuple[Laboratory, FlightLog, IdentifiedFlight]:
    """Fly a run, see that its data are `good`, and identify it as the command does, which knows the rig by its name."""
    laboratory = _laboratory(rig, tuple(run.parameters.items()))
    flights = [laboratory.fly(FLOWN[run.case], run.seed)]
    if run.case == WITH_IMPULSE:
        flights.append(laboratory.fly("impulse", run.seed + _IMPULSE_SEEDS))
    log, *impulse = [_good(one).log if good else one.log for one in flights]
    kind = None if run.case in EXPERIMENTS else "doublet"
    return laboratory, log, identify_flight(log, kind, impulse=impulse[0] if impulse else None)


@functools.lru_cache(maxsize=2)
def _laboratory(rig: str, changed: tuple[tuple[str, float], ...]) -> Laboratory:
    machine, conditions = ({k: v for k, v in changed if (k in CONDITIONS) is of} for of in (False, True))
    made = Laboratory(ParameterSet({**load_rig(rig).snapshot(), **machine}, TABLE), conditions=conditions)
    made.rig_name = rig
    return made


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
