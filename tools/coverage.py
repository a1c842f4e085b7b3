"""The coverage campaign: flights of known truth, each identified by itself, and whether its intervals hold the truth.

`campaign(rig, case, seeds)` flies an experiment on a virtual rig with the noise of each seed and fits it as a user
would. The truth is the rig's own, in closed form. `tools/coverage_table.py` makes the table in docs of it.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from inspect import signature
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import truncnorm

from tools.coverage_bound import pitch_information, rail_information
from twodof.errors import IdentificationError
from twodof.excitation import Multisine, ThreeTwoOneOne
from twodof.experiment.experiments import Experiment, experiment, script
from twodof.experiment.flight import Flight, Laboratory
from twodof.identify.disturbance.noise_search import LONG
from twodof.identify.experiments import KINDS
from twodof.identify.greybox import fit
from twodof.identify.information import predict
from twodof.identify.ready_made import FRICTION_PRIOR, POLES_PRIOR, TRAVEL, known_rail
from twodof.identify.record import Record
from twodof.models.structure import Structure
from twodof.models.structures import pitch_on_cart, pitch_rate, rail
from twodof.parameters import ParameterSet
from twodof.rig.parameters import TABLE
from twodof.rig.steady_state import cart_parameters, model_parameters
from twodof.signals import PERIOD, Q_AGE, RAIL_CENTRE

Array = NDArray[np.float64]

PITCH = ("mu", "tau")
FIGURES = ("k_v", "p_v")
POLES = ("w_n", "xi")
EARLIER = 0
"""Seed of the flight from which the noise is known to plan with."""

BOUND_FLIGHTS = 3
"""Flights over which the bound is averaged: in a closed loop the noise moves the input too."""


CHANNELS: Mapping[str, str] = {"gyro": "q"}
"""Inputs that a log knows by another name."""


@dataclass(frozen=True)
class Case:
    """An experiment, the structure that a fit of it has, and the figures that it is flown for."""

    name: str
    experiment: Experiment
    structure: Structure
    figures: tuple[str, ...]
    estimate: tuple[str, ...] | None = None
    values: Mapping[str, float] = field(default_factory=dict)
    prior: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """What is known of the machine before, beside what the structure knows: see `fit`."""
    other_rails: bool = False
    """Whether each flight has a rail of its own, with a dry friction as likely as the prior says."""

    @property
    def unknowns(self) -> tuple[str, ...]:
        """What is estimated."""
        return self.structure.estimate if self.estimate is None else self.estimate


def cases(rig: Mapping[str, float]) -> dict[str, Case]:
    """The experiments of the campaign by name, for a rig with these parameters."""
    pitch = [
        experiment("doublet"),
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
        experiment("attitude-steps"),
        experiment("attitude-prbs"),
    ]
    travel = [experiment("velocity-doublet"), experiment("velocity-doublets")]
    known, before = known_rail(rig)
    along = (*TRAVEL, *before)
    along_the_rail = [Case(one.name, one, rail(thrust=True), FIGURES, along, known, before) for one in travel]
    dry = "coulomb" in before
    return {
        **{one.name: _pitch(one, rig) for one in pitch},
        **{one.name: one for one in along_the_rail},
        **{other.name: other for other in (_on_other_rails(one) for one in along_the_rail if dry)},
    }


def _on_other_rails(case: Case) -> Case:
    return replace(case, name=f"{case.name}, other rails", other_rails=True)


def _pitch(flown: Experiment, rig: Mapping[str, float]) -> Case:
    """On `lab` a flight in closed loop is fitted with the cart; the gust of another is found with one input only.

    What the logs tell of the poles is known to all but the shortest flights, which last less than a swing. On a rig
    with no more than the paper's model the poles are held in a closed loop, where they cannot be told.
    """
    closed = flown.mode != "open-loop"
    if rig["lag"] > 0.0 and not closed:
        short = flown.excitation.duration < LONG * PERIOD
        return Case(flown.name, flown, pitch_rate(lag=True), PITCH, prior={} if short else POLES_PRIOR)
    if rig["lag"] > 0.0:
        cart = {**cart_parameters(rig), "play": rig["ring_play"]}
        return Case(flown.name, flown, pitch_on_cart(), PITCH, values=cart, prior={**POLES_PRIOR, **FRICTION_PRIOR})
    structure = pitch_rate()
    if not closed:
        return Case(flown.name, flown, structure, PITCH)
    known = model_parameters(rig)
    poles = {name: known[f"{name}_run"] for name in POLES}
    return Case(flown.name, flown, structure, PITCH, tuple(n for n in structure.estimate if n not in POLES), poles)


@dataclass(frozen=True, eq=False)
class Outcome:
    """What n fits gave: `values` and `sigma` (n, figures), `covered` (n, figures); the reasons of those that failed.

    `truths` (n, figures) are those of each flight's rig. `bound` (Cramer-Rao, for the noise that the rig really has)
    holds one number a figure.
    """

    case: Case
    seeds: tuple[int, ...]
    values: Array
    sigma: Array
    covered: NDArray[np.bool_]
    truths: Array
    bound: Array
    failures: tuple[str, ...]

    @property
    def truth(self) -> Array:
        """The mean of the truths."""
        return np.asarray(self.truths.mean(axis=0))

    @property
    def spread(self) -> Array:
        """Standard deviation of the estimates about the truth."""
        return np.asarray((self.values - self.truths).std(axis=0, ddof=1))

    @property
    def bias(self) -> Array:
        """Mean less truth."""
        return np.asarray((self.values - self.truths).mean(axis=0))

    @property
    def claimed(self) -> Array:
        """The standard deviation that one flight claims: the median."""
        return np.asarray(np.nanmedian(self.sigma, axis=0))

    @property
    def coverage(self) -> Array:
        """Share of the 95 % intervals that hold the truth."""
        return np.asarray(self.covered.mean(axis=0))


def campaign(rig: str, case: Case, seeds: Iterable[int], bound_flights: int = BOUND_FLIGHTS, **options: Any) -> Outcome:
    """Fly `case` on `rig` with the noise of each seed, and fit each flight with `options` of `fit`.

    The bound is that of the first `bound_flights`.
    """
    nominal = Laboratory(rig)
    seeds = tuple(seeds)
    known = true_values(nominal, case)
    values, sigma, covered, truths, failures = [], [], [], [], []
    for seed in seeds:
        laboratory, truth = nominal, known
        if case.other_rails:
            laboratory = Laboratory(_other_rail(nominal.parameters, case, seed))
            truth = true_values(laboratory, case)
        flight = laboratory.fly(case.experiment, seed)
        record = record_of(flight, case)
        if not flight.good:
            failures.append(f"seed {seed}: {'; '.join(str(one) for one in flight.checks if not one.passed)}")
            continue
        try:
            found = fit(case.structure, record, estimate=case.estimate, values=case.values, prior=case.prior, **options)
        except IdentificationError as error:
            failures.append(f"seed {seed}: {error.what}")
            continue
        values.append([found[figure] for figure in case.figures])
        sigma.append([found.sigma(figure) for figure in case.figures])
        truths.append([truth[figure] for figure in case.figures])
        within = [(found.interval(figure), truth[figure]) for figure in case.figures]
        covered.append([low <= true <= high for (low, high), true in within])
    return Outcome(
        case,
        seeds,
        np.array(values),
        np.array(sigma),
        np.array(covered),
        np.array(truths),
        _bound(nominal, case, seeds[:bound_flights], known),
        tuple(failures),
    )


def _other_rail(rig: ParameterSet, case: Case, seed: int) -> ParameterSet:
    """The rig with a dry friction of the rail drawn from the prior, which has nothing below 0."""
    mean, deviation = case.prior["coulomb"]
    drawn = float(truncnorm.rvs(-mean / deviation, math.inf, mean, deviation, random_state=seed))
    return ParameterSet({**rig, "rail_coulomb": drawn * (rig["mass_drone"] + rig["mass_cart"])}, TABLE)


def record_of(flight: Flight, case: Case) -> Record:
    """What was applied and measured while the excitation played."""
    plan = script(case.experiment, flight.x_start)
    log = flight.log
    clock = log["M"].time
    start, stop = float(clock[plan.begin]) - 1e-6, float(clock[min(plan.end, len(clock) - 1)])
    name = f"{case.name} {flight.seed}"
    if "k_v" not in case.figures:
        channels = {one: CHANNELS.get(one, one) for one in case.structure.inputs}
        smooth = [one for one in channels if one == "theta"]
        return Record.from_log(log, channels, {"q": "q"}, start, stop, smooth=smooth, name=name)
    kind = KINDS["velocity"]
    channels = {one: (log[one].time, log[one].value) for one in kind.inputs}
    channels["x"] = (log["dist"].time, log["dist"].value - RAIL_CENTRE)
    return Record.from_channels(channels, kind.inputs, ["x"], start=start, stop=stop, smooth=kind.smooth, name=name)


def true_values(laboratory: Laboratory, case: Case) -> dict[str, float]:
    """The structure's unknowns on this rig, for small angles, at the voltage that the battery has in the excitation.

    All thrusts go with `supply`, so mu and k_v do. It falls by a per cent in a hold of 20 s.
    """
    rig = laboratory.parameters.snapshot()
    known = model_parameters(rig)
    plan = script(case.experiment)
    flown = laboratory.signals(
        case.experiment, plan, 0.0 if case.experiment.rings else laboratory.start(case.experiment)
    )
    full = rig["voltage_full"] - rig["resistance"] * rig["hover_current"]
    supply = float(np.mean((flown["voltage"][plan.begin : plan.end] / full) ** 2))
    return {
        "w_n": known["w_n_run"],
        "xi": known["xi_run"],
        "mu": known["mu"] * supply,
        "tau": known["tau"],
        "dead_time": rig["delay"] - Q_AGE,
        "lag": max(rig["lag"], case.structure.unknowns["lag"].lower if "lag" in case.structure.unknowns else 0.0),
        "k_v": known["k_v"] * supply,
        "p_v": known["p_v"],
        "coulomb": known["rail_coulomb" if "k_v" in case.figures else "coulomb_run"],
    }


def _bound(laboratory: Laboratory, case: Case, seeds: Sequence[int], truth: Mapping[str, float]) -> Array:
    """The Cramer-Rao bound of each figure: the root of its mean variance in the flights of these `seeds`."""
    rig = laboratory.parameters.snapshot()
    shared = {**case.values, **{name: truth[name] for name in case.structure.unknowns if name in truth}}
    covariances = []
    for seed in seeds:
        flight = laboratory.fly(case.experiment, seed)
        record, values, unknowns = record_of(flight, case), dict(shared), case.unknowns
        if "k_v" in case.figures:
            # What the structure calls the delay is here the age of the range.
            values["tau"] = rig["tof_age"]
            plan = script(case.experiment, flight.x_start)
            flown = laboratory.signals(case.experiment, plan, flight.x_start, seed)
            values |= {f"{name}_0": float(flown[f"true_{name}"][plan.begin]) for name in ("theta", "x", "v")}
            # A cart that dry friction holds has no speed to tell.
            held = values.get("coulomb", 0.0) > 0.0 and values["v_0"] == 0.0
            unknowns = tuple(name for name in unknowns if not (held and name == "v_0"))
            information = rail_information(case.structure, unknowns, values, record, rig, case.prior)
        else:
            information = pitch_information(case.structure, unknowns, values, record, rig, case.prior)
        covariances.append(_full(case.unknowns, unknowns, np.linalg.inv(information)))
    # Not the inverse of the mean: unknowns that no flight tells apart differ in how they cannot be told.
    return _deviations(case, case.unknowns, np.mean(covariances, axis=0))


def _full(every: Sequence[str], unknowns: Sequence[str], covariance: Array) -> Array:
    """`covariance` of the `unknowns` among `every` unknown; the others are certain."""
    full = np.zeros((len(every), len(every)))
    place = [every.index(name) for name in unknowns]
    full[np.ix_(place, place)] = covariance
    return full


def promised(laboratory: Laboratory, case: Case) -> Array:
    """The standard deviations that `predict` promises, from the noise of one earlier flight and the planned input.

    In a closed loop the planned input is that of a flight without noise.
    """
    earlier = fit(
        case.structure,
        record_of(laboratory.fly(case.experiment, EARLIER), case),
        estimate=case.estimate,
        values=case.values,
        prior=case.prior,
    )
    unknowns = tuple(name for name in case.unknowns if name not in earlier.at_rest)
    planned = record_of(Laboratory(laboratory.parameters, noise=0.0).fly(case.experiment), case)
    known = {name: value for name, value in true_values(laboratory, case).items() if name in case.structure.unknowns}
    # A plan has a sample of each output at each step. Fewer samples of the same noise are as good as all of a larger.
    rarer = {name: math.sqrt(planned.steps / one.position.size) for name, one in planned.outputs.items()}
    information = predict(
        case.structure,
        {name: planned.inputs[name] for name in case.structure.inputs},
        planned.dt,
        {name: size * rarer[name] for name, size in earlier.noise.items()},
        values={**known, **case.values},
        estimate=unknowns,
        prior=case.prior,
        **({"disturbance": earlier.disturbance} if "disturbance" in signature(predict).parameters else {}),
    )
    return _deviations(case, unknowns, np.linalg.inv(information.matrix))


def _deviations(case: Case, unknowns: Sequence[str], covariance: Array) -> Array:
    """The standard deviation of each figure, which may be a sum of unknowns."""
    sums = case.structure.sums
    weights = np.array([[float(one in sums.get(name, (name,))) for one in unknowns] for name in case.figures])
    return np.sqrt(np.diag(weights @ covariance @ weights.T))
