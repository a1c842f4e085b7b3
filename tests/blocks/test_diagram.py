"""Diagram.add: inputs that have the names of its own arguments, and rates that no counter holds."""

from typing import Any

import pytest

from tests.blocks.samples import Counter, Gain
from twodof.blocks import Block, Diagram, Port
from twodof.blocks.reference.interpreter import Reference
from twodof.compile.program.lower import lower
from twodof.errors import DiagramError

NAMES = (
    *("name", "item", "rate", "params", "enable", "reset", "disabled", "position", "inputs"),
    *("enabling", "trigger", "edge", "initial"),
)


class Awkward(Block):
    """Inputs named as the arguments of `add` are: the sum of them weighted by their places."""

    inputs = tuple(Port(n) for n in NAMES)
    outputs = (Port("y"),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return sum(((i + 1.0) * u[n] for i, n in enumerate(NAMES)), 0.0)


def sub() -> Diagram:
    """A sub-diagram with inputs named as the arguments of `add` are."""
    d = Diagram("sub")
    for name in NAMES:
        d.input(name)
    d.add("inner", Awkward(), inputs={n: n for n in NAMES})
    d.output("y", "inner")
    return d


def test_an_input_of_any_name_is_connected() -> None:
    d = Diagram("d")
    for name in NAMES:
        d.input(f"{name}_in")
    d.add("sub", sub(), inputs={n: f"{n}_in" for n in NAMES})
    d.output("y", "sub")
    found = Reference(d, 0.1).machine().step({f"{n}_in": 10.0**i for i, n in enumerate(NAMES)})
    assert found["y"] == sum(place * 10.0 ** (place - 1) for place in range(1, len(NAMES) + 1))


@pytest.mark.parametrize(
    "argument", ["rate", "params", "enable", "reset", "trigger", "edge", "disabled", "enabling", "position"]
)
def test_a_keyword_that_means_another_thing_is_refused_with_the_way_out(argument: str) -> None:
    d = Diagram("d")
    d.input("u", "bool")
    for item in (sub(), Awkward()):
        with pytest.raises(DiagramError, match=rf"inputs={{'{argument}': 'u'}}") as caught:
            d.add("part", item, **{argument: "u"})
        assert caught.value.where == "d.part"
        assert "part" not in d.parts


def test_a_sub_diagram_with_an_input_named_reset_can_be_reset() -> None:
    d = Diagram("d")
    d.input("u")
    d.input("again", "bool")
    d.add("part", sub(), reset="again", inputs=dict.fromkeys(NAMES, "u"))
    assert d.parts["part"].reset == "again"
    assert d.connections["part", "reset"] == "u"


def test_a_block_without_such_an_input_says_what_is_possible() -> None:
    d = Diagram("d")
    with pytest.raises(DiagramError, match=r"a block cannot be reset \(put it into a sub-diagram\)"):
        d.add("gain", Gain(), reset="u")


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"enabling": "afresh"}, "enabling='afresh' is unknown .use one of keep, restart"),
        ({"disabled": "zero"}, "disabled='zero' is unknown .use one of hold, reset"),
        ({"trigger": "u", "edge": "up"}, "edge='up' is unknown .use one of rising, falling, either"),
        ({"edge": "falling"}, "edge='falling' without a trigger"),
    ],
)
def test_a_condition_that_is_none_is_refused(options: dict[str, str], what: str) -> None:
    d = Diagram("d")
    d.input("u", "bool")
    with pytest.raises(DiagramError, match=what):
        d.add("part", Diagram("part"), **options)
    with pytest.raises(DiagramError, match="a block cannot be restarted"):
        d.add("gain", Gain(), u="u", enabling="restart")
    assert not d.parts


def test_rates_that_multiply_without_end_are_refused() -> None:
    """Accept a period beyond the tick's 2^32 (the block runs once); refuse one beyond 2^256."""

    def nested(levels: int) -> Diagram:
        d = Diagram("inner")
        d.add("n", Counter(), rate=(2**30, 1))
        for _ in range(levels):
            outer = Diagram("outer")
            outer.add("part", d, rate=(2**30, 0))
            d = outer
        return d

    assert Reference(nested(2), 0.01).hierarchy.cells[0].rate == (2**90, 2**60)
    for check in (Reference, lower):
        with pytest.raises(DiagramError, match="is impossible") as caught:
            check(nested(40), 0.01)
        assert caught.value.where.startswith("part.part.part")
