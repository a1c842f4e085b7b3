"""Records made from closed-form models, for the tests of this folder."""

import numpy as np
from numpy.typing import NDArray

from twodof.identify.record import Record
from twodof.models.plant import PitchRate, Velocity

DT = 0.004
Array = NDArray[np.float64]


def doublet(steps: int, start: float, period: float, amplitude: float) -> Array:
    """A doublet on a grid of DT: half a period up, half down, from `start` [s] on."""
    t = DT * np.arange(steps) + 1e-9
    up = (t >= start) & (t < start + period / 2)
    down = (t >= start + period / 2) & (t < start + period)
    return amplitude * (up.astype(float) - down.astype(float))


def pitch_record(
    model: PitchRate, u: Array, sigma: float, rng: np.random.Generator, trim: float = 0.0, name: str = "record"
) -> Record:
    """q of the linear model, with white noise, for M = u + trim."""
    q = model.state_space().zero_order_hold(DT).simulate(u)[:, 1]
    measured = q + sigma * rng.standard_normal(u.size)
    return Record.from_columns(DT * np.arange(u.size), {"M": u + trim, "q": measured}, ["M"], ["q"], name)


def velocity_record(model: Velocity, sigma: float, rng: np.random.Generator, name: str = "record") -> Record:
    """v for the paper's doublet of 15 degrees and 0.8 s through an attitude loop of 15 rad/s, damping 0.7."""
    theta0 = doublet(1000, 0.8, 1.6, np.radians(15.0))
    theta, rate = np.zeros(theta0.size), 0.0
    fine = 20
    for k in range(theta0.size - 1):
        angle = theta[k]
        for _ in range(fine):
            rate += DT / fine * (225.0 * (theta0[k] - angle) - 21.0 * rate)
            angle += DT / fine * rate
        theta[k + 1] = angle
    v = model.state_space().zero_order_hold(DT).simulate(theta)[:, 1] + sigma * rng.standard_normal(theta.size)
    columns = {"theta0": theta0, "theta": theta, "v": v}
    return Record.from_columns(DT * np.arange(theta.size), columns, ["theta0", "theta"], ["v"], name)
