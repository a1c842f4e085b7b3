"""The noise of a virtual rig, as a plan takes it: gusts, vibration, white noise and rounding, from its own parameters.

Gusts and vibration grow with the thrust: `load` is the thrust over that of hover.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from twodof.identify.disturbance.autoregression import Autoregression, from_covariance

Array = NDArray[np.float64]

_ORDER = 40
"""Samples that the noise of q remembers in a plan, as in a fit: .16 s, a gust's correlation time."""
_RESPONSE = 1 << 12
_VIBRATION = 400


def gyro_covariance(rig: Mapping[str, float], steps: int, dt: float, load: float = 1.0) -> Array:
    """Autocovariance (steps,) of the gyro: white noise, rounding, and vibration in a band (`rig.sensors`)."""
    radius, turn = rig["vibration_r2"], (1.0 + rig["vibration_r2"]) * np.cos(2.0 * np.pi * rig["vibration_hz"] * dt)
    pulse = np.sqrt(0.5 * (1.0 - radius))
    driven = {0: pulse, 2: -pulse}
    band, before, last = np.zeros(_VIBRATION + 2000), 0.0, 0.0
    for k in range(band.size):  # scipy.signal, which has this as lfilter, takes a second to import
        before, last = last, turn * last - radius * before + driven.get(k, 0.0)
        band[k] = last
    covariance = np.array([band[: band.size - k] @ band[k:] for k in range(min(steps, _VIBRATION))])
    full = np.zeros(steps)
    full[: covariance.size] = (load * rig["gyro_hover"]) ** 2 * covariance
    full[0] += rig["gyro_idle"] ** 2 + rig["gyro_step"] ** 2 / 12.0
    return full


def range_variance(rig: Mapping[str, float]) -> float:
    """Variance [m^2] of the range sensor's own noise and of its rounding."""
    return rig["tof_noise"] ** 2 + rig["tof_step"] ** 2 / 12.0


def pushed_rate(values: Mapping[str, float], steps: int, dt: float) -> Array:
    """Response (steps,) of q to an angular acceleration of 1 in the first step, for the pitch of `values`."""
    from scipy.linalg import expm  # imported late: most commands start without it

    a = np.array([[0.0, 1.0], [-(values["w_n"] ** 2), -2.0 * values["xi"] * values["w_n"]]])
    step = expm(dt * np.block([[a, np.array([[0.0], [1.0]])], [np.zeros((1, 3))]]))
    response, state = np.zeros(steps), step[:2, 2]
    for k in range(1, steps):
        response[k], state = state[1], step[:2, :2] @ state
    return response


def pitch_noise(rig: Mapping[str, float], values: Mapping[str, float], dt: float, load: float) -> Autoregression:
    """The noise of the measured q: what gusts make of it through the pitch of `values`, and the gyro's own."""
    keep = np.exp(-dt / rig["gust_time"])
    turn = 2.0 * np.pi * np.arange(_RESPONSE + 1) / (2 * _RESPONSE)
    gust = (1.0 - keep**2) / (1.0 - 2.0 * keep * np.cos(turn) + keep**2)
    power = np.abs(np.fft.rfft(pushed_rate(values, _RESPONSE, dt), 2 * _RESPONSE)) ** 2
    pushed = np.fft.irfft(power * gust, 2 * _RESPONSE)[: _ORDER + 1]
    moment = load * rig["gust"] / rig["inertia"]
    return from_covariance(moment**2 * pushed + gyro_covariance(rig, _ORDER + 1, dt, load))


def rail_covariance(
    rig: Mapping[str, float], values: Mapping[str, float], position: Array, steps: int, dt: float, load: float = 1.0
) -> Array:
    """Covariance of the ranges at `position` (in steps) about a motion that the measured q predicts.

    The gyro's noise, summed up, is an error of the pitch, and the cart follows that. The range has its own noise.
    """
    from scipy.linalg import matmul_toeplitz  # imported late: most commands start without it

    k_v, p_v = values["k_v"], values["p_v"]
    # A sample's error turns the pitch by `dt` for good: v' = -k_v dt - p_v v.
    late = np.maximum(dt * np.arange(steps) - values["tau"], 0.0)
    moved = -k_v * dt * (late / p_v + np.expm1(-p_v * late) / p_v**2)
    age = position[:, None] - np.arange(steps)[None, :]
    spread = np.where(age > 0.0, np.interp(age, np.arange(steps), moved), 0.0)
    covariance = spread @ matmul_toeplitz(gyro_covariance(rig, steps, dt, load), spread.T)
    return np.asarray(covariance + range_variance(rig) * np.eye(position.size))
