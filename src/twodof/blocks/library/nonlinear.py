"""Nonlinear blocks: saturation, dead zone, quantiser, rate limit, relay with hysteresis, backlash."""

from typing import Any

from twodof.blocks.block import Block, Clock, library_block
from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.elementary.functions import floor
from twodof.blocks.elementwise import ORDERED, Pointwise, Recurrent, clamp, elementwise, one_of
from twodof.blocks.expressions.expr import maximum, minimum, where

__all__ = ["Backlash", "DeadZone", "DynamicSaturation", "Quantiser", "RateLimit", "Relay", "Saturation"]


@library_block("saturation")
class Saturation(Pointwise):
    """y = u within [low, high]; NaN stays NaN."""

    def __init__(
        self, low: float = -1.0, high: float = 1.0, kind: str = "real", width: int | None = None, unit: str = ""
    ) -> None:
        self.ports("u", one_of(kind, ORDERED, "kind"), width, unit)
        self.params = [Param("low", low, kind, unit=unit), Param("high", high, kind, unit=unit)]

    def of(self, p: Any, u: Any) -> Any:
        return clamp(p.low, p.high, u)


@library_block("dynamic_saturation")
class DynamicSaturation(Block):
    """y = u within [low, high], which are inputs; NaN stays NaN."""

    def __init__(self, width: int | None = None, unit: str = "") -> None:
        self.inputs = [Port("u", width=width, unit=unit), Port("low", unit=unit), Port("high", unit=unit)]
        self.outputs = [Port("y", width=width, unit=unit)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return elementwise(lambda v: clamp(u.low, u.high, v), u.u)


@library_block("dead_zone")
class DeadZone(Pointwise):
    """y = 0 for low <= u <= high, u - high above, u - low below."""

    def __init__(self, low: float = -0.5, high: float = 0.5, width: int | None = None, unit: str = "") -> None:
        self.ports("u", "real", width, unit)
        self.params = [Param("low", low, unit=unit), Param("high", high, unit=unit)]

    def of(self, p: Any, u: Any) -> Any:
        return where(p.high < u, u - p.high, where(u < p.low, u - p.low, where(u == u, 0.0, u)))


@library_block("quantiser")
class Quantiser(Pointwise):
    """y = step floor(u / step + 1/2): the nearest multiple of step, halves upwards; y = u for step 0."""

    def __init__(self, step: float = 0.1, width: int | None = None, unit: str = "") -> None:
        self.ports("u", "real", width, unit)
        self.params = [Param("step", step, unit=unit, low=0.0)]

    def of(self, p: Any, u: Any) -> Any:
        return where(p.step == 0.0, u, p.step * floor(u / p.step + 0.5))


@library_block("rate_limit")
class RateLimit(Recurrent):
    """y[k] = u[k], put within y[k-1] - falling T .. y[k-1] + rising T; y[-1] = initial.

    `rising` and `falling` are per second and >= 0, T is the block's period.
    """

    def __init__(
        self, rising: float = 1.0, falling: float = 1.0, initial: Any = 0.0, width: int | None = None, unit: str = ""
    ) -> None:
        self.ports("u", "real", width, unit)
        self.params = [
            Param("rising", rising, low=0.0),
            Param("falling", falling, low=0.0),
            Param("initial", initial, width=width, unit=unit),
        ]
        self.derived = [Port("up"), Port("down")]
        self.states = [State("x", "initial", width=width, unit=unit)]

    def prepare(self, p: Any, t: Clock) -> Any:
        return {"up": p.rising * t.dt, "down": p.falling * t.dt}

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return elementwise(lambda v, before: clamp(before - p.down, before + p.up, v), u.u, x.x)


@library_block("relay")
class Relay(Block):
    """Switch with hysteresis: on at u >= on_at, off at u <= off_at, else as before; y = on_value or off_value.

    `initial` is whether it was on before the start.
    """

    def __init__(
        self,
        on_at: float = 0.5,
        off_at: float = -0.5,
        on_value: float = 1.0,
        off_value: float = 0.0,
        initial: bool = False,
        input_unit: str = "",
        unit: str = "",
    ) -> None:
        self.inputs = [Port("u", unit=input_unit)]
        self.outputs = [Port("y", unit=unit), Port("on", "bool")]
        self.params = [
            Param("on_at", on_at, unit=input_unit),
            Param("off_at", off_at, unit=input_unit),
            Param("on_value", on_value, unit=unit),
            Param("off_value", off_value, unit=unit),
            Param("initial", initial, "bool"),
        ]
        self.states = [State("x", "initial", "bool")]

    def _on(self, u: Any, x: Any, p: Any) -> Any:
        return (p.on_at <= u.u) | (x.x & ~(u.u <= p.off_at))

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        on = self._on(u, x, p)
        return {"y": where(on, p.on_value, p.off_value), "on": on}

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return self._on(u, x, p)


@library_block("backlash")
class Backlash(Recurrent):
    """Play of `width`: y moves only when pushed; y[k] is y[k-1], put within u - width/2 .. u + width/2."""

    def __init__(self, width: float = 1.0, initial: float = 0.0, unit: str = "") -> None:
        self.ports("u", unit=unit)
        self.params = [Param("width", width, unit=unit, low=0.0), Param("initial", initial, unit=unit)]
        self.states = [State("x", "initial", unit=unit)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        half = 0.5 * p.width
        return minimum(maximum(x.x, u.u - half), u.u + half)
