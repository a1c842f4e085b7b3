"""Transports of every kind: what is sent arrives, deadlines hold, ends are errors of their type, queues are bounded."""

import asyncio
import os
import socket
import termios
import threading
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from tests.link.ends import SOON, gather, in_loop, port, run
from twodof.errors import LinkError, LinkLost
from twodof.link.transport import base as bounds
from twodof.link.transport import open_transport, udp
from twodof.link.transport.base import Transport

KINDS = ("udp", "tcp", "mem", "serial")


@asynccontextmanager
async def pair(kind: str) -> AsyncIterator[tuple[Transport, Transport]]:
    """Two ends of a link; the first is the one that was opened to the other's address."""
    names = {"udp": "udpin://:0", "tcp": "tcpin://:0", "mem": "memin://pair"}
    if kind == "serial":
        master, slave = os.openpty()
        name = os.ttyname(slave)
        os.set_blocking(master, False)
        here = await open_transport(f"serial://{name}?baud=115200")
        there = await open_transport("memin://unused")
        # The other end of a pseudo-terminal is a descriptor, not a device: an end made of it by hand.
        from_master = _Descriptor(master)
        ends: tuple[Transport, Transport] = (here, from_master)
        os.close(slave)
        await there.close()
    else:
        there = await open_transport(names[kind])
        here = await open_transport(there.url.replace("in:", ":"))
        ends = (here, there)
    try:
        yield ends
    finally:
        for end in ends:
            await end.close()


class _Descriptor(Transport):
    """The master of a pseudo-terminal as a transport."""

    def __init__(self, descriptor: int) -> None:
        super().__init__("pty")
        self.descriptor = descriptor
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(descriptor, self._readable)

    @property
    def peers(self) -> tuple[str, ...]:
        """The slave."""
        return ("pty",)

    def _readable(self) -> None:
        try:
            self._inbox.put(bounds.Packet(os.read(self.descriptor, 65536), "pty"))
        except OSError:
            self._lose("closed")

    def _send(self, data: bytes, peer: Any) -> bool:
        return os.write(self.descriptor, data) == len(data)

    def _release(self) -> None:
        self._loop.remove_reader(self.descriptor)
        os.close(self.descriptor)


@pytest.mark.parametrize("kind", KINDS)
@in_loop
async def test_both_ways(kind: str) -> None:
    async with pair(kind) as (here, there):
        here.send(b"\xfdup\x00\x0a\x0d\x11\x13")
        packet = await there.receive(SOON)
        assert packet is not None
        assert packet.data == b"\xfdup\x00\x0a\x0d\x11\x13"  # nothing is translated or taken for flow control
        there.send(b"\xfddown", to=packet.peer)
        answer = await here.receive(SOON)
        assert answer is not None
        assert answer.data == b"\xfddown"
        assert answer.peer in here.peers
        there.confirm(packet.peer)
        there.send(b"\xfdall")
        assert await gather(here, 4) == b"\xfdall"
        assert (here.counts.packets_out, here.counts.dropped_out, here.counts.dropped_in) == (1, 0, 0)
        assert here.counts.bytes_in == 9


@pytest.mark.parametrize("kind", KINDS)
@in_loop
async def test_a_deadline_is_a_deadline(kind: str) -> None:
    async with pair(kind) as (here, _):
        assert here.receive_now() is None
        assert await here.receive(0.0) is None
        start = time.monotonic()
        assert await here.receive(0.05) is None
        assert 0.04 < time.monotonic() - start < SOON


@pytest.mark.parametrize("kind", KINDS)
@in_loop
async def test_closing_wakes_who_waits_and_frees_everything(kind: str) -> None:
    before = len([*Path("/proc/self/fd").iterdir()])
    async with pair(kind) as (here, _):
        waiting = asyncio.create_task(here.receive(SOON))
        await asyncio.sleep(0)
        await here.close()
        with pytest.raises(LinkLost, match="the link was closed"):
            await waiting  # at its deadline it would be None
        with pytest.raises(LinkLost):
            here.send(b"late")
        with pytest.raises(LinkLost):
            await here.receive(SOON)
        await here.close()
    while len([*Path("/proc/self/fd").iterdir()]) > before:
        await asyncio.sleep(0.01)


@pytest.mark.parametrize("kind", ["tcp", "mem", "serial"])
@in_loop
async def test_a_peer_that_goes_is_seen_after_what_it_said(kind: str) -> None:
    async with pair(kind) as (here, there):
        if kind != "mem":
            here.send(b"x")  # a pseudo-terminal's master must have been read from once
            await gather(there, 1)
        there.send(b"last words")
        if kind == "serial":
            await asyncio.sleep(0.05)  # a master's close discards what the slave has not read
            assert await gather(here, 10) == b"last words"
        await there.close()
        if kind != "serial":
            assert await gather(here, 10) == b"last words"
        with pytest.raises(LinkLost):
            await here.receive(SOON)  # at its deadline it would be None
        assert here.closed


@in_loop
async def test_nobody_there_ends_at_the_deadline() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # bound and not listening: refused
        for url in (f"tcp://127.0.0.1:{taken.getsockname()[1]}", "mem://nobody"):
            start = time.monotonic()
            with pytest.raises(LinkLost, match=r"no answer within 0\.2 s"):
                await open_transport(url, timeout=0.2)
            assert time.monotonic() - start < SOON


def test_a_name_that_does_not_resolve(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(
        *_: object, **__: object
    ) -> None:  # as a name server says; one that is slow, or not there, says it late
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    for url in ("udp://no.such.host.invalid:1", "tcp://no.such.host.invalid:1"):
        with pytest.raises(LinkError, match="cannot be opened: Name or service not known"):
            run(open_transport(url))


@in_loop
async def test_a_port_that_is_taken() -> None:
    for kind in ("udpin", "tcpin"):
        async with await open_transport(f"{kind}://:0") as first:
            with pytest.raises(LinkError, match="choose another port"):
                await open_transport(f"{kind}://:{port(first)}")
    async with await open_transport("memin://taken"):
        with pytest.raises(LinkError, match="is taken"):
            await open_transport("memin://taken")
    await (await open_transport("memin://taken")).close()  # free again


@in_loop
async def test_listening_is_on_loopback_unless_asked_otherwise() -> None:
    async with await open_transport("udp://:0") as one, await open_transport("tcp://:0") as two:
        # Another address of this machine, which a socket that is open to all answers at.
        with socket.socket(type=socket.SOCK_DGRAM) as sender:
            sender.connect(("127.0.0.2", port(one)))
            sender.settimeout(SOON)
            sender.send(b"x")
            with pytest.raises(ConnectionRefusedError):
                sender.recv(1)
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.2", port(two)), SOON)


@in_loop
async def test_a_forged_sender_gets_nothing_until_it_was_sound() -> None:
    async with await open_transport("udpin://:0") as there, await open_transport(there.url.replace("in:", ":")) as here:
        here.send(b"rubbish")
        packet = await there.receive(SOON)
        assert packet is not None
        there.send(b"telemetry")
        assert await here.receive(0.05) is None
        there.confirm(packet.peer)
        there.send(b"telemetry")
        assert await gather(here, 9) == b"telemetry"


@in_loop
async def test_udp_peers_are_bounded_and_the_silent_make_room(monkeypatch: pytest.MonkeyPatch) -> None:
    async with await open_transport("udpin://:0") as there:
        for number in range(3 * udp.MOST_PEERS):
            there.confirm(("127.0.0.1", 1000 + number))
        assert len(there.peers) == udp.MOST_PEERS
        assert ("127.0.0.1", 1000) in there.peers  # who spoke lately is not pushed out
        monkeypatch.setattr(udp, "SILENT_S", 0.0)
        there.confirm(("127.0.0.1", 9))
        assert ("127.0.0.1", 9) in there.peers
        assert len(there.peers) == udp.MOST_PEERS


@in_loop
async def test_udp_outlives_a_peer_that_is_not_there() -> None:
    taken = socket.socket(type=socket.SOCK_DGRAM)
    taken.bind(("127.0.0.1", 0))
    port = taken.getsockname()[1]
    taken.connect(("127.0.0.1", 1))  # closed to us, and nobody else is given it meanwhile
    async with await open_transport(f"udp://127.0.0.1:{port}") as here:
        with taken:
            for _ in range(5):
                here.send(b"anybody?")
                assert await here.receive(0.02) is None
            assert here.counts.errors > 0  # the system said that the port is closed
        async with await open_transport(f"udpin://:{port}") as there:
            here.send(b"anybody?")
            here.send(b"anybody?")  # the first may be told of the error before
            assert (await gather(there, 8))[:8] == b"anybody?"


@in_loop
async def test_a_serial_line_is_raw_at_its_speed_and_exclusive(tmp_path: Path) -> None:
    master, slave = os.openpty()
    name = os.ttyname(slave)
    os.close(slave)
    async with await open_transport(f"serial://{name}?baud=57600"):
        settings = termios.tcgetattr(master)
        assert settings[4] == settings[5] == termios.B57600
        assert not settings[3] & (termios.ECHO | termios.ICANON | termios.ISIG)
        assert not settings[0] & (termios.IXON | termios.ICRNL)
        if os.getuid():  # the superuser is let in all the same
            with pytest.raises(LinkError, match="end the program that uses it"):
                await open_transport(f"serial://{name}")
    os.close(master)
    with pytest.raises(LinkError, match="plug it in"):
        await open_transport("serial:///dev/ttyNONE")
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(LinkError, match="is not a serial line"):
        await open_transport(f"serial://{file}")


@in_loop
async def test_a_serial_line_that_takes_nothing_costs_bounded_memory() -> None:
    master, slave = os.openpty()
    os.set_blocking(master, False)
    name = os.ttyname(slave)
    async with await open_transport(f"serial://{name}") as here:
        os.close(slave)
        for _ in range(400):
            here.send(b"y" * 1000)
        assert here.counts.dropped_out > 0
        assert here.counts.dropped_out + here.counts.packets_out == 400
        data = b""
        while len(data) < here.counts.bytes_out:  # what was taken is all there, in order, once somebody reads
            await asyncio.sleep(0)
            with suppress(BlockingIOError):  # it is on its way in the system
                data += os.read(master, 65536)
        assert data == b"y" * here.counts.bytes_out
    os.close(master)


def test_memory_reaches_across_threads() -> None:
    async def server(ready: Callable[[], None]) -> None:
        async with await open_transport("memin://threads") as there:
            ready()
            packet = await there.receive(SOON)
            assert packet is not None
            there.send(packet.data[::-1], to=packet.peer)
            while there.peers:
                await there.receive(0.05)

    up = threading.Event()
    other = threading.Thread(target=lambda: run(server(up.set)))
    other.start()
    assert up.wait(SOON)

    async def client() -> bytes:
        async with await open_transport("mem://threads") as here:
            here.send(b"abc")
            return await gather(here, 3)

    assert run(client()) == b"cba"
    other.join(SOON)
    assert not other.is_alive()
