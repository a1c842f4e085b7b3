"""Grey-box output error: the parameters with which a simulated structure reproduces the measured outputs best.

The estimate minimises the sum of ((measured - simulated) / sigma)^2 over all outputs of all records. With white output
noise that is maximum likelihood (Ljung, System Identification, section 7.4; what MATLAB's greyest does without a
disturbance model). The standard deviations sigma of the outputs are estimated along, unless given.
"""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError
from twodof.flightlog.log import FlightLog
from twodof.identify.covariance import ResidualRows, check_identifiable, covariance, robust_covariance
from twodof.identify.estimate import Estimate
from twodof.identify.levenberg_marquardt import LeastSquaresMinimum, minimise
from twodof.identify.problem import Problem
from twodof.identify.record import Record
from twodof.identify.validate import Comparison, compare
from twodof.models.structure import Structure

Array = NDArray[np.float64]


def fit(
    structure: Structure,
    records: Record | Sequence[Record],
    *,
    estimate: Collection[str] | None = None,
    values: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    separate: Collection[str] = (),
    noise: Mapping[str, float] | None = None,
    band: tuple[float, float] | None = None,
    validation: Record | Sequence[Record] = (),
    like: str = "",
) -> Estimate:
    """Fit `structure` to `records`.

    `estimate`: the unknowns to find, or the one (default: the structure's choice); all others keep their values.
    `values`: first guesses and fixed values by unknown, or by "unknown[record]" for one record. `bounds`: (lower,
    upper) by unknown. `separate`: unknowns that get one value for each record although they are not local. `noise`:
    standard deviation of outputs (or "output[record]") whose weight stays fixed. `band`: fit in the frequency
    domain, from and to these frequencies [Hz].
    `validation`: records that the model must reproduce without having seen them. Only their local unknowns are fitted.
    The separate ones are those of the record `like` (default: the last).

    Raises IdentificationError for a wrong type, for unknown or repeated names, and for a record without the structure's
    channels. It is also raised for a model that is not finite at the first guess, and for unknowns that the data cannot
    tell (apart), naming them.
    """
    if not isinstance(structure, Structure):
        raise IdentificationError(
            f"a {type(structure).__name__} is not a structure",
            f"{getattr(structure, '__name__', structure)!s:.80}",
            "give a twodof.models.Structure; the ready-made ones are functions, to be called: pitch_rate()",
        )
    wanted = structure.estimate if estimate is None else _names(estimate)
    twice = [name for i, name in enumerate(wanted) if name in wanted[:i]]
    if twice:
        raise IdentificationError(
            f"'{twice[0]}' is named twice in `estimate`", f"structure '{structure.name}'", "name each unknown once"
        )
    if not wanted:
        raise IdentificationError("`estimate` names no unknown", f"structure '{structure.name}'", "name an unknown")
    given = dict(values or {})
    problem = Problem(structure, _several(records), wanted, given, dict(bounds or {}), _names(separate), band)
    minimum = _solve(problem, noise or {})
    jacobian = problem.central_jacobian(minimum.x)
    labels = [slot.label for slot in problem.slots]
    free = np.flatnonzero(~minimum.at_bound)
    where = f"structure '{structure.name}'"
    if free.size == 0:
        raise IdentificationError("every unknown is held by a bound", where, "widen the bounds or check the signs")
    condition = check_identifiable(jacobian[:, free], problem.scale[free], [labels[i] for i in free], where)
    white, robust = (np.full((len(labels), len(labels)), math.nan) for _ in range(2))
    residual = problem.residual(minimum.x)
    white[np.ix_(free, free)] = covariance(jacobian[:, free])
    robust[np.ix_(free, free)] = robust_covariance(jacobian[:, free], residual, problem.blocks, band is not None)
    return Estimate(
        structure=structure.name,
        labels=tuple(labels),
        units=tuple(slot.unknown.unit for slot in problem.slots),
        local=frozenset(slot.label for slot in problem.slots if slot.unknown.local),
        values=minimum.x,
        covariance=white,
        robust=robust,
        noise=problem.noise(),
        fixed={name: value for name, value in problem.values(minimum.x, 0).items() if name not in wanted},
        at_bound=tuple(label for label, held in zip(labels, minimum.at_bound, strict=True) if held),
        condition_number=condition,
        identification=_comparisons(problem, minimum.x),
        validation=_validation(structure, problem, minimum.x, _several(validation), like),
        iterations=minimum.iterations,
        converged=minimum.converged,
        domain="time domain" if band is None else f"frequency domain, {band[0]:g} to {band[1]:g} Hz",
    )


def _names(names: Collection[str]) -> tuple[str, ...]:
    """The names in the order asked for; those of a set, which lacks an order, sorted."""
    if isinstance(names, str):
        return (names,)
    return tuple(names) if isinstance(names, Sequence) else tuple(sorted(names))


def _several(records: Record | Sequence[Record]) -> tuple[Record, ...]:
    if isinstance(records, Record):
        return (records,)
    # Iterating over a log or a mapping gives the names of what it holds.
    many = isinstance(records, Iterable) and not isinstance(records, (FlightLog, Mapping))
    several = tuple(records) if many else ()
    if not many or not all(isinstance(one, Record) for one in several):
        odd = next((one for one in several if not isinstance(one, Record)), records)
        raise IdentificationError(
            f"a {type(odd).__name__} is not a record", "records", "cut one from a log: cut(log, 'doublet')"
        )
    return several


def _solve(problem: Problem, noise: Mapping[str, float]) -> LeastSquaresMinimum:
    """Minimise; with several noises unknown re-weight by the residuals until the weights stand still."""
    fixed = problem.set_noise(noise)
    open_weights = [block for block in problem.blocks if (block.record, block.output) not in fixed]
    x = problem.x0
    for _ in range(20):
        minimum = minimise(problem.residual, problem.jacobian, x, problem.lower, problem.upper)
        x = minimum.x
        if not math.isfinite(minimum.cost):
            raise IdentificationError(
                "the model's outputs are not finite at the first guess",
                f"structure '{problem.structure.name}'",
                "choose other first guesses, or a smaller step (substeps)",
            )
        change = _reweight(problem, minimum, open_weights)
        # One weight alone does not move the minimum; of several, a per cent is far below what their estimated
        # spread is worth.
        if change < 0.01 or len(problem.blocks) == 1:
            break
    return minimum


def _reweight(problem: Problem, minimum: LeastSquaresMinimum, blocks: Sequence[ResidualRows]) -> float:
    """Set the sigma of each block to that of its residuals (degrees of freedom shared by rows); the largest change."""
    residual = minimum.residual
    freedom = max(1, residual.size - len(problem.slots)) / residual.size
    change = 0.0
    for block in blocks:
        rows = residual[block.rows]
        factor = math.sqrt(float(rows @ rows) / (rows.size * freedom))
        # A perfect model of noise-free data leaves rounding errors: a weight far below them would be noise itself.
        factor = max(factor, 1e-9)
        problem.sigma[block.record, block.output] *= factor
        change = max(change, abs(factor - 1.0))
    return change


def _comparisons(problem: Problem, x: Array) -> tuple[Comparison, ...]:
    found = []
    for r, record in enumerate(problem.records):
        for output, simulated in problem.simulate(x, r).items():
            samples = record.outputs[output]
            step = np.floor(samples.position).astype(np.int64)
            found.append(
                compare(
                    record.name,
                    output,
                    record.output_time(output),
                    samples.value,
                    np.array(simulated),
                    {name: record.inputs[name][step] for name in problem.structure.inputs},
                )
            )
    return tuple(found)


def _validation(
    structure: Structure, problem: Problem, x: Array, records: Sequence[Record], like: str
) -> tuple[Comparison, ...]:
    """Simulate records that the fit did not use, with the values of record `like`; local unknowns are fitted."""
    names = [record.name for record in problem.records]
    if like and like not in names:
        raise IdentificationError(f"no record is called '{like}'", "validation", f"there are: {', '.join(names)}")
    found: list[Comparison] = []
    unknowns = structure.unknowns
    values = problem.values(x, names.index(like) if like else len(names) - 1)
    shared = {name: value for name, value in values.items() if not unknowns[name].local}
    local = {slot.unknown.name for slot in problem.slots if slot.unknown.local}
    for record in records:
        own = Problem(structure, [record], local, shared, {})
        found.extend(_comparisons(own, _solve(own, {}).x if local else own.x0))
    return tuple(found)
