"""Whatever comes over a link, the program that reads it gets on with its other work, and nobody waits behind others."""

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from tests.link.ends import SOON, in_loop, port
from twodof.link import connection
from twodof.link.connection import Connection
from twodof.link.mavlink import framing
from twodof.link.mavlink.framing import LONGEST_FRAME, Parser, encode
from twodof.link.mavlink.messages import message
from twodof.link.signing import Key, Signing, Stamps
from twodof.link.transport import base as bounds
from twodof.link.transport import open_transport, udp
from twodof.link.transport.base import Inbox, Packet, TransportCounts, memory_pair

pytestmark = pytest.mark.slow

FALSE = b"\xfe"  # each begins a frame of MAVLink 1 whose message there is and whose checksum does not hold
TICK = message("TWODOF_TICK", tick=7)


def unknown(number: int) -> bytes:
    """A frame of a message that the dialect lacks."""
    return b"\xfd\x01\x00\x00" + bytes([number & 0xFF]) + b"\x09\x01\xaa\xaa\x00\x07\x12\x34"


FLOODS = {
    "rubbish": FALSE * 40,
    "unknown": unknown(3),
    "pings": encode(message("PING", seq=1), 9, 9, 0),
    "time": encode(message("TIMESYNC", ts1=5), 9, 9, 0),
    "nothing": b"",
}


@asynccontextmanager
async def turns() -> AsyncIterator[list[int]]:
    """How often another task had its turn."""
    count = [0]

    async def work() -> None:
        while True:
            count[0] += 1
            await asyncio.sleep(0)

    task = asyncio.create_task(work())
    try:
        yield count
    finally:
        task.cancel()


@pytest.mark.parametrize("kind", FLOODS)
@in_loop
async def test_others_have_their_turn_beside_packets_that_hold_no_message(kind: str) -> None:
    here, there = memory_pair()
    async with Connection(there, 1, 1) as drone, turns() as count:
        for _ in range(5000):
            here.send(FLOODS[kind])
        here.send(encode(TICK, 9, 9, 0))
        got = await drone.receive(SOON)
        assert got is not None
        assert got.message.tick == 7
        # 5000 of them cost a quarter of a second; in turns of two milliseconds at most that is a hundred.
        most = connection.MOST_LOOKED_THROUGH // connection.A_PACKET
        assert count[0] >= 5000 // most - 1


@in_loop
async def test_others_have_their_turn_beside_what_is_not_signed() -> None:
    here, there = memory_pair()
    key = Key.fresh()
    async with (
        Connection(here, 9, 9, Signing(key, Stamps(None))) as ground,
        Connection(there, 1, 1, Signing(key, Stamps(None))) as drone,
        turns() as count,
    ):
        for _ in range(5000):
            here.send(encode(TICK, 9, 9, 0))
        ground.send(TICK)
        assert await drone.receive(SOON) is not None
        assert count[0] >= 10


@in_loop
async def test_rubbish_on_a_stream_is_looked_through_in_pieces() -> None:
    size = 200 * connection.PIECE
    async with (
        await open_transport("tcpin://:0") as there,
        await open_transport(f"tcp://127.0.0.1:{port(there)}") as here,
        Connection(there, 1, 1) as drone,
        turns() as count,
    ):
        here.send(FALSE * size)
        here.send(bytes(LONGEST_FRAME))  # ends what looks begun
        here.send(encode(TICK, 9, 9, 0))
        assert await drone.receive(SOON) is not None
        assert drone.framing["bad_checksum"] > size // 2
        assert count[0] >= 200


@in_loop
async def test_a_look_that_was_broken_off_goes_on() -> None:
    """`receive_now` may find nothing yet; it finds every frame in the end, in their order."""
    here, there = memory_pair()
    async with Connection(there, 1, 1) as drone:
        for number in range(20):
            for _ in range(200):
                here.send(FALSE * 60)
            here.send(encode(message("TWODOF_TICK", tick=number), 9, 9, number))
        found, looks = [], 0
        while len(found) < 20 and looks < 1000:
            looks += 1
            got = drone.receive_now()
            if got is not None:
                found.append(got.message.tick)
        assert found == [*range(20)]
        assert looks > 20
        assert drone.receive_now() is None


@pytest.mark.parametrize("data", [FALSE * 65_000, b"\xfd\xff\x00" * 20_000, b"\xfd\x03\x00\xfe" * 16_000])
def test_a_datagram_costs_no_more_than_so_many_checksums(data: bytes) -> None:
    parser = Parser()
    assert len(parser.feed(data, whole=True)) < len(data) / 12
    assert parser.counts.bad_checksum <= framing.MOST_FALSE
    assert parser.counts.rubbish_bytes + sum(map(len, (f.raw for f in Parser().feed(data, whole=True)))) == len(data)
    assert parser.waiting == 0


@in_loop
async def test_a_datagram_longer_than_a_network_carries_is_dropped() -> None:
    async with await open_transport("udpin://:0") as there:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here:
            here.connect(("127.0.0.1", port(there)))
            for size in (udp.LONGEST_DATAGRAM + 1, 60_000, udp.LONGEST_DATAGRAM):
                here.send(bytes(size))
            packet = await there.receive(SOON)
            assert packet is not None
            assert len(packet.data) == udp.LONGEST_DATAGRAM
            assert there.counts.dropped_in == 2


@in_loop
async def test_peers_take_turns_by_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Six packets of 50 bytes weigh as much as one of 300, and who had 3000 at once waits for ten turns."""
    monkeypatch.setattr(bounds, "TURN_BYTES", 300)
    inbox = Inbox(TransportCounts())
    for number in range(24):
        inbox.put(Packet(b"%50d" % number, "pilot"))
    for _ in range(4):
        inbox.put(Packet(bytes(300), "flooder"))
        inbox.put(Packet(bytes(3000), "worse"))
    taken = ""
    while (packet := inbox.take()) is not None:
        taken += str(packet.peer)[0]
    assert taken == "ppppppfw" + 3 * "ppppppf" + "www"


@in_loop
async def test_who_floods_drops_its_own_and_nobody_elses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bounds, "MOST_PACKETS", 100)
    counts = TransportCounts()
    inbox = Inbox(counts)
    inbox.put(Packet(b"kill", "other"))
    for number in range(1000):
        inbox.put(Packet(b"%d" % number, "flooder"))
    inbox.put(Packet(b"again", "other"))
    taken = []
    while (packet := inbox.take()) is not None:
        taken.append(packet.data)
    assert [data for data in taken if not data.isdigit()] == [b"kill", b"again"]
    assert taken.index(b"again") <= 3
    assert [int(data) for data in taken if data.isdigit()] == [*range(1000 - len(taken) + 2, 1000)]
    assert counts.dropped_in == 1002 - len(taken)


@in_loop
async def test_a_newcomer_has_room_where_each_of_many_has_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bounds, "MOST_PACKETS", 100)
    inbox = Inbox(TransportCounts())
    for number in range(1000):
        inbox.put(Packet(b"x", number))
    inbox.put(Packet(b"kill", "other"))
    taken = []
    while (packet := inbox.take()) is not None:
        taken.append(packet.data)
    assert taken == [b"x"] * 99 + [b"kill"]


@pytest.mark.parametrize("kind", ["tcp", "udp"])
@pytest.mark.parametrize("signed", [False, True], ids=["plain", "signed"])
@in_loop
async def test_a_kill_waits_behind_nothing_that_came_before_it_and_acts_once(kind: str, signed: bool) -> None:
    """Behind its own sender's other words, whole or in two pieces; what was signed before it and waits is void."""
    key = Key.fresh()
    kill = message("COMMAND_LONG", command=400, param2=21196.0, target_system=1, target_component=1)

    def signing() -> Signing | None:
        return Signing(key, Stamps(None)) if signed else None

    there = await open_transport(f"{kind}in://:0")
    pilot = Connection(await open_transport(f"{kind}://127.0.0.1:{port(there)}"), 250, 190, signing())
    async with Connection(there, 1, 1, signing()) as drone, pilot:
        for number in range(12):
            pilot.send(message("TWODOF_TICK", tick=number))
        pilot.send(kill)
        await asyncio.sleep(0.2)
        heard = []
        while (got := await drone.receive(0.2)) is not None:
            heard.append(got.message.get_type())
        assert heard == ["COMMAND_LONG"] + ["TWODOF_TICK"] * (0 if signed else 12)
        raw = encode(kill, 250, 190, 77, *((drone.signing.outgoing(),) if drone.signing is not None else ()))
        for piece in (raw[:20], raw[20:]) if kind == "tcp" else (raw,):
            pilot.transport.send(piece)
            await asyncio.sleep(0.05)
        assert (await drone.receive(SOON)).frame.raw == raw  # type: ignore[union-attr]
        assert await drone.receive(0.2) is None


@in_loop
async def test_a_kill_behind_thirty_floods_acts_before_their_first_frame() -> None:
    """Counted in what was taken before it, not in time: 30 connections' worth waits, and the kill comes last of all."""
    beats = b"".join(encode(message("HEARTBEAT"), 9, 9, number & 255) for number in range(400))
    async with await open_transport("tcpin://:0") as there:
        drone = Connection(there, 1, 1)
        floods = [await open_transport(f"tcp://127.0.0.1:{port(there)}") for _ in range(30)]
        other = await open_transport(f"tcp://127.0.0.1:{port(there)}")
        while len(there.peers) < 31:
            await asyncio.sleep(0.01)
        for one in floods:
            one.send(beats)
        await asyncio.sleep(0.2)
        other.send(encode(message("COMMAND_LONG", command=400, param2=21196.0), 8, 8, 0))
        await asyncio.sleep(0.2)  # meanwhile whoever receives is busy
        before = 0
        while (got := await drone.receive(SOON)) is not None and got.message.get_type() != "COMMAND_LONG":
            before += 1
        assert got is not None
        assert before == 0
        for one in (*floods, other):
            await one.close()
