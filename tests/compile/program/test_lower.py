"""Refusals of contradictions, by lowering and by the reference, and the order of signals."""

import re
from collections.abc import Callable
from typing import Any

import pytest

from tests.compile import examples
from twodof.blocks import Block, Diagram
from twodof.blocks.library import CompareToConstant, DataStore, FirstOrder, Gain, StoreRead, StoreWrite
from twodof.blocks.reference import Reference
from twodof.compile.program.lower import lower
from twodof.errors import DiagramError

pytestmark = pytest.mark.slow


def within(fault: Callable[[Diagram], None]) -> Diagram:
    """The faulty diagram as the sub-diagram `sub` of another."""
    inner = Diagram("inner")
    inner.input("u")
    inner.output("y", "u")
    fault(inner)
    outer = Diagram("outer")
    outer.input("u")
    outer.add("sub", inner, u="u")
    outer.output("y", "sub.y")
    return outer


def starting(initial: Any) -> Callable[[Diagram], None]:
    """A held output that starts at something."""

    def fault(d: Diagram) -> None:
        inner = Diagram("inner")
        inner.input("u")
        inner.add("gain", Gain(), u="u", initial={"y": 1.0})
        inner.output("y", "gain")
        inner.output("through", "u")
        d.add("part", inner, u="u", initial=initial)

    return fault


def stores(*parts: Block, kind: str = "real", wired: bool = False) -> Callable[[Diagram], None]:
    """A data store `cell`, wired or not, and parts beside it."""

    def fault(d: Diagram) -> None:
        d.add("cell", DataStore(0, kind), inputs={"u": "u"} if wired else None)
        for i, part in enumerate(parts):
            d.add(f"part{i}", part, inputs={"u": "u"} if isinstance(part, StoreWrite) else None)

    return fault


def enabled_in_enabled(values: dict[str, Any]) -> Callable[[Diagram], None]:
    """A part that is reset to `values`, around one whose output is reset to 3."""

    def fault(d: Diagram) -> None:
        parts = [Diagram("inner"), Diagram("around")]
        for inner in parts:
            inner.input("u")
            inner.add("on", CompareToConstant(">", 0.0), u="u")
            inner.output("through", "u")
        parts[0].add("gain", Gain(), u="u")
        parts[0].output("y", "gain")
        parts[1].add("inner", parts[0], u="u", enable="on", disabled={"y": 3.0})
        parts[1].output("y", "inner.y")
        d.add("on", CompareToConstant(">", 0.0), u="u")
        d.add("part", parts[1], u="u", enable="on", disabled=values)

    return fault


REFUSED = [
    (stores(), "cell.u", r"the input u is not connected \(connect it, or add StoreWrite\(\"cell\"\)\)"),
    (stores(StoreRead("elsewhere"), wired=True), "part0.u", "no data store 'elsewhere' here or in a diagram around it"),
    (stores(StoreWrite("elsewhere"), wired=True), "part0", "no data store 'elsewhere' here or in a diagram around it"),
    (stores(StoreWrite("cell"), StoreWrite("cell")), "part1", "sub.cell is written by sub.part0 too"),
    (stores(StoreWrite("cell"), wired=True), "part0", "sub.cell is written by u too"),
    (stores(StoreWrite("cell"), kind="int32"), "cell.u", "it takes int32 and sub.part0.y"),
    (stores(StoreRead("cell"), StoreWrite("cell", "int32"), kind="int32"), "part0.u", "it takes real and sub.cell.y"),
    (starting({"y": 2.0}), "part.gain.y", "sub.part.gain.y starts at 2.0 and at 1.0"),
    (starting({"y": [1.0, 2.0]}), "part.y", "it takes real"),
    (starting({"y": True}), "part.y", "bool"),
    (starting({"through": 0.0}), "part.through", "no part inside computes this output"),
    (enabled_in_enabled({"y": 2.0}), "part.*y", "gain.y is reset to (3.0 and to 2.0|2.0 and to 3.0)"),
    (enabled_in_enabled({"y": [1.0, 2.0]}), "part.*y", "it takes real"),
    (enabled_in_enabled({"through": 0.0}), "part.*through", "no part inside computes this output"),
]


@pytest.mark.parametrize(("fault", "where", "what"), REFUSED)
@pytest.mark.parametrize("read", [lower, Reference])
def test_contradictions_are_refused_with_their_path(
    read: Callable[..., Any], fault: Callable[[Diagram], None], where: str, what: str
) -> None:
    with pytest.raises(DiagramError, match=what) as caught:
        read(within(fault), 0.01)
    assert re.fullmatch(rf"sub\.{where}", caught.value.where)
    assert caught.value.remedy


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"initial": {"z": 1.0}}, "no output named 'z' to start"),
        ({"enable": "on", "disabled": {"z": 1.0}}, "no output named 'z' to reset"),
        ({"disabled": {"y": 1.0}}, "has values for disabled=, and is never disabled"),
        ({"enable": "on", "disabled": "off"}, "disabled='off'"),
    ],
)
def test_values_of_unknown_outputs_are_refused(options: dict[str, Any], what: str) -> None:
    inner = Diagram("inner")
    inner.input("u")
    inner.output("y", "u")
    d = Diagram("d")
    d.input("u")
    d.input("on", "bool")
    with pytest.raises(DiagramError, match=what) as caught:
        d.add("part", inner, u="u", **options)
    assert caught.value.where == "d.part"


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"dt": 0.0}, "dt"),
        ({"dt": float("nan")}, "dt"),
        ({"dt": 0.01, "integrator": "magic"}, "integrator"),
        ({"dt": 0.01, "log": ("sum.z",)}, "no signal"),
    ],
)
def test_wrong_options_are_refused(options: dict[str, Any], what: str) -> None:
    with pytest.raises(DiagramError, match=what):
        lower(examples.loop(), **options)


def test_an_output_that_leads_back_to_itself_is_refused() -> None:
    inner = Diagram("inner")
    inner.input("u")
    inner.output("y", "u")
    d = Diagram("outer")
    d.add("a", inner, u="b")
    d.add("b", inner, u="a")
    d.output("y", "a")
    with pytest.raises(DiagramError, match="leads back to itself"):
        lower(d, 0.01)


def test_feedback_through_another_port_is_no_loop() -> None:
    """Feed-through is a matter of ports: the pendulum's angle does not depend on its moment in the same tick."""
    flat = lower(examples.loop(), 0.01)
    order = [s.path for g in flat.tick for a in g.actions for s in a.signals]
    assert order.index("pendulum.theta") < order.index("held.y") < order.index("error.y") < order.index("sum.y")


def test_unneeded_signals_are_not_computed() -> None:
    d = Diagram("idle")
    d.input("u")
    d.add("unused", Gain(), u="u")
    d.add("used", Gain(), u="u")
    d.output("y", "used")
    d.add("first", FirstOrder(1.0, 0.1), u="used")  # the integration alone reads it
    d.add("second", FirstOrder(1.0, 0.1), u="first")
    d.output("z", "second")
    flat = lower(d, 0.01)
    assert {s.path for g in flat.tick for a in g.actions for s in a.signals} == {"used.y", "second.y"}


@pytest.mark.long
def test_thousands_of_blocks_can_stand_in_a_row() -> None:
    d = Diagram("deep")
    d.input("u")
    last = "u"
    for k in range(3000):
        d.add(f"g{k}", Gain(), u=last)
        last = f"g{k}"
    d.output("y", last)
    assert len(lower(d, 0.01).tick[0].actions) == 3000
