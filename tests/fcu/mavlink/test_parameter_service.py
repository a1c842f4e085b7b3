"""Parameters over MAVLink as PX4 has them: types, bits, the list and its hash, targets; refusals that say why."""

import math
import struct
import zlib
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fcu.mavlink.world import CLIENT, World
from tests.fcu.parameters.tuned import tuned
from twodof.fcu.mavlink.parameter_service import (
    A_TICK,
    DOES_NOT_EXIST,
    INT32,
    OUT_OF_RANGE,
    PERMISSION_DENIED,
    READ_ONLY,
    REAL32,
    TYPE_MISMATCH,
    TYPE_UNSUPPORTED,
)
from twodof.fcu.parameters.parameter_store import ParameterStore
from twodof.fcu.parameters.table import user_parameters
from twodof.link.mavlink.messages import float_of_int, message

pytestmark = pytest.mark.slow

US = {"target_system": 1, "target_component": 1}
ROWS = ParameterStore().rows
FLOATS = [row for row in ROWS if row.kind == "float" and not row.fixed and not row.disarmed]
WHOLE = [row for row in ROWS if row.kind == "int32" and not row.fixed]


def bits(value: Any) -> bytes:
    """Four bytes of a PARAM_VALUE, read back from the float."""
    return struct.pack("<f", value.param_value)


def listed(world: World, ticks: int = 1000) -> list[Any]:
    """All PARAM_VALUEs that are sent in so many ticks, in order."""
    world.run(ticks)
    return world.taken("PARAM_VALUE")


def ask_list(world: World, peer: str = "client") -> None:
    world.say(message("PARAM_REQUEST_LIST", **US), peer)


def set_to(world: World, name: str, value: float, kind: int = REAL32, **options: Any) -> None:
    world.say(message("PARAM_SET", param_id=name, param_value=value, param_type=kind, **US), **options)


def test_the_list_begins_with_the_hash_and_has_everything_in_order() -> None:
    world = World()
    ask_list(world)
    first, *rest = listed(world)
    assert (first.param_id, first.param_type, first.param_index) == ("_HASH_CHECK", 5, 65535)
    assert [row.param_id for row in rest] == [row.name for row in ROWS]
    assert [row.param_index for row in rest] == [*range(len(ROWS))]
    assert {row.param_count for row in (first, *rest)} == {len(ROWS)}
    for row, got in zip(ROWS, rest, strict=True):
        kind, number = (INT32, "<i") if row.kind == "int32" else (REAL32, "<f")
        assert (got.param_type, bits(got)) == (kind, struct.pack(number, world.store[row.name]))
    # PX4's: CRC-32 over name and value of each, begun with 0 and not inverted at the end.
    content = b"".join(row.param_id.encode() + bits(row) for row in rest)
    assert bits(first) == struct.pack("<I", zlib.crc32(content, 0xFFFFFFFF) ^ 0xFFFFFFFF)


def test_the_list_is_paced_and_other_clients_get_their_own() -> None:
    world = World(profile={})
    ask_list(world, "one")
    assert world.taken("PARAM_VALUE") == []
    world.run()
    assert len(world.taken("PARAM_VALUE", "one")) == A_TICK
    ask_list(world, "other")
    world.run(len(ROWS) // A_TICK + 1)
    assert len(world.taken("PARAM_VALUE", "one")) == len(ROWS) + 1 - A_TICK
    assert len(world.taken("PARAM_VALUE", "other")) == len(ROWS) + 1
    assert world.taken("PARAM_VALUE") == []


def test_in_lockstep_the_list_does_not_wait_for_time() -> None:
    world = World(lockstep=True)
    ask_list(world)
    assert len(world.taken("PARAM_VALUE")) == len(ROWS) + 1


def test_asked_again_while_it_is_sent_the_list_begins_again_without_the_hash() -> None:
    world = World()
    ask_list(world)
    world.run(3)
    world.sent.clear()
    ask_list(world)
    assert [row.param_id for row in listed(world)] == [row.name for row in ROWS]


def test_setting_the_hash_stops_the_list() -> None:
    world = World()
    ask_list(world)
    world.run()
    world.sent.clear()
    set_to(world, "_HASH_CHECK", 0.0, 5)
    assert listed(world) == []
    assert world.commander.asked == []


@pytest.mark.parametrize(
    ("name", "index"), [("NONSENSE", -1), ("", -1), ("", len(ROWS)), ("", 32767), ("RATE_KP", 9999)]
)
def test_what_there_is_not_is_said_so(name: str, index: int) -> None:
    world = World()
    world.say(message("PARAM_REQUEST_READ", param_id=name, param_index=index, **US), source=(250, 3))
    (error,) = world.taken("PARAM_ERROR")
    assert (error.error, error.param_index) == (DOES_NOT_EXIST, index)
    assert (error.target_system, error.target_component) == (250, 3)
    assert world.taken("PARAM_VALUE") == []


@settings(max_examples=40)
@given(row=st.sampled_from(FLOATS), part=st.floats(0.0, 1.0))
def test_a_float_is_set_to_the_very_bits(row: Any, part: float) -> None:
    world = World()
    value = struct.unpack("<f", struct.pack("<f", row.low + part * (row.high - row.low)))[0]
    if not row.low <= value <= row.high:  # rounded across the bound
        return
    set_to(world, row.name, value)
    got = [one for one in world.taken("PARAM_VALUE") if one.param_id == row.name]
    assert [one.param_value for one in got] == [value]
    assert struct.pack("<f", world.store[row.name]) == struct.pack("<f", value)
    assert world.taken("PARAM_ERROR") == []


@pytest.mark.parametrize("row", WHOLE, ids=lambda row: row.name)
def test_an_int32_travels_with_its_bits(row: Any) -> None:
    world = World()
    for value in (int(row.low), int(row.high), int(row.default)):
        set_to(world, row.name, float_of_int(value), INT32)
        assert world.store[row.name] == value
        got = [one for one in world.taken("PARAM_VALUE") if one.param_id == row.name]
        assert {struct.unpack("<i", bits(one))[0] for one in got} == {value}


def test_a_change_is_told_to_everybody_under_all_its_names_and_takes_no_lease() -> None:
    world = World()
    set_to(world, "RATE_KP", 0.0625)
    told = world.taken("PARAM_VALUE", None)
    assert {(one.param_id, one.param_value) for one in told} == {("RATE_KP", 0.0625), ("FC_PARAM_4", 0.0625)}
    assert world.commander.asked == [("tune", CLIENT, "parameters")]


@pytest.mark.parametrize(
    ("name", "value", "kind", "error", "answered"),
    [
        ("NONSENSE", 1.0, REAL32, DOES_NOT_EXIST, False),
        ("RATE_KP", 1.0, INT32, TYPE_MISMATCH, False),
        ("SYS_AUTOSTART", 1.0, REAL32, TYPE_MISMATCH, False),
        ("RATE_KP", 0.01, 1, TYPE_UNSUPPORTED, False),
        ("RATE_KP", 0.01, 0, TYPE_UNSUPPORTED, False),
        ("RATE_KP", 1e6, REAL32, OUT_OF_RANGE, True),
        ("RATE_KP", -0.01, REAL32, OUT_OF_RANGE, True),
        ("RATE_KP", math.nan, REAL32, OUT_OF_RANGE, True),
        ("RATE_KP", math.inf, REAL32, OUT_OF_RANGE, True),
        ("MAV_SYS_ID", float_of_int(9), INT32, READ_ONLY, True),
    ],
)
def test_refusals(name: str, value: float, kind: int, error: int, answered: bool) -> None:
    world = World()
    before = dict(world.store)
    set_to(world, name, value, kind, peer="asks")
    (got,) = world.taken("PARAM_ERROR", "asks")
    assert (got.error, got.param_id) == (error, name)
    values = world.taken("PARAM_VALUE")
    assert [one.param_id for one in values] == ([name] if answered else [])
    assert dict(world.store) == before


def test_what_wants_disarming_is_refused_while_armed() -> None:
    locked = next(row for row in ROWS if row.disarmed and row.kind == "float" and not row.fixed)
    world = World()
    world.commander.armed = True
    set_to(world, locked.name, (locked.low + locked.default) / 2.0)
    assert [one.error for one in world.taken("PARAM_ERROR")] == [PERMISSION_DENIED]
    assert "disarmed" in world.texts()
    set_to(world, "RATE_KP", 0.0625)
    assert world.store["RATE_KP"] == 0.0625


@pytest.mark.parametrize(("system", "component"), [(2, 1), (0, 1), (1, 2), (255, 190)])
def test_others_parameters_are_none_of_ours(system: int, component: int) -> None:
    world = World()
    there = {"target_system": system, "target_component": component}
    for name in ("PARAM_REQUEST_LIST", "PARAM_REQUEST_READ"):
        assert world.say(message(name, **there))
    world.say(message("PARAM_SET", param_id="RATE_KP", param_value=0.0625, param_type=REAL32, **there))
    world.run(10)
    assert world.taken("PARAM_VALUE") == world.taken("PARAM_ERROR") == []
    assert world.store["RATE_KP"] != 0.0625


def test_other_controllers_bring_another_list_also_to_who_is_being_sent_one() -> None:
    world, own = World(), user_parameters([tuned()])
    names = {row.name for one in own for row in one.rows}
    ask_list(world)
    begun = listed(world, 5)
    assert 1 < len(begun) < len(ROWS)
    world.store.carry(own)
    (everybody,) = [one for one in world.taken("PARAM_VALUE", None) if one.param_id == "_HASH_CHECK"]
    first, *rest = listed(world)
    assert bits(everybody) == bits(first) == struct.pack("<I", world.store.hash_check())
    assert [row.param_index for row in rest] == [*range(len(ROWS) + len(names))]
    assert {row.param_id for row in rest} == {row.name for row in ROWS} | names
    set_to(world, "TMI_LAW_ABOVE", 5.0)
    assert world.store["TMI_LAW_ABOVE"] == 5.0
    ask_list(world)
    assert len(listed(world, 5)) > 1
    world.store.carry([])
    world.taken("PARAM_VALUE", None)
    _, *rest = listed(world)
    assert [row.param_id for row in rest] == [row.name for row in ROWS]
    set_to(world, "TMI_LAW_ABOVE", 6.0)
    assert world.taken("PARAM_ERROR")[-1].error == DOES_NOT_EXIST
