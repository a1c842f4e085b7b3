"""Parameters of user controllers: named as in their PX4 module, of the wire's types, exact at their defaults."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fcu.parameters.tuned import ALL, KIND, Law, Numbers, tuned, with_inputs, with_names
from twodof.blocks import Param
from twodof.blocks.reference import Reference
from twodof.compile.px4 import make_module
from twodof.compile.px4.parameters import MOST
from twodof.fcu.control.flight_code import FlightCode
from twodof.fcu.mavlink.file_tree import metadata_files
from twodof.fcu.parameters.parameter_store import ParameterStore
from twodof.fcu.parameters.table import user_parameters, wire_rows
from twodof.flight.starters import STARTERS, starter
from twodof.flight.templates import ATTITUDE

pytestmark = pytest.mark.slow

NAMES = st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,30}", fullmatch=True)
DIAGRAMS = st.sampled_from(["mine", "a", "TH", "thrust_bar", "x_y"])


@settings(max_examples=8, deadline=None)
@given(st.lists(st.tuples(DIAGRAMS, st.lists(NAMES, min_size=1, max_size=6, unique=True)), min_size=3, max_size=3))
def test_names_are_legal_unique_and_those_of_the_first_never_move(wanted: list[tuple[str, list[str]]]) -> None:
    diagrams = [with_names(names, kind, name) for kind, (name, names) in zip(ALL, wanted, strict=True)]
    found = user_parameters(diagrams)
    names = [row.name for own in found for row in own.rows]
    assert len(names) == sum(len(names) for _, names in wanted)
    assert len({*names, *(row.name for row in wire_rows(1))}) == len(names) + len(wire_rows(1))
    for name in names:
        assert re.fullmatch(r"[A-Z][0-9A-Z_]{0,15}", name)
    assert {row.user_path for own in found for row in own.rows} == {
        f"{kind.name}.part0.{name}" for kind, (_, own) in zip(ALL, wanted, strict=True) for name in own
    }
    assert user_parameters(reversed(diagrams)) == found
    assert user_parameters(diagrams[:1])[0] == found[0]


@pytest.mark.parametrize("name", STARTERS)
def test_names_and_bounds_are_those_of_the_module_for_px4(name: str) -> None:
    """A ground station's file of parameters fits both."""
    (own,) = user_parameters([starter(name)])
    module = [row for row in make_module(starter(name)).parameters if row.path and not row.fixed]
    assert [row.name for row in own.rows] == [row.name for row in module]
    assert [row.user_path for row in own.rows] == [f"{own.kind}.{row.place}" for row in module]
    for ours, theirs in zip(own.rows, module, strict=True):
        wire = [np.float32(value) for value in (ours.low, ours.default, ours.high)]
        assert wire == [np.float32(value) for value in (theirs.low, theirs.default, theirs.high)]


def test_an_initial_value_is_no_gain() -> None:
    (own,) = user_parameters([starter("notch-attitude")])
    others = {row.user_path for row in own.rows if not row.tuning}
    assert others == {f"{KIND}.{name}" for name in ("pid.initial_integral", "pid.initial_filter", "notch.initial")}


def test_types_bounds_and_texts() -> None:
    (own,) = user_parameters([tuned()])
    rows = {row.user_path.removeprefix(f"{KIND}.law."): row for row in own.rows}
    assert "fixed" not in rows, "what cannot change while it runs"
    assert [(row.kind, row.low, row.high) for row in (rows["steps"], rows["mask"], rows["inverted"])] == [
        ("int32", -5, 7),
        ("int32", 0, 2**31 - 1),
        ("int32", 0, 1),
    ]
    assert rows["above"].text == "attitude_control.law.above: counter of the gain"
    assert (rows["weights[1]"].unit, rows["weights[1]"].name) == ("1/s", "TMI_LAW_WEIGHT_1")
    assert not rows["free"].bounded
    assert rows["free"].high == float(np.finfo(np.float32).max)


def test_at_its_default_a_value_flies_as_the_diagram_has_it_and_beside_it_as_it_was_sent() -> None:
    (own,) = user_parameters([tuned()])
    store = ParameterStore()
    store.carry([own])
    flying = store.user_values()
    assert flying[f"{KIND}.law.weights"] == [1 / 3, 2 / 3], "no float32 holds them"
    assert flying[f"{KIND}.law.inverted"] is False
    store.update({"TMI_LAW_WEIGHT_1": 0.25, "TMI_LAW_INVERTED": 1, "TMI_LAW_STEPS": -5.0})
    flying = store.user_values()
    assert flying[f"{KIND}.law.weights"] == [1 / 3, 0.25]
    assert (flying[f"{KIND}.law.inverted"], flying[f"{KIND}.law.steps"]) == (True, -5)
    store.reset()
    assert store.user_values()[f"{KIND}.law.weights"] == [1 / 3, 2 / 3]


@pytest.mark.long
def test_a_hostile_diagram_of_ten_thousand_parameters_is_bounded() -> None:
    hostile = with_names([f"p{n}" for n in range(1000)], parts=10)
    (own,) = user_parameters([hostile])
    assert len(own.rows) == MOST
    assert "9800 parameters are not shown" in own.remark
    store = ParameterStore()
    stock = len(metadata_files(store.rows)["parameters.json"])
    store.carry([own])
    assert len(store.rows) == len(wire_rows(1)) + MOST
    assert len(metadata_files(store.rows)["parameters.json"]) < stock + 500 * MOST
    # All are enforced, those that are not shown too: they stay at their defaults.
    assert len(store.user_values()) == MOST


def test_an_array_is_shown_whole_or_not_at_all() -> None:
    d = with_names([f"p{n}" for n in range(MOST - 1)])
    d.add("tail", Numbers(["last"], 2))
    (own,) = user_parameters([d])
    assert len(own.rows) == MOST - 1, "one of its two numbers would be beyond"
    assert "attitude_control: 1 parameters are not shown: tail.last" in own.remark


def test_a_bound_that_no_float32_holds_is_reached_and_not_passed() -> None:
    d = tuned()
    d.param("share", 0.5, low=1 / 3, high=2 / 3)
    (own,) = user_parameters([d])
    store, code = ParameterStore(), FlightCode([d], trusted=True)
    store.carry([own])
    for bound, reached in ((store.row("TMI_SHARE").low, 1 / 3), (store.row("TMI_SHARE").high, 2 / 3)):
        store.update({"TMI_SHARE": float(np.float32(bound))})
        code.set_parameters(store.user_values())
        flying = code.parameter(f"{KIND}.share")
        assert flying == pytest.approx(reached, rel=1e-7)
        assert 1 / 3 <= flying <= 2 / 3


class Weighted(Law):
    """The law of `tuned`, with a matrix among its parameters."""

    params = (*Law.params, Param("Q", [[1.0, 2.0, 3.0], [4.0, 5.0, 0.1]], shape=(2, 3)))


def test_the_elements_of_a_matrix_stand_as_in_memory_and_fly_as_rows() -> None:
    d = with_inputs("mine", ATTITUDE)
    d.add("law", Weighted(), inputs={port.name: port.name for port in ATTITUDE.inputs})
    d.output("M", "law.M")
    (own,) = user_parameters([d])
    rows = [row for row in own.rows if ".Q" in (row.user_path or "")]
    assert [np.float32(row.default) for row in rows] == [np.float32(v) for v in (1, 4, 2, 5, 3, 0.1)]
    values = {row.name: row.default for row in own.rows} | {rows[1].name: 40.0}
    (flying,) = (value for path, value in own.flying(values).items() if path.endswith(".Q"))
    assert flying == [[1.0, 2.0, 3.0], [40.0, 5.0, 0.1]]
    machine = Reference(d, 0.004).machine()
    machine.set("law.Q", flying)
    assert machine.get("law.Q") == flying
