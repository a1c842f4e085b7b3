"""Connections: over every transport, over a bad network on virtual time, signed, and against rubbish."""

import asyncio
import gc
import random
from contextlib import nullcontext
from pathlib import Path

import pytest

from tests.faults.transport import Faults, FaultyTransport
from tests.faults.virtual_time import on_virtual_time
from tests.link.ends import SOON, in_loop, port
from twodof.errors import LinkError, LinkLost
from twodof.link.connection import Connection
from twodof.link.mavlink import dialect
from twodof.link.mavlink.framing import Parser, encode
from twodof.link.mavlink.messages import message
from twodof.link.signing import Key, Signing, SigningVerdict, Stamps
from twodof.link.transport import open_transport, udp
from twodof.link.transport.base import memory_pair

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("kind", ["udp", "tcp", "mem"])
@in_loop
async def test_messages_both_ways(kind: str) -> None:
    there_at = await open_transport("memin://both" if kind == "mem" else f"{kind}in://:0")
    here_at = await open_transport(there_at.url.replace("in:", ":"))
    async with Connection(there_at, 1, 1) as drone, Connection(here_at, 255, 190) as ground:
        for tick in range(300):
            ground.send(message("TWODOF_OPENLOOP", tick=tick, M=0.1, openloop=1))
        got = [await drone.receive(SOON) for _ in range(300)]
        assert [one.message.tick for one in got if one] == list(range(300))
        assert got[0] is not None
        assert (got[0].frame.system, got[0].frame.component) == (255, 190)
        drone.send(message("HEARTBEAT", type=2, autopilot=12))  # the ground's address was learned
        answer = await ground.receive(SOON)
        assert answer is not None
        assert answer.message.autopilot == 12
        assert drone.statistics.senders[255, 190].received == 300
        assert drone.statistics.loss == 0.0
        assert drone.framing["frames"] == 300
        assert await drone.receive(0.01) is None


@on_virtual_time
async def test_damage_on_the_way_changes_no_message() -> None:
    here, there = memory_pair()
    faulty, got = FaultyTransport(here, Faults(damage=0.5), seed=6), []
    async with Connection(faulty, 1, 1) as drone, Connection(there, 255, 190) as ground:
        for tick in range(2000):
            drone.send(message("TWODOF_TICK", tick=tick, until=tick + 1, number=7 * tick))
        await asyncio.sleep(1.0)
        while one := ground.receive_now():
            assert one.message.get_type() == "TWODOF_TICK"
            assert (one.message.until, one.message.number) == (one.message.tick + 1, 7 * one.message.tick)
            got.append(one.message.tick)
        assert ground.framing["bad_checksum"] > 600  # the others hit the marker, the length, the flags or the id
        assert ground.framing["rubbish_bytes"] > 1000 * 12
    assert got == sorted(set(got))
    assert abs(len(got) - 1000) < 112  # five standard deviations of 2000 throws


@on_virtual_time
async def test_a_round_trip_is_measured() -> None:
    here, there = memory_pair()
    loop = asyncio.get_running_loop()
    slow = FaultyTransport(here, Faults(delay=0.1), seed=1)
    back = FaultyTransport(there, Faults(delay=0.1), seed=2)
    ground = Connection(slow, 255, 190, clock=loop.time)
    drone = Connection(back, 1, 1, clock=lambda: loop.time() + 50.0)
    serving = asyncio.create_task(drone.receive(10.0))
    ground.ping()
    assert await ground.receive(3.0) is None  # answered and taken within
    await ground.close()
    with pytest.raises(LinkLost):
        await serving
    await drone.close()
    trips = ground.statistics.round_trips
    assert trips.count == 1
    assert trips.last == pytest.approx(0.2, abs=1e-6)
    assert trips.offset == pytest.approx(50.0, abs=1e-6)  # the way takes as long there as back


@in_loop
async def test_a_question_about_time_is_answered_to_its_sender() -> None:
    """Unless it is for another component: that question is for the user."""
    here, there = memory_pair()
    async with Connection(here, 1, 1) as drone, Connection(there, 255, 190) as ground:
        for sequence, (system, component) in enumerate([(0, 0), (1, 0), (1, 1), (1, 2), (9, 0), (0, 1)]):
            asked = message("TIMESYNC", ts1=7, target_system=system, target_component=component)
            there.send(encode(asked, 255, 190, sequence))
            got = drone.receive_now()
            assert (got is None) is (sequence < 3)
            answer = there.receive_now()
            assert (answer is None) is (sequence >= 3)
        for number, system in enumerate((0, 9)):
            there.send(encode(message("PING", time_usec=7, seq=3, target_system=system), 255, 190, 6 + number))
        got = drone.receive_now()
        assert got is not None
        assert got.message.target_system == 9
        answered = ground.receive_now()
        assert answered is not None
        sent = answered.message
        assert (sent.time_usec, sent.seq, sent.target_system, sent.target_component) == (7, 3, 255, 190)


@in_loop
async def test_every_peer_has_its_own_sequence() -> None:
    async with (
        Connection(await open_transport("memin://two"), 1, 1) as drone,
        Connection(await open_transport("mem://two"), 255, 190) as one,
        Connection(await open_transport("mem://two"), 254, 190) as two,
    ):
        one.send(message("HEARTBEAT"))
        first = await drone.receive(SOON)
        assert first is not None
        for number in range(600):
            drone.send(message("TWODOF_TICK", tick=number), to=first.peer if number % 3 else None)
        for ground, expected in ((one, 600), (two, 200)):
            while ground.receive_now():
                pass
            counts = ground.statistics.senders[1, 1]
            assert (counts.received, counts.lost) == (expected, 0)


@in_loop
async def test_a_message_that_does_not_fit_uses_up_no_sequence() -> None:
    here, there = memory_pair()
    async with Connection(here, 1, 1) as drone, Connection(there, 255, 190) as ground:
        for kind in (1, 2, 999, 3):
            with pytest.raises(LinkError, match="type = 999") if kind == 999 else nullcontext():
                drone.send(message("HEARTBEAT", type=kind))
        got = [ground.receive_now() for _ in range(3)]
        assert [one.frame.sequence for one in got if one] == [0, 1, 2]


@in_loop
async def test_a_signed_link_and_an_intruder(tmp_path: Path) -> None:
    key = Key.fresh()
    async with (
        Connection(await open_transport("memin://signed"), 1, 1, Signing(key, Stamps(tmp_path / "drone"))) as drone,
        Connection(await open_transport("mem://signed"), 255, 190, Signing(key, Stamps(tmp_path / "ground"))) as ground,
        Connection(await open_transport("mem://signed"), 255, 191) as intruder,
    ):
        assert drone.signing is not None
        intruder.send(message("COMMAND_LONG", command=400, param1=1.0))
        ground.send(message("COMMAND_LONG", command=400, param1=0.0))
        got = await drone.receive(SOON)
        assert got is not None
        assert (got.frame.component, got.message.param1) == (190, 0.0)
        # What was recorded on the air and sent again is refused, by whoever sends it.
        intruder.transport.send(got.frame.raw)
        assert await drone.receive(0.05) is None
        assert (drone.signing.counts[SigningVerdict.UNSIGNED], drone.signing.counts[SigningVerdict.REPEATED]) == (1, 1)
        old = message("COMMAND_LONG", command=400, param1=1.0)
        intruder.transport.send(bytes(old.pack(dialect.load().MAVLink(None, 255, 190), force_mavlink1=True)))
        assert await drone.receive(0.05) is None
        assert drone.framing["mavlink1_refused"] == 1
        drone.send(message("COMMAND_ACK", command=400), to=got.peer)
        answer = await ground.receive(SOON)
        assert answer is not None
        assert answer.frame.signed


@in_loop
async def test_an_unsigned_stranger_over_udp_gets_no_telemetry() -> None:
    at = await open_transport("udpin://:0")
    drone = Connection(at, 1, 1, Signing(Key.fresh(), Stamps(None)))
    stranger = Connection(await open_transport(f"udp://127.0.0.1:{port(at)}"), 255, 190)
    stranger.send(message("HEARTBEAT"))
    stranger.send(message("RADIO_STATUS", rssi=1))  # a radio's own word, which has no signature anywhere else either
    assert await drone.receive(0.1) is None
    assert not drone.statistics.senders
    drone.send(message("HEARTBEAT"))
    assert await stranger.receive(0.1) is None
    await stranger.close()
    await drone.close()


@in_loop
async def test_what_is_not_signed_keeps_nobodys_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the very address of one who has gone: its place goes to the next who signs."""
    monkeypatch.setattr(udp, "MOST_PEERS", 1)
    monkeypatch.setattr(udp, "SILENT_S", 0.2)
    key = Key.fresh()
    at = await open_transport("udpin://:0")
    async with (
        Connection(at, 1, 1, Signing(key, Stamps(None))) as drone,
        Connection(await open_transport(f"udp://127.0.0.1:{port(at)}"), 9, 9, Signing(key, Stamps(None))) as gone,
        Connection(await open_transport(f"udp://127.0.0.1:{port(at)}"), 8, 8, Signing(key, Stamps(None))) as new,
    ):
        gone.send(message("HEARTBEAT"))
        assert await drone.receive(SOON) is not None
        (place,) = at.peers
        for _ in range(5):
            gone.transport.send(encode(message("HEARTBEAT"), 9, 9, 0))
            assert await drone.receive(0.1) is None
        new.send(message("HEARTBEAT"))
        assert await drone.receive(SOON) is not None
        assert len(at.peers) == 1
        assert at.peers != (place,)


@on_virtual_time
async def test_half_a_frame_on_a_stream_holds_the_next_up_for_a_tenth_of_a_second() -> None:
    here, there = memory_pair()
    here.whole = False  # as a serial line cuts it
    there.send(b"\xfd\xff\x00" + encode(message("HEARTBEAT"), 1, 1, 0))
    assert await Connection(here, 255, 190).receive(10.0) is not None
    assert asyncio.get_running_loop().time() == pytest.approx(0.1, abs=1e-6)


def parsers() -> int:
    """Parsers that are alive."""
    gc.collect()
    return sum(type(one) is Parser for one in gc.get_objects())


@in_loop
async def test_rubbish_arms_nothing_and_leaves_nothing_behind() -> None:
    here, there = memory_pair()
    chance, before = random.Random(5), parsers()
    async with Connection(here, 1, 1) as drone:
        for _ in range(3000):
            there.send(chance.randbytes(chance.randrange(300)))
            assert drone.receive_now() is None
        there.send(encode(message("HEARTBEAT"), 255, 190, 0))
        got = await drone.receive(SOON)
        assert got is not None
        assert drone.framing["rubbish_bytes"] > 100_000
        assert parsers() == before + 1


@in_loop
async def test_peers_on_a_stream_each_have_a_parser_and_those_are_bounded() -> None:
    at = await open_transport("memin://many")
    at.whole = False  # as TCP cuts it
    heartbeat, before = encode(message("HEARTBEAT"), 255, 190, 0), parsers()
    async with Connection(at, 1, 1) as drone:
        clients = [await open_transport("mem://many") for _ in range(100)]
        for cut in (5, len(heartbeat)):
            for client in clients[:60]:
                client.send(heartbeat[:5] if cut == 5 else heartbeat[5:])
        for _ in range(60):  # none took the other's half for its own
            assert drone.receive_now() is not None
        for client in clients:
            client.send(b"\x00" + heartbeat)
            assert drone.receive_now() is not None
        assert parsers() == before + 64
        assert drone.framing["frames"] == 160
        assert drone.framing["rubbish_bytes"] == 100
        for client in clients:
            await client.close()


@in_loop
async def test_a_message_that_the_dialect_has_not_is_passed_over() -> None:
    here, there = memory_pair()
    strange = b"\xfd\x03\x00\x00\x05\x01\x01" + (300_000).to_bytes(3, "little") + b"abc" + b"\x12\x34"
    here.send(strange)
    here.send(known := encode(message("HEARTBEAT"), 7, 8, 9))
    async with Connection(there, 1, 191) as drone:
        got = await drone.receive(SOON)
        assert got is not None
        assert got.frame.raw == known


@in_loop
async def test_two_tasks_cannot_receive_at_once() -> None:
    here, _ = memory_pair()
    drone = Connection(here, 1, 1)
    first = asyncio.create_task(drone.receive(SOON))
    await asyncio.sleep(0)
    with pytest.raises(RuntimeError, match="two tasks receive"):
        await drone.receive(SOON)
    await drone.close()
    with pytest.raises(LinkLost):
        await first


@in_loop
async def test_ends_are_errors_of_their_type() -> None:
    here, there = memory_pair()
    drone = Connection(here, 1, 1)
    there.send(encode(message("HEARTBEAT"), 255, 190, 0))
    await there.close()
    assert await drone.receive(SOON) is not None  # what had arrived comes first
    with pytest.raises(LinkLost, match="the other end was closed"):
        await drone.receive(SOON)
    with pytest.raises(LinkLost):
        drone.send(message("HEARTBEAT"))
    await drone.close()
