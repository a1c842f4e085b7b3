"""P, PI, PD and PID by crossover and phase margin: closed forms, exact for the sampled plant's response."""

import cmath
import math
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.errors import ParameterError, is_number, shown
from twodof.signals import PERIOD

Complex = NDArray[np.complex128]

FORMS = MappingProxyType({"P": (), "PI": ("ki",), "PD": ("kd",), "PID": ("ki", "kd")})
"""Gains of each form besides Kp."""

INTEGRAL_SHARE = 0.1
"""Zero of the integral as a share of the crossover; it costs 6 degrees of phase."""


@dataclass(frozen=True)
class PidGains:
    """Gains of the platform's PID, Kp e + Ki Ts z/(z - 1) e + Kd (z - 1)/((1/N + Ts) z - 1/N) e at 250 Hz.

    `n` is the filter N [rad/s] of the derivative.
    """

    kp: float
    ki: float = 0.0
    kd: float = 0.0
    n: float = 100.0

    def response(self, omega: ArrayLike) -> Complex:
        """Return the frequency response at `omega` [rad/s], shape (k,)."""
        z = np.exp(1j * np.atleast_1d(np.asarray(omega, dtype=float)) * PERIOD)
        integral, derivative = _parts(z, self.n)
        return np.asarray(self.kp + self.ki * integral + self.kd * derivative, dtype=np.complex128)


def shaped_pid(mu: float, crossover: float, n: float = 100.0) -> PidGains:
    """Return the course's rate PID for mu / s, by loop shaping at `crossover` w [rad/s].

        C = w / mu (1 + w / (10 s)) (1 + s / (2 w)) / (1 + s / N)

    A zero a tenth of w for the integral, one at twice w for the lead, the gain as of mu / s. Written as Kp, Ki, Kd with
    filter N: with d = 1/(2 w) - 1/N, Ki = w^2 / (10 mu), Kp = (w + w^2 d / 10) / mu, Kd = w d (1 - w / (10 N)) / mu.
    The phase margin follows from the delay. Raises ParameterError for numbers that are not positive, and for a
    crossover above N / 2, where Kd would be negative.
    """
    for name, value in (("mu", mu), ("crossover", crossover), ("N", n)):
        _positive(name, value)
    lead = 1.0 / (2.0 * crossover) - 1.0 / n
    if lead < 0.0:
        raise ParameterError(
            f"a crossover of {crossover:g} rad/s is above N / 2", "shaped_pid", f"give at most {0.5 * n:g} rad/s"
        )
    zero = 0.1 * crossover
    gain = crossover / mu
    return PidGains(gain * (1.0 + zero * lead), gain * zero, gain * lead * (1.0 - zero / n), n)


def pid_at(
    response: complex, crossover: float, phase_margin: float = math.radians(60.0), form: str = "PID", n: float = 100.0
) -> PidGains:
    """Return the gains of the `form` P, PI, PD or PID for a plant whose response at `crossover` is `response`.

    C G = exp(j (phase_margin - pi)) at the crossover is two equations. PI and PD have two gains. PID has its third by
    Ki = `INTEGRAL_SHARE` crossover Kp (Astrom and Hagglund, Advanced PID Control, sec. 6.3). P only meets the
    crossover. Raises ParameterError for an unknown form, for numbers out of range, and if a gain would be negative: the
    form cannot give that phase at the crossover.
    """
    if form not in FORMS:
        raise ParameterError(f"unknown form {shown(form)}", "pid", f"use {', '.join(FORMS)}")
    for name, value in (("crossover", crossover), ("N", n)):
        _positive(name, value)
    if not -math.pi < phase_margin < math.pi:
        what = f"a phase margin of {phase_margin!r} rad is out of range"
        raise ParameterError(what, "pid", "give it in radians: 0.5 to 1.2 is usual")
    if not (cmath.isfinite(response) and abs(response) > 0.0):
        what = f"the plant's response at {crossover:g} rad/s is {response!r}"
        raise ParameterError(what, "pid", "choose another crossover")
    wanted = cmath.exp(1j * (phase_margin - math.pi)) / response
    if form == "P":
        return PidGains(float(abs(wanted)), n=n)
    integral, derivative = (complex(v) for v in _parts(np.exp(1j * crossover * PERIOD), n))
    if form == "PI":
        gains = PidGains(*_solved(wanted, 1.0, integral), n=n)
    else:
        zero = INTEGRAL_SHARE * crossover if form == "PID" else 0.0
        kp, kd = _solved(wanted, 1.0 + zero * integral, derivative)
        gains = PidGains(kp, zero * kp, kd, n)
    _check_signs(gains, form, wanted, crossover)
    return gains


def _parts(z: NDArray[np.complex128] | complex, n: float) -> tuple[Complex, Complex]:
    lag = 1.0 / n
    both = (PERIOD * z / (z - 1.0), (z - 1.0) / ((lag + PERIOD) * z - lag))
    return np.asarray(both[0], dtype=np.complex128), np.asarray(both[1], dtype=np.complex128)


def _solved(wanted: complex, one: complex, other: complex) -> tuple[float, float]:
    """Return real (a, b) with a one + b other = wanted."""
    rows = np.array([[one.real, other.real], [one.imag, other.imag]])
    a, b = np.linalg.solve(rows, [wanted.real, wanted.imag])
    return float(a), float(b)


def _check_signs(gains: PidGains, form: str, wanted: complex, crossover: float) -> None:
    phase = math.degrees(cmath.phase(wanted))
    way, remedy = "lead", "ask for a lower crossover or a smaller phase margin"
    if phase <= 0.0:
        way, remedy = "lag", "ask for a larger phase margin, a higher crossover, or a form with fewer parts"
    if negative := [name for name in ("kp", "ki", "kd") if getattr(gains, name) < 0.0]:
        what = f"a {form} cannot give {abs(phase):.1f} degrees of {way} at {crossover:g} rad/s"
        raise ParameterError(f"{what}: {', '.join(negative)} would be negative", "pid", remedy)


def _positive(name: str, value: float) -> None:
    if not is_number(value) or value <= 0.0:
        raise ParameterError(f"{name} = {shown(value)} is not a positive number", "pid", "give a finite number > 0")
