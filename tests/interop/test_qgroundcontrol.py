"""QGroundControl's connection sequence, replayed against the program: every request is answered at once.

QGroundControl itself needs a screen. Its sources show what it asks, in which order, and what it cannot do without:
InitialConnectStateMachine, StandardModes, ParameterManager and PlanManager, and PX4's mavlink_parameters.cpp.
"""

from __future__ import annotations

import asyncio
import struct
import zlib
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest

from tests.link.ends import in_loop
from tests.patience import PATIENCE_S
from twodof.link.connection import Connection
from twodof.link.mavlink.framing import encode
from twodof.link.mavlink.messages import message
from twodof.link.transport import open_transport

pytestmark = pytest.mark.slow

CANNOT_MISS = {
    *("BAT_LOW_THR", "BAT_CRIT_THR", "BAT_EMERGEN_THR", "CAL_ACC0_ID", "CAL_GYRO0_ID", "SENS_BOARD_ROT"),
    *("SENS_BOARD_X_OFF", "SENS_BOARD_Y_OFF", "SENS_BOARD_Z_OFF", "SENS_DPRES_OFF", "TRIG_MODE", "UAVCAN_ENABLE"),
    *("SYS_PARAM_VER", "SYS_AUTOSTART"),
    *(f"CAL_MAG{number}_{what}" for number in range(4) for what in ("ID", "ROT")),
}
"""PX4's mavlink_parameters.cpp: "parameters QGC can't tolerate not finding"."""

STREAMS = {"SYS_STATUS", "EXTENDED_SYS_STATE", "BATTERY_STATUS", "HOME_POSITION", "ATTITUDE", "VFR_HUD"}
STREAMS |= {"LOCAL_POSITION_NED", "HEARTBEAT"}

AUTOPILOT_VERSION, PROTOCOL_VERSION, AVAILABLE_MODES, COMPONENT_METADATA = 148, 300, 435, 397
# COMPONENT_INFORMATION, GIMBAL_MANAGER_INFORMATION, CAMERA_INFORMATION: what a vehicle like ours has not.
FOR_NAUGHT = (395, 280, 259)
REQUEST_MESSAGE, ACCEPTED, UNSUPPORTED = 512, 0, 3
UINT32, INT32, REAL32 = 5, 6, 9
AUTOPILOT = {"target_system": 1, "target_component": 1}


class Station:
    """QGroundControl on the wire: system 255, component 190."""

    def __init__(self, link: Connection) -> None:
        self.link = link
        self.seen: set[str] = set()

    def say(self, name: str, **fields: Any) -> None:
        """To the autopilot of system 1."""
        if "HEARTBEAT" not in name:
            fields = AUTOPILOT | fields
        self.link.send(message(name, **fields))

    def say_in_one_breath(self, *said: Any) -> None:
        """Messages in one piece: however late the machine runs us, the autopilot reads them at once."""
        pieces = [encode(one, self.link.system, self.link.component, number) for number, one in enumerate(said)]
        self.link.transport.send(b"".join(pieces))

    async def until(self, wanted: Callable[[Any], bool]) -> list[Any]:
        """Return the messages up to the first one that is `wanted`."""
        got: list[Any] = []
        async with asyncio.timeout(PATIENCE_S):
            while True:
                received = await self.link.receive(1.0)
                if received is None:
                    self.say("HEARTBEAT", type=6, autopilot=8, system_status=4)
                    continue
                got.append(received.message)
                self.seen.add(received.message.get_type())
                if wanted(received.message):
                    return got

    async def command(self, number: int, *params: float) -> tuple[int, list[Any]]:
        """MAV_RESULT, and what came before it."""
        named = {f"param{place}": value for place, value in enumerate(params, start=1)}
        self.say("COMMAND_LONG", command=number, **named)
        *before, ack = await self.until(lambda m: m.get_type() == "COMMAND_ACK" and m.command == number)
        assert (ack.target_system, ack.target_component) == (255, 190)
        return ack.result, before


@asynccontextmanager
async def station(url: str) -> AsyncIterator[Station]:
    """QGroundControl, connected."""
    async with Connection(await open_transport(url, PATIENCE_S), 255, 190) as link:
        found = Station(link)
        found.say("HEARTBEAT", type=6, autopilot=8, system_status=4)
        beat = (await found.until(lambda m: m.get_type() == "HEARTBEAT"))[-1]
        assert (beat.type, beat.autopilot) == (2, 12)  # a quadrotor, PX4: what the plugins are chosen by
        yield found


def named(got: list[Any], name: str) -> list[Any]:
    return [one for one in got if one.get_type() == name]


async def versions(qgc: Station) -> None:
    result, got = await qgc.command(REQUEST_MESSAGE, AUTOPILOT_VERSION)
    (version,) = named(got, "AUTOPILOT_VERSION")
    assert result == ACCEPTED
    assert version.flight_sw_version >> 24 == 1
    assert version.capabilities & 8192  # MAVLink 2
    assert version.uid
    result, got = await qgc.command(REQUEST_MESSAGE, PROTOCOL_VERSION)
    assert result == ACCEPTED
    assert named(got, "PROTOCOL_VERSION")[0].max_version == 200


async def standard_modes(qgc: Station) -> None:
    """One request after the other, until as many modes have come as the first says there are."""
    rows: list[Any] = []
    while not rows or len(rows) < rows[0].number_modes:
        result, got = await qgc.command(REQUEST_MESSAGE, AVAILABLE_MODES, len(rows) + 1.0)
        assert result == ACCEPTED
        rows += named(got, "AVAILABLE_MODES")
    assert [row.mode_index for row in rows] == [*range(1, len(rows) + 1)]
    assert len({row.custom_mode for row in rows}) == len({row.mode_name for row in rows}) == len(rows)


async def component_metadata(qgc: Station) -> None:
    result, got = await qgc.command(REQUEST_MESSAGE, COMPONENT_METADATA)
    assert result == ACCEPTED
    assert named(got, "COMPONENT_METADATA")[0].uri.startswith("mftp://")
    for number in FOR_NAUGHT:
        assert (await qgc.command(REQUEST_MESSAGE, number))[0] == UNSUPPORTED


async def parameters(qgc: Station) -> dict[str, Any]:
    """All of them, by name; none may be missing when the list is through, and the hash is theirs."""
    qgc.say("PARAM_REQUEST_LIST", target_component=0)
    found: dict[str, Any] = {}

    def complete(one: Any) -> bool:
        if one.get_type() == "PARAM_VALUE":
            found[one.param_id] = one
        return "_HASH_CHECK" in found and len(found) == found["_HASH_CHECK"].param_count + 1

    got = named(await qgc.until(complete), "PARAM_VALUE")
    first = found.pop("_HASH_CHECK")
    assert (got[0].param_id, first.param_type, first.param_index) == ("_HASH_CHECK", UINT32, 65535)
    assert {one.param_index for one in found.values()} == set(range(first.param_count))
    assert {one.param_type for one in found.values()} == {INT32, REAL32}
    assert CANNOT_MISS - found.keys() == set()
    # As ParameterManager computes it from its cache, by names in order.
    content = b"".join(name.encode() + struct.pack("<f", found[name].param_value) for name in sorted(found))
    assert struct.pack("<f", first.param_value) == struct.pack("<I", zlib.crc32(content, 0xFFFFFFFF) ^ 0xFFFFFFFF)
    return found


async def plans(qgc: Station) -> None:
    for kind in (0, 1, 2):
        qgc.say("MISSION_REQUEST_LIST", mission_type=kind)
        count = (await qgc.until(lambda m: m.get_type() == "MISSION_COUNT"))[-1]
        assert (count.count, count.mission_type) == (0, kind)
        assert (count.target_system, count.target_component) == (255, 190)
        qgc.say("MISSION_ACK", mission_type=kind)


STEPS: tuple[Callable[[Station], Awaitable[Any]], ...] = (
    versions,
    standard_modes,
    component_metadata,
    parameters,
    plans,
)


@pytest.mark.long
@pytest.mark.waits
@in_loop
async def test_it_connects_and_finds_all_it_needs(fcu_url: str) -> None:
    async with station(fcu_url) as qgc:
        for step in STEPS:
            await step(qgc)
        await qgc.until(lambda _: qgc.seen >= STREAMS)
        # It does not know our own messages, and would count them as lost.
        assert {name for name in qgc.seen if name.startswith("TWODOF")} == set()


@pytest.mark.long
@in_loop
async def test_a_cache_with_the_same_hash_stops_the_list(fcu_url: str) -> None:
    """QGroundControl waits for the hash of the list; a list takes an eighth of a second, and who stands still is late.

    It is stopped once its hash has come: tests/fcu/mavlink/test_parameter_service.py shows that in the drone's time.
    """
    async with station(fcu_url) as qgc:
        qgc.say_in_one_breath(
            message("PARAM_REQUEST_LIST", **AUTOPILOT),
            message("PARAM_SET", param_id=b"_HASH_CHECK", param_type=UINT32, **AUTOPILOT),
            # PX4 does not answer it. A question behind it is answered after whatever was sent before.
            message("PARAM_REQUEST_READ", param_id=b"THERE_IS_NONE", param_index=-1, **AUTOPILOT),
        )
        await qgc.until(lambda m: m.get_type() == "PARAM_ERROR")
        after = await qgc.until(lambda m: m.get_type() == "HEARTBEAT")
        assert named(after, "PARAM_VALUE") == []


@pytest.mark.long
@in_loop
async def test_a_parameter_is_read_again_and_set(fcu_url: str) -> None:
    async with station(fcu_url) as qgc:

        def is_gain(one: Any) -> bool:
            return one.get_type() == "PARAM_VALUE" and one.param_id == "FC_PARAM_4"

        qgc.say("PARAM_REQUEST_READ", param_id="FC_PARAM_4", param_index=-1)
        old = (await qgc.until(is_gain))[-1]
        qgc.say("PARAM_SET", param_id="FC_PARAM_4", param_value=0.0625, param_type=REAL32)
        assert (await qgc.until(is_gain))[-1].param_value == 0.0625
        # What is refused is answered with what stays, so that it does not ask again and shows the true value.
        qgc.say("PARAM_SET", param_id="FC_PARAM_4", param_value=9.0, param_type=REAL32)
        assert (await qgc.until(is_gain))[-1].param_value == 0.0625
        qgc.say("PARAM_SET", param_id="FC_PARAM_4", param_value=old.param_value, param_type=REAL32)
        assert (await qgc.until(is_gain))[-1].param_value == old.param_value
