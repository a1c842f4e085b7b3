"""Missions: there are none, and every question about them is answered so."""

import pytest

from tests.fcu.mavlink.world import World
from twodof.link.mavlink.enums import MavResult
from twodof.link.mavlink.messages import message

US = {"target_system": 1, "target_component": 1}


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_there_are_none_of_any_kind(kind: int) -> None:
    world = World()
    world.say(message("MISSION_REQUEST_LIST", mission_type=kind, **US), source=(255, 190))
    (got,) = world.taken("MISSION_COUNT")
    assert (got.count, got.mission_type, got.target_system, got.target_component) == (0, kind, 255, 190)
    world.say(message("MISSION_ACK", type=0, mission_type=kind, **US))
    assert world.sent[2:] == []  # but for the greeting, a HEARTBEAT and the number of the last event


@pytest.mark.parametrize(
    ("name", "fields", "result"),
    [
        ("MISSION_COUNT", {"count": 0}, 0),
        ("MISSION_COUNT", {"count": 3}, 4),
        ("MISSION_CLEAR_ALL", {"mission_type": 0}, 0),
        ("MISSION_CLEAR_ALL", {"mission_type": 255}, 0),
        ("MISSION_REQUEST_INT", {"seq": 0}, 13),
        ("MISSION_REQUEST", {"seq": 5}, 13),
        ("MISSION_ITEM_INT", {"seq": 5}, 13),
        ("MISSION_REQUEST_LIST", {"mission_type": 7}, 3),
        ("MISSION_CLEAR_ALL", {"mission_type": 7}, 3),
    ],
)
def test_whatever_is_asked_is_answered(name: str, fields: dict[str, int], result: int) -> None:
    world = World()
    assert world.say(message(name, **US, **fields))
    (got,) = world.taken("MISSION_ACK")
    assert (got.type, got.mission_type) == (result, fields.get("mission_type", 0))


def test_no_item_is_in_force() -> None:
    world = World()
    world.say(message("MISSION_SET_CURRENT", seq=4, **US))
    assert world.command(512, 42.0) == MavResult.ACCEPTED
    assert [(one.seq, one.total, one.mission_state) for one in world.taken("MISSION_CURRENT")] == [(0, 0, 1)] * 2
    assert world.command(300) == MavResult.DENIED


def test_others_missions_are_none_of_ours() -> None:
    world = World()
    assert world.say(message("MISSION_REQUEST_LIST", target_system=2, target_component=1))
    assert world.taken("MISSION_COUNT") == []
