"""One interface for a running program: the same rules and words from the interpreter and from compiled code."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from twodof.blocks import Block, Diagram, Param, Port, State
from twodof.blocks.machine import Machine
from twodof.blocks.reference import Reference
from twodof.compile import build
from twodof.errors import DiagramError, ParameterError


class Whole(Block):
    """Adds integer parameters of both types, and counts."""

    inputs = (Port("u"), Port("pair", "real", 2))
    outputs = (Port("y"), Port("n", "int32"))
    states = (State("n", 0, "int32"),)
    params = (
        Param("signed", 0, "int32"),
        Param("unsigned", 0, "uint32"),
        Param("gain", 1.0, low=0.0, high=2.0),
        Param("fixed", 1.0, tunable=False),
    )

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"y": u.u * p.gain + u.pair[0] + p.fixed, "n": x.n + p.signed}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"n": x.n + 1}


def diagram() -> Diagram:
    d = Diagram("whole")
    d.input("u")
    d.input("pair", "real", 2)
    d.add("count", Whole(), u="u", pair="pair")
    d.output("y", "count.y")
    d.output("n", "count.n")
    return d


MAKERS: dict[str, Callable[[], Machine]] = {
    "reference": lambda: Reference(diagram(), 0.01).machine(),
    "native": lambda: build(diagram(), 0.01).machine(),
}


@pytest.mark.parametrize("make", MAKERS.values(), ids=list(MAKERS))
def test_every_machine_refuses_the_same_with_the_same_words(make: Callable[[], Machine]) -> None:
    machine = make()
    assert isinstance(machine, Machine)
    machine.step({"u": 1.0, "pair": [1.0, 2.0]})
    for path, value, said in (
        ("count.signed", 2**31, r"count.signed: 2147483648 is outside -2147483648 to 2147483647"),
        ("count.unsigned", -1, r"count.unsigned: -1 is outside 0 to 4294967295"),
        ("count.signed", np.int64(-(2**40)), "is outside"),
        ("count.signed", 2**32 + 3, "is outside"),
        ("count.signed", [1], "count.signed: "),
        ("count.signed", 2.5, "count.signed: "),
        ("count.gain", 2.5, r"count.gain: 2.5 is outside 0 to 2"),
        ("count.gain", float("nan"), "nan is outside"),
        ("count.gain", "much", "it takes real, not the text .much. .give a number"),
        ("count.fixed", 2.0, "it is fixed while the diagram runs"),
        ("count.gian", 2.0, "no parameter named 'count.gian'.*there are: count.gain"),
    ):
        before = machine.get("count.gain"), machine.get("count.signed")
        with pytest.raises(ParameterError, match=said):
            machine.set_many({"count.gain": 1.5, path: value})
        assert np.all(np.asarray(before) == np.asarray((machine.get("count.gain"), machine.get("count.signed"))))
    for wrong, said in (
        (lambda: machine.state("count.m"), "no state named 'count.m'"),
        (lambda: machine.set_state("count.n", 0.5), "it takes int32"),
        (lambda: machine.step({"v": 1.0}), "no input named 'v'.*there are: u, pair"),
        (lambda: machine.run(5, {"u": [1.0, 2.0]}), "u: "),
        (lambda: machine.run(2, {"u": ["a", "b"]}), "u: an array of <U1"),
        (lambda: machine.step({"u": "1"}), "u: "),
        *((lambda n=n: machine.run(n), "is not a possible number of steps") for n in (-1, 1.5, None, True, 10**12)),
    ):
        with pytest.raises(DiagramError, match=said):
            wrong()


def test_every_machine_takes_the_same_values() -> None:
    results = []
    for make in MAKERS.values():
        machine = make()
        machine.set_many({"count.signed": -(2**31), "count.unsigned": 2**32 - 1, "count.gain": np.float64(2.0)})
        machine.set_state("count.n", 7)
        rows = machine.run(4, {"u": np.arange(4.0), "pair": 0.5})
        results.append([np.asarray(rows[name]).reshape(4, -1)[:, 0].tolist() for name in ("y", "n")])
        assert np.all(np.asarray(machine.state("count.n")) == 11)
        assert machine.tick == 4
    assert results[0] == [[1.5, 3.5, 5.5, 7.5], [7 - 2**31 + k for k in range(4)]]
    assert results[1] == results[0]
