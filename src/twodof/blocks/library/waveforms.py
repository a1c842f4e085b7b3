"""Periodic and swept sources: sine, multisine, sweep, PRBS."""

import math
from collections.abc import Sequence
from typing import Any

from twodof.blocks.block import Block, Clock, library_block
from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.elementary.functions import exp, log, sin
from twodof.blocks.elementwise import count, counts, one_of, reals
from twodof.blocks.expressions.arrays import fold
from twodof.blocks.expressions.expr import maximum, multiply_high, to_real, to_uint32, uint32, where
from twodof.blocks.library.sources import LAWS, MAX_HARMONIC, MAX_LINES, TAPS, shifted, start_param, ticks
from twodof.errors import DiagramError

__all__ = ["MultisineSource", "PrbsSource", "Sine", "SweepSource"]


def _fraction(value: Any) -> Any:
    """`value` less its whole part, for 0 <= value < 2^32."""
    return value - to_real(to_uint32(value))


def _phase_step(frequency: Any, t: Clock) -> tuple[Any, Any]:
    """Return the turns of a frequency in a tick, less whole ones, as a 64-bit fraction (upper, lower word)."""
    scaled = _fraction(frequency * t.base_dt) * 2.0**32
    upper = to_uint32(scaled)
    return upper, to_uint32((scaled - to_real(upper)) * 2.0**32)


def _times(number: Any, upper: Any, lower: Any) -> tuple[Any, Any]:
    """Multiply a 64-bit fraction of a turn by a whole number; whole turns wrap around, so it is exact."""
    return number * upper + multiply_high(number, lower), number * lower


def _angle(upper: Any, lower: Any) -> Any:
    """Return a 64-bit fraction of a turn in rad, 0 .. 2 pi."""
    return (2.0 * math.pi) * (to_real(upper) * 2.0**-32 + to_real(lower) * 2.0**-64)


@library_block("sine")
class Sine(Block):
    """y = bias + amplitude sin(2 pi frequency (t - start) + phase) from `start` on, bias before.

    The phase is counted in whole ticks with 64 bits of a turn, so that it does not drift, in float32 or after days.
    """

    def __init__(
        self,
        frequency: float = 1.0,
        amplitude: float = 1.0,
        phase: float = 0.0,
        bias: float = 0.0,
        start: float = 0.0,
        unit: str = "",
    ) -> None:
        self.outputs = [Port("y", unit=unit)]
        self.params = [
            Param("frequency", frequency, unit="Hz", low=0.0),
            Param("amplitude", amplitude, unit=unit),
            Param("phase", phase, unit="rad"),
            Param("bias", bias, unit=unit),
            start_param(start),
        ]
        self.derived = [Port("first", "uint32"), Port("upper", "uint32"), Port("lower", "uint32")]

    def prepare(self, p: Any, t: Clock) -> Any:
        upper, lower = _phase_step(p.frequency, t)
        return {"first": ticks(p.start, t), "upper": upper, "lower": lower}

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        angle = _angle(*_times(t.tick - p.first, p.upper, p.lower))
        wave = p.amplitude * sin(angle + p.phase)
        return where(p.first <= t.tick, p.bias + wave, p.bias)


@library_block("multisine")
class MultisineSource(Block):
    """y = bias + sum over k of amplitudes[k] cos(2 pi h_k (t - start) / period + phases[k]) from `start` on.

    Before it, bias. `harmonics` h_k are whole numbers >= 1; `period` [s] is the nearest whole number of ticks, so that
    the signal repeats exactly.
    Source: Pintelon, Schoukens, System Identification: A Frequency Domain Approach, chapter 5.
    """

    def __init__(
        self,
        harmonics: Sequence[int] = (1,),
        amplitudes: Sequence[float] = (1.0,),
        phases: Sequence[float] = (0.0,),
        period: float = 1.0,
        bias: float = 0.0,
        start: float = 0.0,
        unit: str = "",
    ) -> None:
        lines = counts(harmonics, 1, MAX_HARMONIC, "harmonics")
        self.lines = count(len(lines), 1, MAX_LINES, "number of harmonics")
        sizes, turns = reals(amplitudes, "amplitudes"), reals(phases, "phases")
        if len(sizes) != self.lines or len(turns) != self.lines:
            what = f"{len(sizes)} amplitudes and {len(turns)} phases for {self.lines} harmonics"
            raise DiagramError(what, "", "give as many of each")
        self.outputs = [Port("y", unit=unit)]
        self.params = [
            Param("harmonics", lines, "uint32", self.lines, low=1, high=MAX_HARMONIC),
            Param("amplitudes", sizes, width=self.lines, unit=unit),
            Param("phases", turns, width=self.lines, unit="rad"),
            Param("period", period, unit="s", low=0.0),
            Param("bias", bias, unit=unit),
            start_param(start),
        ]
        self.derived = [Port(name, "uint32") for name in ("first", "length", "upper", "lower")]

    def prepare(self, p: Any, t: Clock) -> Any:
        length = ticks(p.period, t)
        length = where(length == 0, 1, length)
        # 2^64 / length in two words; 2^32 itself does not fit into one.
        most = uint32(2**32 - 1)
        upper, rest = most // length, most % length + 1
        whole = rest == length
        lower = to_uint32(to_real(rest) / to_real(length) * 2.0**32)
        return {
            "first": ticks(p.start, t),
            "length": length,
            "upper": where(whole, upper + 1, upper),
            "lower": where(whole, 0, lower),
        }

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        upper, lower = _times((t.tick - p.first) % p.length, p.upper, p.lower)

        def add(k: Any, total: Any) -> list[Any]:
            # A quarter of a turn ahead, a sine is a cosine.
            angle = _angle(*_times(p.harmonics[k], upper, lower)) + (p.phases[k] + 0.5 * math.pi)
            return [total + p.amplitudes[k] * sin(angle)]

        return where(p.first <= t.tick, p.bias + fold(self.lines, [0.0], add)[0], p.bias)


@library_block("sweep")
class SweepSource(Block):
    """A sine whose frequency goes from start_hz to end_hz in `length` [s] from `start` on; bias before and after.

    y = bias + amplitude sin(2 pi n + phase), with s = t - start and L = length.
    "linear": The frequency is f = f0 + (f1 - f0) s/L, and n = s (f0 + (f1 - f0) s / (2 L)).
    "logarithmic": The frequency is f = f0 (f1/f0)^(s/L), and n = f0 L/r (exp(r s/L) - 1) with r = log(f1/f0).
    Where |r| < 1e-6, n = f0 s.
    """

    def __init__(
        self,
        start_hz: float = 0.1,
        end_hz: float = 10.0,
        length: float = 10.0,
        amplitude: float = 1.0,
        law: str = "linear",
        phase: float = 0.0,
        bias: float = 0.0,
        start: float = 0.0,
        unit: str = "",
    ) -> None:
        self.law = one_of(law, LAWS, "law")
        least = 1e-9 if law == "logarithmic" else 0.0
        self.outputs = [Port("y", unit=unit)]
        self.params = [
            Param("start_hz", start_hz, unit="Hz", low=least),
            Param("end_hz", end_hz, unit="Hz", low=least),
            Param("length", length, unit="s", low=0.0),
            Param("amplitude", amplitude, unit=unit),
            Param("phase", phase, unit="rad"),
            Param("bias", bias, unit=unit),
            start_param(start),
        ]
        self.derived = [Port("first", "uint32"), Port("last", "uint32"), Port("rate"), Port("turns")]

    def prepare(self, p: Any, t: Clock) -> Any:
        if self.law == "linear":
            rate, turns = 0.5 * (p.end_hz - p.start_hz) / p.length, 0.0
        else:
            octaves = log(p.end_hz / p.start_hz)
            rate = octaves / p.length
            turns = where(abs(octaves) < 1e-6, 0.0, p.start_hz / rate)
        return {"first": ticks(p.start, t), "last": ticks(p.length, t), "rate": rate, "turns": turns}

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        since = t.tick - p.first
        s = to_real(since) * t.base_dt
        if self.law == "linear":
            n = s * (p.start_hz + p.rate * s)
        else:
            n = where(p.turns == 0.0, p.start_hz * s, p.turns * (exp(p.rate * s) - 1.0))
        wave = p.amplitude * sin((2.0 * math.pi) * _fraction(n) + p.phase)
        return where((p.first <= t.tick) & (since < p.last), p.bias + wave, p.bias)


@library_block("prbs")
class PrbsSource(Block):
    """Pseudo-random binary sequence: bias +- amplitude, a new bit every `clock` [s] from `start` on; bias before.

    A linear feedback shift register of `order` bits (3 .. 16) shifts towards its lowest bit, which is the output. It
    runs through all 2^order - 1 states. It starts from the lower `order` bits of `seed`, or from 1 if they are 0.
    `clock` is rounded to a whole number (at least one) of block periods. Source: Golomb, Shift Register Sequences.
    """

    def __init__(
        self,
        clock: float = 0.1,
        amplitude: float = 1.0,
        order: int = 7,
        seed: int = 1,
        bias: float = 0.0,
        start: float = 0.0,
        unit: str = "",
    ) -> None:
        self.order = count(order, min(TAPS), max(TAPS), "order")
        self.outputs = [Port("y", unit=unit)]
        self.params = [
            Param("clock", clock, unit="s", low=0.0),
            Param("amplitude", amplitude, unit=unit),
            Param("seed", count(seed, 0, 2**32 - 1, "seed"), "uint32"),
            Param("bias", bias, unit=unit),
            start_param(start),
        ]
        self.derived = [Port("first", "uint32"), Port("hold", "uint32"), Port("begin", "uint32")]
        self.states = [State("register", "begin", "uint32"), State("held", 0, "uint32")]

    def prepare(self, p: Any, t: Clock) -> Any:
        lower = p.seed & (2**self.order - 1)
        return {
            "first": ticks(p.start, t),
            "hold": to_uint32(maximum(1.0, p.clock / t.dt + 0.5)),
            "begin": where(lower == 0, 1, lower),
        }

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        wave = where(x.register & 1 == 1, p.bias + p.amplitude, p.bias - p.amplitude)
        return where(p.first <= t.tick, wave, p.bias)

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        running = p.first <= t.tick
        full = p.hold <= x.held + 1
        return {
            "register": where(running & full, shifted(x.register, self.order), x.register),
            "held": where(running, where(full, 0, x.held + 1), x.held),
        }
