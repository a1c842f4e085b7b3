"""The difference of two diagrams: each kind of change named once, nothing else, and none after a round trip."""

from typing import Any

import pytest

from twodof.blocks import Block, Diagram, Port
from twodof.blocks.difference import difference
from twodof.blocks.library import Constant, Gain, LowPass, Sum, UnitDelay
from twodof.blocks.schema.json_form import from_json, to_json


class Double(Block):
    """y = 2 u."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)
    factor = 2.0

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return self.factor * u.u


class Triple(Double):
    """y = 3 u, under the same name in JSON."""

    factor = 3.0


Triple.__name__ = "Double"


def inner(gain: float = 2.0, filtered: bool = False) -> Diagram:
    d = Diagram("inner")
    d.input("u")
    d.add("gain", Gain(gain), u="u")
    d.add("own", Double(), u="gain")
    if filtered:
        d.add("filter", LowPass(5.0), u="own")
    d.output("y", "filter" if filtered else "own")
    return d


def outer(item: Block | Diagram | None = None, **changes: Any) -> Diagram:
    d = Diagram(changes.get("name", "outer"), changes.get("text", ""))
    d.input("u", unit=changes.get("unit", "rad"))
    d.param("k", changes.get("k", 1.5), low=0.0, high=changes.get("high", 3.0), unit="s", text="a gain")
    d.add("pid", item or inner(), u="u")
    d.add("bound", Gain(1.0), params={"k": "k"}, u="pid", rate=changes.get("rate", (1, 0)))
    d.add("sum", Sum("+" + changes.get("sign", "-")), a="u", b=changes.get("b", "bound"), position=changes.get("at"))
    d.output("y", "sum")
    return d


@pytest.mark.parametrize(
    ("after", "said"),
    [
        (outer(), []),
        (outer(name="other", text="said otherwise", at=(3.0, 4.0)), []),
        (outer(k=2.0), ["~ parameter k: 1.5 s, 0 to 3 -> 2.0 s, 0 to 3"]),
        (outer(high=4.0), ["~ parameter k: 1.5 s, 0 to 3 -> 1.5 s, 0 to 4"]),
        (outer(k=1.5000000000000002), ["~ parameter k: 1.5 s, 0 to 3 -> 1.5000000000000002 s, 0 to 3"]),
        (outer(unit="m"), ["~ input u: real rad -> real m"]),
        (outer(sign="+"), ["~ block sum: sum (signs='+-', kind='real') -> sum (signs='++', kind='real')"]),
        (outer(b="pid"), ["~ connection sum.b: from bound.y -> from pid.y"]),
        (outer(rate=(4, 1)), ["~ block bound: gain; k is k -> gain; rate 4, offset 1, k is k"]),
        (outer(inner(gain=2.5)), ["~ parameter pid.gain.k: 2.0 -> 2.5"]),
        (
            outer(inner(filtered=True)),
            [
                "~ output pid.y: from pid.own.y -> from pid.filter.y",
                "+ parameter pid.filter.cutoff: 5.0 Hz, 0 to inf",
                "+ initial value pid.filter.initial: 0.0",
                "+ block pid.filter: low_pass (method='trapezoidal')",
                "+ connection pid.filter.u: from pid.own.y",
            ],
        ),
    ],
)
def test_each_change_is_named_once_and_nothing_else(after: Diagram, said: list[str]) -> None:
    found = difference(outer(), after)
    assert [str(change) for change in found.changes] == said
    assert bool(found) is bool(said)
    assert len(found.to_json()) == len(said)
    back = difference(after, outer())
    assert [(c.what, c.path, c.before, c.after) for c in back.changes] == [
        (c.what, c.path, c.after, c.before) for c in found.changes
    ]


def test_a_sub_diagram_that_comes_or_goes_is_one_change() -> None:
    d = outer()
    d.add("extra", inner(), u="u")
    assert [str(c) for c in difference(outer(), d).changes] == [
        "+ block extra: sub-diagram",
        "+ connection extra.u: from u",
    ]
    assert [c.kind for c in difference(d, outer()).changes] == ["removed", "removed"]


def test_custom_blocks_are_compared_by_what_they_compute() -> None:
    def of(item: Block) -> Diagram:
        d = Diagram("d")
        d.input("u")
        d.add("own", item, u="u")
        d.output("y", "own")
        return d

    (change,) = difference(of(Double()), of(Triple())).changes
    assert (change.what, change.path) == ("block", "own")
    assert change.before != change.after
    assert not difference(of(Double()), from_json(to_json(of(Double()))))


def test_enable_reset_and_long_arrays_count() -> None:
    def of(values: list[float], enable: str | None = None) -> Diagram:
        d = Diagram("d")
        d.input("on", "bool")
        d.add("array", Constant(values, width=len(values)))
        part = Diagram("part")
        part.input("u")
        part.add("delay", UnitDelay(0.0), u="u")
        part.output("y", "delay")
        d.add("source", Constant(1.0))
        d.add("part", part, enable=enable, u="source")
        d.output("y", "part")
        return d

    long = [0.0] * 40
    (change,) = difference(of(long), of([*long[:-1], 1.0])).changes
    assert change.what == "parameter"
    assert "and 32 more" in change.before
    assert change.before != change.after
    (change,) = difference(of(long), of(long, "on")).changes
    assert str(change) == "~ block part: sub-diagram -> sub-diagram; enabled by on"
    later = of(long, "on")
    later.parts["part"].enabling, later.parts["part"].trigger = "restart", "on"
    (change,) = difference(of(long, "on"), later).changes
    assert change.after == "sub-diagram; enabled by on, at rising edges of on, starts afresh when enabled again"
