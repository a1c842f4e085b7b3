"""Prediction-error fits of polynomial models: ARX, ARMAX, OE and Box-Jenkins (`twodof.models.polynomial`).

Ljung, System Identification, 2nd edition: the criterion is of section 7.2, its search by Gauss-Newton of section 10.2,
the covariance of section 9.3. The search begins at what linear regressions give (sections 10.4 and 10.5): of A y = B u
+ C e with residuals of a long ARX model for e, and of B / F by the iteration of Steiglitz and McBride (1965).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twodof.identify.covariance import ResidualRows, check_identifiable, covariance, robust_covariance
from twodof.identify.disturbance.disturbance_model import DisturbanceModel, answers
from twodof.identify.estimate import Estimate
from twodof.identify.record import Record
from twodof.identify.validate import Comparison, comparison, fit_percent
from twodof.models.polynomial import PolynomialModel

Array = NDArray[np.float64]

_LONG, _SHARE = 30, 20
"""Order of the ARX model whose residuals stand for e, at most, and at most one in so many samples."""
_ROUNDS = 8
"""Rounds of Steiglitz and McBride; the best one is taken."""
_FAR = 5.0
"""Mean of a signal in its standard deviations above which it lies far from 0."""
_INSIDE = 0.98
"""Largest root of a noise polynomial at the start of a search."""


@dataclass(frozen=True, eq=False)
class _Columns:
    """Inputs (m, steps) and output (steps,) of a record."""

    record: Record
    u: Array
    y: Array


def fit_polynomial(model: PolynomialModel, records: Sequence[Record], validation: Sequence[Record] = ()) -> Estimate:
    """Fit a polynomial model to records of one sample time; free responses at their starts are estimated along.

    Raises IdentificationError for a record without the model's channels, with an output that is not sampled at each
    step, or too short. It is also raised for unknowns that the data cannot tell (apart), naming them.
    """
    data = [_columns(model, record) for record in records]
    if len({round(record.dt, 9) for record in (*records, *validation)}) > 1:
        raise model.error("the records have different sample times", "give them one: Record.resample(period)")
    samples = sum(one.y.size - _lost(model) for one in data)
    count, free = len(model.labels), sum(model.nf) * len(data)
    if samples <= count + free or any(one.y.size <= 2 * _lost(model) for one in data):
        raise model.error(f"{samples} samples for {count} unknowns", "take a longer record, or a smaller order")

    from scipy.optimize import least_squares  # imported late: most commands start without it

    def error(x: Array) -> Array:
        starts = x[count:].reshape(len(data), -1)
        parts = [_innovations(model, x[:count], start, one) for start, one in zip(starts, data, strict=True)]
        return np.concatenate(parts)

    with np.errstate(over="ignore", invalid="ignore"):
        begun = min(_starts(model, data), key=lambda theta: _size(error(np.append(theta, np.zeros(free)))))
        found = least_squares(
            error, np.append(begun, np.zeros(free)), "3-point", x_scale="jac", ftol=1e-12, xtol=1e-12, gtol=1e-12
        )
    theta, e = found.x[:count], error(found.x)
    sigma = float(np.sqrt(e @ e / (e.size - count - free))) or 1e-300
    slopes = found.jac[:, :count] / sigma
    if free:  # the marginal of the unknowns: what free responses explain tells nothing of them
        basis, sizes, _ = np.linalg.svd(found.jac[:, count:], full_matrices=False)
        basis = basis[:, sizes > 1e-9 * sizes[0]]
        slopes = slopes - basis @ (basis.T @ slopes)
    where = f"model '{model.name}'"
    condition = check_identifiable(slopes, np.maximum(np.abs(theta), 1e-3), model.labels, where)
    blocks, at = [], 0
    for i, one in enumerate(data):
        size = one.y.size - _lost(model)
        blocks.append(ResidualRows(i, model.output, slice(at, at + size), np.arange(size)))
        at += size
    made = Estimate(
        structure=model.name,
        labels=model.labels,
        units=("",) * count,
        local=frozenset(),
        values=theta,
        covariance=covariance(slopes),
        robust=robust_covariance(slopes, e / sigma, blocks, spectral=False),
        noise={model.output: sigma},
        fixed={},
        at_bound=(),
        condition_number=condition,
        identification=tuple(compare_polynomial(model, theta, one.record) for one in data),
        validation=tuple(compare_polynomial(model, theta, record) for record in validation),
        iterations=int(found.nfev),
        converged=bool(found.status > 0),
        domain=f"prediction error, steps of {records[0].dt:.6g} s",
        disturbance=DisturbanceModel(dt=records[0].dt),
        offsets=tuple(_offsets(model, data)),
        model=model,
    )
    pushed = [
        name
        for i, name in enumerate(model.inputs)
        if any(answers(one.u[i][b.rows.start - b.rows.stop :], e[b.rows]) for one, b in zip(data, blocks, strict=True))
    ]
    if pushed and model.kind == "oe":
        said = (
            f"{' and '.join(pushed)} answers the noise, as a controller does, which makes output error wrong: take bj"
        )
        made = replace(made, suggestions=(said,))
    return made


def predict_polynomial(model: PolynomialModel, theta: Array, record: Record) -> tuple[Array, Array, int]:
    """Return simulation and one-step prediction, shape (steps,), and the number of first samples without one.

    The free responses at the record's start are those that fit it best. An unstable model is not simulated: its
    prediction stands for both.
    """
    from scipy.signal import lfilter  # imported late: most commands start without it

    one, lost = _columns(model, record), _lost(model)
    p = model.polynomials(theta)
    zero = _innovations(model, theta, np.zeros(sum(model.nf)), one)
    free = np.eye(sum(model.nf))
    if free.size:
        moved = np.column_stack([_innovations(model, theta, start, one) - zero for start in free])
        zero = zero + moved @ np.linalg.lstsq(moved, -zero, rcond=None)[0]
    ahead = np.append(one.y[:lost], one.y[lost:] - zero)
    if not p.stable:
        return ahead, ahead, lost
    simulated = np.zeros(one.y.size)
    columns = []
    for i, u in enumerate(one.u):
        bottom = np.convolve(p.a, p.f[i])
        driven = lfilter(p.b[i], [1.0], u)
        driven[:lost] = 0.0
        simulated += lfilter([1.0], bottom, driven)
        if i == 0 or model.nf[i]:
            columns += [lfilter([1.0], bottom, _impulse(one.y.size, lost + k)) for k in range(bottom.size - 1)]
    if columns:
        told = np.column_stack(columns)
        rest = one.y - simulated
        simulated = simulated + told @ np.linalg.lstsq(told[lost:], rest[lost:], rcond=None)[0]
    return simulated, ahead, lost


def compare_polynomial(model: PolynomialModel, theta: Array, record: Record) -> Comparison:
    """Compare a record with the simulation and the one-step prediction; the tests are those of the latter's error."""
    simulated, ahead, lost = predict_polynomial(model, theta, record)
    y = record.outputs[model.output].value
    made = comparison(
        record.name,
        model.output,
        record.output_time(model.output)[lost:],
        y[lost:],
        simulated[lost:],
        {name: record.inputs[name][lost:] for name in model.inputs},
        prediction_error=(y - ahead)[lost:],
    )
    return replace(made, ahead=fit_percent(y[lost:], ahead[lost:]))


def _columns(model: PolynomialModel, record: Record) -> _Columns:
    for name in model.inputs:
        record.signals(name, model.output)
    samples = record.outputs[model.output]
    if not (samples.on_grid and samples.value.size == record.steps):
        what = f"'{model.output}' is not sampled at each step of {record.dt:.6g} s"
        raise record.error(what, f"put it there: Record.resample(record.dt) (--resample {record.dt:.6g})")
    return _Columns(record, np.array([record.inputs[name] for name in model.inputs]), samples.value)


def _lost(model: PolynomialModel) -> int:
    """Return the number of first samples whose regressors lie before the record."""
    reach = [nb + nk - 1 for nb, nk in zip(model.nb, model.nk, strict=True)]
    return max(model.na, *reach) + model.nd


def _innovations(model: PolynomialModel, theta: Array, start: Array, data: _Columns) -> Array:
    """Return D / C (A y - sum of B / F u) from the first sample with all regressors on (Ljung, equation 4.35)."""
    from scipy.signal import lfilter  # imported late: most commands start without it

    p, first = model.polynomials(theta), _lost(model) - model.nd
    v = lfilter(p.a, [1.0], data.y)
    at = 0
    for i, u in enumerate(data.u):
        drive, order = lfilter(p.b[i], [1.0], u), model.nf[i]
        drive[:first] = 0.0
        drive[first : first + order] += start[at : at + order]
        v = v - lfilter([1.0], p.f[i], drive)
        at += order
    return np.asarray(lfilter([1.0], p.c, lfilter(p.d, [1.0], v[first:])[model.nd :]))


def _starts(model: PolynomialModel, data: Sequence[_Columns]) -> Iterator[Array]:
    """Yield values to begin the search with."""
    if not any(model.nf):
        a, b, c = _regression(model.na, model.nb, model.nk, model.nc, [(one.u, one.y) for one in data])
        yield np.concatenate([a, _inside(c), *b])
        if model.nc:
            yield np.concatenate([a, 0.0 * c, *b])
        return
    for b, f in _steiglitz_mcbride(model, data):
        if not (model.nc or model.nd):
            yield np.concatenate([*b, *f])
            continue
        quiet = replace(model, kind="oe", nc=0, nd=0)
        theta = np.concatenate([*b, *f])
        noise = [(one.u[:0], _innovations(quiet, theta, np.zeros(sum(model.nf)), one)) for one in data]
        d, _, c = _regression(model.nd, (), (), model.nc, noise)
        for share in (1.0, 0.0):
            yield np.concatenate([share * _inside(c), share * _inside(d), theta])


def _steiglitz_mcbride(model: PolynomialModel, data: Sequence[_Columns]) -> Iterator[tuple[list[Array], list[Array]]]:
    """Yield B and F by input, round by round: A of an ARX model of signals that the last A has filtered."""
    from scipy.signal import lfilter  # imported late: most commands start without it

    b, f = [np.zeros(n) for n in model.nb], [np.zeros(n) for n in model.nf]
    for _ in range(_ROUNDS):
        for i in range(len(model.inputs)):
            told = []
            for one in data:
                others = np.zeros(one.y.size)
                for j in range(len(model.inputs)):
                    if j != i:
                        others += lfilter(np.append(np.zeros(model.nk[j]), b[j]), np.append(1.0, f[j]), one.u[j])
                u, y = (lfilter([1.0], np.append(1.0, f[i]), x) for x in (one.u[i], one.y - others))
                told.append((u[None], y))
            a, (b[i],), _ = _regression(model.nf[i], model.nb[i : i + 1], model.nk[i : i + 1], 0, told)
            f[i] = _inside(a, 1.0)
        yield list(b), list(f)


def _regression(
    na: int, nb: Sequence[int], nk: Sequence[int], nc: int, data: Sequence[tuple[Array, Array]]
) -> tuple[Array, list[Array], Array]:
    """Return A, B and C of A y = B u + C e by least squares, with e the residual of a long ARX model."""
    errors = [np.zeros(y.size) for _, y in data]
    if nc:
        order = max(na + nc, min(_LONG, min(y.size for _, y in data) // _SHARE))
        longer = [max(n, order) for n in nb]
        a, b, _ = _regression(order, longer, nk, 0, data)
        from scipy.signal import lfilter  # imported late: most commands start without it

        for e, (u, y) in zip(errors, data, strict=True):
            e += lfilter(np.append(1.0, a), [1.0], y)
            for k, one, own in zip(nk, b, u, strict=True):
                e -= lfilter(np.append(np.zeros(k), one), [1.0], own)
            e[: order + max(nk, default=0)] = 0.0
    first = max(na, nc, *(n + k - 1 for n, k in zip(nb, nk, strict=True)), 0)
    tables, wanted = [], []
    for e, (u, y) in zip(errors, data, strict=True):
        columns = [-y[first - i : y.size - i] for i in range(1, na + 1)]
        for n, k, own in zip(nb, nk, u, strict=True):
            columns += [own[first - k - i : own.size - k - i] for i in range(n)]
        columns += [e[first - i : e.size - i] for i in range(1, nc + 1)]
        tables.append(np.array(columns).T.reshape(y.size - first, -1))
        wanted.append(y[first:])
    x = np.linalg.lstsq(np.concatenate(tables), np.concatenate(wanted), rcond=None)[0]
    a, *b, c = np.split(x, np.cumsum([na, *nb]))
    return a, b, c


def _inside(polynomial: Array, most: float = _INSIDE) -> Array:
    """Return the coefficients behind the leading 1 with roots outside the unit circle mirrored, none beyond `most`."""
    roots = np.roots(np.append(1.0, polynomial))
    size = np.abs(roots)
    if (size <= most).all():
        return polynomial
    size = np.where(size > 1.0, 1.0 / np.maximum(size, 1e-300), size)
    return np.asarray(np.poly(np.minimum(size, _INSIDE) * np.exp(1j * np.angle(roots)))[1:].real)


def _impulse(size: int, at: int) -> Array:
    one = np.zeros(size)
    one[at : at + 1] = 1.0
    return one


def _size(error: Array) -> float:
    total = float(error @ error)
    return total if np.isfinite(total) else np.inf


def _offsets(model: PolynomialModel, data: Sequence[_Columns]) -> Iterator[str]:
    """Yield signals far from 0, which a polynomial model goes through."""
    for one in data:
        far = [
            f"{name} lies at {x.mean():.4g} +- {x.std():.2g}"
            for name, x in (*zip(model.inputs, one.u, strict=True), (model.output, one.y))
            if abs(x.mean()) > _FAR * x.std() > 0.0
        ]
        if far:
            yield f"{' and '.join(far)} in '{one.record.name}', far from 0: take Record.detrend() (--detrend)"
