"""What a faulty diagram is told, with the whole path; what order and hoisting give."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.compile import examples
from twodof.blocks import Block, Diagram, Param, Port
from twodof.blocks.library import (
    CompareToConstant,
    DataStore,
    FractionalDelay,
    Gain,
    Integrator,
    StoreRead,
    StoreWrite,
    Sum,
    UnitDelay,
)
from twodof.blocks.reference import Reference
from twodof.compile.program.lower import lower
from twodof.errors import DiagramError

pytestmark = pytest.mark.slow


class Moment(Block):
    """An output in N m."""

    outputs = (Port("y", unit="N m"),)
    params = (Param("k", 1, kind="int32"),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return 1.0


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


def algebraic(d: Diagram) -> None:
    d.add("sum", Sum("+-"), a="u", b="gain")
    d.add("gain", Gain(), u="sum")


def unconnected(d: Diagram) -> None:
    d.add("gain", Gain())


def of_another_type(d: Diagram) -> None:
    d.add("count", examples.Counter())
    d.add("gain", Gain(), u="count.n")


def of_another_width(d: Diagram) -> None:
    d.add("rotate", examples.Rotate())
    d.add("gain", Gain(), u="rotate.a")


def of_another_unit(d: Diagram) -> None:
    d.add("moment", Moment())
    d.add("sum", examples.LimitedIntegrator(), u="moment")


def without_crossing(d: Diagram) -> None:
    d.add("slow", UnitDelay(), u="u", rate=(4, 0))
    d.add("gain", Gain(), u="slow")


def continuous_and_slow(d: Diagram) -> None:
    d.add("gain", Gain(0.5), u="slow", rate=(2, 0))
    d.add("slow", Integrator(), u="gain", rate=(2, 0))


def edged_and_slow(d: Diagram) -> None:
    d.add("gain", Gain(0.5), u="slow", rate=(2, 0))
    d.add("slow", FractionalDelay(0.1), u="gain", rate=(2, 0))


def enabled_by_a_real(d: Diagram) -> None:
    inner = Diagram("inner")
    inner.add("count", examples.Counter())
    d.add("part", inner, enable="u")


def bound_to_nothing(d: Diagram) -> None:
    d.add("gain", Gain(), u="u", params={"k": "nobody"})


def bound_to_another_type(d: Diagram) -> None:
    d.param("k", 1.0)
    d.add("moment", Moment(), params={"k": "k"})


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


@pytest.mark.parametrize(
    ("fault", "where", "what"),
    [
        (stores(), "cell.u", r"the input is not connected \(connect it, or add StoreWrite\(\"cell\"\)\)"),
        (stores(StoreRead("elsewhere"), wired=True), "part0.u", "there is no data store 'elsewhere' around it"),
        (stores(StoreWrite("elsewhere"), wired=True), "part0", "there is no data store 'elsewhere' around it"),
        (stores(StoreWrite("cell"), StoreWrite("cell")), "part1", "sub.cell is written by sub.part0 too"),
        (stores(StoreWrite("cell"), wired=True), "part0", "sub.cell is written by u too"),
        (stores(StoreWrite("cell"), kind="int32"), "cell.u", "it takes int32 and sub.part0.y"),
        (
            stores(StoreRead("cell"), StoreWrite("cell", "int32"), kind="int32"),
            "part0.u",
            "it takes real and sub.cell.y",
        ),
    ],
)
@pytest.mark.parametrize("read", [lower, Reference])
def test_a_data_store_without_one_writer_is_refused(
    read: Callable[..., Any], fault: Callable[[Diagram], None], where: str, what: str
) -> None:
    with pytest.raises(DiagramError, match=what) as caught:
        read(within(fault), 0.01)
    assert caught.value.where == f"sub.{where}"


def without_source(d: Diagram) -> None:
    d.output("z")


@pytest.mark.parametrize(
    ("fault", "where", "what"),
    [
        (algebraic, "outer", r"algebraic loop sub\.gain\.y <- sub\.sum\.y <- sub\.gain\.y"),
        (unconnected, "sub.gain.u", "not connected"),
        (of_another_type, "sub.gain.u", "int32"),
        (of_another_width, "sub.gain.u", r"real\[3\]"),
        (of_another_unit, "sub.sum.u", r"\[N m\]"),
        (without_crossing, "sub.gain.u", "runs at"),
        (continuous_and_slow, "sub.slow", "continuous states"),
        (edged_and_slow, "sub.slow", "edge"),
        (enabled_by_a_real, "sub.part", "not a bool"),
        (bound_to_nothing, "sub.gain", "no parameter 'nobody'"),
        (bound_to_another_type, "sub.moment.k", "another type"),
        (without_source, "sub.z", "not connected"),
    ],
)
def test_a_fault_is_named_with_its_path(fault: Callable[[Diagram], None], where: str, what: str) -> None:
    with pytest.raises(DiagramError, match=what) as caught:
        lower(within(fault), 0.01)
    assert caught.value.where == where
    assert caught.value.remedy


@pytest.mark.parametrize(
    ("initial", "where", "what"),
    [
        ({"y": 2.0}, "gain.y", r"sub.part.gain.y starts at 2.0 and at 1.0"),
        ({"y": [1.0, 2.0]}, "y", "it takes real"),
        ({"y": True}, "y", "bool"),
        ({"y": "1"}, "y", "it takes real"),
        ({"through": 0.0}, "through", "nothing inside computes it"),
    ],
)
@pytest.mark.parametrize("read", [lower, Reference])
def test_an_initial_value_that_cannot_be_is_refused(
    read: Callable[..., Any], initial: Any, where: str, what: str
) -> None:
    with pytest.raises(DiagramError, match=what) as caught:
        read(within(starting(initial)), 0.01)
    assert caught.value.where == f"sub.part.{where}"
    assert caught.value.remedy


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


@pytest.mark.parametrize(
    ("values", "where", "what"),
    [
        ({"y": 2.0}, "y", "gain.y is reset to 3.0 and to 2.0|gain.y is reset to 2.0 and to 3.0"),
        ({"y": [1.0, 2.0]}, "y", "it takes real"),
        ({"through": 0.0}, "through", "nothing inside computes it"),
    ],
)
@pytest.mark.parametrize("read", [lower, Reference])
def test_a_value_when_disabled_that_cannot_be_is_refused(
    read: Callable[..., Any], values: dict[str, Any], where: str, what: str
) -> None:
    with pytest.raises(DiagramError, match=what) as caught:
        read(within(enabled_in_enabled(values)), 0.01)
    assert caught.value.where.startswith("sub.part.")
    assert caught.value.where.endswith(f".{where}")
    assert caught.value.remedy


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"enable": "on", "disabled": {"z": 1.0}}, "there is no output 'z' to reset"),
        ({"disabled": {"y": 1.0}}, "values when disabled of what is never disabled"),
        ({"enable": "on", "disabled": "off"}, "disabled='off'"),
    ],
)
def test_what_disabled_cannot_say_is_refused(options: dict[str, Any], what: str) -> None:
    inner = Diagram("inner")
    inner.input("u")
    inner.output("y", "u")
    d = Diagram("d")
    d.input("u")
    d.input("on", "bool")
    with pytest.raises(DiagramError, match=what) as caught:
        d.add("part", inner, u="u", **options)
    assert caught.value.where == "d.part"


def test_an_initial_value_of_no_output_is_refused() -> None:
    with pytest.raises(DiagramError, match="there is no output 'z' to start") as caught:
        within(starting({"z": 1.0}))
    assert caught.value.where == "inner.part"


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"dt": 0.0}, "dt"),
        ({"dt": float("nan")}, "dt"),
        ({"dt": 0.01, "integrator": "magic"}, "integrator"),
        ({"dt": 0.01, "log": ("sum",)}, "no signal 'sum'"),
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


def test_feedback_through_one_port_of_a_block_is_no_loop() -> None:
    """Feed-through is a matter of ports: the pendulum's angle does not depend on its moment in the same tick."""
    flat = lower(examples.loop(), 0.01)
    order = [s.path for g in flat.tick for a in g.actions for s in a.signals]
    assert order.index("pendulum.theta") < order.index("held.y") < order.index("error.y") < order.index("sum.y")


def test_what_nobody_needs_is_not_computed() -> None:
    d = Diagram("idle")
    d.input("u")
    d.add("unused", Gain(), u="u")
    d.add("used", Gain(), u="u")
    d.output("y", "used")
    flat = lower(d, 0.01)
    assert [s.path for g in flat.tick for a in g.actions for s in a.signals] == ["used.y"]


def test_thousands_of_blocks_in_a_row_do_not_exhaust_the_stack() -> None:
    d = Diagram("deep")
    d.input("u")
    last = "u"
    for k in range(3000):
        d.add(f"g{k}", Gain(), u=last)
        last = f"g{k}"
    d.output("y", last)
    assert len(lower(d, 0.01).tick[0].actions) == 3000
