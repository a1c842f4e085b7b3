"""UDP sockets that are flooded: others are heard, a kill from any sender passes, and nobody is refused for ever."""

from __future__ import annotations

import asyncio
import random
import select
import socket
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from ipaddress import ip_address

import pytest

from tests.link.ends import SOON, run
from tests.patience import patiently
from twodof.link.mavlink.framing import encode
from twodof.link.mavlink.messages import message
from twodof.link.transport import flood_filter, open_transport, udp
from twodof.link.transport.flood_filter import FloodFilter, looks_like_a_stop, program, sources
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
        if there.floods:
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


@pytest.fixture(params=["kernel", "here"])
def filtered(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """With the kernel's filter, and on a system without one; for longer than any test takes."""
    monkeypatch.setattr(flood_filter, "REFUSED_S", 600.0)
    if request.param == "kernel" and sys.platform != "linux":
        pytest.skip("socket filters are Linux's")
    if request.param == "here":

        def refuse(*_: object) -> None:
            raise OSError("no such option")

        monkeypatch.setattr(flood_filter, "attach", refuse)
    return str(request.param)


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_who_floods_is_refused_but_for_a_kill_and_the_others_are_heard(filtered: str, host: str) -> None:
    async def work() -> None:
        async with await listening(host) as there:
            with senders(there.port, 3, host) as (flooder, pilot, late):
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
                assert there.floods == 1

    run(work())


def test_a_flood_of_many_sources_leaves_room_for_those_who_are_known(filtered: str) -> None:
    async def work() -> None:
        async with await listening() as there:
            with senders(there.port, 100) as many, senders(there.port, 2) as (pilot, late):
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

    run(work())


def test_the_address_that_is_sent_to_unasked_is_known_too(filtered: str) -> None:
    async def work() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as default:
            default.bind(("127.0.0.1", 0))
            there = await open_transport(f"udp://127.0.0.1:{default.getsockname()[1]}?bind=0")
            assert isinstance(there, UdpTransport)
            async with there:
                with senders(there.port, 100) as many:
                    await pour(there, many)
                    await drain(there)
                    default.sendto(b"ground", ("127.0.0.1", there.port))
                    assert await drain(there, b"ground") == [b"ground"]

    run(work())


def test_nobody_is_refused_for_ever(filtered: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flood_filter, "REFUSED_S", 0.05)

    async def work() -> None:
        async with await listening() as there:
            with senders(there.port, 1) as (flooder,):
                await pour(there, [flooder])
                await drain(there)
                for _ in patiently():
                    flooder.send(b"sorry")
                    packet = await there.receive(0.02)
                    if packet is not None and packet.data == b"sorry":
                        break

    run(work())


def test_what_came_while_the_reader_slept_is_no_flood() -> None:
    """A buffer full to the brim is read to its end, and nobody is blamed."""

    async def work() -> None:
        async with await listening() as there:
            with senders(there.port, 1) as (busy,):
                for _ in range(5000):
                    busy.send(b"x")
                await asyncio.sleep(0.05)
                while await there.receive(0.05) is not None:
                    pass
                busy.send(b"y")
                assert await drain(there, b"y") == [b"y"]
                assert there.floods == 0

    run(work())


@pytest.mark.skipif(sys.platform != "linux", reason="socket filters are Linux's")
@pytest.mark.parametrize("listed_pass", [True, False])
def test_the_kernel_and_we_agree_on_what_passes(listed_pass: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flood_filter, "ONE_IN", 1 << 31)  # by chance one in so many: none

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as there:
        there.bind(("127.0.0.1", 0))
        there.settimeout(SOON)
        with senders(there.getsockname()[1], 2) as (one, other):
            flood_filter.attach(there, program(sources([one.getsockname()]), listed_pass))
            for data in (*STOPS, *OTHERS):
                assert looks_like_a_stop(data) == (data in STOPS)
                one.send(data)
                other.send(data)
            flood_filter.attach(there, [])
            one.send(b"end")
            heard = []
            while (found := there.recvfrom(1000))[0] != b"end":
                heard.append(found)
            passing = one if listed_pass else other
            for sender in (one, other):
                expected = [data for data in (*STOPS, *OTHERS) if sender is passing or data in STOPS]
                assert [data for data, peer in heard if peer == sender.getsockname()] == expected


def test_sources_of_every_family() -> None:
    assert sources([("10.0.0.1", 5), ("::ffff:10.0.0.2", 6, 0, 0), ("fe80::1%eth0", 7, 0, 2), "serial"]) == [
        (ip_address("10.0.0.1"), 5),
        (ip_address("10.0.0.2"), 6),
        (ip_address("fe80::1"), 7),
    ]


def test_a_filter_is_bounded() -> None:
    """However many flood, it stays below Linux's 4096 instructions."""
    many = sources([(f"fe80::{number:x}", number, 0, 0) for number in range(1, 1000)])
    assert len(program(many, True)) < 1000


def test_a_flood_is_forgotten_with_its_socket() -> None:
    async def work() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
            watching = FloodFilter(opened, asyncio.get_running_loop(), tuple)
            while watching.count == 0:
                watching.came("somebody", b"")
            assert not watching.came("somebody", b"")
            watching.close()
            await asyncio.sleep(0)

    run(work())
