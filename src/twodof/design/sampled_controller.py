"""SampledController: a controller of the pitch as matrices, x' = A x + B (theta_0, theta, q), M = C x + D (...)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.diagram import Diagram
from twodof.compile.linear.linearize import linearize
from twodof.errors import ParameterError
from twodof.flight.templates import ATTITUDE, check_template
from twodof.models.lti import check_system, transfer
from twodof.signals import PERIOD

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

INPUTS = ("theta_0", "theta", "q")

_FILTER = 100.0  # of the derivative [rad/s]


@dataclass(frozen=True, eq=False)
class SampledController:
    """A linear controller at 250 Hz: `a` (n, n), `b` (n, 3), `c` (1, n), `d` (1, 3), of the inputs `INPUTS`.

    Raises ParameterError for shapes that do not fit and numbers that are not finite.
    """

    a: Array
    b: Array
    c: Array
    d: Array

    def __post_init__(self) -> None:
        check_system(self.a, self.b, self.c, self.d, "SampledController")
        if self.d.shape != (1, len(INPUTS)):
            what = f"D of shape {self.d.shape} is not that of 3 inputs and 1 output"
            raise ParameterError(what, "SampledController", f"give (1, 3): M from {', '.join(INPUTS)}")

    @classmethod
    def of(cls, diagram: Diagram, values: Mapping[str, Any] | None = None) -> Self:
        """Return the exact linear model of a diagram of the template attitude_control: attitude mode, off its limits.

        `values` are those of its parameters, by path, that are not at their defaults. Raises DiagramError for a diagram
        that does not fit the template or has no linear model.
        """
        check_template(diagram, ATTITUDE.name)
        found = linearize(
            diagram,
            PERIOD,
            at={**(values or {}), "FLAG_ATTITUDE_ENABLED": True},
            inputs=INPUTS,
            outputs=("M",),
            time="discrete",
        )
        return cls(found.a, found.b, found.c, found.d)

    @classmethod
    def of_cascade(cls, kp: float, ki: float, kd: float, attitude: float, theta_loop: bool = True) -> Self:
        """Return the stock law with the gains of rate and attitude, off its limits; `ki` may be 0.

        Without `theta_loop` the law does not read theta: the attitude loop is open, theta_0 still enters it.
        """
        lag = 1.0 / _FILTER
        rise, pole = 1.0 / (lag + PERIOD), lag / (lag + PERIOD)
        error = np.array([[attitude, -attitude if theta_loop else 0.0, -1.0]])
        a = np.diag([1.0, pole])
        b = np.array([[PERIOD], [rise * (pole - 1.0)]]) @ error
        return cls(a, b, np.array([[ki, kd]]), (kp + ki * PERIOD + kd * rise) * error)

    def response(self, omega: float) -> Complex:
        """Return the response of M to (theta_0, theta, q) at `omega` [rad/s], shape (3,)."""
        return np.asarray(transfer(self.a, self.b, self.c, self.d, np.exp(1j * omega * PERIOD))[0, 0])
