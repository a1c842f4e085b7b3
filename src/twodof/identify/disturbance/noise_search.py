"""Which noise model a fit takes, and the estimate under it."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError
from twodof.identify.covariance import check_identifiable, covariance, robust_covariance
from twodof.identify.disturbance.coloured_problem import ColouredProblem, swings
from twodof.identify.disturbance.disturbance_model import KINDS, Disturbance, DisturbanceModel, inputs_that_answer
from twodof.identify.disturbance.gust import GustModel, can_be_pushed
from twodof.identify.disturbance.walk import MOST, WalkModel, is_unstable
from twodof.identify.estimate import CONTRADICTED
from twodof.identify.least_squares import LeastSquaresMinimum
from twodof.identify.problem import Problem
from twodof.identify.validate import is_rounding, whiteness

Array = NDArray[np.float64]

LONG = 800
"""Samples from which on `auto` trusts an autoregression: fewer do not tell the slow part of the noise."""

_FEWEST = 250
"""Samples from which on a closed loop is fitted by an autoregression where the gust's model does not exist. Of 30
flights of attitude steps and of pseudo-random ones on the rig `lab`, cut to 250 to 700 samples, 93 to 100 % held mu and
tau. Under white noise 13 to 63 % held mu."""

_SLOW = 2
"""In open loop a record of 4 s has two swings of the pendulum, and slow noise passes for one of them. An
autoregression of the output and a gust of .16 s take the swing after a push for one of the excitation: of 44 multisines
on the rig `lab` 70 % held w_n, and 93 % with noise that pushes a swing."""

_FAR = 12.0
"""Difference of log likelihoods at which noise of the output alone is certain. On the rig `lab`, which has gusts, it is
-17 to 4, on `paper`, which has none, 35 to 66."""

_LAGS = 25
_NEAR = 0.3
_LISTENS = 4
"""How often the places where the noise is louder are found again; they stand after two or three."""
_POLISHES = 8
_STANDS = 0.03
"""Gauss-Newton steps at the end of a fit under louder noise, and the length in standard deviations of the last."""

_LONGEST, _A_COEFFICIENT, _QUIET = 120, 20, 0.3
"""Largest order and samples for each coefficient of a noise that has next to nothing at the frequencies of the motion,
and the fall of the unknowns' log variances by which it is known. The vibration of the rig `paper` does: the order that
predicts best, 28 to 60, leaves 2 to 3.5 times the noise of .0014 rad/s there. The fall was .1 to 1.3 in 21 flights on
`paper`, and at most .13 in 28 on `lab`."""

_TURNS = 5
_STILL = 0.05
"""Turns of the search under a gust, and the move in standard deviations that ends it."""

_MUCH = 5.0
_LOWER = 0.01

_LIKELIER = 5.0
"""Gain of the log likelihood, each less its penalty, from which on a predictor is taken: odds of 150 to 1. Under
process noise it gains 15 to 300 over an autoregression, and at most 3 in the sets of `tests/identify/hard_data.py`."""

_WORSE = 3.0
"""Residual over that of output error from which on coloured noise has taken the response itself for noise. A gust is
found with one correlation time, and may not leave more than what moves."""


@dataclass(frozen=True, eq=False)
class Disturbed:
    """The end of a search: x, its sensitivities and prediction errors over the noise, and the noise model.

    `deviation` is the standard deviation of the residual of each block of rows, in units of its weight. `cost` compares
    searches of one kind. `predictor` is the problem of the innovation form and its x, where that is the noise model.
    """

    minimum: LeastSquaresMinimum
    jacobian: Array
    prediction_error: Array
    deviation: Array
    model: DisturbanceModel
    cost: float = 0.0
    predictor: tuple[Problem, Array] | None = None


def check_disturbance(disturbance: Disturbance, banded: bool, noise_given: bool, where: str) -> None:
    """Raise IdentificationError for an unknown noise model, and for one that is asked for with a band or noise."""
    if disturbance not in KINDS:
        raise IdentificationError(f"no disturbance {disturbance!r:.80}", where, f"there are: {', '.join(KINDS)}")
    if disturbance not in ("auto", "white") and (banded or noise_given):
        what = "a band: a noise model needs all frequencies"
        what = what if banded else "given standard deviations: the noise model finds its own"
        raise IdentificationError(f"disturbance='{disturbance}' with {what}", where, "leave one of the two out")


def search(problem: Problem, minimum: LeastSquaresMinimum, disturbance: Disturbance, noise_given: bool) -> Disturbed:
    """Estimate under the noise model asked for, from the output-error `minimum`.

    "auto" stays with white noise where the output error's residual is white, and where a band is fitted or the noise is
    given. Otherwise it takes the autoregression for long records (`LONG`; in open loop twice that). For shorter ones it
    takes the gust at the input, which has few unknowns. The structure must then be linear and have the actuator's lag.
    Where the poles have priors, the autoregression is that of pushes at the swing, if they may be there (`_coloured`);
    an open loop then takes it from `LONG` on.
    Another structure takes the autoregression from `LONG` on, in closed loop from `_FEWEST` samples of all records. A
    structure with pushed states takes their walk instead of either.

    In open loop output error and noise model are both right if the structure is. Where they differ by more than chance
    (Hausman, 1978), the structure is wrong, unless a gust explains the difference. Output error then stays, which at
    least reproduces the response.
    """
    residual, jacobian = problem.residual(minimum.x), problem.central_jacobian(minimum.x)
    cost = 0.5 * float(residual @ residual)
    white = Disturbed(minimum, jacobian, residual, np.ones(len(problem.blocks)), DisturbanceModel(), cost)
    passed = problem.band is not None or passes(problem, white.prediction_error)
    asked = disturbance == "walk" or (disturbance == "auto" and not passed)
    if asked and not noise_given and _can_walk(problem):
        answers = inputs_that_answer(problem, white.prediction_error)
        return _settled(problem, white, _pushed_from(problem, minimum.x, answers, walks=True))
    if passed:
        return white if disturbance in ("auto", "white") else _asked(problem, minimum, disturbance, ())
    answering = inputs_that_answer(problem, white.prediction_error)
    white = replace(white, model=DisturbanceModel(answering=answering))
    if disturbance == "white" or noise_given:
        return white
    samples = np.array([block.rows.stop - block.rows.start for block in problem.blocks])
    short = samples.min() < (LONG if answering else _SLOW * LONG)
    if disturbance == "auto" and short and can_be_pushed(problem, problem.x0, sure=True):
        if not answering and samples.min() >= LONG and swings(problem):
            pushed = _settled(problem, white, _coloured(problem, minimum, answering))
            if pushed.model.swing:
                return pushed
        return _settled(problem, white, _pushed(problem, minimum, answering))
    if disturbance == "auto" and samples.min() < LONG:
        # Output error may have lost the lag. Too short to tell the slow part of the noise is still better than what a
        # controller makes of it.
        enough = answering and samples.sum() >= _FEWEST
        return _settled(problem, white, _coloured(problem, minimum, answering)) if enough else white
    if disturbance == "auto":
        weights = problem.sigma.copy()
        settled = _settled(problem, white, _coloured(problem, minimum, answering))
        # With other weights the search began anew, and has asked this.
        asked = not np.array_equal(problem.sigma, weights)
        if settled.model.change > 0.0 and not asked and can_be_pushed(problem, problem.x0, sure=True):
            # A slow wander is too long for the flight's own covariance. A gust that explains it acquits the structure.
            pushed_too = _settled(problem, white, _pushed(problem, minimum, answering))
            return pushed_too if pushed_too.model.kind == "input" else settled
        return settled
    return _asked(problem, minimum, disturbance, answering)


def _asked(
    problem: Problem, minimum: LeastSquaresMinimum, disturbance: Disturbance, answering: tuple[str, ...]
) -> Disturbed:
    if disturbance == "ar":
        return _coloured(problem, minimum, answering)
    if disturbance == "walk":
        what = f"disturbance='walk' needs a structure with pushed states and one output of at most {MOST} samples"
        raise problem.structure.error(what, "take disturbance='ar', which any structure can have")
    if not can_be_pushed(problem, minimum.x):
        what = "disturbance='input' needs a linear structure of one input, and one output sampled once a step"
        raise problem.structure.error(what, "take disturbance='ar', which any structure can have")
    return _pushed(problem, minimum, answering)


def _settled(problem: Problem, white: Disturbed, found: Disturbed) -> Disturbed:
    """On "auto": what was `found`, unless that cannot be or says that the structure is wrong."""
    if not (math.isfinite(found.minimum.cost) and _identifiable(problem, found)):
        return white
    if found.model.kind != "walk" and not white.model.answering:
        change = _change(problem, white, found)
        coloured = found.model.kind == "ar"
        # Under pushes the start follows from the first two samples, so the simulation may drift.
        if coloured and not found.model.swing and _far_worse(problem, found.minimum.x, white.minimum.x):
            change = math.inf
        if not coloured and diverges(problem, problem.residual(found.minimum.x)):
            change = math.inf
        # Output error that takes a push for the swing contradicts what is known of it, and proves nothing.
        pushed = found.model.swing or not coloured
        mistaken = pushed and _contradicts(problem, white) and not _contradicts(problem, found)
        if change > _MUCH and not mistaken:
            better = _better(problem, white.minimum, found.minimum.x)
            if better is not None:
                return search(problem, better, "auto", False)
            return replace(white, model=DisturbanceModel(change=change))
    return found


def _contradicts(problem: Problem, found: Disturbed) -> bool:
    """Return True if an estimate is off what was known of it before by more than chance."""
    return bool((np.abs(found.prediction_error[problem.size :]) > CONTRADICTED).any())


def likelier(problem: Problem, found: Disturbed, predictor: Disturbed) -> Disturbed:
    """Return the `predictor` in place of what was `found` on "auto", if process noise rules.

    The data must be likelier by far than under noise of the outputs, even or coloured. What a wrong structure leaves
    out has a colour too, but not that of pushes behind the plant's poles: an autoregression predicts it better.
    """
    assert predictor.predictor is not None
    own, x = predictor.predictor
    if is_unstable(own.structure, own.values(x, 0), own.records[0].dt):
        return found  # a predictor whose own errors grow follows the chance of one record
    cost = predictor.cost + len(predictor.model.gains)
    starts = (found.minimum.x, predictor.minimum.x)
    other = _coloured_by(ColouredProblem(problem), problem, starts, found.minimum, found.model.answering)
    return predictor if cost < min(found.cost, other.cost) - _LIKELIER else found


def _far_worse(problem: Problem, x: Array, white: Array) -> bool:
    """Return True if the simulation at x misses the data by far more than that of output error's estimate `white`."""
    left, least = problem.residual(x), problem.residual(white)
    return not float(left @ left) <= _WORSE**2 * float(least @ least)


def _better(problem: Problem, minimum: LeastSquaresMinimum, x: Array) -> LeastSquaresMinimum | None:
    """Output error's minimum from `x`, if it is lower than the one that was found; the weights become those there.

    Slow noise gives output error several minima, and one of them proves nothing against the structure.
    """
    other = problem.minimise(x)
    if not other.cost < (1.0 - _LOWER) * minimum.cost:
        return None
    problem.sigma *= np.maximum(_deviation(problem, other.residual), 1e-9)
    return problem.minimise(other.x)


def _pushed(problem: Problem, minimum: LeastSquaresMinimum, answering: tuple[str, ...]) -> Disturbed:
    tried = [_pushed_from(problem, start, answering) for start in (minimum.x, problem.x0)]
    return min(tried, key=lambda one: one.cost if math.isfinite(one.cost) else math.inf)


def _pushed_from(problem: Problem, x: Array, answering: tuple[str, ...], walks: bool = False) -> Disturbed:
    """Search the most likely unknowns under a gust, or where a state `walks` under its pushes, from the guess `x`."""
    pushed = WalkModel if walks else GustModel
    thetas: list[Array | None] = [None] * len(problem.blocks)
    for turn in range(_TURNS):
        gusts: list[Any] = [pushed(problem, x, k, theta) for k, theta in enumerate(thetas)]
        models = [gust.improve(15 if turn else 40) for gust in gusts]
        thetas = [gust.theta for gust in gusts]
        filtered = ColouredProblem(problem, models)
        minimum = problem.minimise(x, filtered.whiten, 1e-6)
        jacobian = filtered.sensitivities(minimum.x)
        moved = float(np.linalg.norm(jacobian @ (minimum.x - x)))
        x = minimum.x
        if stands := moved < _STILL or not math.isfinite(minimum.cost):
            break
    error = filtered.whitened(x)
    # After the last turn the unknowns moved by less than a fifth of a standard deviation or so in all trials.
    ended = replace(minimum, residual=error, converged=minimum.converged and (stands or moved < 0.5))
    noise = {label: model.scaled(s) for (label, s), model in zip(problem.noise().items(), models, strict=True)}
    pushes = {} if walks else {label: gust.gust for label, gust in zip(noise, gusts, strict=True)}
    found = DisturbanceModel("walk" if walks else "input", {} if walks else noise, answering, gusts=pushes)
    found = replace(found, dt=problem.records[0].dt, walks=noise if walks else {})
    deviation = np.array([model.white for model in models]) if walks else _deviation(problem, problem.residual(x))
    cost = 0.5 * float(error @ error) + filtered.log_deviations(models)
    return Disturbed(ended, jacobian, error, deviation, found, cost)


def _can_walk(problem: Problem) -> bool:
    """Return True if each record has one output, not too long, and the structure says which of its states walk."""
    one = len(problem.blocks) == len(problem.records) and problem.band is None
    return one and bool(problem.structure.pushed) and problem.size <= MOST * len(problem.blocks)


def _deviation(problem: Problem, raw: Array) -> Array:
    """Root mean square of the residual of each block."""
    rows = [raw[block.rows] for block in problem.blocks]
    return np.array([math.sqrt(float(own @ own) / own.size) for own in rows])


def _identifiable(problem: Problem, found: Disturbed) -> bool:
    """Return True if the prefiltered data tell the unknowns apart."""
    free = np.flatnonzero(~found.minimum.at_bound)
    try:
        check_identifiable(found.jacobian[:, free], problem.scale[free], [problem.slots[i].label for i in free], "")
    except IdentificationError:
        return False
    return True


def _change(problem: Problem, white: Disturbed, found: Disturbed) -> float:
    """By how many standard deviations output error is off the other estimate, of the unknown that is most so."""
    # What only one of the two has at a bound leaves the others their own doubt in each.
    own, other = (np.flatnonzero(~one.minimum.at_bound) for one in (white, found))
    shared = [i for i in np.intersect1d(own, other) if not problem.slots[i].unknown.local]
    jacobian = white.jacobian[:, own]
    if not shared or (np.linalg.norm(jacobian, axis=0) == 0.0).any():
        return 0.0  # an unknown without any effect is refused later
    variance = np.zeros(len(problem.slots))
    if found.model.kind == "ar":
        # Not the colour that was found: what a wrong structure leaves out has passed into it.
        variance[own] = np.diag(robust_covariance(jacobian, white.prediction_error, problem.blocks, spectral=False))
        variance[other] += np.diag(covariance(found.jacobian[:, other]))
    else:
        # A record so short does not show the colour, and the gust has no room for a wrong structure.
        variance[own] = _under(problem, jacobian, found)
        # Output error may end in a corner where it believes itself sure. What it would be worth at the other estimate
        # bounds that from below.
        there = problem.central_jacobian(found.minimum.x)[:, own]
        if (np.linalg.norm(there, axis=0) > 0.0).all():
            variance[own] = np.maximum(variance[own], _under(problem, there, found))
    deviation = np.sqrt(np.maximum(variance[shared], 1e-300))
    return float((np.abs(found.minimum.x - white.minimum.x)[shared] / deviation).max())


def _under(problem: Problem, jacobian: Array, found: Disturbed) -> Array:
    """Return the variance of output error's estimates under the noise that was `found`, from its sensitivities."""
    bread, sigmas = covariance(jacobian), problem.noise()
    variance = np.zeros(bread.shape[0])
    for block, (label, model) in zip(problem.blocks, found.model.noise.items(), strict=True):
        seen = model.scaled(1.0 / sigmas[label]).colour(jacobian[block.rows]) @ bread
        variance += np.einsum("ij,ij->j", seen, seen)
    return variance


def _coloured(problem: Problem, minimum: LeastSquaresMinimum, answering: tuple[str, ...]) -> Disturbed:
    """Search under coloured noise of the output, or of pushes at the swing where the poles have priors.

    The pushes are taken unless noise of the output is far likelier.
    """
    found = _coloured_by(ColouredProblem(problem), problem, (minimum.x, problem.x0), minimum, answering)
    if not swings(problem):
        return found
    pushed = _coloured_by(ColouredProblem(problem, swing=True), problem, (found.minimum.x,), found.minimum, answering)
    likely = pushed.cost < found.cost + _FAR
    return replace(pushed, model=replace(found.model, swing=True)) if likely else found


def _coloured_by(
    coloured: ColouredProblem,
    problem: Problem,
    starts: Sequence[Array],
    minimum: LeastSquaresMinimum,
    answering: tuple[str, ...],
) -> Disturbed:
    """Search under the noise of `coloured`."""
    # The output error's optimum may be far off in closed loop, the first guess in open loop.
    found = [coloured.minimise(start) for start in starts]
    # In open loop the noise may not swallow the response: a swing that dies out is also an autoregression's.
    right = [math.isfinite(one.cost) and bool(answering or not _far_worse(problem, one.x, minimum.x)) for one in found]
    usable = right if any(right) else [math.isfinite(one.cost) for one in found]
    costs = [coloured.cost(one.x) if use else math.inf for one, use in zip(found, usable, strict=True)]
    best = found[int(np.argmin(costs))]
    coloured.choose(best.x)
    for _ in range(_LISTENS):
        louder = bool(coloured.louder())
        # Where the noise turns out to be even after all, the estimate of before is one under other weights.
        if not (coloured.listen(best.x) or louder):
            break
        before = best.x
        again = coloured.minimise(before)
        if not math.isfinite(again.cost):
            break
        best = _polished(coloured, again, coloured.choose)
        free = coloured.sensitivities(best.x)
        if float(np.linalg.norm(free @ (best.x - before))) < _NEAR:
            break
    jacobian, error = coloured.sensitivities(best.x), coloured.whitened(best.x)
    if not best.converged and _left(jacobian[:, ~best.at_bound], error)[1] >= _NEAR:
        best = _polished(coloured, best, coloured.choose)
        jacobian, error = coloured.sensitivities(best.x), coloured.whitened(best.x)
    # At the optimum a further step is not quite 0, because Burg's coefficients are not quite those of least squares.
    best = replace(best, converged=best.converged or _left(jacobian[:, ~best.at_bound], error)[1] < _NEAR)
    models = coloured.at(best.x)[2]
    coloured.lengthen(best.x)
    longer = coloured.sensitivities(best.x)
    if _doubt(longer) > _doubt(jacobian):
        models, jacobian, error = coloured.at(best.x)[2], longer, coloured.whitened(best.x)
    if problem.size >= _SLOW * LONG:
        coloured.lengthen(best.x, _A_COEFFICIENT, _LONGEST)
        if _doubt(coloured.sensitivities(best.x)) < _doubt(jacobian) - _QUIET * best.x.size:
            best = _polished(coloured, best, coloured.lengthen)
            models, jacobian, error = coloured.at(best.x)[2], coloured.sensitivities(best.x), coloured.whitened(best.x)
    noise = {problem.noise_label(k): m.scaled(float(problem.sigma[problem.noises[k][0]])) for k, m in enumerate(models)}
    found_noise = DisturbanceModel("ar", noise, answering, dt=problem.records[0].dt, louder=coloured.louder())
    deviation = _deviation(problem, coloured.at(best.x)[0])
    return Disturbed(best, jacobian, error, deviation, found_noise, 0.5 * coloured.cost(best.x))


def _polished(
    coloured: ColouredProblem, minimum: LeastSquaresMinimum, choose: Callable[[Array], None]
) -> LeastSquaresMinimum:
    """Search x near the minimum where no sensitivity correlates with the prediction errors; `choose` the orders there.

    Burg's coefficients are not quite those of the least cost: less so in a short record, and where the noise is louder,
    as they know of no weights. The cost's minimum is then off by what is chance in them. The sensitivities are without
    what a coefficient would do, and the x at which they vanish beside the errors does not feel it.
    """
    choose(minimum.x)
    x, free, share = minimum.x, ~minimum.at_bound, 1.0
    step, left = _left(coloured.sensitivities(x)[:, free], coloured.whitened(x))
    for _ in range(_POLISHES):
        if left < _STANDS or share < 0.1:
            break
        other = x.copy()
        other[free] = np.clip(x[free] - share * step, coloured.problem.lower[free], coloured.problem.upper[free])
        # So far out that the model's outputs overflow: a step too far.
        there = np.isfinite(coloured.problem.residual(other)).all()
        next_step, further = (
            _left(coloured.sensitivities(other)[:, free], coloured.whitened(other)) if there else (step, math.inf)
        )
        if further < left:
            x, step, left = other, next_step, further
        else:
            share *= 0.5
    choose(x)
    return replace(minimum, x=x, converged=minimum.converged or left < _STANDS)


def _left(jacobian: Array, error: Array) -> tuple[Array, float]:
    """Return the remaining Gauss-Newton step, and its length in standard deviations, infinite if it is not known."""
    if not (np.isfinite(jacobian).all() and np.isfinite(error).all()):
        return np.zeros(jacobian.shape[1]), math.inf
    step = np.asarray(np.linalg.lstsq(jacobian, error, rcond=None)[0], dtype=np.float64)
    return step, float(np.linalg.norm(jacobian @ step))


def _doubt(jacobian: Array) -> float:
    """How much the claims from sensitivities add up to: the logarithms of their variances."""
    if not np.isfinite(jacobian).all() or (np.linalg.norm(jacobian, axis=0) == 0.0).any():
        return math.nan  # an unknown without any effect is refused later
    return float(np.log(np.maximum(np.diag(covariance(jacobian)), 1e-300)).sum())


def passes(problem: Problem, residual: Array) -> bool:
    """Return True if each output's residual is white, only rounding, or too short for the test."""
    for k, block in enumerate(problem.blocks):
        own = residual[block.rows]
        tested = own.size >= 4 * _LAGS and float(np.ptp(own)) > 0.0
        if tested and not is_rounding(own * problem.sigma[k], problem.measured(k)) and not whiteness(own, _LAGS).passed:
            return False
    return True


def diverges(problem: Problem, residual: Array, times: float = 1.0) -> bool:
    """Return True if the residual of an output is not finite, or over `times` the standard deviation of its data."""
    left = (_deviation(problem, residual) * problem.sigma).tolist()
    moves = [float(problem.measured(k).std()) for k in range(len(left))]
    return any(own > 0.0 and not error <= times * own for error, own in zip(left, moves, strict=True))
