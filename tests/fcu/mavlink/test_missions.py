"""Missions: there are none, and every question about them is answered so."""

import pytest

from tests.fcu.mavlink.world import World
from twodof.link.mavlink.messages import message

US = {"target_system": 1, "target_component": 1}


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_there_are_none_of_any_kind(kind: int) -> None:
    world = World()
    world.say(message("MISSION_REQUEST_LIST", mission_type=kind, **US), source=(255, 190))
    (got,) = world.taken("MISSION_COUNT")
    assert (got.count, got.mission_type, got.target_system, got.target_component) == (0, kind, 255, 190)
    world.say(message("MISSION_ACK", type=0, mission_type=kind, **US))
    assert world.sent[1:] == []  # but for the greeting, a HEARTBEAT


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("MISSION_COUNT", {"count": 3}),
        ("MISSION_CLEAR_ALL", {"mission_type": 255}),
        ("MISSION_REQUEST_INT", {"seq": 0}),
        ("MISSION_REQUEST", {"seq": 5}),
        ("MISSION_ITEM_INT", {"seq": 5}),
        ("MISSION_SET_CURRENT", {"seq": 4}),
        ("MISSION_REQUEST_LIST", {"mission_type": 7}),
    ],
)
def test_all_else_is_refused_at_once(name: str, fields: dict[str, int]) -> None:
    world = World()
    assert world.say(message(name, **US, **fields))
    (got,) = world.taken("MISSION_ACK")
    assert (got.type, got.mission_type) == (3, fields.get("mission_type", 0))


def test_others_missions_are_none_of_ours() -> None:
    world = World()
    assert world.say(message("MISSION_REQUEST_LIST", target_system=2, target_component=1))
    assert world.taken("MISSION_COUNT") == []
