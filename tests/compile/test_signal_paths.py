"""Paths: the output of a sub-diagram is a signal, and an unknown name is answered with its nearest neighbours."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from twodof.blocks import Diagram
from twodof.blocks.library import Compare, Constant, Gain, Sum, UnitDelay
from twodof.blocks.reference.interpreter import Reference
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.compile import build
from twodof.compile.linear.linearize import linearize
from twodof.errors import TwodofError

LOG = ("ctl.M", "ctl.pd.u", "ctl.pd.p.y", "ctl.through", "memory.y")


def diagram() -> Diagram:
    """A controller of two levels, switched off while r > 5, whose output M feeds back over `memory`."""
    inner = Diagram("pd")
    inner.input("e")
    inner.add("p", Gain(2.0), u="e")
    inner.output("u", "p")
    controller = Diagram("controller")
    controller.input("r")
    controller.input("theta")
    controller.add("error", Sum("+-"), a="r", b="theta")
    controller.add("pd", inner, e="error")
    controller.output("M", "pd")
    controller.output("through", "r")
    d = Diagram("loop")
    d.input("r")
    d.add("five", Constant(5.0))
    d.add("low", Compare("<="), a="r", b="five")
    d.add("ctl", controller, r="r", theta="memory", enable="low", disabled="reset")
    d.add("memory", UnitDelay(), u="ctl.M")
    d.output("y", "memory")
    return d


MAKERS = [Reference, build]


@pytest.mark.parametrize("make", MAKERS)
def test_the_output_of_a_sub_diagram_is_the_signal_that_drives_it(make: Any) -> None:
    r = np.array([1.0, 3.0, 9.0, 2.0, 1.0])
    out = make(diagram(), 0.1, log=LOG).machine().run(len(r), {"r": r})
    rows = {name: np.ravel(values).tolist() for name, values in out.items()}
    memory, expected = 0.0, []
    for value in r:
        expected.append(2.0 * (value - memory) if value <= 5.0 else 0.0)
        memory = expected[-1]
    assert rows["ctl.M"] == rows["ctl.pd.u"] == rows["ctl.pd.p.y"] == expected
    assert rows["memory.y"] == [0.0, *expected[:-1]]
    assert rows["ctl.through"] == r.tolist()


def test_a_model_is_cut_at_the_output_of_a_sub_diagram() -> None:
    model = linearize(diagram(), 0.1, inputs=["ctl.M"], outputs=["y", "ctl.pd.u"])
    assert (model.a.tolist(), model.b.tolist(), model.c.tolist()) == ([[0.0]], [[1.0]], [[1.0], [-2.0]])
    assert model.d.tolist() == [[0.0], [0.0]]


# What else is named depends on the rooms that have been imported.
TYPES = "unit_delay, delay, "


def wired(*connection: str) -> Callable[[], object]:
    return lambda: diagram().connect(*connection)


def first_error(call: Callable[[], object]) -> str:
    with pytest.raises(TwodofError) as caught:
        call()
    return str(caught.value)


@pytest.mark.parametrize("make", MAKERS)
def test_unknown_paths_are_answered_with_the_same_words_everywhere(make: Any) -> None:
    machine = make(diagram(), 0.1, log=()).machine()
    signals = "five.y, low.y, memory.y"
    near, other = "there are: ctl.M, ctl.pd.u", "there are: ctl.pd.u, ctl.pd.p.y, ctl.M"
    assert [
        first_error(call)
        for call in (
            lambda: make(diagram(), 0.1, log=("ctl.N",)),
            lambda: make(diagram(), 0.1, log=("ctl.pd.M",)),
            lambda: make(diagram(), 0.1, log=("ctl",)),
            lambda: machine.state("memory.y"),
            lambda: machine.set_state("memoy.x", 1.0),
            lambda: machine.step({"R": 1.0}),
            lambda: machine.set("memory.inital", 1.0),
        )
    ] == [
        f"loop: no signal named 'ctl.N' ({near}, ctl.error.y, ctl.pd.p.y, ctl.through, {signals})",
        f"loop: no signal named 'ctl.pd.M' ({other}, ctl.error.y, ctl.through, {signals})",
        f"loop: no signal named 'ctl' (there are: ctl.M, ctl.error.y, ctl.pd.p.y, ctl.pd.u, ctl.through, {signals})",
        "loop: no state named 'memory.y' (there are: memory.x)",
        "loop: no state named 'memoy.x' (there are: memory.x)",
        "loop: no input named 'R' (there are: r)",
        "no parameter named 'memory.inital' (there are: memory.initial, ctl.pd.p.k, five.value)",
    ]


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (wired("ctl.M", "memory.v"), "loop: 'memory' has no input 'v' (inputs: u)"),
        (wired("ctl.M", "memori.u"), "loop: no output or part named 'memori' (there are: memory, five, low, ctl, y)"),
        (wired("ctl.M", "ctl.thata"), "loop: 'ctl' has no input 'thata' (inputs: theta, r)"),
        (
            lambda: diagram().add("g", Gain(), params={"K": "k"}),
            "loop.g: no parameter named 'K' to bind (there are: k)",
        ),
        (
            lambda: from_json(to_json(diagram()).replace('"unit_delay"', '"unitdelay"')),
            f"loop.memory: unknown block type 'unitdelay' (there are those of twodof.blocks.library: {TYPES}",
        ),
    ],
)
def test_an_unknown_name_in_a_diagram_is_answered_with_the_nearest(call: Callable[[], object], text: str) -> None:
    assert first_error(call).startswith(text)
