"""Simulation and prediction of a structure on a record, its frequency response, and several models side by side."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.compile.linear.linearize import linearize
from twodof.errors import IdentificationError, finite, is_number, shown
from twodof.identify.disturbance.autoregression import Autoregression, autoregression, pieces_of
from twodof.identify.disturbance.walk import can_predict, with_measured
from twodof.identify.estimate import Estimate
from twodof.identify.polynomial_fit import predict_polynomial
from twodof.identify.problem import Problem
from twodof.identify.record import Record, Samples, check_record
from twodof.identify.record_simulator import RecordSimulator
from twodof.identify.validate import deviations, fit_percent, rmse, vaf
from twodof.models.polynomial import PolynomialModel
from twodof.models.structure import Structure, check_structure

Array = NDArray[np.float64]

# Steps that inputs go on behind the samples looked at, so that a band-limited input does not end there.
_BEHIND = 256


def simulate(
    structure: Structure,
    record: Record,
    values: Mapping[str, float] | Estimate | None = None,
    *,
    initial: int | None = None,
) -> dict[str, Array]:
    """Return the outputs of `structure` for the inputs of `record`, at the times of their samples: arrays by output.

    `values`: the unknowns by name, or what a fit found; others have the structure's own. With `initial` the states at
    the start are those that fit the first `initial` samples best (see `initial_state`), nothing else is looked at.
    Raises IdentificationError for a record without the structure's channels and for unknown names, ParameterError for
    a value outside its bounds.
    """
    given = _given(structure, record, values)
    if initial is not None:
        given |= initial_state(structure, record, given, samples=initial)
    return RecordSimulator(structure, record).run(given)


def initial_state(
    structure: Structure, record: Record, values: Mapping[str, float] | Estimate | None = None, *, samples: int = 50
) -> dict[str, float]:
    """Return the initial states, by name, that reproduce the first `samples` steps of a record best, all else given.

    They are the structure's local unknowns whose names end in "_0"; those that `samples` steps do not tell keep their
    values. Raises IdentificationError for a structure without any, for no samples, and as `simulate` does.
    """
    given = _given(structure, record, values)
    names = [name for name in structure.local if name.endswith("_0") and name in structure.unknowns]
    where = f"structure '{structure.name}', record '{record.name}'"
    if not names:
        raise IdentificationError(
            "the structure has no initial states as local unknowns", where, "name them in its `local`, as theta_0"
        )
    start = _start(record, samples, where)
    problem = Problem(structure, [start], names, given)
    jacobian = problem.jacobian(problem.x0, problem.residual(problem.x0))
    if not np.isfinite(jacobian).all():
        raise IdentificationError("the model's outputs are not finite", where, "choose other values")
    told = [name for name, effect in zip(names, np.linalg.norm(jacobian, axis=0), strict=True) if effect > 0.0]
    if told:
        problem = Problem(structure, [start], told, given)
        given = problem.values(problem.minimise(problem.x0).x, 0)
    return {name: given[name] for name in names}


def predict_ahead(
    structure: Structure,
    record: Record,
    values: Mapping[str, float] | Estimate | None = None,
    *,
    steps: int,
    initial: int | None = None,
) -> dict[str, Array]:
    """Each output predicted from its samples up to `steps` earlier, at the times of its samples: arrays by output.

    It is the simulation, and of its error what the noise model tells from the errors up to `steps` samples before
    (Ljung, System Identification, section 3.2). An estimate brings its noise model; white noise tells nothing of the
    future, and the prediction is the simulation. Without an estimate an autoregression is fitted to the record's own
    errors. `values`, `initial` and errors as in `simulate`; IdentificationError for `steps` below 1. An estimate in
    innovation form predicts one sample ahead, and raises IdentificationError for more.
    """
    if not is_number(steps, 1, whole=True):
        raise record.error(f"{shown(steps)} samples ahead", "give a whole number, 1 or more")
    gains = values.disturbance.gains if isinstance(values, Estimate) else {}
    if gains and structure.predictor is not None:
        if steps > 1 or not can_predict(structure, [record]):
            what = "a model in innovation form predicts one sample ahead of outputs with a sample at each step"
            raise record.error(what, "give steps=1, and such a record")
        known = {**_given(structure, record, values), **gains}
        return RecordSimulator(structure.predictor, with_measured(structure, record)).run(known)
    found = simulate(structure, record, values, initial=initial)
    for name, simulated in found.items():
        samples = record.outputs[name]
        error, pieces = samples.value - simulated, pieces_of(samples.position)
        if isinstance(values, Estimate):
            models = values.disturbance.noise
            noise = models.get(f"{name}[{record.flight or record.name}]", models.get(name))
        else:
            noise = autoregression(error, pieces)
        if noise is not None:
            for piece in pieces:
                found[name][piece] += _ahead(noise, error[piece], steps)
    return found


@dataclass(frozen=True)
class ComparedModel:
    """Figures of a model on an output of a record: FIT and VAF [%] and RMSE of the simulation, FIT one sample ahead."""

    model: str
    record: str
    output: str
    fit_percent: float
    vaf: float
    rmse: float
    ahead: float


@dataclass(frozen=True)
class ModelTable:
    """Figures of each model on each output and record; the models that simulate best come first."""

    rows: tuple[ComparedModel, ...]

    def table(self) -> str:
        """Return the figures as text for a terminal."""
        places = {(row.record, row.output) for row in self.rows}
        width = max(len(row.model) for row in self.rows) + 2
        lines = []
        for record, output in sorted(places):
            lines.append(f"{output} in '{record}'")
            lines.append(f"{'':{width}}{'FIT, %':>9}{'VAF, %':>9}{'RMSE':>12}{'FIT one sample ahead, %':>26}")
            lines += [
                f"{row.model:{width}}{row.fit_percent:9.2f}{row.vaf:9.2f}{row.rmse:12.4g}{row.ahead:26.2f}"
                for row in self.rows
                if (row.record, row.output) == (record, output)
            ]
        return "\n".join(lines)

    def to_json(self) -> list[dict[str, object]]:
        """Return the rows as plain values."""
        return [finite(vars(row)) for row in self.rows]


def compare(models: Mapping[str, Estimate] | Sequence[Estimate], records: Record | Sequence[Record]) -> ModelTable:
    """Simulate and predict `records` with each of the fitted `models`, by name or by the names of their structures.

    The initial states are those with which the simulation follows a record best; all else is as it was fitted.
    Raises IdentificationError for no models, for anything but results of `fit`, and for a record without the channels.
    """
    named = dict(models) if isinstance(models, Mapping) else {_name(one): one for one in models}
    several = [records] if isinstance(records, Record) else list(records)
    if not named or len(named) < len(models):
        raise IdentificationError("no models, or two of one name", "compare", "give a dict of name and result of `fit`")
    rows = []
    for record in several:
        check_record(record)
        for name, found in named.items():
            for output, (simulated, ahead, first) in _outputs(found, record).items():
                y, fitted = record.outputs[output].value[first:], simulated[first:]
                ahead_fit = fit_percent(y, ahead[first:])
                figures = (fit_percent(y, fitted), vaf(y, fitted), rmse(y, fitted), ahead_fit)
                rows.append(ComparedModel(name, record.name, output, *figures))
    return ModelTable(tuple(sorted(rows, key=lambda row: -row.fit_percent)))


def _name(found: Estimate) -> str:
    return found.structure if isinstance(found, Estimate) else shown(found)


def _outputs(found: Estimate, record: Record) -> dict[str, tuple[Array, Array, int]]:
    """Return simulation, one-step prediction and first sample by output."""
    model = found.model if isinstance(found, Estimate) else None
    if model is None:
        raise IdentificationError(f"{shown(found)} is not a fitted model", "compare", "give results of `fit`")
    if isinstance(model, PolynomialModel):
        return {model.output: predict_polynomial(model, found.values, record)}
    free = record.steps if any(name.endswith("_0") for name in model.local) else None
    simulated = simulate(model, record, found, initial=free)
    ahead = predict_ahead(model, record, found, steps=1, initial=free)
    return {name: (simulated[name], ahead[name], 0) for name in simulated}


def _ahead(noise: Autoregression, error: Array, steps: int) -> Array:
    """Predict each error from those up to `steps` samples before, shape (samples,); the first ones from fewer."""
    told, order = np.zeros(error.size), noise.order
    for known in range(1, order):
        at = known - 1 + steps
        if at < error.size:
            told[at] = _weights(noise.predictors[known], steps) @ error[known - 1 :: -1][:known]
    first = order - 1 + steps
    if order and first < error.size:
        for i, weight in enumerate(_weights(noise.coefficients, steps)):
            told[first:] += weight * error[order - 1 - i : error.size - steps - i]
    return told


def _weights(polynomial: Array, steps: int) -> Array:
    """Weights of the latest errors, the last one first, in the best prediction `steps` ahead."""
    one = -polynomial[1:]
    weights = one.copy()
    for _ in range(steps - 1):
        if np.abs(weights).max() < 1e-15:  # the noise has forgotten; a stable one does
            break
        weights = weights[0] * one + np.append(weights[1:], 0.0)
    return np.asarray(weights)


def _start(record: Record, samples: int, where: str) -> Record:
    """Return the first steps of a record, with the samples of its outputs in the first `samples` steps."""
    if not is_number(samples, whole=True):
        raise IdentificationError(f"the first {shown(samples)} samples", where, "give a whole number of steps")
    steps = min(record.steps, samples + _BEHIND)
    outputs = {}
    for name, output in record.outputs.items():
        keep = output.position < samples
        if keep.any():
            outputs[name] = Samples(output.position[keep], output.value[keep])
    if not outputs:
        raise IdentificationError(f"the first {samples} samples hold no sample of an output", where, "give more")
    return replace(record, inputs={name: u[:steps] for name, u in record.inputs.items()}, outputs=outputs)


def _given(structure: Structure, record: Record, values: Mapping[str, float] | Estimate | None) -> dict[str, float]:
    """Return all values by unknown; of an estimate's unknowns of each record this record's, or the structure's own.

    Raises IdentificationError for names that are not there and values that are not finite.
    """
    check_structure(structure)
    check_record(record)
    if not isinstance(values, Mapping | Estimate | None):
        raise structure.error(f"the values are {shown(values)}", "give a dict by name, or an estimate")
    own = dict(values.fixed if isinstance(values, Estimate) else values or {})
    if isinstance(values, Estimate):
        for label, value in zip(values.labels, values.values, strict=True):
            name, bracket, of = label.partition("[")
            if not bracket or of.removesuffix("]") == record.name:
                own[name] = float(value)
    structure.check_names(own)
    if wrong := [name for name, value in own.items() if not is_number(value)]:
        raise structure.error(f"the value of '{wrong[0]}' is not a number", "give a finite number")
    return {name: unknown.value for name, unknown in structure.unknowns.items()} | own


Complex = NDArray[np.complex128]

_STEP = 1e-4
"""Of a parameter, in units of its own size: small beside any curvature, large beside rounding."""


@dataclass(frozen=True, eq=False)
class ModelResponse:
    """Response at `omega` [rad/s], shape (k,), of the sampled model to its held input.

    `gain_sigma` is the standard deviation of the logarithm of the gain, `phase_sigma` that of the phase [rad]; both
    come from the estimate's quoted covariance by linear propagation.
    """

    input: str
    output: str
    omega: Array
    response: Complex
    gain_sigma: Array
    phase_sigma: Array

    def gain_band(self, level: float = 0.95) -> tuple[Array, Array]:
        """Return the lower and upper limit of the gain, as a ratio, at the confidence `level`."""
        share = deviations(level) * self.gain_sigma
        return np.asarray(abs(self.response) * np.exp(-share)), np.asarray(abs(self.response) * np.exp(share))


def model_response(
    structure: Structure | PolynomialModel,
    estimate: Estimate,
    input: str,
    output: str,
    omega: ArrayLike,
    dt: float,
    record: str = "",
) -> ModelResponse:
    """Return the response from `input` to `output` of `structure` with the values of `estimate`, linearised at rest.

    `dt` [s] is the step of the data; `omega` lies below pi / dt. Unknowns that belong to one record alone (initial
    states, biases) move nothing. Of unknowns that were found for each record by itself those of `record` count, else
    the first. Raises IdentificationError for a name that is not there and an input that moves nothing. Raises
    DiagramError where the structure cannot be linearised: at rest it sticks, or a limit begins.
    """
    if input not in structure.inputs or output not in structure.outputs:
        what = f"no response leads from '{input:.80}' to '{output:.80}'"
        raise structure.error(what, f"inputs: {', '.join(structure.inputs)}; outputs: {', '.join(structure.outputs)}")
    w = np.asarray(omega, dtype=np.float64)
    chosen = estimate.places(record)
    values = {name: float(estimate.values[i]) for name, i in chosen.items()}
    if isinstance(structure, Structure):
        scales = {name: one.scale for name, one in structure.unknowns.items()}
        values = {name: value for name, value in estimate.fixed.items() if name in scales} | values
    else:
        scales = dict.fromkeys(values, 1.0)

    def response(point: dict[str, float]) -> Complex:
        if isinstance(structure, PolynomialModel):
            found = structure.polynomials(np.array([point[name] for name in structure.labels]))
            return found.response(structure.inputs.index(input), w, dt)
        model = linearize(structure.diagram, dt / structure.substeps, at=point, inputs=[input], outputs=[output])
        return np.asarray(model.response(w)[:, 0, 0], dtype=np.complex128)

    nominal = response(values)
    if not (np.isfinite(nominal).all() and (abs(nominal) > 0.0).all()):
        raise structure.error(f"'{input}' does not move '{output}' at rest", "choose another input")
    slopes, rows = [], []
    for name, i in chosen.items():
        if estimate.labels[i] in estimate.local or not math.isfinite(estimate.quoted[i, i]):
            continue
        step = _STEP * max(abs(values[name]), scales[name])
        ahead = response({**values, name: values[name] + step})
        slopes.append(np.log(ahead / nominal) / step)
        rows.append(i)
    slope = np.array(slopes).reshape(len(rows), w.size)
    spread = estimate.quoted[np.ix_(rows, rows)]
    gain, phase = (np.einsum("ik,ij,jk->k", part, spread, part) for part in (slope.real, slope.imag))
    return ModelResponse(input, output, w, nominal, np.sqrt(np.maximum(gain, 0.0)), np.sqrt(np.maximum(phase, 0.0)))
