"""Discrete filters set by physical parameters; their coefficients are computed when a parameter changes.

k = tan(pi f T) is the frequency f pre-warped for the trapezoidal rule s = (1/k) (z - 1) / (z + 1). Here T is the
block's period, and s is in units of 2 pi f. An f above 0.499 / T, which the sampling cannot carry, is cut to it.
Source: Oppenheim, Schafer, Discrete-Time Signal Processing, section 7.2 (bilinear transformation).
"""

import math
from typing import Any

from twodof.blocks.block import Clock, library_block
from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.elementary.functions import exp, tan
from twodof.blocks.elementwise import OneOutput, one_of
from twodof.blocks.expressions.expr import minimum

__all__ = ["HighPass", "LeadLag", "LowPass", "LowPass2", "Notch"]

LOW_PASS_METHODS = ("forward", "backward", "trapezoidal", "zoh")


def _warped(frequency: Any, dt: Any) -> Any:
    """Return k = tan(pi f T)."""
    return tan(math.pi * minimum(0.499, frequency * dt))


class _Filter(OneOutput):
    """Filter whose states start from `rest`, where the input `initial` leaves it."""

    def _declare(self, params: list[Param], initial: float, unit: str) -> None:
        self.ports("u", unit=unit)
        self.params = [*params, Param("initial", initial, unit=unit, text="the input before the start")]


class _FirstOrder(_Filter):
    """y = b0 u + s, s' = b1 u - a1 y; at the start the filter rests at u = `initial`."""

    direct = True  # b0 is there

    def _declare(self, params: list[Param], initial: float, unit: str) -> None:
        super()._declare(params, initial, unit)
        self.derived = [Port("b0"), Port("b1"), Port("a1"), Port("rest", unit=unit)]
        self.states = [State("s", "rest", unit=unit)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return p.b0 * u.u + x.s if self.direct else x.s

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return p.b1 * u.u - p.a1 * self.output(u, x, p, t)


class _SecondOrder(_Filter):
    """y = b0 u + s1, s1' = b1 u - a1 y + s2, s2' = b2 u - a2 y; at the start the filter rests at u = y = `initial`."""

    derived = tuple(Port(name) for name in ("b0", "b1", "b2", "a1", "a2", "rest1", "rest2"))
    states = (State("s1", "rest1"), State("s2", "rest2"))

    @staticmethod
    def _coefficients(top: tuple[Any, Any, Any], bottom: tuple[Any, Any, Any], initial: Any) -> dict[str, Any]:
        b0, b1, b2 = (v / bottom[0] for v in top)
        a1, a2 = bottom[1] / bottom[0], bottom[2] / bottom[0]
        rest1, rest2 = (1.0 - b0) * initial, (b2 - a2) * initial
        return {"b0": b0, "b1": b1, "b2": b2, "a1": a1, "a2": a2, "rest1": rest1, "rest2": rest2}

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return p.b0 * u.u + x.s1

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        y = self.output(u, x, p, t)
        return {"s1": p.b1 * u.u - p.a1 * y + x.s2, "s2": p.b2 * u.u - p.a2 * y}


@library_block("low_pass")
class LowPass(_FirstOrder):
    """First-order low-pass w / (s + w), w = 2 pi cutoff, by the named rule, T the block's period.

    "forward": y[k] = y[k-1] + w T (u[k-1] - y[k-1]). It is stable for w T < 2.
    "backward": y[k] = (y[k-1] + w T u[k]) / (1 + w T).
    "zoh": With a = exp(-w T), y[k] = a y[k-1] + (1 - a) u[k-1]. It is exact for a held input.
    "trapezoidal": With k = tan(pi cutoff T), y[k] = (k (u[k] + u[k-1]) + (1 - k) y[k-1]) / (1 + k). It is exact at the
    cut-off.

    At the start the filter rests at u = y = initial. forward and zoh have no feed-through.
    """

    def __init__(self, cutoff: float = 10.0, method: str = "trapezoidal", initial: float = 0.0, unit: str = "") -> None:
        self.method = one_of(method, LOW_PASS_METHODS, "method")
        self.direct = method in ("backward", "trapezoidal")
        self._declare([Param("cutoff", cutoff, unit="Hz", low=0.0)], initial, unit)

    def prepare(self, p: Any, t: Clock) -> Any:
        step = 2.0 * math.pi * p.cutoff * t.dt
        if self.method == "forward":
            b0, b1, a1 = 0.0, step, step - 1.0
        elif self.method == "zoh":
            decay = exp(-step)
            b0, b1, a1 = 0.0, 1.0 - decay, -decay
        elif self.method == "backward":
            b0, b1, a1 = step / (1.0 + step), 0.0, -1.0 / (1.0 + step)
        else:
            k = _warped(p.cutoff, t.dt)
            b0 = b1 = k / (1.0 + k)
            a1 = (k - 1.0) / (1.0 + k)
        return {"b0": b0, "b1": b1, "a1": a1, "rest": (1.0 - b0) * p.initial}


@library_block("high_pass")
class HighPass(_FirstOrder):
    """First-order high-pass (washout) s / (s + w), w = 2 pi cutoff, by the trapezoidal rule, exact at the cut-off.

    y[k] = (u[k] - u[k-1] + (1 - k) y[k-1]) / (1 + k), k = tan(pi cutoff T).
    At the start it rests at u = initial, y = 0.
    """

    def __init__(self, cutoff: float = 1.0, initial: float = 0.0, unit: str = "") -> None:
        self._declare([Param("cutoff", cutoff, unit="Hz", low=0.0)], initial, unit)

    def prepare(self, p: Any, t: Clock) -> Any:
        k = _warped(p.cutoff, t.dt)
        b0 = 1.0 / (1.0 + k)
        return {"b0": b0, "b1": -b0, "a1": (k - 1.0) / (1.0 + k), "rest": -b0 * p.initial}


@library_block("lead_lag")
class LeadLag(_FirstOrder):
    """gain (lead s + 1) / (lag s + 1) by the trapezoidal rule s = (2/T) (z - 1) / (z + 1), times in seconds.

    y[k] = b0 u[k] + b1 u[k-1] - a1 y[k-1], b0 = gain (T + 2 lead) / (T + 2 lag), b1 = gain (T - 2 lead) / (T + 2 lag),
    a1 = (T - 2 lag) / (T + 2 lag). At the start it rests at u = initial, y = gain initial.
    """

    def __init__(
        self, gain: float = 1.0, lead: float = 0.1, lag: float = 0.01, initial: float = 0.0, unit: str = ""
    ) -> None:
        params = [Param("gain", gain), Param("lead", lead, unit="s", low=0.0), Param("lag", lag, unit="s", low=0.0)]
        self._declare(params, initial, unit)

    def prepare(self, p: Any, t: Clock) -> Any:
        bottom = t.dt + 2.0 * p.lag
        b0 = p.gain * (t.dt + 2.0 * p.lead) / bottom
        b1 = p.gain * (t.dt - 2.0 * p.lead) / bottom
        return {"b0": b0, "b1": b1, "a1": (t.dt - 2.0 * p.lag) / bottom, "rest": (p.gain - b0) * p.initial}


@library_block("low_pass_2")
class LowPass2(_SecondOrder):
    """Second-order low-pass w^2 / (s^2 + 2 damping w s + w^2), w = 2 pi cutoff, by the trapezoidal rule, exact at w.

    Let k = tan(pi cutoff T) and d = 1 + 2 damping k + k^2. Then b0 = b2 = k^2/d and b1 = 2 k^2/d.
    The others: a1 = 2 (k^2 - 1)/d and a2 = (1 - 2 damping k + k^2)/d. The default `damping`, sqrt(1/2), makes it a
    Butterworth filter. At the start it rests at u = y = initial.
    """

    def __init__(
        self, cutoff: float = 10.0, damping: float = math.sqrt(0.5), initial: float = 0.0, unit: str = ""
    ) -> None:
        params = [Param("cutoff", cutoff, unit="Hz", low=0.0), Param("damping", damping, low=0.0)]
        self._declare(params, initial, unit)

    def prepare(self, p: Any, t: Clock) -> Any:
        k = _warped(p.cutoff, t.dt)
        square, slope = k * k, 2.0 * p.damping * k
        bottom = (1.0 + slope + square, 2.0 * (square - 1.0), 1.0 - slope + square)
        return self._coefficients((square, 2.0 * square, square), bottom, p.initial)


@library_block("notch")
class Notch(_SecondOrder):
    """Notch (s^2 + 2 depth width w s + w^2) / (s^2 + 2 width w s + w^2), w = 2 pi frequency, trapezoidal, exact at w.

    `width` is the denominator's damping: the notch is 2 width w wide (-3 dB); `depth` is the gain at w.
    Let k = tan(pi frequency T) and d = 1 + 2 width k + k^2. Then b0, b2 = (1 +- 2 depth width k + k^2)/d.
    The others: b1 = a1 = 2 (k^2 - 1)/d and a2 = (1 - 2 width k + k^2)/d. At the start it rests at u = y = initial.
    """

    def __init__(
        self, frequency: float = 50.0, width: float = 0.1, depth: float = 0.0, initial: float = 0.0, unit: str = ""
    ) -> None:
        params = [
            Param("frequency", frequency, unit="Hz", low=0.0),
            Param("width", width, low=0.0),
            Param("depth", depth, low=0.0),
        ]
        self._declare(params, initial, unit)

    def prepare(self, p: Any, t: Clock) -> Any:
        k = _warped(p.frequency, t.dt)
        square, slope = k * k, 2.0 * p.width * k
        middle = 2.0 * (square - 1.0)
        top = (1.0 + p.depth * slope + square, middle, 1.0 - p.depth * slope + square)
        return self._coefficients(top, (1.0 + slope + square, middle, 1.0 - slope + square), p.initial)
