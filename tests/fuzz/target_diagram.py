"""Diagram files: a diagram that is written as it was read, or a DiagramError."""

from tests.fuzz.target import Target
from twodof.blocks import Diagram
from twodof.blocks.library import Constant, Gain
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.errors import DiagramError


def seeds() -> list[bytes]:
    """A small diagram, and what stands in one."""
    d = Diagram("seed")
    d.add("a", Constant(1.0))
    d.add("b", Gain(2.0))
    d.connect("a", "b")
    return [to_json(d).encode(), b'{"schema": "twodof-diagram", "version": 1, "diagram": {}}']


def attempt(data: bytes) -> None:
    """Loaded, and what was loaded written and loaded again."""
    try:
        found = from_json(data)
    except DiagramError:
        return
    text = to_json(found)
    assert to_json(from_json(text)) == text


TARGET = Target("diagram", seeds, attempt, 4000)
