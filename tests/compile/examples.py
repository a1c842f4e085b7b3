"""Hand-made blocks and diagrams whose results have a closed form or are read in the tests."""

from typing import Any

from twodof.blocks import Block, Diagram, Param, Port, State, int32, maximum, minimum, store, where
from twodof.blocks.elementary.functions import sin
from twodof.blocks.library import FractionalDelay, Gain, Integrator, Sum, UnitDelay, ZeroOrderHold


class LimitedIntegrator(Block):
    """Integral of u by backward Euler within +-limit: the example of docs/explanation/language.md."""

    inputs = (Port("u", unit="rad/s"),)
    outputs = (Port("y", unit="rad"),)
    states = (State("sum", initial="start", unit="rad"),)
    params = (
        Param("start", 0.0, unit="rad"),
        Param("limit", 1.0, unit="rad", low=0.0, text="largest magnitude of the integral"),
    )

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return maximum(-p.limit, minimum(p.limit, x.sum + u.u * t.dt))

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return self.output(u, x, p, t)


class Pendulum(Block):
    """A pendulum with a moment; stiffness and damping are derived from frequency and damping ratio."""

    inputs = (Port("moment"),)
    outputs = (Port("theta", unit="rad"), Port("q", unit="rad/s"))
    states = (State("theta", "theta0", unit="rad", continuous=True), State("q", 0.0, unit="rad/s", continuous=True))
    params = (Param("theta0", 0.1), Param("omega", 2.0, low=0.0), Param("zeta", 0.05))
    derived = (Port("stiffness"), Port("damping"))

    def prepare(self, p: Any, t: Any) -> Any:
        return {"stiffness": p.omega * p.omega, "damping": 2.0 * p.zeta * p.omega}

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"theta": x.theta, "q": x.q}

    def derivative(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"theta": x.q, "q": u.moment - p.stiffness * sin(x.theta) - p.damping * x.q}

    def project(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"q": where(abs(x.theta) > 1.5, -0.5 * x.q, x.q)}


class Counter(Block):
    """Counts its own ticks; `wraps` overflows an int32."""

    outputs = (Port("n", "int32"), Port("wraps", "int32"))
    states = (State("n", 0, "int32"),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"n": x.n, "wraps": x.n + int32(2**31 - 3)}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.n + 1


class Ring(Block):
    """A delay of `length` samples in a ring buffer, read before written."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)

    def __init__(self, length: int = 1000) -> None:
        self.states = [State("ring", 0.0, width=length), State("at", 0, "int32")]
        self.length = length

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.ring[x.at]

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        last = x.at == self.length - 1
        return {"ring": store(x.ring, x.at, u.u), "at": where(last, int32(0), x.at + 1)}


class Positive(Block):
    """Comparison of the input with 0."""

    inputs = (Port("u"),)
    outputs = (Port("y", "bool"),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return u.u > 0.0


def loop() -> Diagram:
    """A limited integrator that drives a pendulum, which feeds back through a delay at a quarter of the rate."""
    d = Diagram("loop", 'a loop; "quoted" */ and /* harmless')
    d.input("r", unit="rad/s")
    d.param("k", 2.0, low=0.0, high=10.0, text="gain of the feedback")
    d.add("held", ZeroOrderHold(), rate=(4, 1), u="pendulum.theta")
    d.add("gain", Gain(), rate=(4, 1), u="held", params={"k": "k"})
    d.add("back", ZeroOrderHold(), u="gain")
    d.add("error", Sum("+-"), a="r", b="back")
    d.add("sum", LimitedIntegrator(), u="error")
    d.add("pendulum", Pendulum(), moment="sum")
    d.output("y", "sum")
    d.output("theta", "pendulum.theta")
    return d


def switched(disabled: str = "hold") -> Diagram:
    """A sub-diagram with a discrete and a continuous integral that `on` enables and `clear` resets."""
    inner = Diagram("inner")
    inner.input("u")
    inner.add("count", Counter())
    inner.add("sum", Integrator(), u="u")
    inner.output("n", "count.n")
    inner.output("x", "sum")
    d = Diagram("switched")
    d.input("u")
    d.input("on", "bool")
    d.input("clear", "bool")
    d.add("inner", inner, u="u", enable="on", reset="clear", disabled=disabled)
    d.output("n", "inner.n")
    d.output("x", "inner.x")
    return d


def edge() -> Diagram:
    """The integral of a signal that is delayed by a fraction of a step."""
    d = Diagram("edge")
    d.input("u")
    d.add("late", FractionalDelay(0.013), u="u")
    d.add("sum", Integrator(), u="late")
    d.output("x", "sum")
    return d


def delay(length: int = 1000) -> Diagram:
    """A ring buffer and a unit delay."""
    d = Diagram("delay")
    d.input("u")
    d.add("ring", Ring(length), u="u")
    d.add("one", UnitDelay(), u="u")
    d.output("y", "ring")
    d.output("one", "one")
    return d
