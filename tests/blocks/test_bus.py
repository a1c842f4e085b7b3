"""Buses: fields, connections as one wire, blocks, files and programs, and refusals."""

import copy
import json
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.compile.typed_signals import RATES, STATE, Mode, bused
from twodof.blocks import Block, Bus, Diagram, Param, Port, State
from twodof.blocks.action_group import action_group
from twodof.blocks.bus import MAX_LEVELS, expanded, grouped
from twodof.blocks.library import BusAssign, BusCreate, BusSelect, Gain, UnitDelay, ZeroOrderHold
from twodof.blocks.reference import Reference
from twodof.blocks.schema import from_json, to_json
from twodof.compile import build
from twodof.compile.program.check import check
from twodof.errors import DiagramError
from twodof.report.diagram_svg import draw

ATTITUDE = Bus("Attitude", [Port("roll", unit="rad"), Port("rates", RATES), Port("dcm", shape=(2, 3))])
VALUE = {"roll": 0.25, "rates": {"p": 2.0, "count": 7}, "dcm": [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]}


def held() -> Diagram:
    """A bus from the input through a sub-diagram to the output, held at a slower rate."""
    inner = Diagram("inner")
    inner.input("attitude", ATTITUDE)
    inner.add("hold", ZeroOrderHold(ATTITUDE), u="attitude")
    inner.output("attitude", "hold")
    d = Diagram("held")
    d.input("attitude", ATTITUDE)
    d.add("inner", inner, attitude="attitude", rate=(2, 0))
    d.output("attitude", "inner.attitude")
    d.output("p", "inner.attitude.rates.p")
    return d


def test_a_bus_is_its_fields() -> None:
    port = Port("attitude", ATTITUDE)
    names = ["attitude.roll", "attitude.rates.p", "attitude.rates.count", "attitude.dcm"]
    assert [leaf.name for leaf in expanded([port])] == names
    assert copy.deepcopy(ATTITUDE) == pickle.loads(pickle.dumps(ATTITUDE)) == ATTITUDE != RATES
    assert hash(copy.copy(ATTITUDE)) == hash(ATTITUDE)
    assert Port("a", ATTITUDE.form()).kind == ATTITUDE


REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "a field twice": (lambda: Bus("B", [Port("a"), Port("a")]), "bus B: two fields are named 'a'"),
    "a bus and a field": (lambda: Bus("B", [Port("a", RATES), Port("a.p")]), "two fields are named 'a.p'"),
    "no fields": (lambda: Bus("B", []), "the fields are []"),
    "names": (lambda: Bus("B", ["a", "b"]), """the field 'a' is not a Port (write Port("name"))"""),
    "no name": (lambda: Bus("a b", [Port("a")]), "'a b' is not a name"),
    "too many": (lambda: Bus("B", [Port(f"a{i}") for i in range(1001)]), "more than 1000 fields"),
    "a shape": (lambda: Port("a", RATES, shape=(2, 2)), "a: a bus has no shape, unit or enumeration (give"),
    "a unit": (lambda: Port("a", RATES, unit="m"), "a bus has no shape, unit"),
    "no width": (lambda: Port("a", RATES, 0), "a: width 0 is not in 1..1000000 (use None for one bus)"),
    "matrices": (lambda: expanded([Port("a", Bus("M", [Port("m", shape=(2, 2))]), 3)]), "cannot have the matrix m"),
    "other fields": (lambda: expanded([State("s", [{"p": 1}, {"count": 1}], RATES, 2)]), "not have the same fields"),
    "a plain form": (lambda: Port("a", {"name": "B", "fields": [3]}), "is not a bus"),
    "a part of a name": (lambda: Port("a..b"), "'' is not a name"),
    "made without": (lambda: RATES(p=1.0), "Rates is made without its field 'count' (give all its fields)"),
    "made with more": (lambda: RATES(p=1.0, cuont=1), "Rates has no field 'cuont' (there are: count, p)"),
    "a state's field": (lambda: expanded([State("s", {"q": 1}, RATES)]), "s: Rates has no field 'q' (there are:"),
    "a parameter's": (lambda: expanded([Param("s", {"p": 1, "count": 0.5}, RATES)]), "s.count"),
    "assigned": (lambda: setattr(RATES, "name", "x"), "bus Rates: 'name' is assigned"),
    "selected": (lambda: BusSelect(ATTITUDE, ["rates.q"]), "Attitude has no field 'rates.q' (there are: rates.p"),
    "created of a number": (lambda: BusCreate(3), "BusCreate: bus=3 (give Bus("),
}  # fmt: skip


def deep(levels: int) -> Bus:
    bus = RATES
    for _ in range(levels):
        bus = Bus("Deep", [Port("inner", bus)])
    return bus


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_a_bus_is_refused(name: str) -> None:
    make, text = REFUSED[name]
    with pytest.raises(DiagramError) as refused:
        make()
    assert text in str(refused.value)


def test_buses_nest_so_deep_and_no_deeper() -> None:
    assert len(expanded([Port("a", deep(MAX_LEVELS - 1))])) == 2
    with pytest.raises(DiagramError, match="more than 8 buses within one another"):
        deep(MAX_LEVELS)


class Gives(Block):
    """Gives what the test says."""

    inputs = (Port("a", ATTITUDE),)
    outputs = (Port("y", ATTITUDE),)

    def __init__(self, gives: Callable[[Any], Any]) -> None:
        self.gives = gives

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return self.gives(u)


WRONG: dict[str, tuple[Callable[[Any], Any], str]] = {
    "a field less": (lambda u: {"y": {"roll": 1.0, "rates": u.a.rates}}, "output does not give 'y.dcm'"),
    "another field": (
        lambda u: {"y": {**vars(u.a), "pitch": 1.0}},
        "output gives 'y.pitch', which is not declared (it may give: y.",
    ),
    "a number": (
        lambda u: {"y": {**vars(u.a), "rates": 1.0}},
        "the value of the bus 'y.rates' is 1.0 (give a value for each",
    ),
    "a field's kind": (
        lambda u: {"y": {**vars(u.a), "rates": RATES(p=u.a.rates.count, count=0)}},
        "'y.rates.p' is given a int32, and is a real",
    ),
    "a field's shape": (lambda u: {"y": {**vars(u.a), "dcm": u.a.dcm.T}}, "'y.dcm' is given an array of 3x2"),
    "a field that is not there": (lambda u: u.a.rol, "no field named 'rol' (there are: roll, rates, dcm)"),
    "an assignment": (lambda u: setattr(u.a, "roll", 1.0), "the field 'roll' is assigned"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_a_method_gives_is_checked_field_by_field(name: str) -> None:
    gives, text = WRONG[name]
    with pytest.raises(DiagramError) as refused:
        _ = Gives(gives).trace
    assert text in str(refused.value)
    assert "Gives.output" in str(refused.value)


@pytest.mark.parametrize(
    "gives",
    [
        lambda u: {"y": u.a},
        lambda u: u.a,
        lambda u: ATTITUDE(roll=u.a.roll, rates=u.a.rates, dcm=u.a.dcm),
        lambda u: {
            "y": {"roll": u.a.roll, "rates": {"p": u.a.rates.p, "count": u["a.rates.count"]}, "dcm": u.a["dcm"]}
        },
        lambda u: {f"y.{leaf.name}": u[f"a.{leaf.name}"] for leaf in ATTITUDE.leaves},
    ],
)
def test_a_method_gives_a_bus_in_many_ways(gives: Callable[[Any], Any]) -> None:
    d = Diagram("d")
    d.input("a", ATTITUDE)
    d.add("b", Gives(gives), a="a")
    d.output("y", "b")
    for machine in (Reference(d, 0.1).machine(), build(d, 0.1, optimise="-O0").machine()):
        found = machine.step({"a": VALUE})
        assert found == {"y.roll": 0.25, "y.rates.p": 2.0, "y.rates.count": 7, "y.dcm": VALUE["dcm"]}


def reading(source: Port | Bus, wanted: Port) -> Diagram:
    """A delay of one type that feeds one of another."""
    d = Diagram("d")
    given = source if isinstance(source, Bus) else Bus("Given", [source])
    d.add("source", UnitDelay(kind=given), u="source")
    d.add("reader", UnitDelay(kind=Bus("Wanted", [wanted])), u="source.y")
    d.output("y", "reader.y")
    return d


CLASHES: dict[str, tuple[Port, Port, str]] = {
    "a missing field": (Port("a"), Port("b"), "reader.u.b: the bus 'source.y' has no field 'b' (there are: a)"),
    "a kind": (Port("a"), Port("a", "int32"), "reader.u.a: it takes int32 and source.y.a is real"),
    "a width": (Port("a", width=3), Port("a", width=2), "reader.u.a: it takes real[2] and source.y.a is real[3]"),
    "a shape": (
        Port("a", shape=(2, 3)),
        Port("a", shape=(3, 2)),
        "reader.u.a: it takes real[3x2] and source.y.a is real[2x3]",
    ),
    "a unit": (Port("a", unit="m"), Port("a", unit="rad"), "reader.u.a: it takes [rad] and source.y.a is in [m]"),
    "an enumeration": (Port("a", "int32"), Port("a", Mode), "reader.u.a: it takes Mode and source.y.a is int32"),
    "a nested field": (
        Port("a", RATES),
        Port("a", Bus("R", [Port("q")])),
        "reader.u.a.q: the bus 'source.y' has no field 'a.q' (there are: a.p, a.count)",
    ),
    "a bus for a number": (Port("a", RATES), Port("a"), "reader.u.a: it is a bus, with the fields p, count"),
    "a number for a bus": (Port("a"), Port("a", RATES), "reader.u.a.p: 'source.y.a' is not a bus"),
}


@pytest.mark.parametrize("name", CLASHES)
def test_a_connection_is_checked_field_by_field(name: str) -> None:
    source, wanted, text = CLASHES[name]
    d = reading(source, wanted)
    texts = []
    for make in (build, Reference):
        with pytest.raises(DiagramError) as refused:
            make(d, 0.1)
        texts.append(str(refused.value))
    compiled, interpreted = texts
    assert text in compiled
    assert interpreted.split(":")[0] == compiled.split(":")[0]
    assert any(text in str(problem) for problem in check(d, 0.1).problems)


def test_what_takes_fewer_fields_takes_them_from_a_larger_bus() -> None:
    d = reading(ATTITUDE, Port("rates", RATES))
    assert set(build(d, 0.1).machine().step()) == {"y.rates.p", "y.rates.count"}


def test_an_input_has_one_source_whether_whole_or_by_field() -> None:
    d = Diagram("d")
    d.input("a", ATTITUDE)
    d.add("one", UnitDelay(kind=ATTITUDE), u="a")
    for destination in ("one.u", "one.u.roll", "one.u.rates"):
        with pytest.raises(DiagramError, match="has two sources"):
            d.connect("a.roll", destination)
    d.add("two", UnitDelay(kind=ATTITUDE))
    d.connect("a.rates", "two.u.rates")
    for destination in ("two.u", "two.u.rates", "two.u.rates.p"):
        with pytest.raises(DiagramError, match="has two sources"):
            d.connect("a", destination)
    with pytest.raises(DiagramError, match=r"two\.u\.roll: the input u\.roll is not connected"):
        build(d, 0.1)


NAMES: dict[str, tuple[Callable[[Diagram], Any], str]] = {
    "a part like a bus": (lambda d: d.add("a", Gain()), "the name 'a' is used twice"),
    "an input like a bus": (lambda d: d.input("a"), "the name 'a' is used twice"),
    "a parameter like a bus": (lambda d: d.param("a"), "the name 'a' is used twice"),
    "a bus like a part": (lambda d: d.input("g", RATES), "the name 'g.p' is used twice"),
    "a field twice": (lambda d: d.declare(Port("a.roll")), "the name 'a.roll' is used twice"),
    "a field of a number": (lambda d: d.declare(Port("n.x")), "the name 'n.x' is used twice"),
    "an unknown field": (lambda d: d.source("a.rol"), "the bus 'a' has no field 'rol' (there are: roll,"),
    "of what is no bus": (lambda d: d.source("n.x"), "'n' is not a bus, and so does not have the field 'x'"),
    "of what gives no bus": (lambda d: d.source("g.y.x"), "'g.y' is not a bus"),
    "a field to feed": (lambda d: d.connect("n", "z.u.rol"), "the bus 'z.u' has no field 'rol'"),
}


@pytest.mark.parametrize("name", NAMES)
def test_names_of_buses_and_fields_are_checked(name: str) -> None:
    d = Diagram("d")
    d.input("a", ATTITUDE)
    d.input("n")
    d.add("g", Gain(), u="n")
    d.add("z", UnitDelay(kind=ATTITUDE), u="a")
    change, text = NAMES[name]
    with pytest.raises(DiagramError) as refused:
        change(d)
    assert text in str(refused.value)


def test_a_running_program_takes_mappings_and_paths() -> None:
    d = bused().case.diagram
    for machine in (Reference(d, 0.1, log=["inner.s"]).machine(), build(d, 0.1, log=["inner.s"]).machine()):
        assert {n for n in machine.step() if n.startswith("inner")} == {f"inner.s.{f.name}" for f in STATE.leaves}
        machine.step({"s": {"rates": {"p": 3.0}}, "gain": 2.0, "go": True, "s.mode": "flying"})
        machine.set("inner.late.initial.mode", "broken")
        assert machine.state("inner.turned.past.rates.p") == 3.0
        machine.set_state("inner.turned.past.roll", 9.0)
        assert machine.run(3, {"s": {"roll": [1.0, 2.0, 3.0]}})["s.roll"].shape == (3,)
        for wrong, text in (
            ({"s": {"rol": 1.0}}, "no input named 's.rol'"),
            ({"s": {"rates": 1.0}}, "the value of the bus 's.rates' is 1.0 (give a value for each field: p, count)"),
            ({"s": {"mode": 3}}, "s.mode: 3 is not a member of Mode"),
        ):
            with pytest.raises(DiagramError) as refused:
                machine.step(wrong)
            assert text in str(refused.value)


def test_a_held_bus_is_one_wire_in_the_file_the_picture_and_the_c() -> None:
    d = held()
    text = to_json(d)
    assert '"connections": [["attitude", "inner.attitude"]]' in text
    assert len(draw(d).nets) == 2  # in, and from the sub-diagram to both outputs
    source = build(from_json(text), 0.1).source
    assert "real attitude_rates_p; /* attitude.rates.p [rad/s] */" in source
    machine = build(from_json(text), 0.1).machine()
    found = machine.run(3, {"attitude": {"roll": np.arange(3.0), "dcm": VALUE["dcm"]}})
    assert found["attitude.roll"].tolist() == [0.0, 0.0, 2.0]
    assert found["attitude.dcm"][0].tolist() == VALUE["dcm"]


def test_action_groups_merge_buses() -> None:
    def action(name: str, gain: float) -> Diagram:
        d = Diagram(name)
        d.input("r", RATES)
        d.add("g", Gain(gain, unit="rad/s"), u="r.p")
        d.add("made", BusAssign(RATES, ["p"]), u="r", p="g")
        d.output("r", "made")
        return d

    d = action_group("group", {"fast": action("fast", 3.0)}, otherwise=action("slow", 0.5))
    for machine in (Reference(d, 0.1).machine(), build(from_json(to_json(d)), 0.1).machine()):
        assert machine.step({"r": {"p": 2.0, "count": 4}, "if_fast": True}) == {"r.p": 6.0, "r.count": 4}
        assert machine.step({"if_fast": False}) == {"r.p": 1.0, "r.count": 4}


def test_a_file_bounds_its_buses() -> None:
    for change, text in (
        (lambda ports: ports.append({"name": "attitude.roll"}), "the name 'attitude.roll' is used twice"),
        (lambda ports: ports.append({"name": "attitude.roll.x"}), "is used twice"),
        (lambda ports: ports.append({"name": ".".join("a" * 40)}), "more than 8 buses within one another"),
        (lambda ports: ports.append({"name": "b." + "a" * 10_000}), "is not a name"),
        (lambda ports: ports.append({"name": "b..a"}), "'' is not a name"),
    ):
        form = json.loads(to_json(held()))
        change(form["diagram"]["inputs"])
        data = json.dumps(form)
        with pytest.raises(DiagramError) as refused:
            from_json(data)
        assert text in str(refused.value)


def ports(depth: int) -> st.SearchStrategy[Port]:
    """Random fields, buses among them."""
    names = st.from_regex(r"[a-z][a-z0-9_]{0,4}", fullmatch=True)
    kinds: st.SearchStrategy[Any] = st.sampled_from(["real", "int32", "uint32", "bool", Mode])
    plain = st.builds(Port, names, kinds, st.none() | st.integers(1, 3), st.sampled_from(["", "m"]))
    matrices = st.builds(lambda name, rows: Port(name, shape=(rows, 2)), names, st.integers(1, 3))
    if depth == 0:
        return plain | matrices
    return plain | matrices | st.builds(Port, names, buses(depth - 1))


def buses(depth: int) -> st.SearchStrategy[Bus]:
    """Random buses, nested `depth` deep."""
    fields = st.lists(ports(depth), min_size=1, max_size=4, unique_by=lambda port: port.name)
    return st.builds(Bus, st.just("Any"), fields)


def sample(port: Port, k: int) -> Any:
    """A value of a field."""
    one = {"bool": bool(k % 2), "real": 0.5 * k}.get(port.kind, 5 if port.enum else k)
    if port.shape:
        return [[0.5 * k + i + 10.0 * j for j in range(port.shape[1])] for i in range(port.shape[0])]
    return one if port.width is None else [one] * port.width


@pytest.mark.long
@settings(max_examples=12, deadline=None)
@given(buses(2))
def test_any_bus_goes_through_a_diagram_as_it_is(bus: Bus) -> None:
    inner = Diagram("inner")
    inner.input("u", bus)
    inner.add("late", UnitDelay(kind=bus), u="u")
    inner.output("y", "late")
    d = Diagram("d")
    d.input("u", bus)
    d.add("inner", inner, u="u")
    d.add("made", BusCreate(bus))
    for field in dict.fromkeys(leaf.name.partition(".")[0] for leaf in bus.leaves):
        d.connect(f"inner.y.{field}", f"made.{field}")
    d.output("y", "made")
    again = from_json(to_json(d))
    assert to_json(again) == to_json(d)
    assert expanded(grouped(again.inputs.values())) == list(again.inputs.values()) == expanded([Port("u", bus)])
    values = {leaf.name: sample(leaf, k) for k, leaf in enumerate(bus.leaves, 1)}
    machine = Reference(again, 0.1).machine()
    machine.step({f"u.{name}": value for name, value in values.items()})
    assert machine.step() == {f"y.{name}": value for name, value in values.items()}


def test_an_array_of_buses_is_given_as_a_list_or_field_by_field() -> None:
    d = Diagram("d")
    d.input("a", RATES, width=2)
    d.add("late", UnitDelay([{"p": 1.0, "count": 0}, {"p": 2.0, "count": 5}], RATES, 2), u="a")
    d.output("y", "late")
    as_list: Any = {"a": [{"p": 3.0, "count": 7}, {"p": 4.0, "count": -1}]}
    for inputs in (as_list, {"a": {"p": [3.0, 4.0], "count": [7, -1]}}, {"a.p": [3.0, 4.0], "a.count": [7, -1]}):
        machine = Reference(d, 0.01).machine()
        assert machine.step(inputs) == {"y.p": [1.0, 2.0], "y.count": [0, 5]}
        assert machine.step(inputs) == {"y.p": [3.0, 4.0], "y.count": [7, -1]}
