"""Diagrams and points without a linear model, the named cause, and states left out of a model."""

import sys
from typing import Any

import numpy as np
import pytest

from tests.compile.linear.linear_diagrams import DT, chain, pendulum, same_response
from twodof.blocks import Block, Diagram, Port, State, maximum, sqrt, where
from twodof.blocks import library as lib
from twodof.blocks.action_group import resettable_integrator
from twodof.compile.linear.linearize import linearize
from twodof.errors import CompileError, DiagramError, ParameterError


def test_a_kink_is_named_and_beside_it_there_is_none() -> None:
    d = chain(lib.Gain(2.0), lib.Saturation(-1.0, 1.0))
    with pytest.raises(DiagramError, match="kink") as found:
        linearize(d, DT, at={"u": 0.5})
    assert found.value.where == "b1"
    assert linearize(d, DT, at={"u": 0.4}).d[0, 0] == 2.0
    assert linearize(d, DT, at={"u": 0.6}).d[0, 0] == 0.0
    for block in (lib.Abs(), lib.Rounding("floor"), lib.Sign()):
        with pytest.raises(DiagramError, match="kink"):
            linearize(chain(block), DT)


def test_branches_that_agree_at_their_border_are_no_kink() -> None:
    class Idle(Block):
        inputs = (Port("u"),)
        outputs = (Port("y"),)

        def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
            return maximum(u.u, 0.0) - maximum(-u.u, 0.0)  # u, in two halves

    assert linearize(chain(Idle()), DT).d[0, 0] == 1.0


def test_an_infinite_slope_is_refused() -> None:
    class Root(Block):
        inputs = (Port("u"),)
        outputs = (Port("y"),)

        def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
            return sqrt(u.u)

    with pytest.raises(DiagramError, match="slope is infinite") as found:
        linearize(chain(Root()), DT)
    assert found.value.where == "b0.y"
    assert linearize(chain(Root()), DT, at={"u": 4.0}).d[0, 0] == 0.25


def test_one_slow_rate_is_the_models_and_dx_dt_of_several_is_refused() -> None:
    d = Diagram("rates")
    d.input("u")
    d.add("slow", lib.ZeroOrderHold(), rate=(3, 1), u="u")
    d.add("filter", lib.DiscreteFilter((0.5,), (1.0, -0.5)), rate=(3, 1), u="slow")
    d.output("y", "filter")
    model = linearize(d, DT)
    assert model.dt == 3 * DT
    same_response(model, lambda z: 0.5 / (1 - 0.5 / z), rtol=1e-12)
    d.add("fast", lib.UnitDelay(), u="u")
    d.output("z", "fast")
    with pytest.raises(DiagramError, match=r"several rates: .*fast"):
        linearize(d, DT, time="continuous")


class Alternating(Block):
    """Its gain is 1 and 2 in turn."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)
    states = (State("odd", False, "bool"), State("x"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.x

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"odd": ~x.odd, "x": u.u * where(x.odd, 2.0, 1.0)}


def test_a_bool_that_moves_the_model_is_named_and_can_be_held() -> None:
    with pytest.raises(DiagramError, match="changes, and the linear model with it") as found:
        linearize(chain(Alternating()), DT)
    assert found.value.where == "b0.odd"
    assert linearize(chain(Alternating()), DT, at={"b0.odd": True}).b[0, 0] == 2.0


def test_noise_and_sources_are_offsets() -> None:
    d = chain(lib.FirstOrder(2.0, 0.3))
    d.add("noise", lib.Noise(0.1))
    d.add("wave", lib.Sine(3.0))
    d.add("sum", lib.Sum("+++"), a="b0", b="noise", c="wave")
    d.output("seen", "sum")
    model = linearize(d, DT)
    np.testing.assert_array_equal(model.c[0], model.c[1])
    assert model.inputs == ("u",)


def test_a_disabled_sub_diagram_is_frozen() -> None:
    inner = Diagram("inner")
    inner.input("v")
    inner.add("memory", lib.DiscreteFilter((0.5,), (1.0, -0.5)), u="v")
    inner.output("w", "memory")
    d = Diagram("outer")
    d.input("u")
    d.input("on", "bool")
    d.add("sub", inner, enable="on", v="u")
    d.output("y", "sub.w")
    assert linearize(d, DT).left_out == {"sub.memory.s[0]": "stays at the point's value"}
    assert linearize(d, DT, at={"on": True}).a[0, 0] == 0.5
    d.parts["sub"].enabling = "restart"
    assert linearize(d, DT, at={"on": True}).a[0, 0] == 0.5
    d.parts["sub"].trigger = "on"
    with pytest.raises(DiagramError, match="has no linear model") as caught:
        linearize(d, DT, at={"on": True})
    assert caught.value.where == "sub"


def test_an_integrator_that_can_be_reset_is_one_while_it_is_not() -> None:
    d = Diagram("lag")
    for name, kind in (("u", "real"), ("x0", "real"), ("clear", "bool")):
        d.input(name, kind)
    d.add("error", lib.Sum("+-"), a="u", b="sum")
    d.add("sum", resettable_integrator("sum", "rising", "input"), u="error", x0="x0", clear="clear")
    d.output("y", "sum")
    model = linearize(d, DT)
    assert model.dt is None
    np.testing.assert_array_equal(model.a, [[-1.0]])
    np.testing.assert_array_equal(model.b, [[1.0, 0.0]])
    np.testing.assert_array_equal(model.c, [[1.0]])


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ({"at": {"nowhere": 1.0}}, "nowhere"),
        ({"inputs": ["p.nothing"]}, "no signal named"),
        ({"outputs": ["nothing"]}, "no signal named"),
        ({"time": "sometimes"}, "use one of"),
        ({"free": ["M"]}, "without trim"),
        ({"trim": True, "free": ["theta"]}, "is not a real input of the model"),
        ({"at": {"p.omega": -1.0}}, "outside"),
    ],
)
def test_what_cannot_be_is_refused(arguments: dict[str, Any], complaint: str) -> None:
    with pytest.raises((DiagramError, ParameterError), match=complaint):
        linearize(pendulum(), DT, **arguments)


def test_too_many_states_are_refused() -> None:
    with pytest.raises(DiagramError, match="at most 1500"):
        linearize(chain(lib.Delay(5000)), DT)


def test_without_python_control_the_error_names_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(CompileError, match="pip install control"):
        linearize(pendulum(), DT).to_control()
