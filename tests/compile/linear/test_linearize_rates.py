"""Linear models over several rates: against python-control, and against the compiled program over many periods."""

import random
from time import process_time
from typing import Any

import control
import numpy as np
import pytest

from tests.compile.linear.linear_diagrams import DT, Smooth, chain, same_response
from twodof.blocks import Block, Diagram, Port, State, int32, store, to_int32, where
from twodof.blocks import library as lib
from twodof.compile import build
from twodof.compile.linear import integer_states
from twodof.compile.linear.linearize import linearize
from twodof.errors import DiagramError

pytestmark = pytest.mark.slow


def test_a_slow_controller_of_a_continuous_plant_is_python_controls_sampled_loop() -> None:
    """PI at every fifth tick, the plant at each: the exact hold over the controller's period, up to RK4."""
    d = Diagram("sampled")
    d.input("r")
    d.add("seen", lib.ZeroOrderHold(), rate=(5, 0), u="plant")
    d.add("error", lib.Sum("+-"), rate=(5, 0), a="r_seen", b="seen")
    d.add("r_seen", lib.ZeroOrderHold(), rate=(5, 0), u="r")
    d.add("pi", lib.DiscreteFilter((2.0, -1.9), (1.0, -1.0)), rate=(5, 0), u="error")
    d.add("hold", lib.ZeroOrderHold(), u="pi")
    d.add("plant", lib.TransferFunction((5.0,), (1.0, 2.0, 1.0)), u="hold")
    d.output("y", "plant")
    step = 5 * DT
    pi = control.tf([2.0, -1.9], [1.0, -1.0], step)
    plant = control.c2d(control.tf([5.0], [1.0, 2.0, 1.0]), step)
    closed = linearize(d, DT)
    assert closed.dt == step
    assert closed.states == ("pi.s[0]", "plant.x[0]", "plant.x[1]")
    # The polynomials of python-control lose some digits where the numerator nearly cancels.
    same_response(closed, control.feedback(pi * plant, 1), rtol=1e-8)
    opened = linearize(d, DT, inputs=["pi.y"], outputs=["pi.y"])
    same_response(opened, lambda z: -(pi * plant)(z), rtol=1e-8)


def sampled_diagram(seed: int) -> Diagram:
    """Linear blocks at rates 1, 2 and 4 with offsets, each behind a hold, and continuous ones, with feedback."""
    r = random.Random(seed)
    d = Diagram(f"sampled{seed}")
    sources = [d.input("u"), d.input("w"), "back"]
    for i in range(6):
        divider = r.choice([1, 2, 4])
        rate = (divider, r.randrange(divider))
        hold = r.choice([lib.ZeroOrderHold, lib.RateTransition])
        a, b = (d.add(f"hold_{side}{i}", hold(), rate=rate, u=r.choice(sources)) for side in "ab")
        total = d.add(f"sum{i}", lib.Sum("+-"), rate=rate, a=a, b=b)
        block = r.choice(
            [
                lib.DiscreteFilter((0.3, 0.1), (1.0, -0.6)),
                lib.Delay(r.randint(1, 6)),
                lib.Pid(0.1, 0.2, 0.01, 20.0),
                *([lib.FirstOrder(0.7, 0.02), lib.FractionalDelay(r.uniform(0.0, 3.0) * DT)] if divider == 1 else []),
            ]
        )
        part = d.add(f"b{i}", block, rate=rate)
        d.connect(total, f"{part}.{block.inputs[0].name}")
        sources.append(f"{part}.{block.outputs[0].name}")
        d.output(f"y{i}", sources[-1])
    d.add("back", lib.RateTransition(), u=sources[-1])
    return d


@pytest.mark.parametrize("seed", range(8))
def test_random_diagrams_of_several_rates_fly_as_their_models_do(seed: int) -> None:
    """Inputs that change once a period, from rest: the compiled outputs at each period's start are the model's."""
    d = sampled_diagram(seed)
    model = linearize(d, DT)
    assert model.dt is not None
    period = round(model.dt / DT)
    machine = build(d, DT).machine()
    start = first_tick(d, period)
    u = np.random.Generator(np.random.PCG64(seed)).standard_normal((25, 2))
    held = np.vstack([np.zeros((start, 2)), np.repeat(u, period, axis=0)])
    out = machine.run(len(held), {"u": held[:, 0], "w": held[:, 1]})
    x = np.zeros(len(model.a))
    for k in range(len(u)):
        expected = model.c @ x + model.d @ u[k]
        found = [out[name][start + k * period] for name in model.outputs]
        # Some 25 periods of numbers of about 10, each rounded.
        np.testing.assert_allclose(found, expected, atol=1e-11)
        x = model.a @ x + model.b @ u[k]


def first_tick(d: Diagram, period: int) -> int:
    """The first tick at which the most parts are due."""
    rates = [part.rate for part in d.parts.values()]
    return max(range(period), key=lambda k: sum(k % r.divider == r.offset for r in rates))


def smooth_diagram(seed: int) -> Diagram:
    """Make nonlinear parts at rates 1, 2 and 4, in sub-diagrams that are plain, enabled or reset."""
    r = random.Random(seed)
    d = Diagram(f"smooth{seed}")
    sources = [d.input("u"), d.input("w")]
    d.input("on", "bool")
    for i in range(5):
        divider = r.choice([1, 1, 2, 4])
        block = Smooth(divider == 1, r.randrange(10**6)) if r.random() < 0.7 else lib.Pid(0.3, 0.2, 0.01, 20.0)
        inner = Diagram(f"inner{i}")
        inner.input("v")
        inner.add("b", block)
        inner.connect("v", f"b.{block.inputs[0].name}")
        inner.output("y", f"b.{block.outputs[0].name}")
        rate = (divider, 0)
        d.add(f"held{i}", lib.ZeroOrderHold(), rate=rate, u=r.choice(sources))
        condition = r.choice([{}, {"enable": "on"}, {"reset": "on"}, {"enable": "on", "disabled": "reset"}])
        d.add(f"s{i}", inner, rate=rate, v=f"held{i}", **condition)
        sources.append(f"s{i}.y")
        d.output(f"y{i}", sources[-1])
    return d


@pytest.mark.parametrize("seed", [*range(1, 5), *(pytest.param(n, marks=pytest.mark.soak) for n in range(5, 30))])
def test_over_a_period_each_column_is_a_difference_of_the_compiled_steps(seed: int) -> None:
    """The slopes change from tick to tick as the point moves: states after a period, outputs at its start."""
    d = smooth_diagram(seed)
    at = {"u": 0.2, "w": -0.3, "on": seed % 2 == 1}
    model = linearize(d, DT, at=at, time="discrete", keep_all=True)
    assert model.dt is not None
    machine = build(d, DT).machine()
    kept = [n for n in model.states if "held" not in n]
    rows = [model.states.index(n) for n in kept]

    def after(name: str, shift: float) -> tuple[Any, Any]:
        machine.reset()
        inputs = dict(at)
        if name in inputs:
            inputs[name] += shift
        else:
            machine.set_state(name, machine.state(name) + shift)
        y = machine.step(inputs)
        for _ in range(round(model.dt / DT) - 1):
            machine.step(inputs)
        return np.array([machine.state(n) for n in kept]), np.array([y[n] for n in model.outputs])

    h = 1e-5  # errors: third derivatives times h^2 and roundings 1e-16 / h, both near 1e-10
    for to_x, to_y, names in ((model.a, model.c, model.states), (model.b, model.d, model.inputs)):
        for j, name in enumerate(names):
            if name in kept or name in at:
                up, down = after(name, h), after(name, -h)
                np.testing.assert_allclose(to_x[rows, j], (up[0] - down[0]) / (2 * h), atol=1e-7)
                np.testing.assert_allclose(to_y[:, j], (up[1] - down[1]) / (2 * h), atol=1e-7)
    machine.reset()
    stepped = machine.step(at)
    for name in model.outputs:
        assert model.output_values[name] == pytest.approx(stepped[name], rel=1e-13, abs=1e-15)


def test_what_holds_over_the_start_of_a_period_is_a_state() -> None:
    d = Diagram("offset")
    d.input("u")
    d.add("first", lib.ZeroOrderHold(), rate=(2, 1), u="u")
    d.add("now", lib.DiscreteFilter((1.0,), (1.0, -0.5)), rate=(2, 0), u="seen")
    d.add("seen", lib.ZeroOrderHold(), rate=(2, 0), u="first")
    d.output("y", "now")
    model = linearize(d, DT)
    assert model.states == ("now.s[0]", "first.y (held)")
    assert model.to_control().nstates == 2
    # At the even tick y = s + h, s' = s/2 + h/2; at the odd one h' = u.
    np.testing.assert_array_equal(model.a, [[0.5, 0.5], [0.0, 0.0]])
    np.testing.assert_array_equal(model.b, [[0.0], [1.0]])
    np.testing.assert_array_equal(model.c, [[1.0, 1.0]])


def test_rates_that_hardly_ever_meet_are_refused_with_a_remedy() -> None:
    d = chain(lib.UnitDelay())
    for divider in (97, 89):
        d.add(f"r{divider}", lib.RateTransition(), rate=(divider, 0), u="u")
        d.output(f"y{divider}", f"r{divider}")
    with pytest.raises(DiagramError, match=r"every 8633 ticks.*r97 runs at \(97, 0\).*ask for fewer outputs"):
        linearize(d, DT)
    assert linearize(d, DT, outputs=["y", "y97"]).dt == pytest.approx(97 * DT)


class Recorder(Block):
    """u three steps ago, from a ring whose index never comes round, or is the tick; `full` stays from the start."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)
    states = (State("past", width=8), State("count", 0, "int32"), State("full", False, "bool"))

    def __init__(self, ticks: bool = False) -> None:
        self.ticks = ticks

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.past[self._place(x, t, 5)]

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        count = x.count if self.ticks else x.count + 1
        return {"past": store(x.past, self._place(x, t, 0), u.u), "count": count, "full": x.full | True}

    def _place(self, x: Any, t: Any, ahead: int) -> Any:
        return ((to_int32(t.tick) if self.ticks else x.count) + ahead) % int32(8)


def test_an_index_that_never_comes_round_is_named_and_holding_it_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """If it is held, what is written is never read: B was 0 without a word."""
    monkeypatch.setattr(integer_states, "MAX_STEPS", 1000)
    with pytest.raises(
        DiagramError, match=r"bool states count do not settle or repeat.*depend on them: y \(let count wrap"
    ):
        linearize(chain(Recorder()), DT)
    with pytest.raises(DiagramError, match="written samples would never be read") as found:
        linearize(chain(Recorder()), DT, at={"b0.count": 100})
    assert found.value.where == "b0.count"


def test_a_tick_that_moves_the_model_is_refused_unless_it_is_given() -> None:
    with pytest.raises(DiagramError, match="the linear model changes with the tick") as found:
        linearize(chain(Recorder(ticks=True)), DT)
    assert found.value.where == "b0"
    model = linearize(chain(Recorder(ticks=True)), DT, at={"tick": 3})
    assert "no effect on any output" in model.remarks["u"]


def test_what_no_output_depends_on_does_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(integer_states, "MAX_STEPS", 1000)
    d = chain(lib.FirstOrder(2.0, 0.3))
    d.add("record", Recorder(), rate=(7, 0), u="b0_held")
    d.add("b0_held", lib.ZeroOrderHold(), rate=(7, 0), u="b0")
    d.output("late", "record")
    model = linearize(d, DT, outputs=["y"])
    assert model.dt is None
    np.testing.assert_allclose(model.a, [[-1 / 0.3]], rtol=1e-15)
    assert model.left_out == {"record.past": "no output depends on it"}
    with pytest.raises(DiagramError, match="or ask for the outputs y only"):
        linearize(d, DT)


def test_inputs_without_effect_and_outputs_that_nothing_moves_are_remarks() -> None:
    d = chain(lib.Gain(2.0), lib.Saturation(-1.0, 1.0), lib.FirstOrder(1.0, 0.5))
    d.input("spare")
    d.add("steps", lib.Rounding("floor"), u="u")
    d.output("whole", "steps")
    model = linearize(d, DT, at={"u": 1.3})
    assert set(model.remarks) == {"u", "spare", "whole"}
    assert "numbers are rounded in steps" in model.remarks["whole"]
    assert set(linearize(d, DT, at={"u": 0.3}).remarks) == {"spare", "whole"}
    assert model.to_json()["remarks"] == model.remarks


def test_a_delay_that_is_cut_acts_through_the_whole_step() -> None:
    """Its edge is cut with it: x' = -x + u held over the step, not over what is left after the edge."""
    d = chain(lib.FractionalDelay(0.6 * DT), lib.FirstOrder(1.0, 1.0))
    model = linearize(d, DT, inputs=["b0.y"], time="discrete")
    np.testing.assert_allclose(model.a, [[np.exp(-DT)]], rtol=1e-13)
    np.testing.assert_allclose(model.b, [[1.0 - np.exp(-DT)]], rtol=1e-9)  # up to RK4's DT^5 / 120


class Bent(Block):
    """u, with a kink at 0 at one tick of each round of a counter, or with another slope there."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)
    states = (State("count", 0, "int32"),)

    def __init__(self, slope: float, round_: int = 4, kink: bool = True) -> None:
        self.slope = slope
        self.round = round_
        self.kink = kink

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        bent = u.u * where(x.count == 2, self.slope, 1.0)
        return where(u.u > 0.0, u.u, bent) if self.kink else bent

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"count": (x.count + 1) % int32(self.round)}


def test_a_counter_that_moves_the_model_is_refused() -> None:
    for round_, why in ((10, "state changes, and the linear model"), (101, "count repeat after 101 periods")):
        with pytest.raises(DiagramError, match=why):
            linearize(chain(Bent(2.0, round_, kink=False), lib.DiscreteFilter((0.5,), (1.0, -0.5))), DT)


def test_a_kink_is_sought_at_each_different_tick_once() -> None:
    def slow(slope: float) -> Diagram:
        d = chain(lib.ZeroOrderHold(), Bent(slope), lib.FirstOrder(2.0, 0.3))
        d.add("held", lib.ZeroOrderHold(), rate=(200, 0), u="u")
        d.output("slow", "held")
        return d

    times = []
    for u in (1.0, 0.0):  # beside the border and on it
        start = process_time()
        linearize(slow(1.0), DT, at={"u": u})
        times.append(process_time() - start)
    assert times[1] < 4.0 * times[0]
    with pytest.raises(DiagramError, match="the point is on a kink") as found:
        linearize(slow(2.0), DT)
    assert found.value.where == "b1"
