"""The PID controller."""

from collections.abc import Sequence
from typing import Any

from twodof.blocks.block import Block, Clock, library_block
from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.elementwise import clamp, limit_params, one_of
from twodof.blocks.expressions.expr import where
from twodof.blocks.library.discrete import METHODS
from twodof.errors import DiagramError

__all__ = ["Pid"]

ANTI_WINDUP = ("none", "clamping", "back-calculation")
RESETS = ("none", "integral", "all")


@library_block("pid")
class Pid(Block):
    """M = P + I + D of the error e, each part discretised by a named rule; T is the block's period.

    P = Kp e.
    I: has the state i. Forward: I = i, i' = i + Ki T e. Backward: I = i + Ki T e, i' = I.
    Trapezoidal: I = i + Ki T/2 e, i' = I + Ki T/2 e.
    D: is Kd N s / (s + N), N [rad/s], whose state f follows Kd e. D = N (Kd e - f) / d and f' = f + T D.
    Here d is 1 (forward), 1 + N T (backward) or 1 + N T/2 (trapezoidal).

    Both backward gives M = (Kp + Ki T z/(z-1) + Kd (z-1) / ((1/N + T) z - 1/N)) e, the 2DoF Drone's rate controller.

    `limits` [low, high] bound M, and v = P + I + D is M before the bounds. The anti-windup "none" changes nothing.
    With "clamping", i' = i where v is beyond a bound and Ki e points further beyond it.
    With "back-calculation", i' = (i' above) + Kb T (M - v).

    `reset` "integral" or "all" adds a bool input `clear`: while it is true, i (with "all" f too) reads as its initial
    value.
    Source: Astrom, Hagglund, Advanced PID Control, chapters 3 and 13.
    """

    def __init__(
        self,
        Kp: float = 1.0,
        Ki: float = 0.0,
        Kd: float = 0.0,
        N: float = 100.0,
        integral: str = "backward",
        derivative: str = "backward",
        limits: Sequence[float] | None = None,
        anti_windup: str = "none",
        Kb: float = 1.0,
        reset: str = "none",
        unit: str = "",
        output_unit: str = "",
    ) -> None:
        self.integral_rule = one_of(integral, METHODS, "integral")
        self.derivative_rule = one_of(derivative, METHODS, "derivative")
        self.anti_windup = one_of(anti_windup, ANTI_WINDUP, "anti_windup")
        self.resets = one_of(reset, RESETS, "reset")
        bounds = limit_params(limits, output_unit)
        self.limited = bool(bounds)
        if anti_windup != "none" and not self.limited:
            raise DiagramError("anti-windup without limits", "Pid", "give limits=[low, high]")
        self.inputs = [Port("e", unit=unit), *([Port("clear", "bool")] if reset != "none" else [])]
        self.outputs = [Port("M", unit=output_unit)]
        self.params = [
            Param("Kp", Kp),
            Param("Ki", Ki),
            Param("Kd", Kd),
            Param("N", N, unit="rad/s", low=0.0),
            Param("initial_integral", 0.0, unit=output_unit),
            Param("initial_filter", 0.0, text="initial f"),
            *bounds,
        ]
        if anti_windup == "back-calculation":
            self.params += [Param("Kb", Kb, unit="1/s", low=0.0, text="1/Kb is the tracking time")]
        self.derived = [Port("integral_gain"), Port("derivative_gain")]
        self.states = [State("i", "initial_integral", unit=output_unit), State("f", "initial_filter")]

    def prepare(self, p: Any, t: Clock) -> Any:
        share = {"forward": 0.0, "backward": 1.0, "trapezoidal": 0.5}[self.derivative_rule]
        step = p.Ki * t.dt
        return {
            "integral_gain": 0.5 * step if self.integral_rule == "trapezoidal" else step,
            "derivative_gain": p.N / (1.0 + share * (p.N * t.dt)),
        }

    def _starts(self, u: Any, x: Any, p: Any) -> tuple[Any, Any]:
        """Return the states i and f, or their initial values in a reset."""
        i = x.i if self.resets == "none" else where(u.clear, p.initial_integral, x.i)
        return i, where(u.clear, p.initial_filter, x.f) if self.resets == "all" else x.f

    def _parts(self, u: Any, x: Any, p: Any) -> tuple[Any, Any, Any]:
        """(I, D, v)."""
        i, f = self._starts(u, x, p)
        integral = i if self.integral_rule == "forward" else i + p.integral_gain * u.e
        rate = p.derivative_gain * (p.Kd * u.e - f)
        return integral, rate, p.Kp * u.e + integral + rate

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        v = self._parts(u, x, p)[2]
        return clamp(p.low, p.high, v) if self.limited else v

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        start, f = self._starts(u, x, p)
        integral, rate, v = self._parts(u, x, p)
        after = integral if self.integral_rule == "backward" else integral + p.integral_gain * u.e
        if self.anti_windup == "clamping":
            push = p.Ki * u.e
            beyond = ((p.high < v) & (push > 0.0)) | ((v < p.low) & (push < 0.0))
            after = where(beyond, start, after)
        elif self.anti_windup == "back-calculation":
            after = after + p.Kb * t.dt * (clamp(p.low, p.high, v) - v)
        return {"i": after, "f": f + t.dt * rate}
