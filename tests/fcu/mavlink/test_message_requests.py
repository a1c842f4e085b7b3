"""Requests for one message, and what the vehicle says of itself."""

import pytest

from tests.fcu.mavlink.world import World
from twodof.fcu.mavlink.message_requests import VersionService
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
        "MISSION_INT",
        "PARAM_FLOAT",
        "COMMAND_INT",
        "PARAM_ENCODE_BYTEWISE",
        "FTP",
        "SET_ATTITUDE_TARGET",
        "SET_POSITION_TARGET_LOCAL_NED",
        "FLIGHT_TERMINATION",
        "MAVLINK2",
    }
    assert got.flight_sw_version >> 8 == 1 << 16 | 16 << 8 | 1
    assert got.uid > 0


def test_each_vehicle_has_a_number_of_its_own() -> None:
    def uid(name: str) -> tuple[int, bytes]:
        world = World()
        VersionService(world.px4.requests, 1, name)
        world.command(512, AUTOPILOT_VERSION)
        (got,) = world.taken("AUTOPILOT_VERSION")
        return got.uid, bytes(got.uid2)

    assert uid("a") == uid("a")
    assert uid("a") != uid("b")
