"""Before flying: how accurately an excitation will tell the unknowns; after flying: predicted beside achieved.

The Fisher information of an experiment is J' J, with J the sensitivities of the outputs over their noise. Its inverse
is the Cramer-Rao bound, which the grey-box fit attains (Jategaonkar, Flight Vehicle System Identification, chapter 2).
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.errors import is_number, shown
from twodof.excitation import LIMITS, Doublet, Excitation, Multisine, ThreeTwoOneOne
from twodof.identify.covariance import check_identifiable, covariance
from twodof.identify.disturbance.disturbance_model import DisturbanceModel
from twodof.identify.disturbance.walk import spreads, walk
from twodof.identify.estimate import Estimate
from twodof.identify.problem import Problem
from twodof.identify.record import Record, Samples
from twodof.identify.record_simulator import RecordSimulator
from twodof.models.structure import Structure

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Information:
    """The accuracy an experiment will give: `sigma` (Cramer-Rao bound) of each unknown, in the order of `labels`.

    `peaks` are the largest magnitudes of the simulated outputs, `travel` their peak-to-peak; `correlation` that of
    the estimates to come.
    """

    structure: str
    labels: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    matrix: Array
    sigma: Array
    correlation: Array
    condition_number: float
    peaks: dict[str, float]
    travel: dict[str, float]

    def table(self) -> str:
        """Values and predicted standard deviations as text."""
        width = max(12, *(len(label) for label in self.labels)) + 1
        lines = [f"{self.structure}: predicted accuracy", f"{'':{width}}{'value':>12}{'1 sigma':>11}  unit"]
        for i, label in enumerate(self.labels):
            lines.append(f"{label:{width}}{self.values[i]:12.5g}{self.sigma[i]:11.2g}  {self.units[i] or '-'}")
        lines.append("peaks: " + ", ".join(f"{name} {value:.3g}" for name, value in self.peaks.items()))
        return "\n".join(lines)

    def beside(self, achieved: Estimate) -> str:
        """Predicted beside achieved standard deviations, after flying; what was not estimated is left out."""
        both = [label for label in self.labels if label in achieved.labels]
        width = max(12, *(len(label) for label in both)) + 1
        lines = [f"{'':{width}}{'predicted':>11}{'achieved':>11}{'ratio':>8}"]
        for label in both:
            predicted, found = float(self.sigma[self.labels.index(label)]), achieved.sigma(label)
            lines.append(f"{label:{width}}{predicted:11.2g}{found:11.2g}{found / predicted:8.2f}")
        return "\n".join(lines)


def predict(
    structure: Structure,
    inputs: Mapping[str, ArrayLike],
    dt: float,
    noise: Mapping[str, float],
    *,
    values: Mapping[str, float] | None = None,
    estimate: Collection[str] | None = None,
    repeats: int = 1,
    disturbance: DisturbanceModel | None = None,
    prior: Mapping[str, tuple[float, float]] | None = None,
    sampled: Mapping[str, ArrayLike] | None = None,
    covariance: Mapping[str, Array] | None = None,
) -> Information:
    """Predict the accuracy that `inputs` (name -> samples, each `dt` [s]) will give for the unknowns `estimate`.

    `noise`: standard deviation of each output that will be measured (its unit). `values`: what the unknowns are thought
    to be (default: the structure's guesses). `repeats`: how often the experiment is flown; local unknowns, one value a
    flight, gain nothing from it. `disturbance`: the noise model of an earlier estimate (`found.disturbance`), whose
    noise of an output is taken instead of white noise of that size. `prior`: what is known before, as `fit` has it. It
    counts once, however many flights there are. `sampled`: when an output's samples come, in steps (default: each).
    `covariance`: that of an output's samples, which takes the place of its white noise. Raises IdentificationError as
    `fit` does, for unknowns the experiment cannot tell.
    """
    if not is_number(repeats, 1, whole=True):
        raise structure.error(f"{shown(repeats)} repeats", "give a whole number, 1 or more")
    record = _blank(structure, inputs, dt, tuple(noise), sampled)
    wanted = structure.estimate if estimate is None else tuple(estimate)
    problem = Problem(structure, [record], wanted, values or {}, prior=prior)
    problem.set_noise(noise)
    x = problem.x0
    jacobian = problem.central_jacobian(x)
    for k, block in enumerate(problem.blocks):
        rows = jacobian[block.rows] * noise[block.output]
        if disturbance is not None and (model := disturbance.of(block.output, dt)) is not None:
            jacobian[block.rows] = model.whiten(rows, [slice(0, rows.shape[0])])
        if disturbance is not None and (own := disturbance.walks.get(block.output)) is not None:
            jacobian[block.rows] = walk(noise[block.output], own.pushes, spreads(problem, x, k)).whiten(rows)
        if (spread := (covariance or {}).get(block.output)) is not None:
            jacobian[block.rows] = np.linalg.solve(np.linalg.cholesky(spread), rows)
    labels = tuple(slot.label for slot in problem.slots)
    where = f"structure '{structure.name}', planned experiment"
    condition = check_identifiable(jacobian, problem.scale, labels, where)
    shared = np.flatnonzero([not slot.unknown.local for slot in problem.slots])
    bound = _repeated(jacobian, problem.size, shared, repeats)
    sigma = np.sqrt(np.diag(bound))
    simulated = simulate_planned(structure, inputs, dt, problem.values(x, 0))
    return Information(
        structure.name,
        labels,
        tuple(slot.unknown.unit for slot in problem.slots),
        x,
        np.asarray(np.linalg.inv(bound)),
        sigma,
        bound / np.outer(sigma, sigma),
        condition,
        {name: float(np.abs(y).max()) for name, y in simulated.items()},
        {name: float(np.ptp(y)) for name, y in simulated.items()},
    )


def _blank(
    structure: Structure,
    inputs: Mapping[str, ArrayLike],
    dt: float,
    outputs: Sequence[str],
    sampled: Mapping[str, ArrayLike] | None = None,
) -> Record:
    """Return a record with the inputs and no measurements yet (zeros)."""
    if not is_number(dt) or dt <= 0.0:
        raise structure.error(f"samples each {shown(dt)} s", "give a time above 0")
    columns = {name: np.asarray(u, dtype=float) for name, u in inputs.items()}
    lengths = {u.size for u in columns.values()}
    if len(lengths) != 1 or min(lengths) < 2:
        raise structure.error(f"inputs of {sorted(lengths)} samples", "give equal lengths, 2 or more")
    steps = lengths.pop()
    places = {name: np.asarray((sampled or {}).get(name, np.arange(steps)), dtype=float) for name in outputs}
    blank = {name: Samples(place, np.zeros(place.size)) for name, place in places.items()}
    return Record("planned", dt, 0.0, columns, blank)


def simulate_planned(
    structure: Structure, inputs: Mapping[str, ArrayLike], dt: float, values: Mapping[str, float]
) -> dict[str, Array]:
    """Every output of the structure for planned inputs, from parameters `values`."""
    return RecordSimulator(structure, _blank(structure, inputs, dt, structure.outputs)).run(values)


def _repeated(jacobian: Array, size: int, shared: NDArray[np.int64], repeats: int) -> Array:
    """Return the covariance after `repeats` flights that each have their own local unknowns.

    The first `size` rows of `jacobian` are those of a flight's data, the others what was known before them all.
    """
    one = covariance(jacobian)
    if repeats == 1 or not shared.size:
        return one
    # Each further flight adds what it tells of the shared unknowns, whatever its own local ones are.
    information = np.linalg.inv(one)
    flight = jacobian[:size].T @ jacobian[:size]
    own = np.setdiff1d(np.arange(jacobian.shape[1]), shared)
    mixed = flight[np.ix_(shared, own)]
    told = flight[np.ix_(shared, shared)] - mixed @ np.linalg.solve(flight[np.ix_(own, own)], mixed.T)
    information[np.ix_(shared, shared)] += (repeats - 1) * told
    return np.linalg.inv(information)


@dataclass(frozen=True)
class Limits:
    """Limits of an experiment on the rig.

    `within` is the largest magnitude of outputs, `travel` the largest peak-to-peak, since an experiment picks a start
    that fits the rail. `least` and `most` bound the excitation's amplitude: below `least` the machine sticks.
    `twodof.excitation.LIMITS` bounds it too, by its unit.
    """

    within: Mapping[str, float] = field(default_factory=dict)
    travel: Mapping[str, float] = field(default_factory=dict)
    least: float = 0.0
    most: float = math.inf


# A tenth of each is kept free: the model that plans the flight is the one that the flight shall correct.
_FREE = 0.9

PITCH_LIMITS = Limits(within={"theta": _FREE * math.radians(50.0)})
"""Pitch must stay under 50 degrees or the drone hits a carbon rod (paper, section 4.1); a tenth is kept free."""

RAIL_LIMITS = Limits(within={"theta": _FREE * math.radians(50.0)}, travel={"x": _FREE * 0.8})
"""And the cart has a stroke of about 0.8 m, of which a tenth is kept free as well."""


@dataclass(frozen=True, eq=False)
class Design:
    """The best excitation of its kind within the limits, what it will tell, and the kinds that were compared.

    `cost` is the root mean square of sigma / scale over the unknowns that are not local; `tried` holds (shape,
    amplitude, cost) of each candidate, NaN where none fits.
    """

    excitation: Excitation
    information: Information
    cost: float
    tried: tuple[tuple[float, float, float], ...]


Family = Callable[[float, float], Excitation]


def doublets(unit: str = "-", lead: float = 0.5) -> Family:
    """Doublets by period [s] and amplitude."""
    return lambda period, amplitude: Doublet(amplitude, period, unit=unit, lead=lead)


def three_two_one_ones(unit: str = "-", lead: float = 0.5) -> Family:
    """3-2-1-1 signals by the length of all seven steps together [s] and amplitude."""
    return lambda length, amplitude: ThreeTwoOneOne(amplitude, length / 7.0, unit=unit, lead=lead)


def multisines(unit: str = "-", lead: float = 0.5, harmonics: int = 10) -> Family:
    """Multisines of equal lines with Schroeder's phases by period [s] and peak."""
    return lambda period, peak: Multisine.schroeder(peak, period, tuple(range(1, harmonics + 1)), unit=unit, lead=lead)


def best(
    structure: Structure,
    family: Family,
    shapes: Sequence[float],
    duration: float,
    dt: float,
    noise: Mapping[str, float],
    limits: Limits,
    *,
    values: Mapping[str, float] | None = None,
    estimate: Collection[str] | None = None,
    disturbance: DisturbanceModel | None = None,
) -> Design:
    """Return the best of `family(shape, amplitude)` over `shapes`, each with the largest amplitude within `limits`.

    The experiment lasts `duration` [s], rest and free response included. Excitations that do not fit into it are passed
    over. `disturbance` as in `predict`. Raises IdentificationError if none fits the limits, saying which limit is in
    the way.
    """
    if len(structure.inputs) != 1:
        raise structure.error(f"the structure has {len(structure.inputs)} inputs", "design for one input")
    tried: list[tuple[float, float, float]] = []
    found: list[Design] = []
    reasons: set[str] = set()
    times = np.asarray(dt * np.arange(round(duration / dt) + 1), dtype=np.float64)
    for shape in shapes:
        amplitude, reason = _largest(structure, family, shape, times, limits, values)
        if amplitude <= 0.0:
            reasons.add(reason)
            tried.append((shape, math.nan, math.nan))
            continue
        excitation = family(shape, amplitude)
        inputs = {structure.inputs[0]: excitation.at(times)}
        info = predict(structure, inputs, dt, noise, values=values, estimate=estimate, disturbance=disturbance)
        found.append(Design(excitation, info, _cost(structure, info), ()))
        tried.append((shape, amplitude, found[-1].cost))
    if not found:
        what = f"no excitation fits: {'; '.join(sorted(reasons)) or 'no shape was given'}"
        raise structure.error(what, "try shorter shapes, a longer experiment, or another kind of signal")
    best_of = min(found, key=lambda one: one.cost)
    return replace(best_of, tried=tuple(tried))


def _cost(structure: Structure, info: Information) -> float:
    shared = [k for k, label in enumerate(info.labels) if not structure.unknowns[label].local]
    shares = [float(info.sigma[k]) / structure.unknowns[info.labels[k]].scale for k in shared]
    return math.sqrt(sum(share**2 for share in shares) / max(1, len(shares)))


def _largest(
    structure: Structure, family: Family, shape: float, times: Array, limits: Limits, values: Mapping[str, float] | None
) -> tuple[float, str]:
    """Return the largest amplitude within the limits, to 1 %, or 0 and the limit that is in the way."""
    full = {name: unknown.value for name, unknown in structure.unknowns.items()} | dict(values or {})

    def broken(amplitude: float) -> str:
        u = family(shape, amplitude).at(times)
        simulated = simulate_planned(structure, {structure.inputs[0]: u}, float(times[1]), full)
        sizes = {name: (float(np.abs(y).max()), float(np.ptp(y))) for name, y in simulated.items()}
        far = [f"{n} exceeds {most:g}" for n, most in limits.within.items() if n in sizes and not sizes[n][0] <= most]
        wide = [(n, most) for n, most in limits.travel.items() if n in sizes and not sizes[n][1] <= most]
        return next(iter([*far, *(f"{n} travels more than {most:g}" for n, most in wide)]), "")

    low = max(limits.least, 1e-6)
    if family(shape, low).duration > times[-1] + 1e-9:
        return 0.0, f"the signal is longer than {times[-1]:g} s"
    reason = broken(low)
    if reason:
        return 0.0, f"{reason} at the least amplitude {low:g}"
    high = min(limits.most, LIMITS[family(shape, low).unit])
    if not broken(high):
        return high, ""
    while high / low > 1.01:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if broken(middle) else (middle, high)
    return low, ""
