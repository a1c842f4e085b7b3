"""Compiled programs: closed forms, the reference's bits, the interface of docs/explanation/language.md, section 6."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

import twodof.blocks
import twodof.compile
from tests.compile import examples
from twodof.blocks import Block, Diagram, Param, Port, array_of, int32, sqrt
from twodof.blocks.library import Constant, DiscreteIntegrator, Gain, Sum
from twodof.blocks.reference.interpreter import Reference
from twodof.compile import CompiledMachine, CompiledProgram, build
from twodof.compile.toolchain import compilers
from twodof.errors import CompileError, DiagramError, ParameterError

pytestmark = pytest.mark.slow

DIAGRAMS: list[tuple[Callable[[], Diagram], tuple[str, ...], dict[str, Any]]] = [
    (examples.loop, ("gain.y", "held.y", "pendulum.q"), {"r": 0.7}),
    (examples.switched, (), {"u": 1.5, "on": True}),
    (examples.edge, ("late.y",), {"u": 1.0}),
    (partial(examples.delay, 40), (), {"u": 3.0}),
]


def compiled(diagram: Diagram, dt: float = 0.01, **options: Any) -> CompiledMachine:
    program = build(diagram, dt, **options)
    assert isinstance(program, CompiledProgram)
    return program.machine()


def random_inputs(inputs: dict[str, Any], steps: int) -> dict[str, Any]:
    rng = np.random.default_rng(7)
    return {
        n: rng.random(steps) < 0.7 if isinstance(v, bool) else np.round(rng.normal(size=steps).cumsum() * v, 3)
        for n, v in inputs.items()
    }


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("integrator", ["rk4", "euler"])
@pytest.mark.parametrize(("make", "log", "inputs"), DIAGRAMS, ids=["loop", "switched", "edge", "delay"])
def test_the_bits_are_those_of_the_reference(
    make: Callable[[], Diagram], log: tuple[str, ...], inputs: dict[str, Any], integrator: str, precision: str
) -> None:
    signals = random_inputs(inputs, 120)
    ours = compiled(make(), precision=precision, log=log, integrator=integrator)
    judge = Reference(make(), 0.01, precision, log, integrator).machine()
    got, want = ours.run(120, signals), judge.run(120, signals)
    assert got.keys() == want.keys()
    for name in want:
        assert np.array_equal(got[name], want[name]), name
    for path in ours.program.states:
        assert ours.state(path) == judge.state(path), path


def test_the_integral_of_a_constant_grows_and_stops_at_its_limit() -> None:
    d = Diagram("integral")
    d.input("u")
    d.add("sum", examples.LimitedIntegrator(), u="u")
    d.output("y", "sum")
    y = compiled(d, dt=0.125).run(20, {"u": 0.5})["y"]
    assert y.tolist() == [min(1.0, 0.0625 * (k + 1)) for k in range(20)]


def test_the_free_pendulum_swings_as_theory_says() -> None:
    d = Diagram("free")
    d.input("u")
    d.add("pendulum", examples.Pendulum(), moment="u")
    d.output("theta", "pendulum.theta")
    machine = compiled(d, dt=0.001)
    omega, zeta, start = 3.0, 0.1, 1e-4
    machine.set_many({"pendulum.omega": omega, "pendulum.zeta": zeta, "pendulum.theta0": start})
    machine.reset()
    theta = machine.run(5000, {"u": 0.0})["theta"]
    t, damped = np.arange(5000) * 0.001, omega * np.sqrt(1 - zeta**2)
    free = np.exp(-zeta * omega * t) * (np.cos(damped * t) + zeta * omega / damped * np.sin(damped * t))
    # sin(theta) is theta but for theta^3 / 6 = 2e-13 of it; RK4 at 1 ms adds (omega dt)^5 / 120 a step.
    assert np.max(np.abs(theta - start * free)) < 1e-8 * start


def test_a_ring_buffer_delays_by_its_length() -> None:
    u = np.arange(2500.0)
    out = compiled(examples.delay(1000)).run(2500, {"u": u})
    assert np.array_equal(out["y"], np.concatenate([np.zeros(1000), u[:-1000]]))
    assert np.array_equal(out["one"], np.concatenate([[0.0], u[:-1]]))


def test_arrays_change_places_at_once() -> None:
    d = Diagram("rotate")
    d.add("r", examples.Rotate())
    d.output("a", "r.a")
    d.output("b", "r.b")
    out = compiled(d).run(3)
    assert out["a"].tolist() == [[1, 2, 3], [4, 5, 6], [2, 3, 1]]
    assert out["b"].tolist() == [[4, 5, 6], [2, 3, 1], [5, 6, 4]]


def test_integers_wrap_around() -> None:
    d = Diagram("wrap")
    d.add("count", examples.Counter())
    d.output("wraps", "count.wraps")
    assert compiled(d).run(5)["wraps"].tolist() == [2**31 - 3, 2**31 - 2, 2**31 - 1, -(2**31), 1 - 2**31]


def test_a_slow_block_acts_at_its_ticks_and_holds_between() -> None:
    d = Diagram("slow")
    d.add("count", examples.Counter(), rate=(3, 1))
    d.output("n", "count.n")
    assert compiled(d).run(9)["n"].tolist() == [0, 0, 0, 0, 1, 1, 1, 2, 2]


@pytest.mark.parametrize(("disabled", "while_off"), [("hold", 2), ("reset", 0)])
def test_a_disabled_diagram_freezes(disabled: str, while_off: int) -> None:
    on = np.array([1, 1, 1, 0, 0, 1, 1], bool)
    clear = np.array([0, 0, 0, 0, 0, 0, 1], bool)
    machine = compiled(examples.switched(disabled), dt=0.5)
    out = machine.run(7, {"u": 1.0, "on": on, "clear": clear})
    assert out["n"].tolist() == [0, 1, 2, while_off, while_off, 3, 0]
    assert out["x"].tolist() == [0.0, 0.5, 1.0, while_off / 2, while_off / 2, 1.5, 0.0]
    assert machine.state("inner.sum.x") == 0.5  # integrated from the initial value in the tick of the reset


def test_an_edge_splits_the_step() -> None:
    """The integral of a ramp of steps that is late by 1.3 samples is exact: it is piecewise constant."""
    u = np.arange(1.0, 30.0)
    x = compiled(examples.edge(), dt=0.01).run(29, {"u": u})["x"]
    late = np.concatenate([[0.0], u])  # value k - 1 holds from (k + .3) dt on
    exact = np.concatenate([[0.0, 0.0], np.cumsum(0.01 * (0.3 * late[:-1] + 0.7 * late[1:]))])[:29]
    assert np.allclose(x, exact, rtol=0, atol=1e-12)  # 29 additions of magnitude 1


def test_parameters_are_set_by_path_and_bounded() -> None:
    machine = compiled(examples.loop())
    assert machine.get("k") == 2.0
    machine.set("k", 3)
    assert machine.get("k") == 3.0
    for path, value, said in (
        ("k", 11.0, "outside"),
        ("k", -0.1, "outside"),
        ("k", float("nan"), "outside"),
        ("k", "1", "real"),
        ("gain.k", 1.0, "no parameter"),
        ("sum.limit", -1.0, "outside"),
    ):
        with pytest.raises(ParameterError, match=said):
            machine.set(path, value)
    with pytest.raises(ParameterError):
        machine.set_many({"k": 5.0, "sum.limit": -1.0})
    assert machine.get("k") == 3.0  # all or none
    declared = machine.parameters["k"]
    assert (declared.low, declared.high, declared.text) == (0.0, 10.0, "gain of the feedback")
    assert machine.parameters["sum.limit"].unit == "rad"


def test_derived_parameters_follow() -> None:
    machine = compiled(examples.loop())
    machine.set("pendulum.omega", 3.0)
    assert machine.instance.structs["P"]["pendulum_stiffness"][0] == 9.0


def test_machines_do_not_share_anything() -> None:
    program = build(examples.delay(3), 0.01)
    one, two = program.machine(), program.machine()
    one.run(5, {"u": 1.0})
    assert two.run(5, {"u": 0.0})["y"].tolist() == [0.0] * 5
    assert one.step({})["y"] == 1.0


def test_step_run_reset_and_states() -> None:
    machine = compiled(examples.loop(), log=("pendulum.q",))
    first = [machine.step({"r": 0.5}) for _ in range(20)]
    assert list(first[0]) == ["y", "theta", "pendulum.q"]
    machine.reset()
    assert machine.tick == 0
    again = machine.run(20, {"r": 0.5})
    assert again["theta"].tolist() == [f["theta"] for f in first]
    machine.set_state("pendulum.theta", 0.25)
    assert machine.state("pendulum.theta") == 0.25
    assert machine.step({"r": 0.5})["theta"] == 0.25
    assert machine.run(0, {"r": np.zeros(0)})["y"].shape == (0,)


def test_an_input_keeps_its_value() -> None:
    machine = compiled(examples.delay(1))
    machine.run(3, {"u": np.array([1.0, 2.0, 3.0])})
    assert [machine.step()["y"] for _ in range(2)] == [3.0, 3.0]


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda m: m.step({"nobody": 1.0}), DiagramError),
        (lambda m: m.step({"r": "1"}), DiagramError),
        (lambda m: m.run(3, {"r": [1.0, 2.0]}), DiagramError),
        (lambda m: m.run(3, {"r": ["a", "b", "c"]}), DiagramError),
        (lambda m: m.state("sum.nothing"), DiagramError),
        (lambda m: m.set_state("nothing.sum", 0.0), DiagramError),
        (lambda m: m.get("nothing"), ParameterError),
    ],
)
def test_mistakes_raise(call: Callable[[CompiledMachine], Any], error: type[Exception]) -> None:
    with pytest.raises(error):
        call(compiled(examples.loop()))


def test_a_missing_compiler_gives_the_reference_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def nowhere(name: str | None = None) -> compilers.Compiler:
        raise CompileError("there is no C compiler")

    monkeypatch.setattr(compilers, "find_compiler", nowhere)
    with pytest.warns(RuntimeWarning, match="reference interpreter"):
        program = build(examples.loop(), 0.01)
    assert isinstance(program, Reference)
    monkeypatch.undo()
    with pytest.raises(CompileError, match="no C compiler 'no-such-cc'"):
        build(examples.loop(), 0.01, compiler="no-such-cc")


def test_names_that_would_clash_in_c_do_not() -> None:
    """Paths a.b_c and a_b.c are both a_b_c in C; `int` and `double` are words of C."""
    inner, other = Diagram("inner"), Diagram("other")
    for d, part in ((inner, "b_c"), (other, "c")):
        d.input("u")
        d.add(part, Gain(2.0), u="u")
        d.add("sum", DiscreteIntegrator(), u=part)
        d.output("y", part)
    d = Diagram("clash")
    d.input("int")
    d.input("double")
    d.add("a", inner, u="int")
    d.add("a_b", other, u="double")
    d.add("real", Sum("++"), a="a", b="a_b")
    d.output("if", "real")
    machine = compiled(d)
    machine.set_many({"a.b_c.k": 3.0, "a_b.c.k": 5.0})
    assert machine.step({"int": 1.0, "double": 10.0})["if"] == 53.0


def test_a_bound_itself_is_allowed_in_either_precision() -> None:
    """0.1 rounded to float32 lies above 0.1: what is compared is what was given."""
    d = Diagram("bound")
    d.input("u")
    d.param("k", 0.05, low=-0.1, high=0.1)
    d.add("gain", Gain(), u="u", params={"k": "k"})
    d.output("y", "gain")
    machine = compiled(d, precision="float32")
    machine.set("k", 0.1)
    assert machine.get("k") == float(np.float32(0.1))


@pytest.mark.parametrize("given", [2**31, 2**32 + 3, -(2**31) - 1, int32(7), [1], 2.5])
def test_an_integer_is_bounded_before_it_wraps_around(given: Any) -> None:
    d = Diagram("bounded")
    d.input("u", "int32")
    d.param("k", 3, kind="int32", low=-5, high=5)
    d.add("sum", Sum("++", "int32"), a="u", b="u")
    d.output("y", "sum")
    for machine in (compiled(d), Reference(d, 0.01).machine()):
        with pytest.raises(ParameterError):
            machine.set("k", given)
        assert machine.get("k") == 3


def test_rates_beyond_the_tick_are_never_due_but_once() -> None:
    """Three nested sub-diagrams of divider 2^31 - 1 run at tick 0 and not again within 2^32 ticks."""
    d = Diagram("d0")
    d.add("count", examples.Counter(), rate=(2**31 - 1, 0))
    d.output("n", "count.n")
    for k in range(1, 3):
        outer = Diagram(f"d{k}")
        outer.add("part", d, rate=(2**31 - 1, 0))
        outer.output("n", "part.n")
        d = outer
    machine = compiled(d)
    machine.run(5)
    assert machine.state("part.part.count.n") == 1


def test_arrays_that_would_burst_the_stack_are_refused() -> None:
    class Wide(examples.Positive):
        def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
            return array_of(100_000, lambda i: u.u)[7] > 0.0

    d = Diagram("wide")
    d.input("u")
    d.add("wide", Wide(), u="u")
    d.output("y", "wide")
    with pytest.raises(DiagramError, match="stack"):
        build(d, 0.01)


def test_a_long_state_stands_in_the_heap() -> None:
    out = compiled(examples.delay(500_000)).run(10, {"u": 1.0})
    assert out["y"].tolist() == [0.0] * 10


@pytest.mark.parametrize("steps", [-1, 1.5, None, True, 10**12])
def test_a_number_of_steps_that_cannot_be_run_is_refused(steps: Any) -> None:
    d = Diagram("gain")
    d.input("r")
    d.add("gain", Gain(2.0), u="r")
    d.output("y", "gain")
    for program in (build(d, 0.01), Reference(d, 0.01)):
        with pytest.raises(DiagramError, match="steps"):
            program.machine().run(steps, {"r": 1.0})
        assert program.machine().run(0)["y"].size == 0


class SquareRoot(Block):
    """y = sqrt(k) u, with a k that cannot be negative."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)
    params = (Param("k", 1.0, low=0.0),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return sqrt(p.k) * u.u


@pytest.mark.parametrize("make", [build, Reference])
def test_a_bound_parameter_keeps_the_bounds_of_what_it_sets(make: Callable[..., Any]) -> None:
    def diagram(default: float) -> Diagram:
        inner = SquareRoot()
        d = Diagram("bound")
        d.input("r")
        d.param("k", default, low=-10.0, high=2.0)
        d.add("root", inner, u="r", params={"k": "k"})
        d.output("y", "root")
        return d

    m = make(diagram(1.0), 0.01).machine()
    assert m.step({"r": 3.0})["y"] == 3.0
    for value in (-1.0, 3.0):
        with pytest.raises(ParameterError, match=r"outside 0 to 2"):
            m.set("k", value)
    with pytest.raises(
        DiagramError, match=r"root\.k: it is bound to 'k', whose default -1\.0 is outside \[0\.0, 2\.0\]"
    ):
        make(diagram(-1.0), 0.01)


def test_an_unknown_parameter_is_answered_with_the_nearest_names() -> None:
    d = Diagram("many")
    for i in range(50):
        d.add(f"part_{i}", Constant(float(i)))
        d.output(f"y_{i}", f"part_{i}")
    d.add("speed_limit", Constant(1.0))
    d.output("y", "speed_limit")
    for machine in (compiled(d), Reference(d, 0.01).machine()):
        with pytest.raises(ParameterError) as caught:
            machine.set("speed_limt.value", 1.0)
        # By the alphabet it would be the last of 51, behind the 40 that are listed.
        assert caught.value.remedy.startswith("there are: speed_limit.value, ")
        assert caught.value.remedy.endswith(" and 11 more")
        with pytest.raises(ParameterError, match="no parameter"):
            machine.get(7)


def test_no_name_of_the_language_is_one_of_the_compiler_too() -> None:
    assert not set(vars(twodof.blocks)) & set(twodof.compile.__all__)
