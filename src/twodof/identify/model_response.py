"""The frequency response of an identified structure, and the band in which its uncertainty leaves it."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.compile.linear.linearize import linearize
from twodof.identify.estimate import Estimate
from twodof.identify.validate import deviations
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
    structure: Structure, estimate: Estimate, input: str, output: str, omega: ArrayLike, dt: float, record: str = ""
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
    base = {name: value for name, value in estimate.fixed.items() if name in structure.unknowns}
    values = {**base, **{name: float(estimate.values[i]) for name, i in chosen.items()}}

    def response(point: dict[str, float]) -> Complex:
        model = linearize(structure.diagram, dt / structure.substeps, at=point, inputs=[input], outputs=[output])
        return np.asarray(model.response(w)[:, 0, 0], dtype=np.complex128)

    nominal = response(values)
    if not (np.isfinite(nominal).all() and (abs(nominal) > 0.0).all()):
        raise structure.error(f"'{input}' does not move '{output}' at rest", "choose another input")
    slopes, rows = [], []
    for name, i in chosen.items():
        if estimate.labels[i] in estimate.local or not math.isfinite(estimate.quoted[i, i]):
            continue
        step = _STEP * max(abs(values[name]), structure.unknowns[name].scale)
        ahead = response({**values, name: values[name] + step})
        slopes.append(np.log(ahead / nominal) / step)
        rows.append(i)
    slope = np.array(slopes).reshape(len(rows), w.size)
    spread = estimate.quoted[np.ix_(rows, rows)]
    gain, phase = (np.einsum("ik,ij,jk->k", part, spread, part) for part in (slope.real, slope.imag))
    return ModelResponse(input, output, w, nominal, np.sqrt(np.maximum(gain, 0.0)), np.sqrt(np.maximum(phase, 0.0)))


def _chosen(estimate: Estimate, record: str) -> dict[str, int]:
    """Parameter -> its place among the labels: "mu[doublet.mat]" is mu of that record."""
    found: dict[str, int] = {}
    for i, label in enumerate(estimate.labels):
        name, _, of = label.partition("[")
        if name not in found or of.rstrip("]") == record:
            found[name] = i
    return found
