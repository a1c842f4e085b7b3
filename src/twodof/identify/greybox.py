"""Grey-box identification: the parameters with which a simulated structure reproduces the measured outputs best.

The estimate minimises the sum of ((measured - simulated) / sigma)^2 over all outputs of all records: output error. With
white output noise that is maximum likelihood (Ljung, System Identification, section 7.4; what MATLAB's greyest does
without a disturbance model). The standard deviations sigma of the outputs are estimated along, unless given. Where the
residual has a colour, a noise model takes it out of residual and sensitivities (`twodof.identify.disturbance`).
"""

import itertools
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError
from twodof.flightlog.log import FlightLog
from twodof.identify.covariance import check_identifiable, covariance, robust_covariance, uncertain_unknowns
from twodof.identify.disturbance.disturbance_model import Disturbance, DisturbanceModel, inputs_that_answer
from twodof.identify.disturbance.noise_search import Disturbed, check_disturbance, diverges, likelier, passes, search
from twodof.identify.disturbance.walk import (
    ErrorsTogether,
    can_predict,
    first_gains,
    gains_of,
    is_unstable,
    reflected_gains,
    with_measured,
    without_gains,
)
from twodof.identify.estimate import Estimate
from twodof.identify.least_squares import LeastSquaresMinimum
from twodof.identify.notes import drift, flaws, gaps_of, offsets, suggestions
from twodof.identify.polynomial_fit import fit_polynomial
from twodof.identify.problem import Problem
from twodof.identify.record import Record, check_record
from twodof.identify.subspace import subspace_named
from twodof.identify.validate import Comparison, comparison, rmse
from twodof.models.polynomial import PolynomialModel, model_named
from twodof.models.structure import Structure, check_structure

Array = NDArray[np.float64]

_POOR = 80.0
"""FIT [%] below which an offset that the structure has no unknown for is named."""
_COARSE_S = 0.1
"""Shortest step of a record whose time may be in another unit than seconds [s]."""
_DIVERGED, _FAR_DIVERGED = 1.5, 100.0
"""Error of a simulation, over what moves in the output, that no right model makes; the second in closed loop."""
_OTHER_SIZE = 1e6
"""Model over data, at the first guess, from which on rounding hides what the other unknowns do."""
_FINE, _ROUGH = 1e-10, 1e-6
"""Relative decrease that ends a search, and one under weights that are still to change."""
_UNITS = (("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9))


# A first guess too far out may overflow: what follows is an error of ours.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def fit(
    structure: Structure | PolynomialModel | str,
    records: Record | Iterable[Record],
    *,
    estimate: Collection[str] | None = None,
    values: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    separate: Collection[str] = (),
    noise: Mapping[str, float] | None = None,
    band: tuple[float, float] | None = None,
    validation: Record | Iterable[Record] = (),
    like: str = "",
    disturbance: Disturbance = "auto",
    prior: Mapping[str, tuple[float, float]] | None = None,
) -> Estimate:
    """Fit `structure` to `records`.

    `structure`: a Structure, a polynomial model (`twodof.models.arx`, `armax`, `oe`, `bj`), or the name of a model as
    "arx:2,2,1" (see `named_model`), between the records' inputs and outputs. Polynomial models take records and
    `validation` only.
    `estimate`: the unknowns to find, or the one (default: the structure's choice); all others keep their values.
    `values`: first guesses and fixed values by unknown, or by "unknown[record]" for one record. `bounds`: (lower,
    upper) by unknown. `separate`: unknowns that get one value for each record although they are not local. `noise`:
    standard deviation of outputs (or "output[record]") whose weight stays fixed. `band`: fit in the frequency
    domain, from and to these frequencies [Hz].
    `validation`: records that the model must reproduce without having seen them. Only their local unknowns are fitted.
    The separate ones are those of the record `like` (default: the last).
    `disturbance`: "white" is output error. With "ar" the noise of each output has the colour that its residual shows.
    It is an autoregression (Ljung, section 7.2), which closed loops need, and it may be louder where an input has just
    moved. The pieces of a flight share it. With "input" a random push (a gust) acts at
    the input of a linear structure beside the sensor's noise. It is found by restricted likelihood. With "auto" the fit
    takes output error where its residual is white. Otherwise it takes "ar" for records of 800 samples and more, in
    open loop 1,600, and "input" for shorter ones. It stays with output error where `noise` or `band` is given. For a
    record under 800 samples "input" asks for a linear structure with the lag of the actuator. Another one takes "ar" in
    closed loop, from 250 samples on, and output error in open loop. In open loop output error also stays where the
    noise model would change the estimates by more than chance: then the structure is wrong. A structure of
    `linear_model` takes "innovation", a predictor with gains that are found along, where its data are far likelier so.
    With "walk" random pushes move states of the structure that says which (`Structure.pushed`), beside white noise at
    its one output, and "auto" takes it for such a structure.
    `prior`: (mean, standard deviation) of unknowns as they are known from elsewhere. They are still estimated,
    and the prior is weighed against the data (Bayes, normal). It is added to what the structure knows of the
    machine (`Structure.prior`); an infinite standard deviation takes that away. Its mean is the first guess.

    Raises IdentificationError for a wrong type, for unknown or repeated names, and for a record without the structure's
    channels. It is also raised for a model that is not finite at the first guess, and for unknowns that the data cannot
    tell (apart), naming them.
    """
    several, checked = _several(records), _several(validation)
    if isinstance(structure, str):
        structure = named_model(structure, several[0])
    if isinstance(structure, PolynomialModel):
        asked = {"estimate": estimate, "values": values, "bounds": bounds, "separate": separate, "noise": noise}
        if idle := [name for name, one in {**asked, "band": band, "prior": prior}.items() if one]:
            raise structure.error(f"a polynomial model has no use for `{idle[0]}`", "leave it out")
        model, made = structure, fit_polynomial(structure, several, checked)
        poor = any(one.fit_percent < _POOR for one in made.identification)
        drifts = drift(lambda level: fit_polynomial(model, level), several, made.identification) if poor else ()
        gaps = tuple(gaps_of(structure, several))
        return replace(made, gaps=gaps, suggestions=(*made.suggestions, *drifts))
    check_structure(structure)
    unguessed, structure = structure, _guessed(structure, several[0], values or {}) if several else structure
    wanted = structure.estimate if estimate is None else _names(estimate)
    where = f"structure '{structure.name}'"
    if not wanted or len(set(wanted)) < len(wanted):
        twice = [name for i, name in enumerate(wanted) if name in wanted[:i]]
        what = f"'{twice[0]}' is named twice in `estimate`" if twice else "`estimate` names no unknown"
        raise structure.error(what, "name each unknown once, and at least one")
    check_disturbance(disturbance, band is not None, bool(noise), where)
    _check_distinct(structure, several)

    def posed(records: Sequence[Record], more: Mapping[str, float] | None = None) -> Problem:
        shape, given = structure, {**(values or {}), **(more or {})}
        if structure.predictor is not None and set(more or ()) - set(structure.unknowns):
            shape, records = structure.predictor, [with_measured(structure, record) for record in records]
        return Problem(shape, records, (*wanted, *(more or ())), given, bounds, _names(separate), band, prior)

    problem = posed(several)
    if problem.size + len(problem.known) <= len(problem.slots):
        what = f"{problem.size} samples for {len(problem.slots)} unknowns leave none to judge the fit by"
        raise structure.error(what, "take a longer record, or fix unknowns (leave them out of `estimate`)")
    with _naming_the_unit_of_time(posed, several, where):
        found = _found(problem, posed, disturbance, noise or {})
    minimum, jacobian = found.minimum, found.jacobian
    if found.predictor is not None:
        problem.sigma[:] = found.predictor[0].sigma
    labels = [slot.label for slot in problem.slots]
    free = np.flatnonzero(~minimum.at_bound)
    if free.size == 0:
        raise structure.error("every unknown is held by a bound", "widen the bounds or check the signs")
    try:
        with _naming_the_unit_of_time(posed, several, where):
            condition = check_identifiable(jacobian[:, free], problem.scale[free], [labels[i] for i in free], where)
    except IdentificationError:
        moving = tuple(name for name in wanted if name not in structure.at_rest)
        left = np.array([i for i in free if problem.slots[i].unknown.name in moving], dtype=np.int64)
        if left.size == free.size or not left.size:
            _check_stable(problem, found)
            raise
        check_identifiable(jacobian[:, left], problem.scale[left], [labels[i] for i in left], where)
        still = {name: 0.0 for name in wanted if name not in moving}
        held = {n: value for n, value in (values or {}).items() if n.partition("[")[0] not in still} | still
        before = {name: one for name, one in (prior or {}).items() if name not in still}
        given: dict[str, Any] = {"bounds": bounds, "separate": separate, "noise": noise, "band": band, "like": like}
        given |= {"validation": checked, "disturbance": disturbance, "prior": before}
        again = fit(structure, several, estimate=moving, values=held, **given)
        return replace(again, at_rest=tuple(still))
    _check_followed(problem, found)
    white, robust = (np.full((len(labels), len(labels)), math.nan) for _ in range(2))
    known = uncertain_unknowns(jacobian, problem.scale, free)
    white[np.ix_(known, known)] = covariance(jacobian[:, known])
    robust[np.ix_(known, known)] = robust_covariance(
        jacobian[:, known], found.prediction_error, problem.blocks, band is not None
    )
    compared = _comparisons(problem, minimum.x, found)
    poor = any(one.fit_percent < _POOR for one in compared)
    # In closed loop the input answers what the model leaves out, and a prediction has taken it up. But an input that
    # moves on between its samples looks like one that answers, unless a delay may make up for it.
    answered = bool(found.model.answering)
    explained = (answered and bool(structure.delay)) or found.predictor is not None or band is not None
    explained = explained or passes(problem, problem.residual(minimum.x))
    further = [] if explained else [*suggestions(problem, posed, minimum.x, poor and not answered, answered)]
    if poor and not answered and not explained and structure.begin is not None:
        given = {"estimate": estimate, "values": values, "bounds": bounds, "separate": separate, "prior": prior}
        further += drift(lambda level: fit(unguessed, level, disturbance="white", **given), several, compared)
    sigmas = dict(zip(problem.noise(), (problem.sigma * found.deviation).tolist(), strict=True))
    return Estimate(
        structure=structure.name,
        labels=tuple(labels),
        units=tuple(slot.unknown.unit for slot in problem.slots),
        local=frozenset(slot.label for slot in problem.slots if slot.unknown.local),
        values=minimum.x,
        covariance=white,
        robust=robust,
        noise=sigmas,
        fixed={name: value for name, value in problem.values(minimum.x, 0).items() if name not in wanted},
        at_bound=tuple(label for label, held in zip(labels, minimum.at_bound, strict=True) if held),
        condition_number=condition,
        identification=compared,
        validation=_validation(problem, found, checked, like, values or {}),
        iterations=minimum.iterations,
        converged=minimum.converged,
        domain="time domain" if band is None else f"frequency domain, {band[0]:g} to {band[1]:g} Hz",
        sums=structure.sums,
        disturbance=found.model,
        prior=problem.known,
        gaps=tuple(gaps_of(structure, several)),
        offsets=tuple(offsets(problem, wanted, poor)),
        model=structure,
        suggestions=(*flaws(problem, found, poor), *further),
    )


def _found(
    problem: Problem,
    posed: Callable[[Sequence[Record], Mapping[str, float] | None], Problem],
    disturbance: Disturbance,
    noise: Mapping[str, float],
) -> Disturbed:
    """Search by output error and its noise model, or by a predictor.

    A predictor is searched where it is asked for, and on "auto" where output error leaves a colour. There it is taken
    for an unstable plant whose simulation runs away from the data, and where these are likelier by far under it.
    """
    structure, records = problem.structure, problem.records
    able = problem.band is None and not noise and can_predict(structure, records)
    minimum, failed = None, None
    try:
        minimum = _solve(problem, noise)
    except IdentificationError as error:
        failed = error
    found = None
    coloured = minimum is None or not passes(problem, problem.residual(minimum.x))
    if able and (disturbance == "innovation" or (disturbance == "auto" and coloured)):
        found = _predicted(problem, posed, minimum)
    if disturbance == "innovation":
        if found is None:
            raise structure.error(
                "disturbance='innovation' needs a structure of linear_model, held inputs, outputs at each step and a "
                "first guess with which the outputs show the states",
                "take disturbance='ar', which any structure can have",
            )
        return found
    lost = minimum is None or diverges(problem, problem.residual(minimum.x))
    if found is not None and lost and is_unstable(structure, problem.values(found.minimum.x, 0), records[0].dt):
        return found
    if minimum is None:
        assert failed is not None
        raise failed
    searched = search(problem, minimum, disturbance, bool(noise))
    return searched if found is None else likelier(problem, searched, found)


def _predicted(
    problem: Problem,
    posed: Callable[[Sequence[Record], Mapping[str, float] | None], Problem],
    minimum: LeastSquaresMinimum | None,
) -> Disturbed | None:
    """Return the likeliest predictor from several first gains, with the gains' doubt in the sensitivities.

    The search begins at output error's `minimum`, if that does not run away from the data.
    """
    tried, wanted = [], len(problem.slots)
    usable = minimum is not None and not diverges(problem, problem.residual(minimum.x))
    start = minimum.x if minimum is not None and usable else problem.x0
    for gains in first_gains(problem.structure, problem.records[0], problem.values(start, 0)):
        own = posed(problem.records, gains)
        own.x0[:wanted] = start
        try:
            best = _solve(own, {}, together=True)
            if stable := reflected_gains(own, best.x):
                # The errors of an unstable predictor grow, and fit the chance of one record.
                held = [slot.unknown.name in stable for slot in own.slots]
                own.x0[:], own.lower[held] = best.x, list(stable.values())
                own.upper[held] = own.lower[held]
                own.x0[:] = _solve(own, {}, together=True).x
                own.lower[held], own.upper[held] = -math.inf, math.inf
                best = _solve(own, {}, together=True)
        except (IdentificationError, np.linalg.LinAlgError, ValueError):
            continue
        whiten = ErrorsTogether(own, own.residual(best.x))
        sizes = np.array([block.rows.stop - block.rows.start for block in own.blocks])
        tried.append((float(sizes @ np.log(own.sigma / problem.sigma)) + whiten.log_deviations, own, best, whiten))
        if passes(own, own.residual(best.x)):
            break  # white prediction errors leave nothing to other gains
    if not tried:
        return None
    cost, own, best, whiten = min(tried, key=lambda one: one[0])
    error = whiten(own.residual(best.x))
    model = DisturbanceModel(
        "innovation",
        answering=inputs_that_answer(problem, error),
        dt=problem.records[0].dt,
        gains=gains_of(own, best.x),
    )
    return Disturbed(
        replace(best, x=best.x[:wanted], at_bound=best.at_bound[:wanted]),
        without_gains(whiten(own.central_jacobian(best.x)), wanted),
        error,
        np.ones(len(own.blocks)),
        model,
        0.5 * float(error @ error) + cost,
        predictor=(own, best.x),
    )


def _check_followed(problem: Problem, found: Disturbed) -> None:
    """Raise IdentificationError for a model whose outputs run away from the data."""
    if found.model.kind == "walk":
        return
    # In closed loop the model is judged by what it predicts: the input answers pushes that a simulation does not know.
    answered = bool(found.model.answering) and found.model.kind in ("ar", "input")
    own, x = found.predictor or (problem, found.minimum.x)
    if not diverges(own, own.residual(x), _FAR_DIVERGED if answered else _DIVERGED):
        return
    _check_stable(problem, found)
    raise problem.structure.error(
        "the model's outputs diverge from the data: their errors are larger than what moves there",
        "; ".join(offsets(problem, (), True))
        or "choose other first guesses or another structure; an unstable plant in closed loop is predicted, not "
        "simulated: describe it by linear_model",
    )


def _check_stable(problem: Problem, found: Disturbed) -> None:
    """Raise IdentificationError for the simulation of an unstable linear model."""
    structure, dt = problem.structure, problem.records[0].dt
    if structure.predictor is None or found.predictor is not None:
        return
    if any(is_unstable(structure, problem.values(x, 0), dt) for x in (problem.x0, found.minimum.x)):
        what = "the model is unstable, and its simulation diverges from the data for any values of the unknowns"
        remedy = "take disturbance='innovation': a predictor corrects the states by what was measured"
        raise structure.error(what, remedy)


@contextmanager
def _naming_the_unit_of_time(
    posed: Callable[[Sequence[Record]], Problem], records: Sequence[Record], where: str
) -> Iterator[None]:
    """Explain an error of a fit by a time that is not in seconds, if the first guess follows the steps in that unit."""
    try:
        yield
    except IdentificationError as error:
        step = max(record.dt for record in records)
        for unit, factor in _UNITS if step >= _COARSE_S else ():
            problem = posed([replace(record, dt=record.dt / factor) for record in records])
            jacobian = problem.jacobian(problem.x0, problem.residual(problem.x0))
            try:
                check_identifiable(jacobian, problem.scale, [slot.label for slot in problem.slots], where)
            except (IdentificationError, np.linalg.LinAlgError):
                continue
            raise IdentificationError(
                f"the first guess is unstable or at rest within a step of {step:g} s, not within {step / factor:g} s",
                where,
                f"if the time is in {unit}, divide it by {factor:.0f} (in a table, its heading may name the unit); "
                "else give other first guesses",
            ) from error
        first = posed(records)
        far, left = "; ".join(offsets(first, (), True)), first.residual(first.x0)
        if far:
            raise IdentificationError(error.what, where, far) from error
        for block in first.blocks:
            times = float(np.sqrt(np.mean(left[block.rows] ** 2)))
            if _OTHER_SIZE < times < math.inf:
                what = f"{error.what}: with the first guess {block.output} is {times:.0g} times as large as in the data"
                raise IdentificationError(what, where, "scale the data, or give other first guesses") from error
        raise


def _check_distinct(structure: Structure, records: Sequence[Record]) -> None:
    """Raise IdentificationError where an output is an input: a model of it needs no data."""
    for record in records:
        for name, output in itertools.product(structure.inputs, structure.outputs):
            seen, applied = record.outputs.get(output), record.inputs.get(name)
            if seen is None or applied is None or name in structure.measured:
                continue
            if np.array_equal(seen.value, applied) and float(np.ptp(applied)) > 0.0:
                raise record.error(f"the output {output} is the input {name}", "name another column for one of the two")


def named_model(name: str, record: Record) -> Structure | PolynomialModel:
    """Return the model `name`, such as "bj:2,1,1,2,1", between all inputs and outputs of `record`.

    The forms are those of `twodof.models.model_named`, and "subspace", whose order is found, or "subspace:4". Raises
    IdentificationError for other names.
    """
    if name.partition(":")[0] == "subspace":
        return subspace_named(name, record)
    return model_named(name, tuple(record.inputs), tuple(record.outputs))


def _guessed(structure: Structure, record: Record, values: Mapping[str, float]) -> Structure:
    """Return the structure with the first guesses that it finds itself, if it does, for unknowns without `values`."""
    if structure.begin is None:
        return structure
    time, y, u = record.signals(structure.inputs[0], structure.outputs[0])
    found = structure.begin(u, np.interp(record.time, time, y), record.dt)
    return found.with_guess(**{name: value for name, value in values.items() if name in found.unknowns})


def _names(names: Collection[str]) -> tuple[str, ...]:
    """Return the names in the order asked for; those of a set, which has no order, sorted."""
    if isinstance(names, str):
        return (names,)
    return tuple(names) if isinstance(names, Sequence) else tuple(sorted(names))


def _several(records: Record | Iterable[Record]) -> tuple[Record, ...]:
    several: tuple[Any, ...] = (records,)
    # A log or a mapping would give the names of its channels or items.
    if isinstance(records, Iterable) and not isinstance(records, FlightLog | Mapping):
        several = tuple(records)
    for one in several:
        check_record(one)
    return several


def _solve(problem: Problem, noise: Mapping[str, float], together: bool = False) -> LeastSquaresMinimum:
    """Minimise; with several noises unknown re-weight by the residuals until the weights stand still.

    With `together` the weights are those of a predictor's errors, which go together (`ErrorsTogether`).
    """
    fixed = problem.set_noise(noise)
    open_ = [blocks for noise_of in problem.noises if (blocks := [k for k in noise_of if k not in fixed])]
    # One weight alone does not move the minimum; of several, a per cent is far below what their estimated spread is
    # worth.
    x, still = problem.x0, len(problem.blocks) == 1 and not problem.known
    whiten = None
    for _ in range(20):
        minimum = problem.minimise(x, whiten, _FINE if still else _ROUGH)
        x = minimum.x
        if not math.isfinite(minimum.cost):
            raise problem.structure.error(
                "the model's outputs are not finite at the first guess: it is unstable, or too fast for steps of "
                f"{max(record.dt for record in problem.records):g} s",
                "choose other first guesses, or a smaller step (substeps)",
            )
        residual = minimum.residual if whiten is None else problem.residual(x)
        change = _reweight(problem, residual, open_)
        if still:
            break
        if together:
            before, whiten = whiten, ErrorsTogether(problem, residual)
            change = max(change, whiten.change(before) if before else math.inf)
        still = change < 0.01
    return minimum


def _reweight(problem: Problem, residual: Array, noises: Sequence[Sequence[int]]) -> float:
    """Set the sigma of each noise to that of its residuals (degrees of freedom shared by rows); the largest change."""
    freedom = max(1, problem.size - len(problem.slots)) / problem.size
    change = 0.0
    for blocks in noises:
        rows = np.concatenate([residual[problem.blocks[k].rows] for k in blocks])
        # A perfect model of noise-free data leaves rounding errors: a weight far below them would be noise itself.
        factor = max(math.sqrt(float(rows @ rows) / (rows.size * freedom)), 1e-9)
        problem.sigma[list(blocks)] *= factor
        change = max(change, abs(factor - 1.0))
    return change


def _comparisons(
    problem: Problem, x: Array, found: Disturbed | None = None, predicts: bool = False
) -> tuple[Comparison, ...]:
    """Compare each output of each record with the model; the tests are those of the noise model's prediction errors."""
    tested = None if found is None or found.model.kind == "white" else found.prediction_error
    noise = {} if found is None else found.model.noise
    ahead = {k: noise.get(problem.noise_label(i)) for i, blocks in enumerate(problem.noises) for k in blocks}
    own, at = (found.predictor if found is not None else None) or (problem, x)
    predicts = own.structure is not problem.structure or predicts
    simulated = [own.simulate(at, r) for r in range(len(problem.records))]
    compared = []
    for k, block in enumerate(problem.blocks):
        record, model = problem.records[block.record], ahead[k]
        unpredicted = None if model is None else model.sigma
        if found is not None and found.model.walks:
            size = np.diag(list(found.model.walks.values())[k].factor)
            unpredicted = float(np.sqrt(np.mean((size * found.prediction_error[block.rows]) ** 2)))
        if predicts:
            unpredicted = rmse(problem.measured(k), simulated[block.record][block.output])
        step = np.floor(record.outputs[block.output].position).astype(np.int64)
        compared.append(
            comparison(
                record.name,
                block.output,
                record.output_time(block.output),
                problem.measured(k),
                simulated[block.record][block.output],
                {name: record.inputs[name][step] for name in problem.structure.inputs},
                prediction_error=None if tested is None else tested[block.rows],
                unpredicted=unpredicted,
            )
        )
    return tuple(compared)


def _validation(
    problem: Problem, found: Disturbed, records: Sequence[Record], like: str, given: Mapping[str, float]
) -> tuple[Comparison, ...]:
    """Simulate records that the fit did not use, with the values of record `like`; local unknowns are fitted.

    `given` has their first guesses and the values of those that are not fitted, by unknown or "unknown[record]".
    """
    x, predicts = found.minimum.x, found.predictor is not None
    if found.predictor is not None:
        records = [with_measured(problem.structure, record) for record in records]
        problem, x = found.predictor
    names = [record.name for record in problem.records]
    if like and like not in names:
        raise IdentificationError(f"no record is called '{like}'", "validation", f"there are: {', '.join(names)}")
    compared: list[Comparison] = []
    unknowns = problem.structure.unknowns
    values = problem.values(x, names.index(like) if like else len(names) - 1)
    shared = {name: value for name, value in values.items() if not unknowns[name].local}
    local = {slot.unknown.name for slot in problem.slots if slot.unknown.local}
    for record in records:
        own = Problem(problem.structure, [record], local, {**given, **shared})
        compared.extend(_comparisons(own, _solve(own, {}).x if local else own.x0, predicts=predicts))
    return tuple(compared)
