"""Charge: how full a flight's battery was, by the thrust that its motion shows."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError
from twodof.sim.closed_loop import ClosedLoop
from twodof.sim.resimulation import LoggedFlight

_TOLERANCE = 1e-3
_STEP = 0.05
_BLOCK = 250  # samples: about a second, as misfits are coloured


@dataclass(frozen=True)
class ChargeEstimate:
    """The state of charge [0, 1] at the start of a flight's window, and its standard deviation.

    `at_bound` says that the estimate is 0 or 1: the flight had less or more thrust than the rig's battery allows, and
    the deviation says nothing.
    """

    charge: float
    deviation: float
    at_bound: bool


def estimate_charge(flight: LoggedFlight, loop: ClosedLoop, rig: Mapping[str, float]) -> ChargeEstimate:
    """The charge with which the noise-free `rig` comes closest to the flight, each channel over its own spread.

    It uses the estimates *inside* the window, so the FIT with it is not a prediction. The rig's charge 1 is the mean of
    the flights that it was calibrated on. The deviation takes misfits of one second as one (as `calibrate` does).
    Raises IdentificationError if the charge leaves no trace in the flight.
    """
    from scipy.optimize import minimize_scalar  # imported late: most commands start without it

    spread = {name: float(np.linalg.norm(values - values.mean())) for name, values in flight.logged.items()}
    moving = [
        name for name in (("theta", "q", "x", "v") if flight.flown.rails else ("theta", "q")) if spread[name] > 0.0
    ]

    def misfit(charge: float) -> NDArray[np.float64]:
        simulated = flight.simulate(loop, rig, {"charge_start": charge})
        return np.concatenate([np.empty(0), *((flight.logged[n] - simulated[n]) / spread[n] for n in moving)])

    found = minimize_scalar(
        lambda charge: float(np.sum(misfit(charge) ** 2)),
        bounds=(0.0, 1.0),
        method="bounded",
        options={"xatol": _TOLERANCE},
    )
    charge = float(found.x)
    low, high = max(0.0, charge - _STEP), min(1.0, charge + _STEP)
    slope, residual = (misfit(high) - misfit(low)) / (high - low), misfit(charge)
    curvature = float(slope @ slope)
    if not curvature > 0.0:
        raise IdentificationError(
            "the charge leaves no trace in it", "charge", "take a flight with thrust, on a rig whose battery sags"
        )
    blocks = range(0, len(residual), _BLOCK)
    push = np.array([slope[k : k + _BLOCK] @ residual[k : k + _BLOCK] for k in blocks])
    at_bound = min(charge, 1.0 - charge) < 2.0 * _TOLERANCE
    return ChargeEstimate(round(charge, 4), float(np.sqrt(push @ push)) / curvature, at_bound)
