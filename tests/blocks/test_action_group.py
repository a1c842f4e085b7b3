"""Refusals of action groups; their function is tested in tests/compile/semantics.py."""

from typing import Any

import pytest

from twodof.blocks import Diagram
from twodof.blocks.action_group import action_group
from twodof.blocks.library import Gain, Norm
from twodof.blocks.reference.interpreter import Reference
from twodof.errors import DiagramError


def action(name: str, output: str = "y", width: int | None = None, unit: str = "") -> Diagram:
    d = Diagram(name)
    d.input("u", width=width, unit=unit)
    d.add("gain", Gain(width=width), u="u")
    d.output(output, "gain")
    return d


def broken() -> Diagram:
    d = action("broken")
    d.outputs["y"] = None
    return d


@pytest.mark.parametrize(
    ("actions", "options", "complaint"),
    [
        ({}, {}, "give one or more"),
        ({"otherwise": action("a")}, {"otherwise": action("b")}, "the actions are otherwise"),
        ({"a": action("a"), "b": action("b", "z")}, {}, "b has the outputs z, and a y"),
        (
            {"a": action("a"), "b": action("b", width=3)},
            {},
            r"two actions have an input 'u', of real \[\] and real\[3\]",
        ),
        ({"a": action("a", unit="m"), "b": action("b", unit="s")}, {}, r"real \[m\] and real \[s\]"),
        ({"a": action("a")}, {"values": {"b": [1]}}, "give values for a"),
        ({"a": action("a")}, {"values": {"a": []}}, "number of values"),
        ({"a": action("a")}, {"initial": {"z": 1.0}}, "no output named 'z'"),
        ({"choice": action("a")}, {}, "choice"),
        ({"a": action("a"), "b": broken()}, {}, "group.b.y: the output y is not connected"),
    ],
)
def test_what_cannot_be_chosen_from_is_refused(actions: dict[str, Diagram], options: Any, complaint: str) -> None:
    with pytest.raises(DiagramError, match=complaint) as caught:
        action_group("group", actions, **options)
    assert caught.value.remedy


def test_an_action_may_read_a_matrix() -> None:
    size = Diagram("size")
    size.input("m", shape=(2, 2))
    size.add("norm", Norm(shape=(2, 2)), u="m")
    size.output("y", "norm")
    d = Diagram("d")
    d.input("on", "bool")
    d.input("m", shape=(2, 2))
    d.add("group", action_group("group", {"on": size}), if_on="on", m="m")
    d.output("y", "group.y")
    machine = Reference(d, 0.01).machine()
    assert machine.step({"on": True, "m": [[3.0, 0.0], [0.0, 4.0]]})["y"] == 5.0
