"""Many instances of one program: values of their own, the bits of single machines, and what is refused."""

from typing import Any

import numpy as np
import pytest

from twodof.blocks import Block, Diagram, Param, Port, State
from twodof.blocks.reference import Reference
from twodof.compile import build
from twodof.compile.machine import Instances
from twodof.errors import CompileError, DiagramError, ParameterError


class Turned(Block):
    """A sum of matrices, with a gain."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)
    params = (Param("gain", 1.0, high=9.0), Param("m", [[1.0, 2.0], [3.0, 4.0]], shape=(2, 2)))
    states = (State("x", 0.0, shape=(2, 2)),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return p.gain * u.u + x.x[0, 1]

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"x": x.x + p.m}


def diagram() -> Diagram:
    d = Diagram("turned")
    d.input("u")
    d.add("part", Turned(), u="u")
    d.output("y", "part")
    return d


def test_each_instance_runs_as_a_machine_of_its_own() -> None:
    program = build(diagram(), 0.01)
    two = Instances(program, 2)
    two.set_many({"part.gain": [2.0, 3.0], "part.m": [[0.0, 1.0], [2.0, 3.0]]})  # one matrix for both
    two.set_state("part.x", [np.zeros((2, 2)), np.ones((2, 2))])
    assert two.get("part.m").tolist() == 2 * [[[0.0, 1.0], [2.0, 3.0]]]
    u = np.arange(6.0).reshape(3, 2)
    found = two.run(3, {"u": u})["y"]
    assert found.tolist() == [[0.0, 4.0], [5.0, 11.0], [10.0, 18.0]]
    two.skip(1)
    assert two.state("part.x")[:, 0, 1].tolist() == [4.0, 5.0]


def test_instances_refuse_values_of_another_number() -> None:
    program = build(diagram(), 0.01)
    two = Instances(program, 2)
    for columns in (1, 3):
        with pytest.raises(DiagramError, match=f"{columns} values for 2 instances"):
            two.run(4, {"u": np.ones((4, columns))})
        with pytest.raises(DiagramError, match=f"{columns} values for 2 instances"):
            two.set("part.gain", columns * [1.0])
    with pytest.raises(DiagramError, match="-1 is not a possible number of steps"):
        two.skip(-1)
    with pytest.raises(DiagramError, match="0 instances"):
        Instances(program, 0)
    with pytest.raises(CompileError, match="need a C compiler"):
        Instances(Reference(diagram(), 0.01), 2)


def test_a_refused_parameter_changes_no_instance() -> None:
    two = Instances(build(diagram(), 0.01), 2)
    with pytest.raises(ParameterError, match="outside"):
        two.set("part.gain", [2.0, 10.0])
    assert two.get("part.gain").tolist() == [1.0, 1.0]
