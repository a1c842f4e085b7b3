"""Gusts: size and correlation time of the turbulence around a hovering drone, from the level holds in its logs.

The pitch acceleration d that rotors, stiffness and friction do not explain is that of the gusts and the noise of q:

    d = q' - M_rot / J + k theta + c q

M is logged, so the noise that the controller feeds back is known, and a closed loop does not bias d. Its spectrum is
that of a first-order Gauss-Markov process and of white noise of q, whose derivative is d's share of it:

    S(f) = 2 sigma^2 tau / (1 + (2 pi f tau)^2) + (2 pi f n)^2 T

sigma, tau and n maximise Whittle's likelihood (Arkiv foer Matematik 2, 1953) from .3 to 8 Hz. Friction and the wake
act below that band, and the vibration above it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError
from twodof.flightlog.files import read_log
from twodof.flightlog.log import FlightLog
from twodof.rig.rig import stiffness
from twodof.rig.rotors import lift
from twodof.signals import PERIOD
from twodof.sim.closed_loop import ClosedLoop
from twodof.sim.resimulation import LoggedFlight, fit_percent
from twodof.sim.time_alignment import step_clock

Array = NDArray[np.float64]

LOWEST, HIGHEST = 0.3, 8.0
"""Band of the fit [Hz]."""

SHORTEST = 1.0
"""Shortest stretch of level flight that is accepted [s]."""

_LONGER = 10.0  # times the correlation time, that the longest stretch must last
_TICK = 1e-3
_LEAD = 0.5  # s of commands before a stretch, in which the rotors' lag settles
_STARTS = (0.05, 0.15, 0.4)  # s


@dataclass(frozen=True)
class HoverHold:
    """Stretches (start, end) [s] of a log in which the drone hovers level or in place; `free`: the cart can move."""

    name: str
    stretches: tuple[tuple[float, float], ...]
    free: bool


HOLDS: tuple[HoverHold, ...] = (
    HoverHold("doublet-0.03", ((217.5, 236.5),), False),
    HoverHold("velocity-doublets-0.25", ((127.0, 141.5), (144.5, 150.9)), True),
    HoverHold("position-sweep-default", ((109.0, 127.5),), True),
)
"""The long holds of the public logs. The other logs hold level for 2 s at most, which is too short."""


@dataclass(frozen=True)
class GustEstimate:
    """`gust` [rad/s2] is the standard deviation of the pitch acceleration by gusts, `time` [s] its correlation time.

    `noise` [rad/s] is the white noise of q; `duration` [s] that of the stretches.
    """

    gust: float
    time: float
    noise: float
    duration: float


def measure_gusts(
    log: FlightLog | str | Path, stretches: Sequence[tuple[float, float]], rig: Mapping[str, float], free: bool = False
) -> GustEstimate:
    """Return the gusts in the `stretches` (start, end) [s] of level flight of a log, with the parameters of `rig`.

    `free` says that the cart is not locked; its motion then about halves the stiffness. On the simulated `lab` rig with
    gusts of 1.8 rad/s2 and .1 s, 20 s of hold give 1.70 +- .10 and .11 +- .03: 5 % too little. Raises LogError for a
    log that cannot be read or lacks q, theta, M or T; IdentificationError for a stretch below 1 s.
    """
    from scipy.optimize import minimize  # imported late: most commands start without it

    if not isinstance(log, FlightLog):
        log = read_log(log)
    if not stretches:
        raise IdentificationError("no stretch of level flight", log.source, "name at least one")
    spectra = [_spectrum(*_disturbance(log, a, b, rig, free)) for a, b in stretches]
    omega = 2.0 * np.pi * np.concatenate([f for f, _ in spectra])
    power = np.concatenate([s for _, s in spectra])

    def loss(x: Array) -> float:
        gust, time, noise = np.exp(x)
        model = 2.0 * gust**2 * time / (1.0 + (omega * time) ** 2) + (omega * noise) ** 2 * PERIOD
        return float(np.sum(np.log(model) + power / model))

    options = {"maxiter": 4000, "xatol": 1e-5, "fatol": 1e-7}
    starts = (np.log([2.0, time, 0.02]) for time in _STARTS)
    found = min((minimize(loss, x, method="Nelder-Mead", options=options) for x in starts), key=lambda r: float(r.fun))
    gust, time, noise = (float(value) for value in np.exp(found.x))
    if not time * _LONGER < max(b - a for a, b in stretches):
        raise IdentificationError(
            f"the stretches, at most {max(b - a for a, b in stretches):.2g} s, are too short for gusts of {time:.2g} s",
            log.source,
            "give longer stretches of level flight",
        )
    return GustEstimate(gust, time, noise, float(sum(b - a for a, b in stretches)))


def _disturbance(log: FlightLog, t0: float, t1: float, rig: Mapping[str, float], free: bool) -> tuple[Array, float]:
    """Return d between the samples of q in a stretch, and the period of the samples by the drone's clock [s]."""
    q, theta = log["q"], log["theta"]
    stamps = q.slice(t0, t1).time
    if not (t1 - t0 >= SHORTEST and len(stamps) >= 0.5 * SHORTEST / PERIOD):
        what = f"only {len(stamps)} samples of q from {t0:g} to {t1:g} s"
        raise IdentificationError(what, log.source, f"give stretches of {SHORTEST:g} s or more")
    period, origin, last = step_clock(stamps)
    time = origin + period * np.arange(last + 1)
    rate, angle = np.interp(time, q.time, q.value), np.interp(time, theta.time, theta.value)
    fine = np.arange(time[0] - _LEAD, time[-1] + _TICK, _TICK)
    turned = np.interp(time, fine, _TICK * np.cumsum(_acceleration(log, fine, rig)))
    spring = stiffness(rig) / rig["inertia"] * (0.5 if free else 1.0)
    viscous = rig["viscous_run"] / rig["inertia"]
    held = 0.5 * (spring * (angle[1:] + angle[:-1]) + viscous * (rate[1:] + rate[:-1]))
    return np.diff(rate) / period - np.diff(turned) / period + held, period


def _acceleration(log: FlightLog, time: Array, rig: Mapping[str, float]) -> Array:
    """Return the pitch acceleration [rad/s2] by the rotors at ticks, from the logged commands."""
    from scipy.signal import lfilter  # imported late: most commands start without it

    def arrived(name: str) -> Array:
        channel = log[name]
        return channel.value[np.maximum(channel.index(time - rig["delay"], "hold"), 0)]

    def lagged(command: Array) -> Array:
        held = np.clip(command, 0.0, 1.0)
        keep = float(np.exp(-_TICK / rig["lag"])) if rig["lag"] > 0.0 else 0.0
        return np.asarray(lfilter([1.0 - keep], [1.0, -keep], held, zi=[keep * held[0]])[0])

    moment, thrust = arrived("M"), arrived("T")
    curve = rig["curve"]
    difference = lift(lagged(thrust + moment), curve) - lift(lagged(thrust - moment), curve)
    return np.asarray(rig["arm"] * rig["pair_thrust"] / rig["inertia"] * difference)


def _spectrum(d: Array, period: float) -> tuple[Array, Array]:
    """Return frequencies [Hz] in the band and the two-sided power density there, with a Hann window."""
    window = np.hanning(len(d))
    density = np.abs(np.fft.rfft((d - d.mean()) * window)) ** 2 * period / float(window @ window)
    frequency = np.fft.rfftfreq(len(d), period)
    inside = (frequency >= max(LOWEST, 1.5 / (len(d) * period))) & (frequency <= HIGHEST)
    return np.asarray(frequency[inside]), np.asarray(density[inside])


SEEDS = 20
"""Number of simulated flights with noise over which the median is taken."""


def gust_fits(
    flight: LoggedFlight, loop: ClosedLoop, rig: Mapping[str, float], seeds: int = SEEDS
) -> dict[str, NDArray[np.float64]]:
    """Return the FIT [%], by channel (seeds,), of the noise-free flight of `rig` to its flights with noise.

    Each noisy flight stands for a log, and the noise-free one for a model without an error. Gusts, vibration and the
    sensors' noise are those of `rig`. `loop` is one of `resimulation_loop`. Raises IdentificationError below one seed.
    """
    if seeds < 1:
        raise IdentificationError(f"{seeds} seeds are too few", "gust ceiling", "give at least one")
    model = flight.simulate(loop, rig)
    flown = [flight.simulate(loop, rig, {"noise": 1.0, "seed": seed}) for seed in range(1, seeds + 1)]
    return {name: np.array([fit_percent(noisy[name], values) for noisy in flown]) for name, values in model.items()}


def gust_ceiling(
    flight: LoggedFlight, loop: ClosedLoop, rig: Mapping[str, float], seeds: int = SEEDS
) -> dict[str, float]:
    """Return the median of `gust_fits` by channel [%]. In open loop single flights differ much from it."""
    return {name: float(np.median(fits)) for name, fits in gust_fits(flight, loop, rig, seeds).items()}
