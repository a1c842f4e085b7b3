"""UDP that is bound and has an address of its own to send to, as PX4's links are; broadcast until somebody answers."""

import socket
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from tests.link.ends import SOON, in_loop
from twodof.errors import LinkError
from twodof.link.transport import open_transport, udp
from twodof.link.transport.base import Packet
from twodof.link.transport.udp import UdpTransport
from twodof.link.transport.url import Address, parse


@pytest.mark.parametrize(
    ("url", "address"),
    [
        ("udp://127.0.0.1:14540?bind=14580", Address("udp", "127.0.0.1", 14540, 0, "127.0.0.1", 14580)),
        ("udp://localhost:1?bind=0", Address("udp", "localhost", 1, 0, "127.0.0.1", 0)),
        ("udp://[::1]:14540?bind=14580", Address("udp", "::1", 14540, 0, "::1", 14580)),
        ("udpout://10.0.0.2:1?bind=0.0.0.0:14580", Address("udp", "10.0.0.2", 1, 0, "0.0.0.0", 14580)),
        ("udp://[fe80::2]:1?bind=[::]:2", Address("udp", "fe80::2", 1, 0, "::", 2)),
        ("udpbcast://192.168.1.255:14550", Address("udpbcast", "192.168.1.255", 14550)),
        ("udpbcast://10.0.0.255:1?bind=0.0.0.0:2", Address("udpbcast", "10.0.0.255", 1, 0, "0.0.0.0", 2)),
        ("udpbcast:10.0.0.255:14550", Address("udpbcast", "10.0.0.255", 14550)),
    ],
)
def test_forms(url: str, address: Address) -> None:
    assert parse(url) == address
    assert parse(str(address)) == address


@pytest.mark.parametrize(
    ("url", "complaint"),
    [
        ("udp://10.0.0.2:14540?bind=14580", r"bind=0\.0\.0\.0:14580"),  # this machine only cannot reach that one
        ("udp://127.0.0.1:1?bind=x", "bind=PORT"),
        ("udp://127.0.0.1:1?bind=99999", "out of range"),
        ("udp://127.0.0.1:1?bind=1&bind=2", "does not take"),
        ("udp://127.0.0.1:1?bind=", "not a place to listen"),
        ("udp://127.0.0.1:1?bind=a@b:1", "not a place to listen"),
        ("udpin://127.0.0.1:1?bind=2", "does not take"),
        ("tcp://127.0.0.1:1?bind=2", "does not take"),
        ("udpbcast://:14550", "has no host"),
        ("udpbcast://10.0.0.255", "has no port"),
        ("udpbcast://0.0.0.0:1", "not a host to send to"),
    ],
)
def test_the_rest_is_refused_with_a_remedy(url: str, complaint: str) -> None:
    with pytest.raises(LinkError, match=complaint):
        parse(url)


@contextmanager
def plain(host: str = "127.0.0.1") -> Iterator[tuple[socket.socket, int]]:
    """A UDP socket of somebody else, and its port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind((host, 0))
        opened.settimeout(SOON)
        yield opened, opened.getsockname()[1]


async def one(transport: UdpTransport) -> Packet:
    """The next packet."""
    packet = await transport.receive(SOON)
    assert packet is not None
    return packet


async def opened(url: str) -> UdpTransport:
    """A UDP transport."""
    transport = await open_transport(url)
    assert isinstance(transport, UdpTransport)
    return transport


@in_loop
async def test_it_sends_to_its_address_always_and_to_whoever_writes_soundly() -> None:
    with plain() as (default, port), plain() as (guest, guest_port), plain() as (mad, _):
        async with await opened(f"udp://127.0.0.1:{port}?bind=0") as link:
            assert isinstance(link, UdpTransport)
            here = ("127.0.0.1", link.port)
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
            assert link.peers == (("127.0.0.1", port), ("127.0.0.1", guest_port))  # its own is not there twice
            link.send(b"2")
            assert (default.recv(9), guest.recv(9)) == (b"2", b"2")
            mad.setblocking(False)
            with pytest.raises(BlockingIOError):
                mad.recv(9)


@in_loop
async def test_a_broadcast_ends_while_somebody_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    with plain("0.0.0.0") as (listener, port):
        # The loopback network's own broadcast address: nothing leaves this machine.
        async with await opened(f"udpbcast://127.255.255.255:{port}?bind=127.0.0.1:0") as link:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
                ground.settimeout(SOON)
                assert link.peers == (("127.255.255.255", port),)
                link.send(b"who is there")
                assert listener.recvfrom(20) == (b"who is there", ("127.0.0.1", link.port))
                ground.sendto(b"I am", ("127.0.0.1", link.port))
                packet = await one(link)
                link.confirm(packet.peer)
                assert link.peers == (packet.peer,)
                link.send(b"you alone")
                assert ground.recv(20) == b"you alone"
                listener.setblocking(False)
                with pytest.raises(BlockingIOError):
                    listener.recv(20)
                monkeypatch.setattr(udp, "SILENT_S", 0.0)  # as if so long had passed
                assert link.peers == (("127.255.255.255", port),)
