"""All problems at once, as lowering refuses them, with whole paths; sizes, feed-through, remarks."""

from typing import Any

import pytest

from tests.compile.random_diagrams import Maker
from twodof.blocks import Block, Diagram, Param, Port
from twodof.blocks import library as lib
from twodof.compile.program.check import MAX_PROBLEMS, check
from twodof.compile.program.lower import lower
from twodof.errors import DiagramError
from twodof.flight.core import core

pytestmark = pytest.mark.slow

DT = 0.001


class Untraceable(Block):
    """Asks a recorded value for its truth."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return 1.0 if u.u > 0.0 else 0.0


def faulty() -> Diagram:
    """One fault of each kind, most of them in a sub-diagram."""
    inner = Diagram("inner")
    inner.input("v", unit="m")
    inner.param("k", 1.0, unit="s")
    inner.add("bad", Untraceable(), u="v")
    inner.add("gain", lib.Gain(input_unit="rad"), u="v", params={"k": "missing"})
    inner.add("compare", lib.Compare("<"), a="v", b="v")
    inner.add("wrong", lib.Gain(), u="compare")
    inner.add("loose", lib.Gain())
    inner.add("wide", lib.Gain(), u="pair")
    inner.add("pair", lib.Mux(), a="v", b="v")
    inner.add("p", lib.Sum("++"), a="v", b="q")
    inner.add("q", lib.Gain(), u="p")
    inner.add("count", lib.Gain(), u="v", params={"k": "n"})
    inner.param("n", 1, kind="int32")
    inner.output("w")
    inner.output("x", "gain")
    d = Diagram("outer")
    d.input("u", unit="m")
    d.add("sub", inner, v="u", enable="u")
    d.add("a", lib.Sum("++"), a="u", b="b")
    d.add("b", lib.Gain(), u="a")
    d.add("c", lib.Gain(), u="d")
    d.add("d", lib.Gain(), u="c")
    d.add("slow", lib.UnitDelay(), rate=(4, 0), u="a")
    d.add("state", lib.Integrator(), rate=(2, 0), u="nowhere")
    d.add("edge", lib.FractionalDelay(0.0001), rate=(2, 0), u="u")
    d.output("y", "slow")
    return d


def test_every_problem_is_named_with_its_whole_path() -> None:
    found = check(faulty(), DT)
    assert not found.fine
    text = [f"{p.where}: {p.what}" for p in found.problems]
    for where, what in (
        ("sub.bad", "no truth"),
        ("sub.gain", "no parameter named 'missing'"),
        ("sub.gain.u", "takes [rad]"),
        ("sub.wrong.u", "it takes real"),
        ("sub.loose.u", "not connected"),
        ("sub.w", "not connected"),
        ("sub.wide.u", "real[2]"),
        ("sub.count.k", "that is bound to it is"),
        ("outer", "algebraic loop sub.p.y <- sub.q.y <- sub.p.y"),
        ("sub", "not a bool"),
        ("outer", "algebraic loop a.y <- b.y <- a.y"),
        ("outer", "algebraic loop c.y <- d.y <- c.y"),
        ("slow.u", "runs at (4, 0)"),
        ("state", "it has continuous states"),
        ("edge", "an edge inside the step"),
        ("outer", "no input or part named 'nowhere'"),
    ):
        assert any(what in t and where in t.partition(": ")[0] for t in text), (where, what, text)
    assert all(p.remedy for p in found.problems)


def test_lowering_stops_at_the_first_problem() -> None:
    with pytest.raises(DiagramError) as raised:
        lower(faulty(), DT)
    assert str(raised.value) == str(check(faulty(), DT).problems[0])


@pytest.mark.parametrize("seed", range(6))
def test_only_a_cut_wire_is_a_problem(seed: int) -> None:
    d = Maker(seed).diagram("random")
    assert check(d, DT).fine
    fed = list(d.connections)
    for key in fed[:2]:
        del d.connections[key]
    problems = check(d, DT).problems
    assert len(problems) >= min(len(fed), 2)
    with pytest.raises(DiagramError) as raised:
        lower(d, DT)
    assert str(raised.value) == str(problems[0])


def test_sizes_and_feed_through_of_a_small_diagram() -> None:
    d = Diagram("small")
    d.input("u")
    d.input("unused")
    d.param("idle", 1.0)
    d.add("delay", lib.Delay(5), u="u")
    d.add("sum", lib.Sum("++"), a="u", b="delay")
    d.add("lag", lib.FirstOrder(1.0, 0.0), u="sum")
    d.add("alone", lib.Gain(), u="u")
    d.add("limit", lib.Saturation(-1.0, 1.0), u="lag")
    d.output("now", "sum")
    d.output("later", "limit")
    found = check(d, DT)
    assert found.sizes is not None
    assert (found.sizes.blocks, found.sizes.inputs, found.sizes.outputs) == (5, 2, 2)
    assert found.sizes.continuous_states == 1
    assert found.sizes.discrete_states == 5 + 3  # five samples; what was before, the write index, the age
    assert found.feedthrough == {"now": ("u",), "later": ()}
    assert found.port_feedthrough is not None
    assert found.port_feedthrough["delay.y"] == ()
    assert found.unread == ("alone.y",)
    assert found.left_out == ("alone",)
    said = {(r.where, r.what) for r in found.remarks}
    assert ("unused", "nothing reads this input") in said
    assert ("idle", "no block uses this parameter") in said
    assert ("alone", "nothing reads its outputs: it is left out") in said


def test_added_nodes_do_not_count_as_blocks() -> None:
    part = Diagram("part")
    part.add("sum", lib.Constant(1.0))
    part.output("y", "sum")
    d = Diagram("d")
    d.input("on", "bool")
    d.add("part", part, enable="on", trigger="on", enabling="restart")
    d.output("y", "part")
    found = check(d, DT)
    assert found.sizes is not None
    assert found.sizes.blocks == 1
    assert found.sizes.discrete_states == 3  # enabled before; what the trigger was, and whether it was looked at
    assert not found.remarks
    assert found.feedthrough == {"y": ("on",)}


def test_defaults_that_divide_by_zero_are_remarked() -> None:
    class Reciprocal(Block):
        inputs = (Port("u"),)
        outputs = (Port("y"),)
        params = (Param("mass", 0.0, low=0.0),)
        derived = (Port("per_mass"),)

        def prepare(self, p: Any, t: Any) -> Any:
            return 1.0 / p.mass

        def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
            return p.per_mass * u.u

    d = Diagram("division")
    d.input("u")
    d.add("r", Reciprocal(), u="u")
    d.output("y", "r")
    (remark,) = check(d, DT).remarks
    assert (remark.where, remark.what) == ("r.per_mass", "the default parameters make it infinite or NaN")
    d = Diagram("quotient")
    d.input("u")
    d.add("q", lib.Product("*/"), a="u", b="u")
    d.output("y", "q")
    (remark,) = check(d, DT).remarks
    assert remark.where == "q.y"


def test_the_flight_core_is_clean() -> None:
    found = check(core(), 0.004)
    assert found.fine
    assert found.feedthrough is not None
    assert found.feedthrough["x"] == ()  # published at 100 Hz, one sample later
    assert "gyro_y" in found.feedthrough["M"]


def test_problems_are_bounded() -> None:
    d = Diagram("many")
    for i in range(1500):
        d.add(f"g{i}", lib.Gain())
    assert len(check(d, DT).problems) == MAX_PROBLEMS


class Scaled(Block):
    """y = a u / trace(a)."""

    inputs = (Port("u", width=2),)
    outputs = (Port("y", width=2),)
    params = (Param("a", [[1.0, 2.0], [3.0, -1.0]], shape=(2, 2)),)
    derived = (Port("scale", shape=(2, 2)),)

    def prepare(self, p: Any, t: Any) -> Any:
        return p.a / (p.a[0, 0] + p.a[1, 1])

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return p.scale @ u.u


def test_the_defaults_of_matrices_are_looked_at_too() -> None:
    d = Diagram("matrices")
    d.input("u", width=2)
    d.param("a", [[1.0, 2.0], [3.0, 4.0]], shape=(2, 2))
    d.add("block", Scaled(), u="u")
    d.output("y", "block")
    assert [(r.where, r.what) for r in check(d, DT).remarks if "NaN" in r.what] == [
        ("block.scale", "the default parameters make it infinite or NaN")
    ]
    d.parts["block"].params["a"] = "a"
    assert check(d, DT).remarks == ()
