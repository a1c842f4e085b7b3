"""UDP that is bound and has an address of its own to send to, as PX4's links are; broadcast until somebody answers."""

import socket
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from tests.link.ends import SOON, in_loop, port
from twodof.link.transport import open_transport, udp
from twodof.link.transport.base import Packet, Transport


@contextmanager
def plain(host: str = "127.0.0.1") -> Iterator[tuple[socket.socket, int]]:
    """A UDP socket of somebody else, and its port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind((host, 0))
        opened.settimeout(SOON)
        yield opened, opened.getsockname()[1]


async def one(transport: Transport) -> Packet:
    """The next packet."""
    packet = await transport.receive(SOON)
    assert packet is not None
    return packet


@in_loop
async def test_it_sends_to_its_address_always_and_to_whoever_writes_soundly() -> None:
    with plain() as (default, there), plain() as (guest, guest_port), plain() as (mad, _):
        async with await open_transport(f"udp://127.0.0.1:{there}?bind=0") as link:
            here = ("127.0.0.1", port(link))
            link.send(b"1")
            assert default.recvfrom(9) == (b"1", here)  # from the port that it is bound to
            guest.sendto(b"hello", here)
            mad.sendto(b"rubbish", here)
            for _ in range(2):
                packet = await one(link)
                if packet.data == b"hello":
                    assert packet.peer == ("127.0.0.1", guest_port)
                    link.confirm(packet.peer)
            default.sendto(b"mine", here)
            packet = await one(link)
            link.confirm(packet.peer)
            assert link.peers == (("127.0.0.1", there), ("127.0.0.1", guest_port))  # its own is not there twice
            link.send(b"2")
            assert (default.recv(9), guest.recv(9)) == (b"2", b"2")
            mad.setblocking(False)
            with pytest.raises(BlockingIOError):
                mad.recv(9)


@in_loop
async def test_a_broadcast_ends_while_somebody_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    with plain("0.0.0.0") as (listener, there):
        # The loopback network's own broadcast address: nothing leaves this machine.
        async with await open_transport(f"udpbcast://127.255.255.255:{there}?bind=127.0.0.1:0") as link:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
                ground.settimeout(SOON)
                assert link.peers == (("127.255.255.255", there),)
                link.send(b"who is there")
                assert listener.recvfrom(20) == (b"who is there", ("127.0.0.1", port(link)))
                ground.sendto(b"I am", ("127.0.0.1", port(link)))
                packet = await one(link)
                link.confirm(packet.peer)
                assert link.peers == (packet.peer,)
                link.send(b"you alone")
                assert ground.recv(20) == b"you alone"
                listener.setblocking(False)
                with pytest.raises(BlockingIOError):
                    listener.recv(20)
                monkeypatch.setattr(udp, "SILENT_S", 0.0)  # as if so long had passed
                assert link.peers == (("127.255.255.255", there),)
