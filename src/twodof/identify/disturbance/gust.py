"""A gust as part of the noise: a random push at the structure's input, seen through the structure, beside the sensor.

The residual of an output is v = h * d + e. The push d is a Gauss-Markov process where the input enters, and h is the
impulse response of the structure. The sensor's own noise e is white noise and a narrow band. The band takes up the
rotors' vibration, for example, which then does not pass for a gust. Standard deviations, correlation time and band are
the most likely ones given that the structure's unknowns were fitted to the same samples: restricted likelihood
(Patterson and Thompson, 1971).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.identify.disturbance.autoregression import Autoregression, from_covariance, pieces_of
from twodof.identify.problem import Problem
from twodof.identify.record import Record, Samples
from twodof.identify.record_simulator import RecordSimulator

Array = NDArray[np.float64]

USUAL_S, FACTOR = 0.15, 2.0
"""A short record hardly tells the correlation time. It is taken to be .15 s to a factor of 2 (one standard deviation of
its logarithm), as gusts and the rotors' own wake have it; the data say the rest."""

_IMPOSSIBLE = 1e10
_DIFFERENCE = 1e-5
"""Step of the derivatives of the likelihood: a smaller one finds its rounding, and the search ends too early."""
_ORDER, _WEAK_ORDER = 40, 120
"""Memory of the noise [samples], and where a band outweighs the pushes: next to nothing at 0 Hz takes a longer one."""
_RESPONSE = 400
_LINEAR = 1e-6
# A lag of 1.5 samples rises by half in one.
_JUMP = 0.45
_FEW, _CLEAR = 2.0, 50.0
"""Gain of the log likelihood that a push must bring for its two unknowns (Akaike), and one so large that the noise
without it is not searched. On the rig `lab`, which has gusts, it is 450 to 600 for a doublet, on `paper` -1 to 1."""
# Logarithms of the push's deviation and time, of the white and the narrow noise (over the residual's deviation); the
# band's frequency as a share of the sampling rate; the logit of its poles' radius.
_BOUNDS = ((-25.0, 5.0), (math.log(0.01), math.log(3.0)), (-12.0, 3.0), (-12.0, 3.0), (0.06, 0.44), (-2.0, 4.0))


@dataclass(frozen=True)
class Gust:
    """The push that was found: its standard deviation (the input's unit) and correlation time [s], and the sensor.

    `white` and `narrow` are the standard deviations of the sensor's white and narrow-band noise (the output's unit),
    `frequency` [Hz] is the middle of the band, `radius` that of its poles.
    """

    input: str
    std: float
    correlation_time: float
    white: float
    narrow: float
    frequency: float
    radius: float = 0.0


class PushModel:
    """Restricted likelihood of one output of one record under pushes, by `theta`, their logarithms among it."""

    bounds: Sequence[tuple[float, float]]

    def __init__(self, problem: Problem, x: Array, block: int) -> None:
        rows = problem.blocks[block]
        self.unit = float(problem.sigma[block])
        self.pieces = pieces_of(problem.records[rows.record].outputs[rows.output].position)
        raw, jacobian = problem.residual(x), problem.central_jacobian(x)
        self._raw, known = raw[rows.rows], raw[problem.size :]
        prior, jacobian = jacobian[problem.size :], jacobian[rows.rows]
        length = np.linalg.norm(jacobian, axis=0)
        seen = length > 0.0
        self._both = np.column_stack([jacobian[:, seen] / length[seen], self._raw])
        before = np.column_stack([prior[:, seen] / length[seen], known])
        self._before = before.T @ before
        self.theta = np.zeros(0)

    def noise(self, theta: Array) -> Any:
        """Return the noise in units of the residual's weight. Raises LinAlgError where rounding rules."""
        raise NotImplementedError

    def prior(self, theta: Array) -> float:
        """-log of what is known of `theta`."""
        raise NotImplementedError

    def cost(self, theta: Array) -> float:
        """-log of the restricted likelihood, and the prior."""
        try:
            model = self.noise(theta)
        except np.linalg.LinAlgError:
            return _IMPOSSIBLE
        white = model.whiten(self._both, self.pieces)
        gram = white.T @ white + self._before
        try:
            factor = np.diag(np.linalg.cholesky(gram))
        except np.linalg.LinAlgError:
            return _IMPOSSIBLE
        # The last entry of the factor is what the unknowns leave of the residual.
        left = 0.5 * float(factor[-1]) ** 2 + float(np.log(factor[:-1]).sum())
        return float(model.log_deviations(self.pieces)) + left + self.prior(theta)

    def improve(self, iterations: int) -> Any:
        """Take the most likely `theta`, searched for from the present one; the noise that it means."""
        from scipy.optimize import minimize  # imported late: most commands start without it

        options = {"maxiter": iterations, "ftol": 3e-6, "eps": _DIFFERENCE}
        self.theta = minimize(self.cost, self.theta, method="L-BFGS-B", bounds=self.bounds, options=options).x
        return self.noise(self.theta)


class GustModel(PushModel):
    """Restricted likelihood and covariance of one output of one record under a gust, by `theta` (see `_BOUNDS`)."""

    bounds = _BOUNDS

    def __init__(self, problem: Problem, x: Array, block: int, theta: Array | None = None) -> None:
        super().__init__(problem, x, block)
        rows = problem.blocks[block]
        self.input, self.dt = problem.structure.inputs[0], problem.records[rows.record].dt
        response = impulse_response(problem, x, rows.record, rows.output)
        assert response is not None
        self._size = 1 << (2 * response.size + _WEAK_ORDER).bit_length()
        self._power = np.abs(np.fft.rfft(response / self.unit, self._size)) ** 2
        self._turn = 2.0 * np.pi * np.arange(self._power.size) / self._size
        self._shift = np.exp(-1j * self._turn)
        self.theta = self._start() if theta is None else theta

    def improve(self, iterations: int) -> Autoregression:
        """Take the most likely `theta`, without a push if that hardly makes the residual likelier.

        The size of a push is not below 0, so that chance alone finds one in half of the records.
        """
        super().improve(iterations)
        pushed, cost = self.theta, self.cost(self.theta)
        without = np.concatenate([[_BOUNDS[0][0]], pushed[1:]])
        if pushed[0] > without[0] and self.cost(without) < cost + _CLEAR:
            self.theta = without
            super().improve(iterations)
            self.theta = self.theta if self.cost(self.theta) < cost + _FEW else pushed
        return self.noise(self.theta)

    def noise(self, theta: Array) -> Autoregression:
        """Return the noise as an autoregression, in units of the residual's weight."""
        push, time, white, narrow, frequency, decay = theta
        pushed = math.exp(2.0 * push) * self._pushed(math.exp(time))
        band = math.exp(2.0 * narrow) * self._band(2.0 * math.pi * frequency, 1.0 / (1.0 + math.exp(-decay)))
        covariance = pushed + band
        covariance[0] += math.exp(2.0 * white)
        return from_covariance(covariance[: 1 + (_ORDER if pushed[0] > band[0] else _WEAK_ORDER)])

    def prior(self, theta: Array) -> float:
        return float(0.5 * ((theta[1] - math.log(USUAL_S)) / math.log(FACTOR)) ** 2)

    @property
    def gust(self) -> Gust:
        """The push and the sensor's noise in their units."""
        push, time, white, narrow, frequency, decay = self.theta
        deviations = (self.unit * math.exp(white), self.unit * math.exp(narrow))
        radius = 1.0 / (1.0 + math.exp(-decay))
        return Gust(self.input, math.exp(push), math.exp(time), *deviations, float(frequency) / self.dt, radius)

    def _pushed(self, time: float) -> Array:
        """Autocovariance of the output under a push of standard deviation 1."""
        keep = math.exp(-self.dt / time)
        density = (1.0 - keep**2) / (1.0 - 2.0 * keep * np.cos(self._turn) + keep**2)
        return np.asarray(np.fft.irfft(self._power * density, self._size)[: _WEAK_ORDER + 1])

    def _band(self, turn: float, radius: float) -> Array:
        """Autocovariance of noise of variance 1 through a band-pass of two poles, with zeros at both ends."""
        density = (
            np.sin(self._turn) ** 2
            / np.abs(1.0 - 2.0 * radius * math.cos(turn) * self._shift + (radius * self._shift) ** 2) ** 2
        )
        covariance = np.fft.irfft(density, self._size)[: _WEAK_ORDER + 1]
        return np.asarray(covariance / covariance[0])

    def _start(self) -> Array:
        """Return the best of some guesses: the sensor has the residual's roughness, the push the rest or a part."""
        change = np.diff(self._raw)
        frequency = np.fft.rfftfreq(change.size)
        inside = np.flatnonzero((frequency > _BOUNDS[4][0]) & (frequency < _BOUNDS[4][1]))
        peak = frequency[inside[np.argmax(np.abs(np.fft.rfft(change))[inside])]] if inside.size else 0.15
        rough = math.log(max(float(change.std()), 1e-9) / 2.0)
        total = float(self._raw.std()) or 1.0
        guesses = [
            np.array(
                [math.log(share * total / math.sqrt(self._pushed(time)[0])), math.log(time), rough, rough, peak, 1.2]
            )
            for time in (0.05, 0.15, 0.5)
            for share in (0.3, 1.0)
        ]
        return min(guesses, key=self.cost)


def answers_at_once(response: Array) -> bool:
    """Return True if an impulse response jumps by nearly all of its size from one sample to the next.

    No machine does. Output error hardly minds an actuator's lag that was left out, and a delay takes its place. Under a
    gust the samples just behind an edge count most, because its push comes only later. A doublet of the rig `lab` then
    gave 217 +- 20 for a mu of 300.
    """
    return float(np.abs(np.diff(response, prepend=0.0)).max()) > _JUMP * float(np.abs(response).max())


def impulse_response(problem: Problem, x: Array, record: int, output: str) -> Array | None:
    """Response of `output` to a push of 1 at the input over one step, or None for a structure that is not linear.

    It is None too where pieces of the output are not sampled once a step.
    """
    flown = problem.records[record]
    position = flown.outputs[output].position
    spacing = [np.diff(position[piece]) for piece in pieces_of(position)]
    if len(problem.structure.inputs) != 1 or np.abs(np.concatenate(spacing) - 1.0).max(initial=0.0) > 0.3:
        return None
    steps = min(flown.steps, _RESPONSE)
    values = problem.values(x, record)

    def response(place: int, size: float) -> Array:
        push = np.zeros(steps)
        push[place : place + 1] = size
        grid = Samples(np.arange(steps, dtype=float), np.zeros(steps))
        blank = Record("pushed", flown.dt, 0.0, {problem.structure.inputs[0]: push}, {output: grid})
        return RecordSimulator(problem.structure, blank).run(values)[output]

    rest = response(0, 0.0)
    one, other = response(1, 1.0) - rest, response(steps // 2, -0.1) - rest
    half = steps - steps // 2
    same = np.abs(other[-half:] + 0.1 * one[1 : half + 1]).max() <= _LINEAR * np.abs(one).max()
    return one[1:] if same and float(np.ptp(one)) > 0.0 else None


def can_be_pushed(problem: Problem, x: Array, sure: bool = False) -> bool:
    """Return True if a gust can be modelled: one input, one output sampled at each step, and a linear structure.

    With `sure`, the structure must also have the actuator's lag, if only as a part of its delay that is held near 0.
    Without it the model is not to be trusted.
    """
    if len(problem.blocks) != len(problem.records):
        return False
    for block in problem.blocks:
        response = impulse_response(problem, x, block.record, block.output)
        if response is None or (sure and not problem.structure.sums and answers_at_once(response)):
            return False
    return True
