"""Discrete-time linear blocks: integrator, derivative, filter, transfer function, state space, moving average."""

from collections.abc import Sequence
from typing import Any

from twodof.blocks.block import EDGES, Block, Clock, edge_of, library_block
from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.elementwise import OneOutput, clamp, count, dot, elementwise, limit_params, matrix, one_of, reals
from twodof.blocks.expressions.arrays import array_of, fold, store, vector
from twodof.blocks.expressions.expr import int32, where
from twodof.errors import DiagramError

__all__ = [
    "DiscreteDerivative",
    "DiscreteFilter",
    "DiscreteIntegrator",
    "DiscreteStateSpace",
    "DiscreteTransferFunction",
    "MovingAverage",
]

RESETS = ("none", "level", *EDGES)
METHODS = ("forward", "backward", "trapezoidal")
MAX_ORDER = 64


class ResetRule:
    """When an integrator starts afresh: never, while the bool `clear` is true, or at its edges; and from what.

    With "input" for an initial value it starts from the signal `x0`, also in its first sample, which has no edge.
    """

    def __init__(self, reset: bool | str, initial: Any, width: int | None) -> None:
        named = {False: "none", True: "level"}[reset] if isinstance(reset, bool) else reset
        self.reset = one_of(named, RESETS, "reset")
        self.external = external = isinstance(initial, str) and initial == "input"
        at_edges = self.reset in EDGES
        self.inputs = [Port("clear", "bool")] if self.reset != "none" else []
        self.inputs += [Port("x0", width=width)] if external else []
        self.states = [State("before", False, "bool")] if at_edges else []
        self.states += [State("begun", False, "bool")] if at_edges or external else []

    def starts(self, u: Any, x: Any) -> Any:
        """Return True if the block starts afresh in this sample; None if it never does."""
        found = None
        if self.reset == "level":
            found = u.clear
        elif self.reset != "none":
            found = x.begun & edge_of(self.reset, x.before, u.clear)
        if self.external:
            found = ~x.begun if found is None else found | ~x.begun
        return found

    def update(self, u: Any) -> dict[str, Any]:
        """Return the next values of the states."""
        given = {"before": u.clear} if self.reset in EDGES else {}
        return {**given, "begun": True} if self.states else {}


@library_block("discrete_integrator")
class DiscreteIntegrator(Block):
    """Integral of gain * u, T the block's period, x the state.

    forward: y = x, x' = x + K T u. backward: y = x + K T u, x' = y.
    trapezoidal: y = x + K T/2 u, x' = y + K T/2 u.

    `limits` [low, high] keep both y and the state within bounds. With `reset` there is a bool input `clear`: while it
    is true, x reads as `initial` (so a backward integral then equals its own sample's contribution). With "rising",
    "falling" or "either" x does so in the samples with such an edge of `clear`; the first sample is not one. With
    initial="input" the initial value is the input `x0`, read in the first sample and at each reset.
    Source: Franklin, Powell, Workman, Digital Control of Dynamic Systems, section 6.1 (the three rules).
    """

    def __init__(
        self,
        method: str = "forward",
        gain: float = 1.0,
        initial: Any = 0.0,
        limits: Sequence[float] | None = None,
        reset: bool | str = False,
        width: int | None = None,
        unit: str = "",
    ) -> None:
        self.method = one_of(method, METHODS, "method")
        bounds = limit_params(limits, unit)
        self.limited, self.rule = bool(bounds), ResetRule(reset, initial, width)
        external = self.rule.external
        self.inputs = [Port("u", width=width), *self.rule.inputs]
        self.outputs = [Port("y", width=width, unit=unit)]
        own = [] if external else [Param("initial", initial, width=width, unit=unit)]
        self.params = [Param("gain", gain), *own, *bounds]
        self.derived = [Port("step", unit="s")]
        first = State("x", 0.0 if external else "initial", width=width, unit=unit)
        self.states = [first, *self.rule.states]

    def prepare(self, p: Any, t: Clock) -> Any:
        step = p.gain * t.dt
        return 0.5 * step if self.method == "trapezoidal" else step

    def _bound(self, value: Any, p: Any) -> Any:
        return clamp(p.low, p.high, value) if self.limited else value

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        starts = self.rule.starts(u, x)

        def begun(s: Any, s0: Any) -> Any:
            return s if starts is None else where(starts, s0, s)

        initial = u.x0 if self.rule.external else p.initial
        if self.method == "forward":
            return elementwise(lambda s, s0: self._bound(begun(s, s0), p), x.x, initial)
        return elementwise(lambda v, s, s0: self._bound(begun(s, s0) + p.step * v, p), u.u, x.x, initial)

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        y = self.output(u, x, p, t)
        if self.method != "backward":
            y = elementwise(lambda v, s: self._bound(s + p.step * v, p), u.u, y)
        return {"x": y, **self.rule.update(u)}


@library_block("discrete_derivative")
class DiscreteDerivative(OneOutput):
    """Backward difference: y[k] = gain (u[k] - u[k-1]) / T, T the block's period, u[-1] = initial."""

    def __init__(self, gain: float = 1.0, initial: Any = 0.0, width: int | None = None, unit: str = "") -> None:
        self.ports("u", width=width, unit=unit, input_unit="")
        self.params = [Param("gain", gain), Param("initial", initial, width=width)]
        self.derived = [Port("slope", unit="1/s")]
        self.states = [State("x", "initial", width=width)]

    def prepare(self, p: Any, t: Clock) -> Any:
        return p.gain / t.dt

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return elementwise(lambda v, s: p.slope * (v - s), u.u, x.x)

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return u.u


def leading_zeros(numerator: list[float]) -> int:
    """Return how many zeros the numerator begins with, the last coefficient not counted."""
    return next((i for i, value in enumerate(numerator) if value), len(numerator) - 1)


def quotient(numerator: Any, denominator: Any, least: int = 1, proper: bool = True) -> tuple[list[float], list[float]]:
    """Return the coefficients of a transfer function as lists, the numerator without the zeros that it begins with.

    Raises DiagramError if they do not define a transfer function.
    """
    top, bottom = reals(numerator, "numerator"), reals(denominator, "denominator", least)
    if proper:
        top = top[leading_zeros(top) :]
    if proper and len(top) > len(bottom):
        raise DiagramError("the numerator's degree is above the denominator's", "", "give a proper transfer function")
    if bottom[0] == 0.0:
        raise DiagramError("the first coefficient of the denominator is 0", "", "leave zeros out")
    order = max(len(top), len(bottom)) - 1
    if order > MAX_ORDER:
        raise DiagramError(f"order {order}", "", f"the order is at most {MAX_ORDER}")
    return top, bottom


class _Rational(OneOutput):
    """A quotient of polynomials in z^-1, in transposed direct form II; `lead` is how many zeros b begins with."""

    def _declare(self, numerator: list[float], denominator: list[float], lead: int, initial: Any, unit: str) -> None:
        self.lead = lead
        self.order = max(len(denominator) - 1, len(numerator) - 1 + lead, 1)
        self.lengths = len(numerator), len(denominator)
        self.ports("u", unit=unit, input_unit="")
        self.params = [
            Param("numerator", numerator, width=len(numerator)),
            Param("denominator", denominator, width=len(denominator)),
            Param("initial", initial, width=self.order, text="initial s1 .. sn"),
        ]
        self.derived = [Port("b", width=self.order + 1), Port("a", width=self.order + 1)]
        self.states = [State("s", "initial", width=self.order)]

    def prepare(self, p: Any, t: Clock) -> Any:
        first = p.denominator[0]
        top, bottom = self.lengths

        def b(i: int) -> Any:
            return p.numerator[i - self.lead] / first if 0 <= i - self.lead < top else 0.0

        def a(i: int) -> Any:
            return p.denominator[i] / first if i < bottom else 0.0

        orders = range(self.order + 1)
        return {"b": vector([b(i) for i in orders]), "a": vector([a(i) for i in orders])}

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        # Without b0 there is no feed-through, which tracing would not see in 0 * u.
        return x.s[0] if self.lead else p.b[0] * u.u + x.s[0]

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        y = self.output(u, x, p, t)
        news = []
        for i in range(1, self.order + 1):
            own = p.b[i] * u.u - p.a[i] * y
            news.append(own + x.s[i] if i < self.order else own)
        return vector(news)


@library_block("discrete_filter")
class DiscreteFilter(_Rational):
    """H(z) = (b0 + b1 z^-1 + ...) / (a0 + a1 z^-1 + ...), `numerator` b and `denominator` a, as scipy.signal.lfilter.

    Transposed direct form II: y = b0 u + s1, s_i' = b_i u - a_i y + s_(i+1), coefficients divided by a0;
    `initial` s1 .. sn (one number fills all), n the larger order. Order 64 at most. A numerator that begins with zeros
    gives no feed-through; they are not elements of the parameter.
    """

    def __init__(
        self,
        numerator: Sequence[float] = (1.0,),
        denominator: Sequence[float] = (1.0,),
        initial: Any = 0.0,
        unit: str = "",
    ) -> None:
        top, bottom = quotient(numerator, denominator, proper=False)
        lead = leading_zeros(top)
        self._declare(top[lead:], bottom, lead, initial, unit)


@library_block("discrete_transfer_function")
class DiscreteTransferFunction(_Rational):
    """H(z) = numerator / denominator in descending powers of z; proper. Strictly proper: no feed-through.

    Transposed direct form II: y = b0 u + s1, s_i' = b_i u - a_i y + s_(i+1), coefficients of z^-i divided by the
    denominator's first; `initial` s1 .. sn (one number fills all). Order 64 at most. Zeros that the numerator begins
    with are left out.
    """

    def __init__(
        self,
        numerator: Sequence[float] = (1.0,),
        denominator: Sequence[float] = (1.0, 0.0),
        initial: Any = 0.0,
        unit: str = "",
    ) -> None:
        top, bottom = quotient(numerator, denominator)
        self._declare(top, bottom, len(bottom) - len(top), initial, unit)


class LinearStateSpace(Block):
    """y = C x + D u, and the state's change A x + B u, in discrete or continuous time."""

    def declare(self, A: Any, B: Any, C: Any, D: Any, initial: Any, unit: str, continuous: bool) -> None:
        """Declare ports, parameters and the state. Raises DiagramError for matrices that do not fit together."""
        a = matrix(A, None, None, "A")
        self.size = n = len(a)
        parts = {"A": matrix(A, n, n, "A"), "B": matrix(B, n, None, "B"), "C": matrix(C, None, n, "C")}
        self.input_count, self.output_count = len(parts["B"][0]), len(parts["C"])
        d = [] if D is None else matrix(D, self.output_count, self.input_count, "D")
        self.direct = any(map(any, d))
        if self.direct:
            parts["D"] = d
        self.inputs = [Port("u", width=None if self.input_count == 1 else self.input_count)]
        self.outputs = [Port("y", width=None if self.output_count == 1 else self.output_count, unit=unit)]
        self.params = [
            *(Param(k, [v for row in rows for v in row], width=len(rows) * len(rows[0])) for k, rows in parts.items()),
            Param("initial", initial, width=n),
        ]
        self.states = [State("x", "initial", width=n, continuous=continuous)]

    def _row(self, i: Any, gain_x: Any, gain_u: Any, u: Any, x: Any) -> Any:
        total = dot(self.size, lambda j: gain_x[i * self.size + j], lambda j: x.x[j])
        if gain_u is None:
            return total
        if self.input_count == 1:
            return total + gain_u[i] * u.u
        return total + dot(self.input_count, lambda j: gain_u[i * self.input_count + j], lambda j: u.u[j])

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        gain = p.D if self.direct else None
        if self.output_count == 1:
            return self._row(0, p.C, gain, u, x)
        return array_of(self.output_count, lambda i: self._row(i, p.C, gain, u, x))

    def change(self, u: Any, x: Any, p: Any) -> Any:
        """Return A x + B u."""
        return array_of(self.size, lambda i: self._row(i, p.A, p.B, u, x))


@library_block("discrete_state_space")
class DiscreteStateSpace(LinearStateSpace):
    """x' = A x + B u, y = C x + D u at the block's rate; x[0] = initial.

    A, B, C and D are lists of rows. One input or output is a scalar port, more are an array. The elements are
    parameters of the same names, row after row. D of zeros, or None: no feed-through, and no parameter D.
    """

    def __init__(
        self,
        A: Sequence[Sequence[float]] = ((0.0,),),
        B: Sequence[Sequence[float]] = ((1.0,),),
        C: Sequence[Sequence[float]] = ((1.0,),),
        D: Sequence[Sequence[float]] | None = None,
        initial: Any = 0.0,
        unit: str = "",
    ) -> None:
        self.declare(A, B, C, D, initial, unit, continuous=False)

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return self.change(u, x, p)


@library_block("moving_average")
class MovingAverage(OneOutput):
    """Mean of the last n = `samples` inputs: y[k] = (u[k] + u[k-1] + ... + u[k-n+1]) / n, u[k < 0] = initial."""

    def __init__(self, samples: int = 2, initial: float = 0.0, unit: str = "") -> None:
        self.samples = count(samples, 2, 10_000, "samples")
        self.ports("u", unit=unit)
        self.params = [Param("initial", initial, unit=unit)]
        self.derived = [Port("fill", width=self.samples - 1, unit=unit)]
        self.states = [State("buffer", "fill", width=self.samples - 1, unit=unit), State("position", 0, "int32")]

    def prepare(self, p: Any, t: Clock) -> Any:
        return array_of(self.samples - 1, lambda _: p.initial)

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        # The sum is made anew each time: one that is carried along would collect rounding errors.
        total = fold(self.samples - 1, [u.u], lambda i, s: [s + x.buffer[i]])[0]
        return total / float(self.samples)

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        after = x.position + 1
        return {
            "buffer": store(x.buffer, x.position, u.u),
            "position": where(after < self.samples - 1, after, int32(0)),
        }
