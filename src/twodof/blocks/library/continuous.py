"""Continuous-time linear blocks, integrated by the step's method: integrator, lags, transfer function, state space."""

from collections.abc import Sequence
from typing import Any

from twodof.blocks.block import Block, Clock, library_block
from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.elementwise import OneOutput, clamp, dot, elementwise, limit_params
from twodof.blocks.expressions.arrays import vector
from twodof.blocks.expressions.expr import where
from twodof.blocks.library.discrete import LinearStateSpace, ResetRule, quotient

__all__ = ["FirstOrder", "Integrator", "ResetIntegrator", "ResetLatch", "SecondOrder", "StateSpace", "TransferFunction"]


@library_block("integrator")
class Integrator(OneOutput):
    """x' = u, y = x, from `initial`.

    With `limits` [low, high]: y is x clamped to them, and after each step x itself is put back within them.
    """

    def __init__(
        self, initial: Any = 0.0, limits: Sequence[float] | None = None, width: int | None = None, unit: str = ""
    ) -> None:
        bounds = limit_params(limits, unit)
        self.limited = bool(bounds)
        self.ports("u", width=width, unit=unit, input_unit="")
        self.params = [Param("initial", initial, width=width, unit=unit), *bounds]
        self.states = [State("x", "initial", width=width, unit=unit, continuous=True)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        if not self.limited:
            return x.x
        return elementwise(lambda s: clamp(p.low, p.high, s), x.x)

    def derivative(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return u.u

    def project(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return self.output(u, x, p, t) if self.limited else {}


@library_block("reset_latch")
class ResetLatch(Block):
    """When a ResetIntegrator starts afresh (`start`), and from what (`x0`): held while the step is integrated.

    It does so in its first sample. With `reset` "level" it also does so while the bool `clear` is true. With "rising",
    "falling" or "either" it does so at the edges of `clear`. The first sample is not an edge. `initial` gives x0. With
    initial="input" the input `x0` gives it. `resettable_integrator` (module `twodof.blocks.action_group`)
    connects the two.
    """

    def __init__(self, reset: str = "level", initial: Any = 0.0, width: int | None = None, unit: str = "") -> None:
        self.rule = ResetRule(reset, initial, width)
        self.inputs = self.rule.inputs
        self.outputs = [Port("x0", width=width, unit=unit), Port("start", "bool")]
        self.params = [] if self.rule.external else [Param("initial", initial, width=width, unit=unit)]
        # A block with discrete states is not computed anew inside a step: what it gives is that of the tick.
        edges = [s for s in self.rule.states if s.name == "before"]
        self.states = [*edges, State("begun", False, "bool")]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        found = self.rule.starts(u, x)
        return {
            "x0": u.x0 if self.rule.external else p.initial,
            "start": ~x.begun if found is None else found | ~x.begun,
        }

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return {"begun": True, **self.rule.update(u)}


@library_block("reset_integrator")
class ResetIntegrator(Block):
    """x' = u, y = x; at a tick with `start` x becomes `x0` before the outputs, and is integrated from there.

    `start` and `x0` must not change inside a step, as those of a ResetLatch do not. With `limits` [low, high] y is x
    clamped to them, and after each step x itself is put back within them. A second state, `moved`, is what u adds in
    the step alone, for the step that starts at x0.
    """

    def __init__(self, limits: Sequence[float] | None = None, width: int | None = None, unit: str = "") -> None:
        bounds = limit_params(limits, unit)
        self.limited = bool(bounds)
        self.inputs = [Port("u", width=width), Port("x0", width=width, unit=unit), Port("start", "bool")]
        self.outputs = [Port("y", width=width, unit=unit)]
        self.params = bounds
        names = ("x", "moved")
        self.states = [State(name, 0.0, width=width, unit=unit, continuous=True) for name in names]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        def of(s: Any, moved: Any, s0: Any) -> Any:
            y = where(u.start, s0 + moved, s)
            return clamp(p.low, p.high, y) if self.limited else y

        return elementwise(of, x.x, x.moved, u.x0)

    def derivative(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return {"x": u.u, "moved": u.u}

    def project(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return {"x": self.output(u, x, p, t), "moved": elementwise(lambda _: 0.0, x.moved)}


@library_block("first_order")
class FirstOrder(OneOutput):
    """First-order lag G(s) = gain / (time_constant s + 1): x' = (u - x) / time_constant, y = gain x."""

    def __init__(self, gain: float = 1.0, time_constant: float = 1.0, initial: float = 0.0, unit: str = "") -> None:
        self.ports("u", unit=unit, input_unit="")
        self.params = [
            Param("gain", gain),
            Param("time_constant", time_constant, unit="s", low=0.0),
            Param("initial", initial, text="initial x = y / gain"),
        ]
        self.states = [State("x", "initial", continuous=True)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return p.gain * x.x

    def derivative(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return (u.u - x.x) / p.time_constant


@library_block("second_order")
class SecondOrder(Block):
    """Second-order lag G(s) = gain w^2 / (s^2 + 2 damping w s + w^2), w = natural_frequency.

    States: position x and velocity v with x' = v and v' = w^2 (u - x) - 2 damping w v. y = gain x and rate = gain v.
    """

    def __init__(
        self,
        gain: float = 1.0,
        natural_frequency: float = 1.0,
        damping: float = 0.7,
        initial: float = 0.0,
        initial_rate: float = 0.0,
        unit: str = "",
    ) -> None:
        self.inputs = [Port("u")]
        self.outputs = [Port("y", unit=unit), Port("rate")]
        self.params = [
            Param("gain", gain),
            Param("natural_frequency", natural_frequency, unit="rad/s", low=0.0),
            Param("damping", damping),
            Param("initial", initial, text="initial x = y / gain"),
            Param("initial_rate", initial_rate, text="initial v = rate / gain"),
        ]
        self.states = [State("x", "initial", continuous=True), State("v", "initial_rate", continuous=True)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return {"y": p.gain * x.x, "rate": p.gain * x.v}

    def derivative(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        w = p.natural_frequency
        return {"x": x.v, "v": w * w * (u.u - x.x) - 2.0 * p.damping * w * x.v}


@library_block("transfer_function")
class TransferFunction(OneOutput):
    """G(s) = numerator / denominator in descending powers of s; proper. Strictly proper: no feed-through.

    All coefficients are divided by the denominator's first, which leaves s^n + a1 s^(n-1) + ... + an. The states have
    the controllable canonical form: x_i' = x_(i+1), x_n' = u - an x_1 - ... - a1 x_n.
    Output: y = c_1 x_1 + ... + c_n x_n + d u. `initial` is x_1 .. x_n (one number fills all). Order 64 at most.
    Zeros that the numerator begins with are left out.
    """

    def __init__(
        self,
        numerator: Sequence[float] = (1.0,),
        denominator: Sequence[float] = (1.0, 1.0),
        initial: Any = 0.0,
        unit: str = "",
    ) -> None:
        top, bottom = quotient(numerator, denominator, least=2)
        self.order = len(bottom) - 1
        self.top = len(top)
        self.direct = self.top == self.order + 1
        self.ports("u", unit=unit, input_unit="")
        self.params = [
            Param("numerator", top, width=self.top),
            Param("denominator", bottom, width=self.order + 1),
            Param("initial", initial, width=self.order),
        ]
        self.derived = [Port("a", width=self.order), Port("c", width=self.order), Port("d")]
        self.states = [State("x", "initial", width=self.order, continuous=True)]

    def prepare(self, p: Any, t: Clock) -> Any:
        first, n = p.denominator[0], self.order
        a = [p.denominator[n - i] / first for i in range(n)]  # a[i] multiplies x_(i+1)

        def b(power: int) -> Any:
            return p.numerator[self.top - 1 - power] / first if power < self.top else 0.0

        d = b(n)
        c = [b(i) - d * a[i] if self.direct else b(i) for i in range(n)]
        return {"a": vector(a), "c": vector(c), "d": d}

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        y = dot(self.order, lambda j: p.c[j], lambda j: x.x[j])
        return y + p.d * u.u if self.direct else y

    def derivative(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        n = self.order
        last = u.u - dot(n, lambda j: p.a[j], lambda j: x.x[j])
        return vector([*(x.x[i + 1] for i in range(n - 1)), last])


@library_block("state_space")
class StateSpace(LinearStateSpace):
    """x' = A x + B u, y = C x + D u, from `initial`.

    A, B, C and D are lists of rows. One input or output is a scalar port, more are an array. The elements are
    parameters of the same names, row after row. D of zeros, or None: no feed-through, and no parameter D.
    """

    def __init__(
        self,
        A: Sequence[Sequence[float]] = ((-1.0,),),
        B: Sequence[Sequence[float]] = ((1.0,),),
        C: Sequence[Sequence[float]] = ((1.0,),),
        D: Sequence[Sequence[float]] | None = None,
        initial: Any = 0.0,
        unit: str = "",
    ) -> None:
        self.declare(A, B, C, D, initial, unit, continuous=True)

    def derivative(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return self.change(u, x, p)
