"""The frequency response of an identified structure, and the band in which its uncertainty leaves it."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.compile.linear.linear_model import LinearModel
from twodof.compile.linear.linearize import linearize
from twodof.errors import IdentificationError
from twodof.identify.estimate import Estimate
from twodof.identify.validate import deviations
from twodof.models.polynomial import PolynomialModel
from twodof.models.structure import Structure

Array = NDArray[np.float64]
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
        raise structure.error(
            f"no response leads from '{input:.80}' to '{output:.80}'",
            f"inputs: {', '.join(structure.inputs)}; outputs: {', '.join(structure.outputs)}",
        )
    w = np.asarray(omega, dtype=np.float64)
    chosen = _chosen(estimate, record)
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


def linear_form(estimate: Estimate, dt: float) -> LinearModel:
    """Return a fitted model of steps `dt` [s] as matrices, at rest; of unknowns of several records the first count.

    Raises DiagramError for a structure that cannot be linearised at rest, IdentificationError for an estimate without
    its model.
    """
    model, found = estimate.model, {name: float(estimate.values[i]) for name, i in _chosen(estimate, "").items()}
    if isinstance(model, PolynomialModel):
        a, b, c, d = model.polynomials(estimate.values).matrices()
        states = tuple(f"x{i + 1}" for i in range(len(a)))
        return LinearModel(a, b, c, d, dt, states, model.inputs, model.outputs, name=model.kind)
    if model is None:
        raise IdentificationError("the estimate does not know its model", "linear_form", "give the result of `fit`")
    still = {name: 0.0 for name in found if name in estimate.local}
    at = {name: one for name, one in {**estimate.fixed, **found, **still}.items() if name in model.unknowns}
    return linearize(model.diagram, dt / model.substeps, at=at)


def _chosen(estimate: Estimate, record: str) -> dict[str, int]:
    """Parameter -> its place among the labels: "mu[doublet.mat]" is mu of that record."""
    found: dict[str, int] = {}
    for i, label in enumerate(estimate.labels):
        name, _, of = label.partition("[")
        if name not in found or of.rstrip("]") == record:
            found[name] = i
    return found
