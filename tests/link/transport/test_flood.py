"""Floods over UDP: other senders are heard, a kill from any sender passes, and a refusal ends."""

import asyncio
import random
import select
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import pytest

from tests.link.ends import SOON, in_loop, port
from tests.patience import patiently
from twodof.link.mavlink.framing import encode, looks_like_a_stop
from twodof.link.mavlink.messages import message
from twodof.link.transport import open_transport, udp
from twodof.link.transport.udp import UdpTransport

pytestmark = pytest.mark.slow


def mavlink1(frame: bytes) -> bytes:
    """The same in MAVLink 1, which is understood, padded to its full length; the checksum is not looked at."""
    payload = frame[10:-2].ljust(51, b"\0")
    return bytes([0xFE, len(payload), *frame[4:7], frame[7]]) + payload + frame[-2:]


BEAT = encode(message("HEARTBEAT", type=6, autopilot=8), 77, 190, 0)
STOPS = [
    encode(message(name, target_system=system, command=command, **fields), 78, 190, 0)
    for name in ("COMMAND_LONG", "COMMAND_INT")
    for system in (0, 1)
    for command, fields in ((400, {"param2": 21196.0}), (400, {}), (185, {"param1": 1.0}))
]
STOPS += [mavlink1(stop) for stop in STOPS]
OTHERS = [
    BEAT,
    b"",
    b"\xfd",
    encode(message("COMMAND_LONG", target_system=1, command=400, param1=1.0), 78, 190, 0),
    encode(message("COMMAND_LONG", target_system=1, command=185), 78, 190, 0),  # releases a kill
    encode(message("COMMAND_LONG", target_system=1, command=512, param1=148.0), 78, 190, 0),
    encode(message("SET_ATTITUDE_TARGET", target_system=1, thrust=0.4), 78, 190, 0),
]
OTHERS += [mavlink1(other) for other in OTHERS[3:]]


@contextmanager
def senders(port: int, count: int, host: str = "127.0.0.1") -> Iterator[list[socket.socket]]:
    """Sockets of others, joined to `port`."""
    with ExitStack() as stack:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        opened = [stack.enter_context(socket.socket(family, socket.SOCK_DGRAM)) for _ in range(count)]
        for one in opened:
            one.connect((host, port))
        yield opened


async def listening(host: str = "127.0.0.1") -> UdpTransport:
    """A socket that others write to."""
    opened = await open_transport(f"udpin://{f'[{host}]' if ':' in host else host}:0")
    assert isinstance(opened, UdpTransport)
    return opened


async def pour(there: UdpTransport, sockets: list[socket.socket], data: bytes = BEAT) -> None:
    """Fill its buffer faster than it is read until a flood is noticed."""
    chance = random.Random(1)  # however much of it finds no room, none of them has more than its share
    for _ in patiently():
        for _ in range(udp.BURST + 64):  # more than is read in a turn
            chance.choice(sockets).send(data)
        await asyncio.sleep(0)
        if there._flood.count:
            return


async def drain(there: UdpTransport, until: bytes = b"") -> list[bytes]:
    """Everything that comes, up to the first `until`; without, until the system holds nothing more and has room."""
    found: list[bytes] = []
    while not until or until not in found[-1:]:
        packet = await there.receive(SOON if until else 0.02)
        if packet is not None:
            found.append(packet.data)
        elif until or not select.select([there._socket], [], [], 0)[0]:
            break
    return found


@pytest.fixture(autouse=True)
def long_refusal(monkeypatch: pytest.MonkeyPatch) -> None:
    """A refusal is longer than any test takes on a loaded machine."""
    monkeypatch.setattr(udp, "REFUSED_S", 600.0)


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
@in_loop
async def test_a_flooder_is_refused_but_its_kill_passes(host: str) -> None:
    async with await listening(host) as there:
        with senders(port(there), 3, host) as (flooder, pilot, late):
            pilot.send(b"pilot")
            await drain(there, b"pilot")
            await pour(there, [flooder])
            await drain(there)
            before = there.counts.packets_in
            for _ in range(100):
                flooder.send(BEAT)
            flooder.send(STOPS[0])
            pilot.send(b"again")
            late.send(b"newcomer")
            assert await drain(there, b"newcomer") == [STOPS[0], b"again", b"newcomer"]
            assert there.counts.packets_in == before + 3
            assert there._flood.count == 1


@in_loop
async def test_known_peers_are_heard_during_a_flood() -> None:
    async with await listening() as there:
        with senders(port(there), 100) as many, senders(port(there), 2) as (pilot, late):
            pilot.send(b"pilot")
            packet = await there.receive(SOON)
            assert packet is not None
            there.confirm(packet.peer)
            await pour(there, many)
            await drain(there)
            for _ in range(3):
                for one in many:
                    one.send(BEAT)
            pilot.send(b"again")
            late.send(STOPS[2])
            found = await drain(there, STOPS[2])
            assert found[-2:] == [b"again", STOPS[2]]
            assert len(found) < 20  # of 300 strangers' packets one in 256 passes


@in_loop
async def test_the_default_address_is_a_known_peer() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as default:
        default.bind(("127.0.0.1", 0))
        there = await open_transport(f"udp://127.0.0.1:{default.getsockname()[1]}?bind=0")
        async with there:
            with senders(port(there), 100) as many:
                await pour(there, many)
                await drain(there)
                default.sendto(b"ground", ("127.0.0.1", port(there)))
                assert await drain(there, b"ground") == [b"ground"]


@in_loop
async def test_a_refusal_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(udp, "REFUSED_S", 0.05)
    async with await listening() as there:
        with senders(port(there), 1) as (flooder,):
            await pour(there, [flooder])
            await drain(there)
            for _ in patiently():
                flooder.send(b"sorry")
                packet = await there.receive(0.02)
                if packet is not None and packet.data == b"sorry":
                    break


@in_loop
async def test_a_sleeping_reader_notices_no_flood() -> None:
    """A buffer full to the brim is read to its end, and nobody is blamed."""
    async with await listening() as there:
        with senders(port(there), 1) as (busy,):
            for _ in range(5000):
                busy.send(b"x")
            await asyncio.sleep(0.05)
            while await there.receive(0.05) is not None:
                pass
            busy.send(b"y")
            assert await drain(there, b"y") == [b"y"]
            assert there._flood.count == 0


def test_a_stop_is_known_by_its_beginning() -> None:
    assert [looks_like_a_stop(data) for data in STOPS] == [True] * len(STOPS)
    assert [looks_like_a_stop(data) for data in OTHERS] == [False] * len(OTHERS)
