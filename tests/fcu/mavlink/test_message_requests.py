"""Requests for one message, and for missions, which are refused."""

import pytest

from tests.fcu.mavlink.world import World
from twodof.fcu.mavlink.message_requests import answer_versions
from twodof.link.mavlink import dialect
from twodof.link.mavlink.dialect import MavResult
from twodof.link.mavlink.messages import message

AUTOPILOT_VERSION = 148


@pytest.mark.parametrize("number", World().px4.requests.supported)
def test_what_can_be_streamed_can_be_asked_for(number: int) -> None:
    world = World()
    world.say(message("HEARTBEAT"))
    world.run(1, dist_new=True)
    world.sent.clear()
    assert world.command(512, float(number), peer="asks") == MavResult.ACCEPTED
    name = dialect.load().mavlink_map[number].msgname
    assert world.taken(name, "asks")
    assert world.taken(name, "client") == []


@pytest.mark.parametrize("number", [33, 24, 411000, -1, float("nan"), float("inf"), 1e30, 54207])
def test_what_there_is_not_is_unsupported(number: float) -> None:
    assert World().command(512, number) == MavResult.UNSUPPORTED


@pytest.mark.parametrize(
    ("command", "name"), [(519, "PROTOCOL_VERSION"), (520, "AUTOPILOT_VERSION"), (410, "HOME_POSITION")]
)
def test_the_older_forms(command: int, name: str) -> None:
    world = World()
    assert world.command(command, 1.0) == MavResult.ACCEPTED
    assert len(world.taken(name)) == 1


def test_the_version_claims_what_there_is() -> None:
    world = World()
    world.command(512, AUTOPILOT_VERSION)
    (got,) = world.taken("AUTOPILOT_VERSION")
    bits = dialect.load().enums["MAV_PROTOCOL_CAPABILITY"]
    claimed = {
        entry.name.removeprefix("MAV_PROTOCOL_CAPABILITY_") for bit, entry in bits.items() if got.capabilities & bit
    }
    assert claimed == {
        *("MISSION_INT", "PARAM_FLOAT", "COMMAND_INT", "PARAM_ENCODE_BYTEWISE", "FTP", "SET_ATTITUDE_TARGET"),
        *("SET_POSITION_TARGET_LOCAL_NED", "FLIGHT_TERMINATION", "MAVLINK2"),
    }
    assert got.flight_sw_version >> 8 == 1 << 16 | 16 << 8 | 1
    assert got.uid > 0


def test_each_vehicle_has_a_number_of_its_own() -> None:
    def uid(name: str) -> tuple[int, bytes]:
        world = World()
        answer_versions(world.px4.requests, 1, name)
        world.command(512, AUTOPILOT_VERSION)
        (got,) = world.taken("AUTOPILOT_VERSION")
        return got.uid, bytes(got.uid2)

    assert uid("a") == uid("a")
    assert uid("a") != uid("b")


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
