"""DisturbanceModel: the noise of a fit, which is white, coloured, or a push at the input; and the test for feedback."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError
from twodof.identify.disturbance.autoregression import Autoregression, autoregression, pieces_of
from twodof.identify.disturbance.coloured_problem import NoiseIncrease
from twodof.identify.disturbance.gust import Gust
from twodof.identify.disturbance.walk import Walk
from twodof.identify.problem import Problem

Array = NDArray[np.float64]

Disturbance = Literal["auto", "white", "ar", "input", "walk", "innovation"]
KINDS: tuple[Disturbance, ...] = ("auto", "white", "ar", "input", "walk", "innovation")

# Clocks of one machine differ by some parts in a thousand.
_SAME = 0.01


@dataclass(frozen=True, eq=False)
class DisturbanceModel:
    """The noise model of an estimate.

    `kind` is one of `KINDS` but "auto". `noise` gives each output's autoregression in the output's unit, for samples
    `dt` [s] apart. Its keys are the outputs, or "output[record]" with several records, of which the pieces of a flight
    are one. It is empty for white noise.
    `gusts` has, by the same names, the pushes at the input of the kind "input". `louder` has the noises that are louder
    after an input has moved. `answering` names the
    inputs that answer the noise, as a controller's output does (closed loop). `change` says by how many of its standard
    deviations the noise model would have changed an estimate. If it is not 0, "auto" stayed with white noise for this
    reason. In open loop only a structure that leaves something out causes such a change. It is infinite if the noise
    model had taken the response itself for noise. `gains` are those of the kind
    "innovation", with which a predictor corrects its states (`Structure.predictor`). `walks` has, by the names of
    `noise`, the pushes at the states of the kind "walk". With `swing` the noise was fitted as pushes of a swing.
    """

    kind: Disturbance = "white"
    noise: Mapping[str, Autoregression] = field(default_factory=dict)
    answering: tuple[str, ...] = ()
    change: float = 0.0
    gusts: Mapping[str, Gust] = field(default_factory=dict)
    dt: float = 0.0
    louder: Mapping[str, NoiseIncrease] = field(default_factory=dict)
    gains: Mapping[str, float] = field(default_factory=dict)
    walks: Mapping[str, Walk] = field(default_factory=dict)
    swing: bool = False

    def of(self, output: str, dt: float) -> Autoregression | None:
        """Return the noise of `output` for a flight with samples `dt` [s] apart; None if it is white.

        Raises IdentificationError for another sampling time, and where several records each have a noise of their own.
        """
        found = [model for label, model in self.noise.items() if label == output or label.startswith(f"{output}[")]
        if not found:
            return None
        if len(found) > 1:
            what = f"{len(found)} records each have a noise model of '{output}'"
            raise IdentificationError(what, "disturbance", "take that of an estimate from one record")
        if abs(dt - self.dt) > _SAME * self.dt:
            what = f"the noise model is of samples {self.dt:g} s apart, the flight's are {dt:g} s apart"
            raise IdentificationError(what, "disturbance", "plan with the same sampling time")
        return found[0]

    @property
    def predicts(self) -> bool:
        """Return True if a model must be judged by its predictions: a simulation knows nothing of earlier pushes."""
        return bool(self.answering) or self.kind == "walk"

    @property
    def text(self) -> str:
        """One line for a table."""
        if self.kind == "white":
            return "white noise at the outputs"
        if self.kind == "innovation":
            gains = ", ".join(f"{name} {value:.3g}" for name, value in self.gains.items())
            return f"noise at the states and the outputs, which a predictor corrects with gains {gains}"
        if self.kind == "walk":
            return f"pushes at the states, in {', '.join(f'{label}: {one.text}' for label, one in self.walks.items())}"
        if self.kind == "input":
            pushes = ", ".join(
                f"{label}: standard deviation {one.std:.2g}, correlation time {one.correlation_time:.2g} s"
                for label, one in self.gusts.items()
            )
            pushed = next(iter(self.gusts.values())).input
            if all(one.std < _NO_PUSH for one in self.gusts.values()):
                return f"white noise and a band of vibration at the outputs, no pushes at {pushed}"
            return f"pushes at {pushed}, seen in {pushes}"
        orders = ", ".join(f"{label} of order {model.order}" for label, model in self.noise.items())
        louder = "".join(
            f"; {label} up to {one.times:.1f} times as strong in the {1e3 * one.window * self.dt:.0f} ms after "
            f"{one.input} has moved"
            for label, one in self.louder.items()
        )
        return f"coloured noise, autoregressive: {orders}{', pushing a swing' if self.swing else ''}{louder}"

    def to_json(self) -> dict[str, object]:
        """Kind, orders, coefficients and standard deviations as plain numbers."""
        return {
            "kind": self.kind,
            "gusts": {label: asdict(one) for label, one in self.gusts.items()},
            "louder": {label: asdict(one) for label, one in self.louder.items()},
            "answering_inputs": list(self.answering),
            "gains": dict(self.gains),
            "walks": {label: {"white": one.white, "pushes": dict(one.pushes)} for label, one in self.walks.items()},
            "noise": {
                label: {"order": model.order, "coefficients": model.coefficients.tolist(), "sigma": model.sigma}
                for label, model in self.noise.items()
            },
        }


_NO_PUSH = 1e-9
_LAGS = 9
_CHANCE = 1e-6
_LEAST = 100
_CLIP = 2.5
_MOVES = 0.5
"""Share of the samples at which the output of a controller differs from the one before, at the least."""


def answers(applied: Array, residual: Array) -> bool:
    """Return True if the input correlates with the innovation of the residual at that sample or up to 8 before.

    Both have shape (samples,). Each is prefiltered by its own autoregression first: inputs and residuals that are
    smooth correlate without any feedback (Haugh, 1976). The innovation is clipped at 2.5 deviations, so that one large
    misfit at the edge of a pulse is not taken for a rule. The sum of the squared correlations is then chi-square.

    An input that stands still at most samples is a test signal, such as a pulse: a controller's moves with the noise.
    Its few edges meet the misfit of a wrong structure, which is not chance, and is not feedback either.
    """
    size = residual.size
    if size < _LEAST or not float(np.ptp(applied)) > 0.0 or not float(np.ptp(residual)) > 0.0:
        return False
    if np.count_nonzero(np.diff(applied)) < _MOVES * (size - 1):
        return False
    u, e = _innovation(applied), _innovation(residual)
    total = sum(float(u[k:] @ e[: size - k]) ** 2 / (size - k) for k in range(_LAGS))
    from scipy.special import chdtrc  # imported late: most commands start without it

    return bool(chdtrc(_LAGS, total) < _CHANCE)


def inputs_that_answer(problem: Problem, residual: Array) -> tuple[str, ...]:
    """Return the structure's inputs that answer the residual of an output in one of the problem's records."""
    found = []
    for name in problem.structure.inputs:
        for block in problem.blocks:
            record = problem.records[block.record]
            if answers(record.inputs[name][block.when], residual[block.rows]):
                found.append(name)
                break
    return tuple(found)


def _innovation(signal: Array) -> Array:
    """Return the innovation of a signal by its autoregression, clipped and with standard deviation 1."""
    centred = signal - signal.mean()
    piece = pieces_of(np.arange(float(signal.size)))
    fresh = autoregression(centred, piece).whiten(centred, piece)
    usual = 1.4826 * float(np.median(np.abs(fresh)))
    fresh = np.clip(fresh, -_CLIP * usual, _CLIP * usual) if usual > 1e-3 else fresh
    return np.asarray(fresh / max(float(np.sqrt(np.mean(fresh**2))), 1e-300))
