"""Rerun gives the numbers of `machine.run`, bit by bit, and refuses what that refuses."""

import numpy as np
import pytest

from twodof.blocks import Diagram
from twodof.blocks.library import FirstOrder
from twodof.compile import CompiledMachine, build
from twodof.compile.rerun import Rerun
from twodof.errors import DiagramError, ParameterError

U = np.random.default_rng(1).standard_normal(200)


def machine(precision: str = "float64") -> CompiledMachine:
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
    rerun = Rerun(machine(precision), U.size, {"u": U}, ["y"])
    for gain in (1.0, 3.3, 3.3, 0.0, 7.0):
        fresh = machine(precision)
        fresh.set("gain", gain)
        assert (rerun.run({"gain": gain})["y"] == fresh.run(U.size, {"u": U})["y"]).all()


def test_what_is_refused_leaves_the_parameters() -> None:
    rerun = Rerun(machine(), U.size, {"u": U}, ["y"])
    before = rerun.run({"gain": 2.0})["y"].copy()
    for wrong in (11.0, -1.0, float("nan")):
        with pytest.raises(ParameterError, match="outside 0 to 10"):
            rerun.run({"gain": wrong})
    with pytest.raises(ParameterError, match="no parameter 'gian'"):
        rerun.run({"gian": 1.0})
    assert (rerun.run({})["y"] == before).all()
    with pytest.raises(DiagramError, match="no scalar output"):
        Rerun(machine(), U.size, {"u": U}, ["z"])
    with pytest.raises(DiagramError, match="no input"):
        Rerun(machine(), U.size, {"v": U}, ["y"])
    with pytest.raises(DiagramError, match="values for 200 steps"):
        Rerun(machine(), U.size, {"u": U[:-1]}, ["y"])
