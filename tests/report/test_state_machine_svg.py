"""Drawings of state machines measured: nothing overlaps, each transition is drawn and told, and texts fit."""

import itertools
import random
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.compile.machine_cases import Arrays, array_case
from tests.compile.random_machines import machine_block, random_table
from twodof.blocks.schema import from_json, to_json
from twodof.blocks.state_machine import StateMachine
from twodof.drawing.text_width import text_width
from twodof.report.state_machine_svg import NAME, SMALL, ModeBox, draw_machine, machine_at, machine_svg

MACHINES = {
    "arrays": Arrays,
    **{f"random{k}": lambda k=k: machine_block(random_table(random.Random(k))) for k in range(12)},
}


def within(inner: ModeBox, outer: ModeBox) -> bool:
    return (
        outer.x < inner.x
        and outer.y + outer.head <= inner.y
        and inner.x + inner.width < outer.x + outer.width
        and inner.y + inner.height < outer.y + outer.height
    )


def apart(a: ModeBox, b: ModeBox) -> bool:
    return a.y + a.height < b.y or b.y + b.height < a.y


@pytest.mark.parametrize("name", MACHINES)
def test_boxes_stand_apart_or_inside_and_texts_fit(name: str) -> None:
    machine: StateMachine = MACHINES[name]()
    drawing = draw_machine(machine)
    around = {leaf.mode.name: leaf.outer for leaf in machine.chart.leaves}
    for (one, a), (other, b) in itertools.combinations(drawing.boxes.items(), 2):
        outer = {one: around.get(one), other: around.get(other)}
        if outer[other] is a.mode:
            assert within(b, a)
        elif outer[one] is b.mode:
            assert within(a, b)
        else:
            assert apart(a, b), (one, other)
    for box in drawing.boxes.values():
        assert text_width(box.mode.name, NAME, True) < box.width
        assert all(text_width(line, SMALL) < box.width for line in box.lines)
        assert box.head >= 16.0 * (1 + len(box.lines))


@pytest.mark.parametrize("name", MACHINES)
def test_each_transition_has_its_own_lane(name: str) -> None:
    machine: StateMachine = MACHINES[name]()
    drawing = draw_machine(machine)
    assert [line.number for line in drawing.lines] == list(range(len(machine.chart.transitions)))
    heights = [height for line in drawing.lines for height in (line.start, line.stop)]
    assert len(set(heights)) == len(heights)
    for line, t in zip(drawing.lines, machine.chart.transitions, strict=True):
        for name_, height, edge in ((t.source, line.start, line.left), (t.target, line.stop, line.right)):
            box = drawing.boxes[name_]
            assert box.y < height < box.y + box.head
            assert edge == box.x + box.width
        assert drawing.label_x + text_width(line.label, SMALL) < drawing.lanes_x
        before = [s for s in machine.chart.transitions[: line.number] if s.source == t.source]
        assert line.label.startswith(f"{len(before) + 1}: ")
    for a, b in itertools.combinations(drawing.lines, 2):
        if a.lane == b.lane:
            (p, q), (r, s) = sorted((a.start, a.stop)), sorted((b.start, b.stop))
            assert q < r or s < p


def test_the_picture_is_xml_and_survives_a_file() -> None:
    diagram = array_case(1).diagram
    machine = machine_at(diagram, "inner.machine")
    assert machine is not None
    assert machine_at(diagram, "inner") is None
    text = machine_svg(machine, "inner.machine")
    words = [e.text for e in ElementTree.fromstring(text).iter() if e.tag.endswith("}text")]
    assert "around (H)" in words
    assert "1: (u.b > 2) | (t.elapsed > 4)" in words
    assert "1: always" in words
    loaded = machine_at(from_json(to_json(diagram)), "inner.machine")
    assert loaded is not None
    again = [
        e.text for e in ElementTree.fromstring(machine_svg(loaded, "inner.machine")).iter() if e.tag.endswith("}text")
    ]
    assert set(again) == set(words) - {Arrays.__doc__}


def test_picture_in_the_documentation_is_current() -> None:
    docs = Path(__file__).resolve().parents[2] / "docs"
    code = re.search(r"```python\n(.*?)```", (docs / "how-to" / "write-a-state-machine.md").read_text(), re.DOTALL)
    assert code is not None
    names = {"__name__": "page"}
    exec(code[1], names)  # of our own page
    made: Callable[[], StateMachine] = names["ModeLogic"]  # type: ignore[assignment]
    shown = (docs / "pictures" / "mode-logic.svg").read_text()
    assert machine_svg(made(), "modes").partition("</style>")[2] == shown.partition("</style>")[2]
