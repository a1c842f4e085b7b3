"""Margins of a loop (gain, phase, delay and disk), sensitivity peaks, crossovers, and whether it is stable."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.design.closed_loop_poles import (
    Motion,
    closed_loop_poles,
    feedback_gain,
    frequencies_of_size,
    frequencies_of_the_real,
    frequency_grid,
    logarithms,
    refined_roots,
    worst_motion,
)
from twodof.design.loop_transfer import LoopTransfer, minimal
from twodof.design.structured_hinf import peak_gain
from twodof.errors import ParameterError

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Transfer `direct` + `share` S of a loop, with S = 1 / (1 + L): T, for example, has direct 1 and share -1."""

    loop: LoopTransfer
    share: float
    direct: float

    @cached_property
    def matrices(self) -> LoopTransfer | None:
        """The transfer as matrices, finite also where L has a pole; None if the loop has a continuous delay."""
        if self.loop.delay:
            return None
        k, one = feedback_gain(self.loop), self.loop
        return LoopTransfer(
            one.a - k * one.b @ one.c, k * one.b, -self.share * k * one.c, self.direct + self.share * k, one.dt
        )

    def response(self, omega: ArrayLike) -> Complex:
        """Return the frequency response at `omega` [rad/s], shape (k,)."""
        if self.matrices is not None:
            return self.matrices.response(omega)
        return np.asarray(self.direct + self.share / (1.0 + self.loop.response(omega)))


def largest(of: Sensitivity, grid: Array) -> tuple[float, float]:
    """Return (size, frequency [rad/s]) of the largest |of| over all frequencies.

    It is the highest peak on `grid` [rad/s], refined. Without a continuous delay no higher peak is missed.
    """
    best, place = _peak(of.response, grid)
    if (own := of.matrices) is not None:
        return max((best, place), peak_gain(own.a, own.b, own.c, np.array([[own.d]]), own.dt))
    for omega, value in ((0.0, of.response(0.0)[0]), (np.inf, of.direct + of.share)):
        if np.isfinite(value) and abs(value) > best:
            best, place = float(abs(value)), omega
    return best, place


def _peak(of: Callable[[Array], Complex], grid: Array) -> tuple[float, float]:
    from scipy.optimize import minimize_scalar  # imported late: most commands start without it

    sizes = np.abs(of(grid))
    grid, sizes = grid[np.isfinite(sizes)], sizes[np.isfinite(sizes)]
    top = float(sizes.max(initial=0.0))
    best, place = top, float(grid[int(np.argmax(sizes))]) if grid.size else 0.0
    inner = np.flatnonzero((sizes[1:-1] >= sizes[:-2]) & (sizes[1:-1] >= sizes[2:])) + 1
    for k in inner[sizes[inner] > 0.8 * top]:
        found = minimize_scalar(
            lambda x: -float(np.abs(of(np.exp(np.atleast_1d(x))))[0]),
            bounds=(float(np.log(grid[k - 1])), float(np.log(grid[k + 1]))),
            method="bounded",
            options={"xatol": 1e-12},
        )
        if -found.fun > best:
            best, place = float(-found.fun), float(np.exp(found.x))
    return best, place


@dataclass(frozen=True)
class DiskMargin:
    """The loop stays stable for every factor (1 + (1 - skew) d / 2) / (1 - (1 + skew) d / 2), |d| < `alpha`, d complex.

    `alpha` is 1 / max |S + (skew - 1) / 2|, at the frequency `omega` [rad/s]: Seiler, Packard and Gahinet, An
    Introduction to Disk Margins, IEEE Control Systems 40-5 (2020), theorem 1. Skew 0 is balanced between S and T,
    1 measures S and -1 measures T.
    """

    alpha: float
    skew: float
    omega: float

    @property
    def gain(self) -> tuple[float, float]:
        """Factors (low, high) between which the gain alone may change; low may be < 0, and high infinite."""
        up, down = 1.0 - self.skew, 1.0 + self.skew
        if math.isinf(self.alpha):
            return (-up / down if down else -math.inf), math.inf
        low = (2.0 - self.alpha * up) / (2.0 + self.alpha * down)
        rest = 2.0 - self.alpha * down
        # An infinite factor comes out as 1e15 by rounding.
        return low, (2.0 + self.alpha * up) / rest if rest > 1e-9 else math.inf

    @property
    def phase(self) -> float:
        """Largest change of the phase alone, either way [rad], at most pi: where |factor| is 1 on |d| = `alpha`."""
        if self.alpha * abs(self.skew) >= 2.0 or math.isinf(self.alpha):
            return math.pi
        squared = self.alpha**2
        cosine = (4.0 - squared * (1.0 + self.skew**2)) / (4.0 + squared * (1.0 - self.skew**2))
        return math.acos(max(-1.0, cosine))


_ON_THE_POINT = 1e-6  # of an open-loop pole to z = 1 or z = -1, where L is then infinite
_SMALL = 1e-4  # a gain margin of 80 dB, up or down, is none
_HALF_POWER = math.sqrt(0.5)


@dataclass(frozen=True)
class GainCrossing:
    """Frequency `omega` [rad/s] where L is real and < 0: with `factor` times the gain L is -1, the stability border."""

    factor: float
    omega: float


@dataclass(frozen=True)
class PhaseCrossing:
    """Frequency `omega` [rad/s] where |L| is 1, and the phase of L above -pi there, `phase` [rad] in (-pi, pi].

    So much further lag brings the loop to the border of stability; if `phase` is negative, so much lead does.
    """

    phase: float
    omega: float

    @property
    def delay(self) -> float:
        """Further delay [s] that turns L to -1 at this frequency."""
        return (self.phase % (2.0 * math.pi)) / self.omega


@dataclass(frozen=True, eq=False)
class LoopMargins:
    """Margins of `loop`. For an unstable loop, the crossings say which change would make it stable.

    `gains` and `phases` are all crossings, by rising frequency. `poles` are those of the closed loop (z plane, or
    rad/s), the least stable first; `motion` is that of the worst pole. `ms` and `mt` are the largest |S| and |T|, at
    `ms_at` and `mt_at` [rad/s]. For an unstable loop they are infinite, and their frequencies and that of `disk` are
    NaN. `bandwidth` [rad/s] is where |T| falls through -3 dB, 0 where |T| is nowhere above.
    """

    loop: LoopTransfer
    gains: tuple[GainCrossing, ...]
    phases: tuple[PhaseCrossing, ...]
    poles: Complex
    motion: Motion | None
    ms: float
    ms_at: float
    mt: float
    mt_at: float
    disk: DiskMargin
    bandwidth: float

    def __repr__(self) -> str:
        if self.motion is not None and not self.stable:
            return f"<LoopMargins unstable: {self.motion.text}>"
        up, down = self.increase, self.decrease
        ways = [f"{20.0 * math.log10(one.factor):+.1f} dB" for one in (up, down) if one is not None]
        gain, delay = " and ".join(ways) or "none", self.delay_margin
        if not self.phases:
            return f"<LoopMargins stable: gain margin {gain}, no crossover>"
        phase = f"{self.phase_margin_deg:.1f} deg at {self.crossover:.3g} rad/s"
        short = f"{delay:.3g} s" if delay >= 1.0 else f"{1e3 * delay:.3g} ms"
        return f"<LoopMargins stable: gain margin {gain}, phase margin {phase}, delay margin {short}>"

    @property
    def stable(self) -> bool:
        """Return True if the closed loop is stable; a loop on the border is not."""
        return self.motion is None or self.motion.growth < 0.0

    @property
    def increase(self) -> GainCrossing | None:
        """Crossing with the smallest factor above 1: more gain than that is unstable. None if there is none."""
        return min((g for g in self.gains if g.factor > 1.0), key=lambda g: g.factor, default=None)

    @property
    def decrease(self) -> GainCrossing | None:
        """Crossing with the largest factor below 1: less gain than that is unstable. None if there is none."""
        return max((g for g in self.gains if g.factor < 1.0), key=lambda g: g.factor, default=None)

    @property
    def gain_margin(self) -> float:
        """The smaller of the gain margins up and down, as a factor above 1; infinity if there is none."""
        factors = [g.factor if g.factor > 1.0 else 1.0 / g.factor for g in self.gains]
        return min(factors, default=math.inf)

    @property
    def gain_margin_db(self) -> float:
        """`gain_margin` [dB]."""
        return 20.0 * math.log10(self.gain_margin)

    @property
    def _nearest_phase(self) -> PhaseCrossing | None:
        return min(self.phases, key=lambda p: abs(p.phase), default=None)

    @property
    def phase_margin(self) -> float:
        """Phase margin [rad] at the crossing nearest to -pi, negative for lead; infinity if |L| is 1 nowhere."""
        nearest = self._nearest_phase
        return math.inf if nearest is None else nearest.phase

    @property
    def phase_margin_deg(self) -> float:
        """`phase_margin` [deg]."""
        return math.degrees(self.phase_margin)

    @property
    def crossover(self) -> float:
        """The frequency [rad/s] of the phase margin; NaN if |L| is 1 nowhere."""
        nearest = self._nearest_phase
        return math.nan if nearest is None else nearest.omega

    @property
    def delay_margin(self) -> float:
        """The shortest further delay [s] that brings the loop to the border of stability; infinity if there is none.

        It is 0 for a continuous loop whose gain does not fall below 1: however short a delay turns it by half a turn.
        """
        if self.loop.dt is None and abs(self.loop.d) >= 1.0:
            return 0.0
        return min((p.delay for p in self.phases), default=math.inf)

    @property
    def modulus_margin(self) -> float:
        """The smallest |1 + L|: the distance of the Nyquist curve from -1."""
        return 1.0 / self.ms if self.ms > 0.0 else math.inf

    @cached_property
    def poles_rad(self) -> Complex:
        """`poles` in rad/s, also of a sampled loop."""
        return logarithms(self.poles, self.loop.dt)

    def to_json(self) -> dict[str, Any]:
        """Return plain data in SI units: radians, factors and seconds; infinity stays infinity."""
        named = ("stable", "crossover", "gain_margin", "phase_margin", "delay_margin", "modulus_margin", "bandwidth")
        return {
            **{name: getattr(self, name) for name in (*named, "ms", "ms_at", "mt", "mt_at")},
            "motion": None if self.motion is None else {"omega": self.motion.omega, "growth": self.motion.growth},
            "gain_increase": self.increase.factor if self.increase else math.inf,
            "gain_decrease": self.decrease.factor if self.decrease else 0.0,
            "disk_margin": self.disk.alpha,
            "disk_gain": list(self.disk.gain),
            "disk_phase": self.disk.phase,
            "gain_crossings": [{"factor": g.factor, "omega": g.omega} for g in self.gains],
            "phase_crossings": [{"phase": p.phase, "omega": p.omega} for p in self.phases],
            "poles": [[float(p.real), float(p.imag)] for p in self.poles],
        }


def margins(loop: Any, skew: float = 0.0) -> LoopMargins:
    """Return the margins of `loop` with negative feedback; `skew` is that of the disk margin (`DiskMargin`).

    `loop` is a LoopTransfer, or a model that `LoopTransfer.of` takes.

    Every frequency is a root found to its last digits. Eigenvalues say how many roots there are, so narrow resonances
    and crossings that lie close together are not missed. The phase of a continuous delay is followed on a grid of 16
    points a turn, to where |L| stays under 1e-3. Stability comes from the closed loop's poles, so the result is right
    for unstable open loops too. Raises ParameterError for another type, a skew that is not finite, a loop whose 1 + D
    is 0, and a delay that turns the phase too many times.
    """
    if not math.isfinite(skew):
        raise ParameterError(f"skew {skew} is not finite", "margins", "use 0 (balanced), 1 (S) or -1 (T)")
    loop = LoopTransfer.of(loop)
    even = loop.balanced()
    poles = closed_loop_poles(even)
    motion = worst_motion(even, poles)
    even = minimal(even).balanced()
    through = np.array([[even.d]])
    unit = frequencies_of_size(even.a, even.b, even.c, through, even.dt, 1.0)
    real = frequencies_of_the_real(even)
    grid = frequency_grid(even, poles, np.unique(np.concatenate([unit, real])))
    values = even.response(grid)
    grid, values = grid[np.isfinite(values)], values[np.isfinite(values)]
    s, t, shifted = (Sensitivity(even, *of) for of in ((1.0, 0.0), (-1.0, 1.0), (1.0, (skew - 1.0) / 2.0)))
    stable = motion is None or motion.growth < 0.0
    # The search for a peak needs a stable loop: on the border of stability a peak is infinite.
    peaks = [largest(of, grid) if stable else (math.inf, math.nan) for of in (s, t, shifted)]
    (ms, ms_at), (mt, mt_at), (reach, disk_at) = peaks
    return LoopMargins(
        loop,
        tuple(_gains(even, grid, values)),
        tuple(_phases(even, grid, values)),
        poles,
        motion,
        ms,
        ms_at,
        mt,
        mt_at,
        DiskMargin(1.0 / reach if reach > 0.0 else math.inf, skew, disk_at),
        _bandwidth(t, grid),
    )


def _phases(loop: LoopTransfer, grid: Array, values: Complex) -> list[PhaseCrossing]:
    def above(omega: float) -> float:
        return math.log(abs(loop.response(omega)[0]) or 1e-300)

    found = []
    for omega in refined_roots(above, grid, np.log(np.maximum(np.abs(values), 1e-300))):
        phase = math.remainder(float(np.angle(loop.response(omega)[0])) + math.pi, 2.0 * math.pi)
        found.append(PhaseCrossing(math.pi if phase == -math.pi else phase, omega))
    return found


def _gains(loop: LoopTransfer, grid: Array, values: Complex) -> list[GainCrossing]:
    def across(omega: float) -> float:
        return float(loop.response(omega)[0].imag)

    inside = grid < (math.inf if loop.dt is None else np.pi / loop.dt * (1.0 - 1e-12))
    roots = refined_roots(across, grid[inside], values.imag[inside])
    places = [(omega, complex(loop.response(omega)[0])) for omega in roots]
    places += _ends(loop)
    # Where the phase jumps (a pole on the axis) the imaginary part changes its sign without a root.
    found = [
        GainCrossing(-1.0 / at.real, omega)
        for omega, at in places
        if -1.0 / _SMALL < at.real < -_SMALL and abs(at.imag) <= 1e-6 * abs(at.real)
    ]
    return sorted(found, key=lambda g: g.omega)


def _ends(loop: LoopTransfer) -> list[tuple[float, complex]]:
    """Return L at frequency 0 and at the Nyquist frequency, where L is real, unless it has a pole there."""
    poles = loop.poles()
    if loop.dt is None:
        ends = [(0.0, 0.0, _ON_THE_POINT * max(1.0, float(np.abs(poles).max(initial=0.0))))]
    else:
        ends = [(0.0, 1.0, _ON_THE_POINT), (math.pi / loop.dt, -1.0, _ON_THE_POINT)]
    found = []
    for omega, place, near in ends:
        if not poles.size or np.abs(poles - place).min() > near:
            found.append((omega, complex(loop.at(place)[0].real)))
    if loop.dt is None and loop.d:
        found.append((math.inf, complex(loop.d)))
    return found


def _bandwidth(t: Sensitivity, grid: Array) -> float:
    """Return the highest frequency where |T| falls through 1 / sqrt(2): Skogestad and Postlethwaite, section 2.4.5.

    Infinity where it does not fall, 0 where it is nowhere above.
    """

    def above(omega: float) -> float:
        return float(np.abs(t.response(omega))[0]) - _HALF_POWER

    sizes = np.abs(t.response(grid)) - _HALF_POWER
    if sizes[-1] > 0.0:
        return math.inf
    roots = refined_roots(above, grid, sizes)
    return roots[-1] if roots else 0.0


FROM, TO, LEAST = 0.05, 30.0, 100.0
"""Range of a Bode plot as multiples of the crossover, and the least upper end [rad/s]."""


class Bode(NamedTuple):
    """Bode plot of a loop: frequencies `omega` [rad/s], gain [dB] and unwrapped phase [rad], all (n,)."""

    omega: Array
    gain: Array
    phase: Array


def bode(of: LoopMargins, points: int = 300) -> Bode:
    """Return the Bode plot around the loop's crossover, up to half the sampling frequency."""
    place = of.crossover if of.phases else 1.0
    end = max(TO * place, LEAST)
    return bode_at(
        of, np.geomspace(FROM * place, end if of.loop.dt is None else min(end, math.pi / of.loop.dt), points)
    )


def bode_at(of: LoopMargins, omega: Array) -> Bode:
    """Return the Bode plot at the rising frequencies `omega` [rad/s], shape (n,).

    The phase at the crossover is -pi plus the phase margin, so that the margin can be read from the plot.
    """
    response = of.loop.response(omega)
    gain = 20.0 * np.log10(np.maximum(np.abs(response), 1e-9))
    phase = np.unwrap(np.angle(response))
    if of.phases:
        there = float(np.interp(of.crossover, omega, phase))
        phase = phase + 2.0 * math.pi * round((of.phase_margin - math.pi - there) / (2.0 * math.pi))
    return Bode(omega, gain, phase)
