"""What a fit found out about its noise: white, coloured, or a moment that pushes the drone itself."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError
from twodof.identify.disturbance.autoregression import Autoregression
from twodof.identify.disturbance.gust import Gust
from twodof.identify.disturbance.loudness import Loudness

Array = NDArray[np.float64]

Disturbance = Literal["auto", "white", "ar", "input"]
KINDS: tuple[Disturbance, ...] = ("auto", "white", "ar", "input")

# Clocks of one machine differ by some parts in a thousand.
_SAME = 0.01


@dataclass(frozen=True, eq=False)
class DisturbanceModel:
    """The noise model of an estimate.

    `kind` is "white", "ar" or "input". `noise` gives each output's autoregression in the output's unit, for samples
    `dt` [s] apart. Its keys are the outputs, or "output[record]" with several records, of which the pieces of a flight
    are one. It is empty for white noise.
    `gusts` are by the same names the pushes at the input from which those of "input" follow, and `louder` says which
    noise is louder where an input has just moved. `answering` names the
    inputs that answer the noise, as a controller's output does (closed loop). `change` says by how many of its standard
    deviations the noise model would have changed an estimate. If it is not 0, "auto" stayed with white noise for this
    reason. In open loop only a structure that leaves something out causes such a change.
    """

    kind: Disturbance = "white"
    noise: Mapping[str, Autoregression] = field(default_factory=dict)
    answering: tuple[str, ...] = ()
    change: float = 0.0
    gusts: Mapping[str, Gust] = field(default_factory=dict)
    dt: float = 0.0
    louder: Mapping[str, Loudness] = field(default_factory=dict)

    def of(self, output: str, dt: float) -> Autoregression | None:
        """The noise of `output`, for a flight with samples `dt` [s] apart; None where it is white.

        Raises IdentificationError for another sampling time, and where several records each have a noise of their own.
        """
        found = [model for label, model in self.noise.items() if label == output or label.startswith(f"{output}[")]
        if not found:
            return None
        if len(found) > 1:
            raise IdentificationError(
                f"{len(found)} records each have a noise model of '{output}'",
                "disturbance",
                "take that of an estimate from one record",
            )
        if abs(dt - self.dt) > _SAME * self.dt:
            raise IdentificationError(
                f"the noise model is of samples {self.dt:g} s apart, the flight's are {dt:g} s apart",
                "disturbance",
                "plan with the same sampling time",
            )
        return found[0]

    @property
    def text(self) -> str:
        """One line for a table."""
        if self.kind == "white":
            return "white noise at the outputs"
        if self.kind == "input":
            pushes = ", ".join(
                f"{label}: standard deviation {one.std:.2g}, correlation time {one.correlation_time:.2g} s"
                for label, one in self.gusts.items()
            )
            return f"pushes at {next(iter(self.gusts.values())).input}, seen in {pushes}"
        orders = ", ".join(f"{label} of order {model.order}" for label, model in self.noise.items())
        louder = "".join(
            f"; {label} up to {one.times:.1f} times as strong in the {1e3 * one.window * self.dt:.0f} ms after "
            f"{one.input} has moved"
            for label, one in self.louder.items()
        )
        return f"coloured noise, autoregressive: {orders}{louder}"

    def to_json(self) -> dict[str, object]:
        """Kind, orders, coefficients and standard deviations as plain numbers."""
        return {
            "kind": self.kind,
            "gusts": {label: asdict(one) for label, one in self.gusts.items()},
            "louder": {label: asdict(one) for label, one in self.louder.items()},
            "answering_inputs": list(self.answering),
            "noise": {
                label: {"order": model.order, "coefficients": model.coefficients.tolist(), "sigma": model.sigma}
                for label, model in self.noise.items()
            },
        }
