"""Test signals: impulse, doublet, 3-2-1-1, steps, sweep, PRBS, multisine; one definition, on board and on the ground.

An excitation is *added* to the value held before it (the trim moment, a level set-point). Time is counted in whole
microseconds from its start, so that 75 control periods of 4 ms and an edge at 0.3 s are the same instant on board and
on the ground. At an edge the new value holds. Before its start and after its end the excitation is 0. Sources:
Jategaonkar, "Flight Vehicle System Identification", ch. 2; Pintelon and Schoukens, "System Identification: A Frequency
Domain Approach", ch. 5.
"""

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from functools import lru_cache
from math import inf, isfinite, log, pi, radians
from numbers import Integral, Real
from types import MappingProxyType
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.blocks.enumeration import plain_data
from twodof.blocks.library.sources import LAWS, MAX_HARMONIC, MAX_LINES, PATTERNS, TAPS, shifted
from twodof.errors import DiagramError, ExperimentError

LIMITS: Mapping[str, float] = MappingProxyType({"-": 1.0, "rad": radians(50.0), "rad/s": 10.0, "m": 0.4, "m/s": 2.0})
"""Largest amplitude by unit: M's range, the stops of pitch and rail, and beyond the rig's reach for rate and speed."""

MAX_DURATION_S = 3600.0
SHORTEST_HOLD_S = 1e-3
# Half the rate of control (250 Hz): nothing above it can be played.
HIGHEST_HZ = 125.0
MAX_PARTS = 10_000
_VERSION = 1
_REST = (0.0, MAX_DURATION_S)
_HOLD = (SHORTEST_HOLD_S, MAX_DURATION_S)
_TWO_HOLDS = (2 * SHORTEST_HOLD_S, MAX_DURATION_S)
_ANY = (-inf, inf)


@dataclass(frozen=True)
class Excitation(ABC):
    """A test signal in `unit` ("-" for M, "rad", "rad/s", "m" or "m/s").

    The pattern of a subclass is played `repeat` times with a `pause` [s] between, after a rest of `lead` [s] and before
    one of `settle` [s]. Raises ExperimentError for a value out of its bounds.
    """

    kind: ClassVar[str]
    bounds: ClassVar[Mapping[str, tuple[float, float]]]
    """Bounds (low, high) of the subclass's own numbers, by field."""

    unit: str = field(default="-", kw_only=True)
    lead: float = field(default=0.0, kw_only=True)
    settle: float = field(default=0.0, kw_only=True)
    pause: float = field(default=0.0, kw_only=True)
    repeat: int = field(default=1, kw_only=True)

    def __post_init__(self) -> None:
        for one in fields(self):
            try:
                object.__setattr__(self, one.name, plain_data(getattr(self, one.name), one.name))
            except DiagramError as error:
                raise self._mistake(one.name, error.what, error.remedy) from error
        if not isinstance(self.unit, str) or self.unit not in LIMITS:
            raise self._mistake("unit", f"unknown unit {self.unit!r}", f"use one of {', '.join(LIMITS)}")
        bounds = {"lead": _REST, "settle": _REST, "pause": _REST, **self.bounds}
        for name, (low, high) in bounds.items():
            value = self._real(name, getattr(self, name))
            if not low <= value <= high:
                raise self._mistake(name, f"{value:g} is outside {low:g} to {high:g}")
            object.__setattr__(self, name, value)
        self._whole("repeat", 1, MAX_PARTS)
        self._check()
        limit = LIMITS[self.unit]
        if not 0.0 < self.peak <= limit * (1.0 + 1e-12):
            degrees = self.unit in ("rad", "rad/s")
            hint = f"; if {self.peak:g} is in degrees, give {radians(self.peak):.4g}" if degrees else ""
            remedy = f"choose a smaller one{hint}" if self.peak else "choose one that is not zero"
            raise self._mistake("amplitude", f"peak {self.peak:g} {self.unit} is not within 0 to {limit:.4g}", remedy)
        if self.duration > MAX_DURATION_S:
            raise self._mistake("duration", f"it lasts {self.duration:g} s", f"use at most {MAX_DURATION_S:g} s")

    @property
    @abstractmethod
    def pattern(self) -> float:
        """Length of one pattern [s]."""

    @property
    @abstractmethod
    def peak(self) -> float:
        """Largest absolute value."""

    def _check(self) -> None:  # noqa: B027
        """Check the values of a subclass that `bounds` does not cover, and convert them to their final types."""

    @abstractmethod
    def _wave(self, us: NDArray[np.int64]) -> NDArray[np.float64]:
        """Values at times within one pattern, 0 <= us < pattern [us]."""

    @property
    def duration(self) -> float:
        """Duration [s], with the rests before the first pattern and after the last one."""
        us = _us(self.lead) + self.repeat * _us(self.pattern) + (self.repeat - 1) * _us(self.pause)
        return (us + _us(self.settle)) / 1e6

    def at(self, t: ArrayLike) -> NDArray[np.float64]:
        """Return the values at the times `t` [s since the start], in the shape of `t`.

        Raises ExperimentError for a time that is NaN or beyond 1e9 s.
        """
        time = np.asarray(t, dtype=np.float64)
        if not np.all(np.abs(time) < 1e9):
            raise self._mistake("t", "a time is NaN or beyond 1e9 s", "give seconds since the start")
        since = np.rint(time * 1e6).astype(np.int64) - _us(self.lead)
        length = _us(self.pattern)
        turn, phase = np.divmod(since, length + _us(self.pause))
        playing = (turn >= 0) & (turn < self.repeat) & (phase < length)
        return np.where(playing, self._wave(np.where(playing, phase, 0)), 0.0)

    def samples(self, period: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return times [s] and values (n,) on a grid of `period` [s], from the start to the end inclusive."""
        if not SHORTEST_HOLD_S <= period <= MAX_DURATION_S:
            raise self._mistake(
                "period", f"{period:g} s is out of bounds", f"give {SHORTEST_HOLD_S:g} to {MAX_DURATION_S:g} s"
            )
        time = period * np.arange(int(np.floor(self.duration / period + 1e-9)) + 1, dtype=np.float64)
        return time, self.at(time)

    def to_dict(self) -> dict[str, Any]:
        """Return kind, layout version and every field as JSON values, for `from_dict`."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        plain = {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}
        return {"kind": self.kind, "version": _VERSION, **plain}

    def to_json(self) -> str:
        """Return the excitation as JSON text, for `from_json`."""
        return json.dumps(self.to_dict())

    def _mistake(self, name: str, what: str, remedy: str = "") -> ExperimentError:
        return ExperimentError(what, f"{self.kind}.{name}", remedy)

    def _whole(self, name: str, low: int, high: int) -> None:
        value = getattr(self, name)
        if isinstance(value, bool) or not isinstance(value, Integral):
            raise self._mistake(name, f"{value!r} is not a whole number")
        whole = int(value)
        if not low <= whole <= high:
            raise self._mistake(name, f"{whole} is outside {low} to {high}")
        object.__setattr__(self, name, whole)

    def _numbers(self, name: str) -> tuple[float, ...]:
        values = getattr(self, name)
        if isinstance(values, str) or not isinstance(values, Iterable):
            raise self._mistake(name, f"{values!r} is not a list of numbers")
        numbers = tuple(self._real(name, value) for value in values)
        if not 1 <= len(numbers) <= MAX_PARTS:
            raise self._mistake(name, f"it has {len(numbers)} numbers", f"give 1 to {MAX_PARTS}")
        object.__setattr__(self, name, numbers)
        return numbers

    def _real(self, name: str, value: Any) -> float:
        with suppress(OverflowError):  # an integer may be too large
            if isinstance(value, Real) and not isinstance(value, bool) and isfinite(number := float(value)):
                return number
        raise self._mistake(name, f"{value!r:.80} is not a finite number")


class _Held(Excitation):
    """A pattern of levels, each held for a while."""

    @abstractmethod
    def _levels(self) -> tuple[list[int], list[float]]:
        """How long each level is held [us], and the levels."""

    @property
    def pattern(self) -> float:
        return sum(self._levels()[0]) / 1e6

    @property
    def peak(self) -> float:
        return max(abs(level) for level in self._levels()[1])

    def _wave(self, us: NDArray[np.int64]) -> NDArray[np.float64]:
        holds, levels = self._levels()
        return np.asarray(levels)[np.searchsorted(np.cumsum(holds)[:-1], us, side="right")]


@dataclass(frozen=True)
class Impulse(_Held):
    """`amplitude` for `width` [s], then 0; give a `settle` to record the free response."""

    kind = "impulse"
    bounds = MappingProxyType({"amplitude": _ANY, "width": _HOLD})
    amplitude: float
    width: float

    def _levels(self) -> tuple[list[int], list[float]]:
        return [_us(self.width)], [self.amplitude]


@dataclass(frozen=True)
class Doublet(_Held):
    """`amplitude` for half a `period` [s], then its opposite for the other half."""

    kind = "doublet"
    bounds = MappingProxyType({"amplitude": _ANY, "period": _TWO_HOLDS})
    amplitude: float
    period: float

    def _levels(self) -> tuple[list[int], list[float]]:
        return _pattern(self.kind, _us(self.period / 2.0), self.amplitude)


@dataclass(frozen=True)
class ThreeTwoOneOne(_Held):
    """+, -, +, - `amplitude` for 3, 2, 1 and 1 times `step` [s]: a broader band than a doublet's."""

    kind = "3-2-1-1"
    bounds = MappingProxyType({"amplitude": _ANY, "step": _HOLD})
    amplitude: float
    step: float

    def _levels(self) -> tuple[list[int], list[float]]:
        return _pattern(self.kind, _us(self.step), self.amplitude)


@dataclass(frozen=True)
class Steps(_Held):
    """The `levels` one after the other, each for `hold` [s]."""

    kind = "steps"
    bounds = MappingProxyType({"hold": _HOLD})
    levels: tuple[float, ...]
    hold: float

    def _check(self) -> None:
        self._numbers("levels")

    def _levels(self) -> tuple[list[int], list[float]]:
        return [_us(self.hold)] * len(self.levels), list(self.levels)


@dataclass(frozen=True)
class Prbs(_Held):
    """Pseudo-random binary sequence: +-`amplitude`, one of 2^order - 1 bits every `clock` [s].

    A maximal-length sequence: its autocorrelation over a period is 1 at shift 0 and -1/(2^order - 1) at every other
    shift. `seed`, 1 to 2^order - 1, is the first state of the shift register: it shifts the sequence in time.
    """

    kind = "prbs"
    bounds = MappingProxyType({"amplitude": _ANY, "clock": _HOLD})
    amplitude: float
    clock: float
    order: int = 7
    seed: int = 1

    def _check(self) -> None:
        self._whole("order", min(TAPS), max(TAPS))
        self._whole("seed", 1, (1 << self.order) - 1)

    def _levels(self) -> tuple[list[int], list[float]]:
        bits = _maximal_length(self.order, self.seed)
        return [_us(self.clock)] * len(bits), [self.amplitude if bit else -self.amplitude for bit in bits]

    @property
    def pattern(self) -> float:
        return ((1 << self.order) - 1) * _us(self.clock) / 1e6


@dataclass(frozen=True)
class Sweep(Excitation):
    """A sine of `amplitude` whose frequency goes from `start_hz` to `end_hz` in `length` [s].

    With `law` "linear" f = f0 + (f1 - f0) t/L; with "logarithmic" f = f0 (f1/f0)^(t/L), the same time in each octave.
    """

    kind = "sweep"
    bounds = MappingProxyType(
        {"amplitude": _ANY, "start_hz": (0.0, HIGHEST_HZ), "end_hz": (0.0, HIGHEST_HZ), "length": _HOLD}
    )
    amplitude: float
    start_hz: float
    end_hz: float
    length: float
    law: Literal["linear", "logarithmic"] = "linear"

    def _check(self) -> None:
        if self.law not in LAWS:
            raise self._mistake("law", f"unknown law {self.law!r}", f"use {' or '.join(map(repr, LAWS))}")
        if self.law == "logarithmic" and not min(self.start_hz, self.end_hz) > 0.0:
            raise self._mistake("law", "a logarithmic sweep cannot start or end at 0 Hz", "use 'linear'")
        if max(self.start_hz, self.end_hz) == 0.0:
            raise self._mistake("end_hz", "a sweep from 0 to 0 Hz gives no signal", "give a frequency")

    @property
    def pattern(self) -> float:
        return self.length

    @property
    def peak(self) -> float:
        return abs(self.amplitude)

    def _wave(self, us: NDArray[np.int64]) -> NDArray[np.float64]:
        t = us / 1e6
        octaves = log(self.end_hz / self.start_hz) if self.law == "logarithmic" else 0.0
        if octaves:  # expm1, since exp(..) - 1 loses every digit where the frequencies nearly agree
            turns = self.start_hz * self.length / octaves * np.expm1(octaves * t / self.length)
        else:
            turns = t * (self.start_hz + 0.5 * (self.end_hz - self.start_hz) * t / self.length)
        wave: NDArray[np.float64] = self.amplitude * np.sin(2.0 * pi * turns)
        return wave


@dataclass(frozen=True)
class Multisine(Excitation):
    """Sum of a_k cos(2 pi h_k t / period + phi_k) over the `harmonics` h_k of 1/`period` [s].

    Repeated without a pause it is periodic, so that a frequency response from it has no leakage. `schroeder` chooses
    phases with a low peak for the power.
    """

    kind = "multisine"
    bounds = MappingProxyType({"period": _HOLD})
    period: float
    harmonics: tuple[int, ...]
    amplitudes: tuple[float, ...]
    phases: tuple[float, ...]

    @classmethod
    def schroeder(
        cls, peak: float, period: float, harmonics: Iterable[int], powers: Iterable[float] | None = None, **options: Any
    ) -> Self:
        """Return the multisine with Schroeder's phases, scaled to a largest absolute value of `peak`.

        `powers` are the relative powers of the harmonics, by default equal; `options` are unit, lead, settle and
        repeat. Source: M. R. Schroeder, IEEE Trans. Information Theory 16 (1970), 85-89.
        """
        lines = tuple(harmonics)[: MAX_PARTS + 1]
        if (
            not all(isinstance(line, Integral) and 1 <= line <= MAX_HARMONIC for line in lines)
            or len(lines) > MAX_LINES
        ):
            what = "a harmonic is not a whole number in bounds, or there are too many"
            remedy = f"give at most {MAX_LINES} whole numbers from 1 to {MAX_HARMONIC}"
            raise ExperimentError(what, f"{cls.kind}.harmonics", remedy)
        power = np.ones(len(lines)) if powers is None else np.asarray(tuple(powers), dtype=np.float64)
        if not lines or power.shape != (len(lines),) or not (np.all(power >= 0.0) and 0.0 < power.sum() < np.inf):
            what = "the powers of the harmonics are not all 0 or more, or are all 0"
            raise ExperimentError(what, f"{cls.kind}.powers", "give one power for each harmonic")
        share = power / power.sum()
        # phi_n = -2 pi sum_{l<n} (n - l) p_l: the group delay moves through the period as the power does.
        phases = -2.0 * pi * np.concatenate(([0.0], np.cumsum(np.cumsum(share))[:-1]))
        amplitudes = np.sqrt(2.0 * share)
        # At peak 1 in "-" whatever the unit, only to learn the pattern's own peak.
        crest = _peak(lines, amplitudes.tolist(), phases.tolist())
        scaled = tuple(float(a) * peak / crest for a in amplitudes)
        return cls(period, lines, scaled, tuple(float(phi) for phi in np.mod(phases, 2.0 * pi)), **options)

    def _check(self) -> None:
        lines = self._numbers("harmonics")
        if any(line != int(line) or line < 1 for line in lines) or len(set(lines)) != len(lines):
            raise self._mistake("harmonics", "they must be different whole numbers from 1 on")
        if len(lines) > MAX_LINES or max(lines) > MAX_HARMONIC:
            remedy = f"give at most {MAX_LINES}, up to the {MAX_HARMONIC}th"
            raise self._mistake("harmonics", f"there are {len(lines)}, up to the {max(lines):g}th", remedy)
        if max(lines) / self.period > HIGHEST_HZ:
            raise self._mistake(
                "harmonics", f"{max(lines) / self.period:g} Hz cannot be played", f"stay under {HIGHEST_HZ:g} Hz"
            )
        object.__setattr__(self, "harmonics", tuple(int(line) for line in lines))
        for name in ("amplitudes", "phases"):
            if len(self._numbers(name)) != len(lines):
                remedy = "give one for each harmonic"
                raise self._mistake(name, f"there are {len(getattr(self, name))} for {len(lines)} harmonics", remedy)

    @property
    def pattern(self) -> float:
        return self.period

    @property
    def peak(self) -> float:
        """Largest absolute value on a grid with 64 points per shortest wave; too low by at most 0.13 %."""
        return _peak(self.harmonics, self.amplitudes, self.phases)

    def _wave(self, us: NDArray[np.int64]) -> NDArray[np.float64]:
        return _sum_of_cosines(self.harmonics, self.amplitudes, self.phases, us / _us(self.period))


KINDS: Mapping[str, type[Excitation]] = MappingProxyType(
    {kind.kind: kind for kind in (Impulse, Doublet, ThreeTwoOneOne, Steps, Sweep, Prbs, Multisine)}
)


def from_dict(values: Mapping[str, Any]) -> Excitation:
    """Return the excitation from the values of `to_dict`. Raises ExperimentError for other values.

    A multisine may have the `peak` and `powers` of `schroeder` instead of amplitudes and phases.
    """
    kind = values.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        raise ExperimentError(f"unknown kind {kind!r}", "excitation", f"there are: {', '.join(KINDS)}")
    if values.get("version") != _VERSION:
        what = f"it has version {values.get('version')!r}, and this twodof reads version {_VERSION}"
        raise ExperimentError(what, kind, "use another version of twodof")
    given = {name: value for name, value in values.items() if name not in ("kind", "version")}
    make: Callable[..., Excitation] = KINDS[kind]
    known = [one.name for one in fields(KINDS[kind])]
    if kind == Multisine.kind and "peak" in given:
        make = Multisine.schroeder
        known = ["peak", "powers", *(name for name in known if name not in ("amplitudes", "phases"))]
    if strange := [name for name in given if name not in known]:
        raise ExperimentError(f"unknown value {strange[0]!r}", kind, f"there are: {', '.join(known)}")
    try:
        return make(**given)
    except TypeError as reason:
        raise ExperimentError(f"a value is missing: {reason}", kind, f"there are: {', '.join(known)}") from reason


def from_json(text: str) -> Excitation:
    """Return the excitation from the text of `to_json`. Raises ExperimentError for another text."""
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as reason:
        raise ExperimentError(f"the text is not JSON: {reason}", "excitation", "write it with to_json") from reason
    if not isinstance(values, dict):
        raise ExperimentError("the text is not a JSON object", "excitation", "write it with to_json")
    return from_dict(values)


def _pattern(kind: str, unit_us: int, amplitude: float) -> tuple[list[int], list[float]]:
    """How long each level of a row of `PATTERNS` is held [us], and the levels."""
    times = PATTERNS[kind]
    return [abs(n) * unit_us for n in times], [amplitude if n > 0 else -amplitude for n in times]


def _us(seconds: float) -> int:
    return round(seconds * 1e6)


_FEW = 1_000_000
"""Most values that are added one by one; more would take seconds, and are found by a Fourier transform."""


def _peak(harmonics: Sequence[int], amplitudes: Sequence[float], phases: Sequence[float]) -> float:
    """Largest absolute value on a grid with 64 points per shortest wave."""
    points = 64 * int(max(harmonics))
    if points * len(harmonics) <= _FEW:
        values = _sum_of_cosines(harmonics, amplitudes, phases, np.arange(points) / points)
    else:
        spectrum = np.zeros(points // 2 + 1, dtype=np.complex128)
        spectrum[list(harmonics)] = 0.5 * points * np.asarray(amplitudes) * np.exp(1j * np.asarray(phases))
        values = np.fft.irfft(spectrum, points)
    return float(np.max(np.abs(values)))


def _sum_of_cosines(
    harmonics: Iterable[int], amplitudes: Iterable[float], phases: Iterable[float], share: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Values at the shares 0 to 1 of the period; one line after the other, so that memory stays small."""
    total = np.zeros(np.shape(share))
    for harmonic, amplitude, phase in zip(harmonics, amplitudes, phases, strict=True):
        total += amplitude * np.cos(2.0 * pi * harmonic * share + phase)
    return total


@lru_cache(maxsize=32)
def _maximal_length(order: int, seed: int) -> tuple[bool, ...]:
    """One period of a linear feedback shift register's output."""
    register, bits = seed, []
    for _ in range((1 << order) - 1):
        bits.append(bool(register & 1))
        register = shifted(register, order)
    return tuple(bits)
