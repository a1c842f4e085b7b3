"""Stepper and Rerun give the bits of `CompiledMachine.step` and `.run`, and refuse what these refuse."""

from typing import Any

import numpy as np
import pytest

from twodof.blocks import Diagram
from twodof.blocks.library import FirstOrder, Gain
from twodof.compile import CompiledProgram, build
from twodof.compile.machine import CompiledMachine, Rerun, Stepper
from twodof.errors import DiagramError, ParameterError
from twodof.flight.core import OUTPUTS, core
from twodof.flight.declarations import FAILSAFE_INPUTS as SAFETY_INPUTS
from twodof.flight.declarations import INPUTS
from twodof.flight.failsafe.diagram import OUTPUTS as SAFETY_OUTPUTS
from twodof.signals import PERIOD

pytestmark = pytest.mark.slow

KINDS = {name: kind for name, kind, *_ in (*INPUTS, *SAFETY_INPUTS)}
NAMES = [name for name, *_ in (*OUTPUTS, *SAFETY_OUTPUTS)]


def machine(diagram: Diagram, precision: str = "float64", target: str = "native") -> CompiledMachine:
    program = build(diagram, PERIOD, precision, target=target)
    assert isinstance(program, CompiledProgram)
    return program.machine()


def random_values(rng: np.random.Generator, names: list[str]) -> list[Any]:
    def value(kind: str) -> Any:
        if kind == "bool":
            return bool(rng.random() < 0.8)
        if kind == "int32":
            return int(rng.integers(0, 6))
        return float(rng.choice([np.nan, 0.0, -0.0, 1e-310, 1e300])) if rng.random() < 0.05 else rng.standard_normal()

    return [value(KINDS[name]) for name in names]


@pytest.mark.long
@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("target", ["native", "wasm"])
def test_the_flight_code_steps_as_by_name(target: str, precision: str) -> None:
    rng = np.random.default_rng(1)
    inputs, outputs = list(KINDS), list(NAMES)
    rng.shuffle(inputs)
    rng.shuffle(outputs)
    by_name, by_place = (machine(core(failsafe=True), precision, target) for _ in range(2))
    stepper = Stepper(by_place, inputs, outputs)
    for _ in range(300):
        values = random_values(rng, inputs)
        with np.errstate(over="ignore"):
            expected = by_name.step(dict(zip(inputs, values, strict=True)))
        got = stepper.step(values)
        assert repr(got) == repr(tuple(expected[name] for name in outputs))
    for struct in "SUY":
        assert by_place.instance.structs[struct].tobytes() == by_name.instance.structs[struct].tobytes()


def test_a_peek_gives_the_next_outputs_and_advances_nothing() -> None:
    rng = np.random.default_rng(2)
    made = machine(core())
    names = [name for name, *_ in INPUTS]
    stepper = Stepper(made, names, ["theta", "M"])
    for _ in range(50):
        values = random_values(rng, names)
        stepper.run(0, values)
        before = made.instance.structs["S"].tobytes()
        seen = [stepper.peek() for _ in range(2)]
        assert made.instance.structs["S"].tobytes() == before
        assert repr([stepper.step(values)] * 2) == repr(seen)


def test_names_that_are_not_there_arrays_and_inputs_left_out_are_refused() -> None:
    d = Diagram("d")
    d.input("a")
    d.input("b", width=2)
    d.add("gain", Gain(2.0), u="a")
    d.output("y", "gain")
    d.output("wide", "b")
    made = machine(d)
    with pytest.raises(DiagramError, match="left out"):
        Stepper(made, ["a"], ["y"])
    with pytest.raises(DiagramError, match="no scalar named 'b'"):
        Stepper(made, ["a", "b"], ["y"])
    flight = machine(core())
    names = [name for name, *_ in INPUTS]
    with pytest.raises(DiagramError, match="no scalar named 'z'"):
        Stepper(flight, names, ["z"])
    with pytest.raises(DiagramError, match="no scalar named 'z'"):
        Stepper(flight, [*names, "z"], ["theta"])


U = np.random.default_rng(1).standard_normal(200)


def lag(precision: str = "float64") -> CompiledMachine:
    diagram = Diagram("motor")
    diagram.input("u")
    diagram.param("gain", 1.0, low=0.0, high=10.0)
    diagram.add("lag", FirstOrder(time_constant=0.1), u="u", params={"gain": "gain"})
    diagram.output("y", "lag")
    made = build(diagram, 0.01, precision).machine()
    assert isinstance(made, CompiledMachine)
    return made


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_each_run_is_that_of_a_fresh_machine(precision: str) -> None:
    rerun = Rerun(lag(precision), U.size, {"u": U}, ["y"])
    for gain in (1.0, 3.3, 3.3, 0.0, 7.0):
        fresh = lag(precision)
        fresh.set("gain", gain)
        assert (rerun.run({"gain": gain})["y"] == fresh.run(U.size, {"u": U})["y"]).all()


def test_what_is_refused_leaves_the_parameters() -> None:
    rerun = Rerun(lag(), U.size, {"u": U}, ["y"])
    before = rerun.run({"gain": 2.0})["y"].copy()
    for wrong in (11.0, -1.0, float("nan")):
        with pytest.raises(ParameterError, match="outside 0 to 10"):
            rerun.run({"gain": wrong})
    with pytest.raises(ParameterError, match="no parameter named 'gian'"):
        rerun.run({"gian": 1.0})
    assert (rerun.run({})["y"] == before).all()
    with pytest.raises(DiagramError, match="no scalar output"):
        Rerun(lag(), U.size, {"u": U}, ["z"])
    with pytest.raises(DiagramError, match="no input"):
        Rerun(lag(), U.size, {"v": U}, ["y"])
    with pytest.raises(DiagramError, match="for 200 steps"):
        Rerun(lag(), U.size, {"u": U[:-1]}, ["y"])
