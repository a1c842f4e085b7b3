"""Predict: what the rig does by its static and simplest dynamic laws, before or instead of a simulation."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.errors import ExperimentError
from twodof.rig.dynamics import GRAVITY
from twodof.rig.rotors import HOVER, lift


def rotor_moment(rig: Mapping[str, float], moment: float, thrust: float = HOVER) -> float:
    """Pitch moment [N m] of the rotors in steady state for the commands `moment` M and `thrust` T."""
    fore, aft = (min(1.0, max(0.0, thrust + sign * moment)) for sign in (1.0, -1.0))
    curve = rig["curve"]
    return float(rig["arm"] * rig["pair_thrust"] * (lift(fore, curve) - lift(aft, curve)))


def restoring_moment(rig: Mapping[str, float], theta: float) -> float:
    """Moment [N m] that holds the drone at pitch `theta` [rad]: gravity and springs, no friction."""
    gravity = rig["mass_drone"] * GRAVITY * rig["offset"] * np.sin(theta)
    return float(gravity + theta * (rig["spring"] + rig["hardening"] * theta**2))


def trim_moment(rig: Mapping[str, float], moment: float, theta: float = 0.0) -> float:
    """The wake's moment [N m] (the rig's parameter `trim`) under which M = `moment` holds `theta` at T = .4."""
    return restoring_moment(rig, theta) - rotor_moment(rig, moment)


def moment_gain(rig: Mapping[str, float], thrust: float) -> float:
    """mu [rad/s2]: pitch acceleration for a unit of M, for small M at `thrust`; at 0, of the fore pair alone."""
    curve = rig["curve"]
    slope = 1.0 - curve + 2.0 * curve * thrust
    pairs = 2.0 if thrust > 0.0 else 1.0
    return float(pairs * rig["arm"] * rig["pair_thrust"] * slope / rig["inertia"])


def velocity_gain(rig: Mapping[str, float], thrust: float = HOVER) -> float:
    """k_v [m/s2 per rad]: thrust over the moved mass."""
    return float(2.0 * rig["pair_thrust"] * lift(thrust, rig["curve"]) / (rig["mass_drone"] + rig["mass_cart"]))


def velocity_damping(rig: Mapping[str, float]) -> float:
    """p_v [1/s]: linear friction of the rail over the moved mass."""
    return float(rig["rail_viscous"] / (rig["mass_drone"] + rig["mass_cart"]))


def travel(
    rig: Mapping[str, float], time: ArrayLike, theta: ArrayLike, lag: float = 0.1
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Predicted (x, v) of the cart, each (n,), from rest at x = 0, for pitch set-points `theta` (n,) [rad] at `time`.

    The pitch follows its set-point with the time constant `lag` [s] (0: at once); thrust is that of hover; rail
    friction as in `rig`. The end stops are left out: what counts is how much rail is asked for. Raises
    ExperimentError for times that do not increase or shapes that differ.
    """
    t = np.asarray(time, dtype=np.float64)
    asked = np.asarray(theta, dtype=np.float64)
    if t.ndim != 1 or t.shape != asked.shape or t.size < 2 or not np.all(np.diff(t) > 0.0):
        raise ExperimentError(
            f"time {t.shape} and theta {asked.shape} do not match or time does not increase",
            "travel",
            "give two arrays of one length, at least 2, with increasing time",
        )
    mass = rig["mass_drone"] + rig["mass_cart"]
    gain, damping, coulomb = velocity_gain(rig), velocity_damping(rig), rig["rail_coulomb"] / mass
    x, v = np.zeros_like(t), np.zeros_like(t)
    pitch = asked[0]
    for k, dt in enumerate(np.diff(t)):
        pitch += (asked[k] - pitch) * (1.0 - np.exp(-dt / lag) if lag > 0.0 else 1.0)
        push = -gain * np.sin(pitch) - damping * v[k]
        moved = v[k] + push * dt
        speed = np.sign(moved) * max(0.0, abs(moved) - coulomb * dt)
        x[k + 1] = x[k] + 0.5 * (v[k] + speed) * dt
        v[k + 1] = speed
    return x, v


def fitting_start(
    rig: Mapping[str, float], time: ArrayLike, theta: ArrayLike, margin: float = 0.05, lag: float = 0.1
) -> float:
    """Where [m] to start so that the predicted travel stays `margin` [m] off both ends of the rail, centred.

    Arguments as `travel`'s. Raises ExperimentError, with the rail that is asked for, if no start fits.
    """
    x, _ = travel(rig, time, theta, lag)
    low, high = float(x.min()), float(x.max())
    room = 2.0 * (rig["rail_stop"] - margin)
    if high - low > room:
        raise ExperimentError(
            f"it would travel {high - low:.2f} m and the rail leaves {room:.2f} m",
            "rail",
            "make it shorter or smaller: travel grows with amplitude and with the square of the half-period",
        )
    return -0.5 * (low + high)
