"""The reference's step, clause by clause of docs/explanation/language.md section 4."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.blocks.samples import Bouncer, Counter, Gain, Hold, Lag, Late, Memory, chain
from twodof.blocks import Block, Diagram, Param, Port, State
from twodof.blocks.reference.interpreter import Reference
from twodof.errors import DiagramError

pytestmark = pytest.mark.slow


def test_rk4_shows_order_four_and_euler_order_one() -> None:
    def error(dt: float, integrator: str) -> float:
        y = Reference(chain(Lag(), Lag()), dt, integrator=integrator).machine().run(round(1 / dt) + 1, {"r": 1.0})["y"]
        exact = 1 - np.exp(-2.0) * (1 + 2.0)
        return abs(y[-1] - exact)

    assert np.log2(error(0.02, "rk4") / error(0.01, "rk4")) == pytest.approx(4, abs=0.15)
    assert np.log2(error(0.01, "euler") / error(0.005, "euler")) == pytest.approx(1, abs=0.05)


def test_two_blocks_that_exchange_states_read_the_same_tick() -> None:
    d = Diagram("swap")
    d.add("a", Memory())
    d.add("b", Memory(), u="a")
    d.connect("b", "a")
    d.output("a", "a")
    d.output("b", "b")
    m = Reference(d, 1.0).machine()
    m.set_state("a.x", 1.0)
    assert [tuple(m.step().values()) for _ in range(3)] == [(1, 0), (0, 1), (1, 0)]


def test_rates_inside_a_part_count_the_parts_own_ticks() -> None:
    inner = Diagram("inner")
    inner.add("n", Counter(), rate=(2, 1))
    inner.output("n", "n")
    d = Diagram("outer")
    d.add("part", inner, rate=(3, 0))
    d.output("n", "part")
    n = Reference(d, 1.0).machine().run(16)["n"]  # due at ticks 3, 9, 15
    assert n.tolist() == [0] * 9 + [1] * 6 + [2]


def test_a_rate_crossing_must_be_explicit() -> None:
    d = Diagram("crossing")
    d.input("r")
    d.add("fast", Gain(), u="r")
    d.add("slow", Gain(), u="fast", rate=(4, 0))
    d.output("y", "slow")
    with pytest.raises(DiagramError, match=r"slow\.u: it runs at \(4, 0\).*ZeroOrderHold"):
        Reference(d, 1.0)
    e = Diagram("held")
    e.input("r")
    e.add("fast", Gain(), u="r")
    e.add("hold", Hold(), u="fast", rate=(4, 0))
    e.add("slow", Gain(), u="hold", rate=(4, 0))
    e.output("y", "slow")
    y = Reference(e, 1.0).machine().run(9, {"r": np.arange(9.0)})["y"]
    assert y.tolist() == [0, 0, 0, 0, 16, 16, 16, 16, 32]


def test_an_edge_splits_the_step_so_that_a_held_signal_turns_late_exactly() -> None:
    d = chain(Late(), Lag())
    m = Reference(d, 0.05).machine()
    m.set("b0.f", 0.3)
    rng = np.random.default_rng(1)
    u = rng.normal(size=40)
    y = m.run(40, {"r": u})["y"]
    x, a = 0.0, np.exp(-0.05 * np.array([0.3, 0.7]) / 0.5)
    exact = []
    for k in range(40):
        exact.append(x)
        old = u[k - 1] if k else 0.0
        x = a[0] * x + (1 - a[0]) * old
        x = a[1] * x + (1 - a[1]) * u[k]
    local = (0.7 * 0.05 / 0.5) ** 5 / 120 * 2 * np.abs(u).max()  # RK4's error in the longer piece, |u - x| <= 2 max|u|
    assert np.abs(y - exact).max() < local / (1 - np.exp(-0.1))  # summed with the lag's own forgetting


def test_what_stands_between_an_edge_and_a_state_turns_with_it() -> None:
    direct = Reference(chain(Late(), Lag()), 0.05).machine()
    scaled = Reference(chain(Late(), Gain(), Lag()), 0.05).machine()
    u = np.random.default_rng(2).normal(size=30)
    assert np.array_equal(2 * direct.run(30, {"r": u})["y"], scaled.run(30, {"r": u})["y"])


def test_discrete_outputs_are_held_during_the_integration() -> None:
    class Sampled(Block):
        """u as it was at the tick: a discrete block with feed-through."""

        inputs = (Port("u"),)
        outputs = (Port("y"),)
        states = (State("unused"),)

        def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
            return u.u

    d = Diagram("feedback")
    d.add("lag", Lag())
    d.add("sampled", Sampled(), u="lag")
    d.add("minus", Gain(), u="sampled")
    d.connect("minus", "lag.u")
    d.output("y", "lag")
    m = Reference(d, 0.1).machine()
    m.set_many({"lag.start": 1.0, "minus.k": -3.0})
    m.reset()
    y = m.run(2)["y"]
    exact = np.exp(-0.2) * 1 + (1 - np.exp(-0.2)) * -3.0  # the input -3 held for 0.1 s, not following the state
    assert y[1] == pytest.approx(exact, abs=1.1 * 4 * 0.2**5 / 120)  # RK4's error for h / tau = 0.2 and a jump of 4


def test_project_bounces_between_integration_and_the_next_tick() -> None:
    d = Diagram("drop")
    d.add("ball", Bouncer())
    d.output("h", "ball.h")
    d.output("v", "ball.v")
    out = Reference(d, 1e-3).machine().run(800)
    first = int(np.argmax(out["v"] > 0))
    assert first == int(np.ceil(np.sqrt(2 / 9.81) / 1e-3))
    assert out["h"].min() == 0.0
    assert out["v"][first] == pytest.approx(0.5 * np.sqrt(2 * 9.81), abs=0.5 * 9.81 * 1e-3)


def test_one_parameter_of_the_diagram_drives_many_blocks() -> None:
    d = Diagram("shared")
    d.input("r")
    d.param("k", 3.0, low=0.0, high=10.0)
    inner = Diagram("inner")
    inner.input("u")
    inner.param("gain", 1.0)
    inner.add("g", Gain(), u="u", params={"k": "gain"})
    inner.output("y", "g")
    d.add("a", Gain(), u="r", params={"k": "k"})
    d.add("b", inner, u="a", params={"gain": "k"})
    d.output("y", "b")
    m = Reference(d, 1.0).machine()
    assert list(m.parameters) == ["k"]
    assert m.step({"r": 1.0})["y"] == 9.0
    m.set("k", 2.0)
    assert m.step()["y"] == 4.0


def test_a_float32_run_rounds_after_every_operation() -> None:
    m = Reference(chain(Gain(), Gain()), 1.0, "float32").machine()
    m.set_many({"b0.k": 0.1, "b1.k": 0.1})
    assert m.step({"r": 0.7})["y"] == float(np.float32(0.1) * (np.float32(0.1) * np.float32(0.7)))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda d: (d.add("a", Gain()), d.add("b", Gain(), u="a"), d.connect("b", "a")),
            r"algebraic loop .*a\.y.*b\.y",
        ),
        (
            lambda d: d.add("a", Gain()),
            r"loose\.?.*a\.u: the input u is not connected|a\.u: the input u is not connected",
        ),
        (lambda d: d.output("y"), r"loose\.y: the output y is not connected"),
        (lambda d: (d.input("n", "int32"), d.add("a", Gain(), u="n")), r"a\.u: it takes real and n is int32"),
        (
            lambda d: d.add("a", Lag(), u=d.input("r"), rate=(2, 0)),
            r"a: it has continuous states, and runs every 2 ticks",
        ),
    ],
)
def test_an_incomplete_diagram_is_refused_with_its_path(make: Callable[[Diagram], object], message: str) -> None:
    d = Diagram("loose")
    make(d)
    with pytest.raises(DiagramError, match=message):
        Reference(d, 1.0)


def test_a_bound_that_float32_rounds_is_still_reachable() -> None:
    gain = Gain()
    gain.params = (Param("k", 0.05, low=0.0, high=0.1),)
    m = Reference(chain(gain), 1.0, "float32").machine()
    m.set("b0.k", 0.1)  # as float32 it is 0.10000000149
    assert m.get("b0.k") == float(np.float32(0.1))
