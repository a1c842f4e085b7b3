"""Ceiling: the FIT that a perfect model of the machine would reach, since gusts differ from flight to flight."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError
from twodof.sim.closed_loop import ClosedLoop
from twodof.sim.resimulation import LoggedFlight, fit_percent

SEEDS = 20
"""Flights with noise that the median is taken of."""


def gust_fits(
    flight: LoggedFlight, loop: ClosedLoop, rig: Mapping[str, float], seeds: int = SEEDS
) -> dict[str, NDArray[np.float64]]:
    """FIT [%], by channel (seeds,), of the noise-free flight of `rig` to flights of the same rig with its noise.

    Each noisy flight stands for a log, and the noise-free one for a model without an error. Gusts, vibration and the
    sensors' noise are those of `rig`. `loop` is one of `resimulation_loop`. Raises IdentificationError below one seed.
    """
    if seeds < 1:
        raise IdentificationError(f"{seeds} seeds", "gust ceiling", "fly at least one")
    model = flight.simulate(loop, rig)
    flown = [flight.simulate(loop, rig, {"noise": 1.0, "seed": seed}) for seed in range(1, seeds + 1)]
    return {name: np.array([fit_percent(noisy[name], values) for noisy in flown]) for name, values in model.items()}


def gust_ceiling(
    flight: LoggedFlight, loop: ClosedLoop, rig: Mapping[str, float], seeds: int = SEEDS
) -> dict[str, float]:
    """The median of `gust_fits` by channel [%]. In open loop single flights are far from it."""
    return {name: float(np.median(fits)) for name, fits in gust_fits(flight, loop, rig, seeds).items()}
