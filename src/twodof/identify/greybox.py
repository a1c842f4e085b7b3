"""Grey-box output error: the parameters with which a simulated structure reproduces the measured outputs best.

The estimate minimises the sum of ((measured - simulated) / sigma)^2 over all outputs of all records. With white output
noise that is maximum likelihood (Ljung, System Identification, section 7.4; what MATLAB's greyest does without a
disturbance model). The standard deviations sigma of the outputs are estimated along, unless given.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError
from twodof.identify.covariance import check_identifiable, covariance, robust_covariance
from twodof.identify.estimate import Estimate
from twodof.identify.levenberg_marquardt import Minimum, minimise
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
) -> Estimate:
    """Fit `structure` to `records`.

    `estimate`: the unknowns to find (default: the structure's choice); all others keep their values. `values`: first
    guesses and fixed values by unknown, or by "unknown[record]" for one record. `bounds`: (lower, upper) by unknown.
    `separate`: unknowns that get one value for each record although they are not local. `noise`: standard deviation of
    outputs whose weight is to be fixed. `band`: fit in the frequency domain, from and to these frequencies [Hz].
    `validation`: records that the model must reproduce without having seen them; only their local unknowns are fitted.

    Raises IdentificationError for unknown names, a record without the structure's channels, a model that is not
    finite at the first guess, and unknowns that the data cannot tell (apart), naming them.
    """
    wanted = structure.estimate if estimate is None else tuple(estimate)
    if not wanted:
        raise IdentificationError("nothing is to be estimated", f"structure '{structure.name}'", "name an unknown")
    given = dict(values or {})
    problem = Problem(structure, _several(records), wanted, given, dict(bounds or {}), separate, band)
    minimum = _solve(problem, dict(noise or {}))
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
        noise=dict(problem.sigma),
        fixed={name: value for name, value in problem.values(minimum.x, 0).items() if name not in wanted},
        at_bound=tuple(label for label, held in zip(labels, minimum.at_bound, strict=True) if held),
        condition_number=condition.number,
        identification=_comparisons(problem, minimum.x),
        validation=_validation(structure, problem, minimum.x, _several(validation)),
        iterations=minimum.iterations,
        converged=minimum.converged,
        domain="time domain" if band is None else f"frequency domain, {band[0]:g} to {band[1]:g} Hz",
    )


def _several(records: Record | Sequence[Record]) -> tuple[Record, ...]:
    return (records,) if isinstance(records, Record) else tuple(records)


def _solve(problem: Problem, noise: dict[str, float]) -> Minimum:
    """Minimise; with several outputs of unknown noise re-weight by the residuals until the weights stand still."""
    for output, sigma in noise.items():
        if output not in problem.sigma or not sigma > 0.0:
            raise IdentificationError(
                f"noise {sigma} for '{output}' is not a positive number for a measured output",
                f"structure '{problem.structure.name}'",
                f"measured outputs: {', '.join(problem.outputs)}",
            )
    problem.sigma.update(noise)
    open_weights = [output for output in problem.outputs if output not in noise]
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
        # With one output its weight does not move the minimum; with several, a per cent is far below what their
        # estimated spread is worth.
        if change < 0.01 or len(problem.outputs) == 1:
            break
    return minimum


def _reweight(problem: Problem, minimum: Minimum, outputs: Sequence[str]) -> float:
    """Set each output's sigma to that of its residuals (degrees of freedom shared by rows); the largest change."""
    residual = minimum.residual
    freedom = max(1, residual.size - len(problem.slots)) / residual.size
    change = 0.0
    for output in outputs:
        rows = np.concatenate([residual[b.rows] for b in problem.blocks if b.output == output])
        factor = math.sqrt(float(rows @ rows) / (rows.size * freedom))
        # A perfect model of noise-free data leaves rounding errors: a weight far below them would be noise itself.
        factor = max(factor, 1e-9)
        problem.sigma[output] *= factor
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


def _validation(structure: Structure, problem: Problem, x: Array, records: Sequence[Record]) -> tuple[Comparison, ...]:
    """Simulate records the fit has not seen: shared values as estimated (separate ones as of the first record)."""
    found: list[Comparison] = []
    shared = {name: value for name, value in problem.values(x, 0).items() if not structure.unknowns[name].local}
    local = [slot.unknown.name for slot in problem.slots if slot.unknown.local]
    for record in records:
        own = Problem(structure, [record], sorted(set(local)), shared, {})
        minimum = _solve(own, {k: v for k, v in problem.sigma.items() if k in own.sigma}) if local else None
        found.extend(_comparisons(own, own.x0 if minimum is None else minimum.x))
    return tuple(found)
