"""Compiled programs: closed forms, the reference's bits, the interface of docs/explanation/language.md, section 6."""

from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest

from tests.compile import examples
from tests.toolchains import need
from twodof.blocks import Block, Diagram, Param, Port, State, array_of, sqrt
from twodof.blocks.library import LowPass
from twodof.blocks.reference.interpreter import Reference
from twodof.compile import CompiledMachine, CompiledProgram, build
from twodof.compile.c.emitter import emit
from twodof.compile.program.lower import lower
from twodof.compile.toolchain import compilers
from twodof.errors import CompileError, DiagramError, ParameterError

pytestmark = pytest.mark.slow


def compiled(diagram: Diagram, dt: float = 0.01, **options: Any) -> CompiledMachine:
    program = build(diagram, dt, **options)
    assert isinstance(program, CompiledProgram)
    return program.machine()


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


@pytest.mark.parametrize("target", ["native", "wasm", "cortex-m7"])
def test_machines_do_not_share_anything(target: str) -> None:
    if target == "cortex-m7":
        need("qemu-system-arm")
    program = build(examples.loop(), 0.01, target=target)
    rows = np.random.default_rng(1).normal(size=300)
    once, first, second = (program.machine() for _ in range(3))
    second.set("k", 5.0)
    together = once.run(300, {"r": rows})["y"]
    ours, theirs = zip(*((first.step({"r": v})["y"], second.step({"r": -v})["y"]) for v in rows), strict=True)
    assert np.array_equal(together, ours)
    assert not np.array_equal(together, np.negative(theirs))  # another gain
    assert first.tick == second.tick == 300


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


def test_a_missing_compiler_gives_the_reference_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def nowhere(name: str | None = None) -> compilers.Compiler:
        raise CompileError("no C compiler was found")

    monkeypatch.setattr(compilers, "find_compiler", nowhere)
    with pytest.warns(RuntimeWarning, match="reference interpreter"):
        program = build(examples.loop(), 0.01)
    assert isinstance(program, Reference)
    monkeypatch.undo()
    with pytest.raises(CompileError, match="no C compiler named 'no-such-cc'"):
        build(examples.loop(), 0.01, compiler="no-such-cc")
    with pytest.raises(CompileError, match=r"unknown target 'fortran'.*native, wasm"):
        build(examples.loop(), 0.01, target="fortran")


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


class Leaky(Block):
    """Continuous states that fade away."""

    outputs = (Port("y"),)

    def __init__(self, width: int) -> None:
        self.states = (State("x", 1.0, width=width, continuous=True),)
        self.width = width

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.x[0]

    def derivative(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"x": array_of(self.width, lambda i: -x.x[i])}


def test_the_integration_may_fill_the_stack() -> None:
    """Four numbers for each continuous state."""
    for width, fits in ((9_990, True), (10_001, False)):
        d = Diagram("leaky")
        d.add("leaky", Leaky(width))
        d.output("y", "leaky")
        with nullcontext() if fits else pytest.raises(DiagramError, match="stack"):
            assert emit([lower(d, 0.01)])


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

    assert repr(diagram(1.0)) == "<Diagram bound: 1 parts; inputs r; outputs y; parameters k>"
    m = make(diagram(1.0), 0.01).machine()
    assert m.step({"r": 3.0})["y"] == 3.0
    for value in (-1.0, 3.0):
        with pytest.raises(ParameterError, match=r"outside 0 to 2"):
            m.set("k", value)
    with pytest.raises(
        DiagramError, match=r"root\.k: it is bound to 'k', whose default -1\.0 is outside \[0\.0, 2\.0\]"
    ):
        make(diagram(-1.0), 0.01)


def test_a_parameter_bound_to_another_unit_names_both_units() -> None:
    d = Diagram("clash")
    d.input("r")
    d.param("n", 100.0, unit="1/s")
    d.add("low", LowPass(10.0), u="r", params={"cutoff": "n"})
    d.output("y", "low")
    with pytest.raises(DiagramError, match=r"low\.cutoff: it is real \[Hz\], and the parameter 'n' .* is real \[1/s\]"):
        build(d, 0.01)
