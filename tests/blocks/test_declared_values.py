"""A declared value is of its kind, or is refused at the door: no compiler ever sees `{0x}` for a whole number."""

import json
import math
from typing import Any

import pytest

from twodof.blocks import Diagram, Param, State
from twodof.blocks.reference.interpreter import Reference
from twodof.blocks.schema.json_form import from_json
from twodof.compile.builder import emit_program
from twodof.errors import DiagramError

INF, NAN = {"float": "inf"}, {"float": "nan"}
NO_WHOLE = (0.5, 1.0, 1e300, True, INF, NAN, "1", None, [1], [], {}, 2**32, 2**40, -(2**31) - 1)
WRONG: dict[str, tuple[Any, ...]] = {
    "real": (True, "1", None, [1.0], [], {}),
    "int32": (*NO_WHOLE, 2**31),
    "uint32": (*NO_WHOLE, -1),
    "bool": (0.5, 1.0, 2, -1, NAN, "true", None, [True], {}),
}
RIGHT: dict[str, tuple[Any, ...]] = {
    "real": (0.5, 1, -1, 2**40, 1e300, INF, NAN),
    "int32": (0, -(2**31), 2**31 - 1),
    "uint32": (0, 2**32 - 1),
    "bool": (True, False, 0, 1),
}
ZERO = {"real": 0.0, "int32": 0, "uint32": 0, "bool": False}


def block(kind: str, node: list[Any], **sections: Any) -> dict[str, Any]:
    """A diagram of one custom block whose output is `node`."""
    made = {"type": "custom", "name": "B", "outputs": [{"name": "y", "kind": kind}], "nodes": [node]}
    part = {"name": "g", "block": made | {"output": {"y": 0}} | sections}
    return {"name": "d", "parts": [part], "outputs": [["y", "g.y"]]}


def places(kind: str, value: Any, **more: Any) -> dict[str, dict[str, Any]]:
    """Diagrams that have `value` as a number of `kind` in each place where one may stand."""
    declared = {"name": "k", "kind": kind, "value": value, **more}
    inner = block(kind, ["param", [], "k"], params=[{"name": "k", "kind": kind, "value": ZERO[kind]}])
    inner["parts"][0]["params"] = {"k": "k"}
    nested = {"name": "e", "parts": [{"name": "s", "diagram": {**inner, "params": [declared]}}]}
    return {
        "of the diagram": {"name": "d", "params": [declared]},
        "of the diagram, bound": {**inner, "params": [declared]},
        "of a sub-diagram": nested,
        "of a block": block(kind, ["param", [], "k"], params=[declared]),
        "an array's": block(
            kind,
            ["const", [], kind, "0x0p+0" if kind == "real" else ZERO[kind]],
            params=[{**declared, "width": 2, "value": [ZERO[kind], value]}],
        ),
        "a state's": block(kind, ["state", [], "k"], states=[{"name": "k", "kind": kind, "initial": value}]),
    }


def load(diagram: dict[str, Any]) -> Diagram:
    return from_json(json.dumps({"schema": "twodof/diagram", "version": 1, "diagram": diagram}))


CASES = [(kind, place) for kind in WRONG for place in places(kind, ZERO[kind])]


@pytest.mark.parametrize(("kind", "place"), CASES)
def test_what_is_not_of_its_kind_is_refused_when_it_is_loaded(kind: str, place: str) -> None:
    taken = []
    for value in WRONG[kind]:
        try:
            load(places(kind, value)[place])
        except DiagramError:
            continue
        taken.append(value)
    assert not taken


@pytest.mark.parametrize(("kind", "place"), CASES)
def test_what_is_of_its_kind_is_loaded_stepped_and_emitted(kind: str, place: str) -> None:
    for value in RIGHT[kind]:
        if value == NAN and place in ("of the diagram, bound", "of a sub-diagram"):
            continue  # it lies within no bounds
        diagram = load(places(kind, value)[place])
        Reference(diagram, 0.01).machine().run(1)
        emit_program(diagram, 0.01)


NUMBERS, WHOLES = ("real", "int32", "uint32"), ("int32", "uint32")
NO_BOUNDS = ({"low": NAN}, {"high": NAN}, {"low": True}, {"high": False}, {"low": 2, "high": 1}, {"low": [1]})
BOUNDS: list[tuple[dict[str, Any], tuple[str, ...], str]] = [
    *((bounds, NUMBERS, "the bound .* is not a number|no value is within") for bounds in NO_BOUNDS),
    *((bounds, NUMBERS, r"1 is outside \[") for bounds in ({"low": 2}, {"high": 0})),
    *((bounds, WHOLES, "whole") for bounds in ({"low": 0.5}, {"high": 2.5})),
]


@pytest.mark.parametrize("place", ["of the diagram", "of a sub-diagram", "of a block"])
def test_bounds_are_numbers_of_the_kind_around_the_default(place: str) -> None:
    for bounds, kinds, message in BOUNDS:
        for kind in kinds:
            with pytest.raises(DiagramError, match=message):
                load(places(kind, 1, **bounds)[place])


def test_the_same_in_python() -> None:
    for kind, value in (("uint32", 0.5), ("uint32", True), ("int32", math.nan), ("bool", 2), ("real", "1")):
        with pytest.raises(DiagramError, match=f"it takes {kind}"):
            Diagram("d").param("k", value, kind=kind)
        with pytest.raises(DiagramError, match=f"it takes {kind}"):
            Param("k", value, kind=kind)
        if not isinstance(value, str):  # the name of a parameter
            with pytest.raises(DiagramError, match=f"it takes {kind}"):
                State("k", value, kind=kind)
    with pytest.raises(DiagramError, match="not a real number"):
        Param("k", 10**400)
    for width in (None, 3):
        with pytest.raises(DiagramError) as caught:
            Diagram("d").param("k", [1.0, 2.0], width=width)
        assert caught.value.where == "d.k"


@pytest.mark.parametrize("value", [2**31, -(2**31) - 1])
def test_a_constant_that_does_not_fit_its_type_is_refused(value: int) -> None:
    with pytest.raises(DiagramError):
        load(block("int32", ["const", [], "int32", value]))
    with pytest.raises(DiagramError):
        load(block("uint32", ["const", [], "uint32", 2**32 if value > 0 else -1]))
