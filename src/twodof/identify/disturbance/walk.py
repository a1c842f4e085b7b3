"""A walk of states as part of the noise: random pushes at states of the structure, beside the sensor's white noise.

The residual of an output is v = e + sum over the pushed states of h * w: white noise e of the sensor, and white pushes
w that each move a state for good, as the gyro's noise moves an integrated pitch and uneven friction a speed. h is the
response of the output to a jump of that state. How dense the pushes are is most likely, given that the structure's
unknowns were fitted to the same samples: restricted likelihood (Patterson and Thompson, 1971).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from twodof.compile.linear.linear_model import LinearModel
from twodof.compile.linear.linearize import linearize
from twodof.errors import DiagramError
from twodof.identify.disturbance.gust import PushModel
from twodof.identify.problem import Problem
from twodof.identify.record import Record, Samples
from twodof.identify.record_simulator import RecordSimulator
from twodof.models.lqr import kalman_gain
from twodof.models.structure import Structure

Array = NDArray[np.float64]

MOST = 1500
"""Samples of an output up to which its whole covariance is taken: a minute and a half of a range sensor."""

_JUMP = 1e-3
_BOUNDS = (-25.0, 5.0)


@dataclass(frozen=True, eq=False)
class Walk:
    """Standard deviation of the sensor's `white` noise, and density of the `pushes` at each state [its unit/sqrt(s)].

    `factor` (samples, samples) is the Cholesky factor of the noise's covariance.
    """

    white: float
    pushes: Mapping[str, float]
    factor: Array = field(repr=False)

    @property
    def text(self) -> str:
        """In words."""
        pushes = " and ".join(f"{size:.2g}/sqrt(s) at {name.removesuffix('_0')}" for name, size in self.pushes.items())
        return f"{pushes}, beside white noise of {self.white:.2g}"

    def scaled(self, factor: float) -> "Walk":
        """Return the same noise in another unit of the output."""
        return replace(self, white=self.white * factor, factor=self.factor * factor)

    def whiten(self, rows: Array, pieces: Sequence[slice] = ()) -> Array:
        """Return `rows` (samples, ...) less their prediction from the earlier ones, over the deviation of the error."""
        from scipy.linalg import solve_triangular  # imported late: most commands start without it

        return np.asarray(solve_triangular(self.factor, rows, lower=True, check_finite=False))

    def log_deviations(self, pieces: Sequence[slice] = ()) -> float:
        """Half the logarithm of the determinant of the noise's covariance."""
        return float(np.log(np.diag(self.factor)).sum())


class WalkModel(PushModel):
    """Restricted likelihood of one output of one record, by `theta`: logarithms of white noise and of each density."""

    def __init__(self, problem: Problem, x: Array, block: int, theta: Array | None = None) -> None:
        super().__init__(problem, x, block)
        self.known = problem.structure.pushed
        self.bounds = [_BOUNDS] * (1 + len(self.known))
        self._spreads = spreads(problem, x, block)
        self._first = np.log([self.unit, *(density for density, _ in self.known.values())])
        self.theta = self._first if theta is None else theta

    def noise(self, theta: Array) -> Walk:
        white, *densities = np.exp(theta).tolist()
        return walk(white, dict(zip(self.known, densities, strict=True)), self._spreads).scaled(1.0 / self.unit)

    def prior(self, theta: Array) -> float:
        factors = np.log([factor for _, factor in self.known.values()])
        return 0.5 * float((((theta - self._first)[1:] / factors) ** 2).sum())


def walk(white: float, pushes: Mapping[str, float], covariances: Mapping[str, Array]) -> Walk:
    """Return the noise of these densities, whose `covariances` (samples, samples) are those of pushes of density 1."""
    size = len(next(iter(covariances.values())))
    whole = white**2 * np.eye(size) + sum(density**2 * covariances[name] for name, density in pushes.items())
    return Walk(white, dict(pushes), np.asarray(np.linalg.cholesky(whole), dtype=np.float64))


def spreads(problem: Problem, x: Array, block: int) -> dict[str, Array]:
    """Return the covariance (samples, samples) of an output under pushes of density 1 at each pushed state.

    Dry friction is left out of the response: what it does to a small push depends on the motion.
    """
    of = problem.blocks[block]
    record = problem.records[of.record]
    grid = {of.output: Samples(np.arange(record.steps, dtype=float), np.zeros(record.steps))}
    still = {name: np.full(record.steps, float(own.mean())) for name, own in record.inputs.items()}
    simulator = RecordSimulator(problem.structure, Record("pushed", record.dt, 0.0, still, grid))
    values = {**problem.values(x, of.record), **dict.fromkeys(problem.structure.pushed, 0.0)}
    values |= {name: 0.0 for name in ("coulomb",) if name in values}
    rest = simulator.run(values)[of.output].copy()
    position = record.outputs[of.output].position
    pushed, lasts = 0.5 * (position[1:] + position[:-1]), np.diff(position) * record.dt
    age = np.maximum(position[:, None] - pushed[None, :], 0.0)
    found = {}
    for name in problem.structure.pushed:
        moved = (simulator.run({**values, name: _JUMP})[of.output] - rest) / _JUMP
        # At age 0 a state has moved nothing yet, and an output that shows it at once is not one for a walk.
        response = np.where(age > 0.0, np.interp(age, np.arange(record.steps), moved), 0.0)
        found[name] = (response * lasts) @ response.T
    return found


_RATIOS = (1.0, 1e-2, 1e2)
"""Variance of the push at the inputs over that of the input itself, with which the first gains are computed."""


def can_predict(structure: Structure, records: Sequence[Record]) -> bool:
    """Return True if `structure` has an innovation form and each record held inputs, and outputs at each step."""
    return structure.predictor is not None and not any(
        record.hold
        or name not in record.outputs
        or not record.outputs[name].on_grid
        or record.outputs[name].value.size < record.steps
        for record in records
        for name in structure.outputs
    )


def with_measured(structure: Structure, record: Record) -> Record:
    """Return the record with its outputs as further inputs."""
    measured = {f"{name}_measured": record.outputs[name].value for name in structure.outputs}
    return replace(record, inputs={**record.inputs, **measured})


def is_unstable(structure: Structure, values: dict[str, float], dt: float) -> bool:
    """Return True if the plant has a pole outside the unit circle."""
    model = _linear(structure, values, dt)
    return model is not None and bool(np.abs(model.poles()).max() > 1.0)


def first_gains(structure: Structure, record: Record, values: dict[str, float]) -> list[dict[str, float]]:
    """Return steady-state Kalman gains for pushes of several sizes at the inputs, as far as there are such gains."""
    model, found = _linear(structure, values, record.dt), list[dict[str, float]]()
    if model is None:
        return found
    moves = np.array([float(record.inputs[name].std()) or 1.0 for name in structure.inputs])
    noise = np.diag([0.01 * float(record.outputs[name].value.var()) + 1e-12 for name in structure.outputs])
    for ratio in _RATIOS:
        push = ratio * (model.b * moves**2) @ model.b.T
        push += 1e-9 * np.trace(push) * np.eye(push.shape[0])
        try:
            gain = kalman_gain(model.a, model.c, push, noise)
        except (np.linalg.LinAlgError, ValueError):
            continue
        if np.isfinite(gain).all():
            found.append(_named(gain))
    return found


def _named(gain: Array) -> dict[str, float]:
    return {f"K_{i + 1}_{j + 1}": float(gain[i, j]) for i, j in np.ndindex(gain.shape)}


def reflected_gains(problem: Problem, x: Array) -> dict[str, float]:
    """Return the gains of a stable predictor that expects the same spectrum as the unstable one at x; {} if stable.

    Each pole outside the unit circle moves to its reciprocal (Anderson and Moore, Optimal filtering, chapter 9).
    """
    model = _linear(problem.structure, problem.values(x, 0), problem.records[0].dt)
    if model is None or np.abs(model.poles()).max() <= 1.0:
        return {}
    own, residual = problem.blocks[: len(problem.outputs)], problem.residual(x)
    errors = np.array([residual[one.rows] * problem.sigma[i] for i, one in enumerate(own)])
    spread, k = errors @ errors.T / errors.shape[1], model.b[:, -len(own) :]
    return _named(kalman_gain(model.a + k @ model.c, model.c, k @ spread @ k.T, spread, k @ spread))


def without_gains(jacobian: Array, wanted: int) -> Array:
    """Return the sensitivities of the first `wanted` unknowns less what the gains behind them explain."""
    own, gains = jacobian[:, :wanted], jacobian[:, wanted:]
    return np.asarray(own - gains @ np.linalg.lstsq(gains, own, rcond=None)[0])


def _linear(structure: Structure, values: dict[str, float], dt: float) -> LinearModel | None:
    """Return the sampled plant; None if its numbers overflow in a step."""
    try:
        return linearize(structure.diagram, dt / structure.substeps, at=values, time="discrete", keep_all=True)
    except DiagramError:
        return None


def gains_of(problem: Problem, x: Array) -> dict[str, float]:
    """Return the gains of a predictor's problem at x."""
    return {
        n: value for n, value in problem.values(x, 0).items() if n.startswith("K_") and n in problem.structure.estimate
    }


class ErrorsTogether:
    """Correlation of the errors that a predictor makes of all outputs at a sample: a push moves several at once.

    Called with rows it makes the errors independent, so that their sum of squares is that of the likeliest unknowns
    (Ljung, System Identification, section 7.4). `log_deviations` is half the logarithm of the correlation's
    determinant over all samples. Each flight has a correlation of its own, seen in the `residual` of the problem.
    """

    def __init__(self, problem: Problem, residual: Array) -> None:
        outputs, self.log_deviations = len(problem.outputs), 0.0
        self._factors: list[tuple[list[slice], Array]] = []
        for first in range(0, len(problem.noises), outputs):
            records = zip(*problem.noises[first : first + outputs], strict=True)
            own = [[problem.blocks[k].rows for k in record] for record in records]
            spans = [slice(rows[0].start, rows[-1].stop) for rows in own]
            errors = np.hstack([residual[span].reshape(outputs, -1) for span in spans])
            errors /= np.maximum(np.sqrt(np.mean(errors**2, axis=1, keepdims=True)), 1e-12)
            factor = np.linalg.cholesky(errors @ errors.T / errors.shape[1] + 1e-9 * np.eye(outputs))
            self.log_deviations += errors.shape[1] * float(np.log(np.diag(factor)).sum())
            self._factors.append((spans, factor))

    def __call__(self, rows: Array) -> Array:
        white = rows.copy()
        for spans, factor in self._factors:
            for span in spans:
                own = np.linalg.solve(factor, rows[span].reshape(len(factor), -1))
                white[span] = own.reshape(rows[span].shape)
        return white

    def change(self, before: "ErrorsTogether") -> float:
        """Return the largest change of the errors' scale or correlation since `before`."""
        pairs = zip(self._factors, before._factors, strict=True)
        return max(float(np.abs(np.linalg.solve(old, new) - np.eye(len(new))).max()) for (_, new), (_, old) in pairs)
