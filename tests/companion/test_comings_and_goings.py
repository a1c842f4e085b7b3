"""Clients that come, go, move and are joined in circles: nothing is left of them, nothing goes round for ever."""

import asyncio
import gc
import random
import socket
from pathlib import Path

import pytest

from tests.companion.ends import Ends, frame
from tests.companion.scripted import Listener, Vehicle, until
from tests.faults.virtual_time import on_virtual_time, run_virtual
from tests.link.ends import in_loop
from twodof.companion.client import MOST_REQUESTS, MOST_SENDERS, SILENT_S
from twodof.companion.companion import Companion, Serve
from twodof.companion.router import BEHIND_S, MOST_PASSED, MOST_ROUNDS
from twodof.link.mavlink.framing import LONGEST_FRAME, decode, encode
from twodof.link.mavlink.messages import message
from twodof.link.transport import open_transport
from twodof.link.transport.tcp import GONE_S, TcpTransport
from twodof.link.transport.url import parse

pytestmark = pytest.mark.slow

ATTITUDE, TRUTH = 30, 54205
TO = {"target_system": 1, "target_component": 1}


def asks(number: int, interval: float = 4000.0) -> dict[str, float]:
    """Command 511 for a message."""
    return {"command": 511, "param1": float(number), "param2": interval, **TO}


def test_a_client_that_asked_for_everything_leaves_nothing_behind() -> None:
    """The router remembers only what present clients want, however many ids were asked for before."""
    ends = Ends("onboard")
    before = dict(ends.router.asked)
    for generation in range(8):
        client = ends.join("none")
        for number in range(300):
            ends.says(client, "COMMAND_LONG", 250, **asks(60_000 + 300 * generation + number))
        assert len(client.requests) == MOST_REQUESTS
        assert decode(ends.heard(client)[-1]).result == 1
        ends.router.remove(client)
    assert ends.router.asked == before


def test_a_client_that_moves_keeps_its_streams() -> None:
    ends = Ends("none", "none", "none")
    first, second, other = ends.clients
    for client in ends.clients[1:]:
        client.transport = first.transport  # three addresses of one link
    ends.says(first, "COMMAND_LONG", 250, **asks(ATTITUDE))
    ends.says(other, "HEARTBEAT", 9)
    ends.settle()
    ends.says(second, "HEARTBEAT", 250)
    ends.router.remove(first)
    assert ends.answer() == []  # the vehicle goes on
    assert second.requests[ATTITUDE].interval == 4000
    assert other.requests == {}


def test_senders_that_are_passed_on_to_a_client_are_bounded() -> None:
    ends = Ends("onboard", "onboard")
    here, there = ends.clients
    ends.says(there, "HEARTBEAT", 77)
    for number in range(1000):
        ends.says(here, "COMMAND_LONG", 100 + number % 100, 1 + number // 10, command=1, target_system=77)
    assert len(ends.heard(there)) == 1000
    assert len(there._sequences) <= MOST_SENDERS


def held() -> tuple[int, int]:
    """Objects and open files of this process."""
    gc.collect()
    return len(gc.get_objects()), len([*Path("/proc/self/fd").iterdir()])


def come_and_go(count: int) -> None:
    """`count` clients come by TCP, ask for something and go, some with a reset; others send from `count` UDP ports."""

    async def work() -> None:
        serve = [Serve("tcpin://127.0.0.1:0", "none"), Serve("udpin://127.0.0.1:0", "none")]
        async with Vehicle(await open_transport("memin://fcu")) as vehicle, Companion("mem://fcu", serve) as companion:
            tcp, udp = (("127.0.0.1", parse(url).port) for url, _ in companion.urls)
            raw = encode(message("COMMAND_LONG", **asks(ATTITUDE, 1e6)), 9, 190, 0)
            warm, vehicle.steps = (0, 0), 25
            for number in range(count):
                _, writer = await asyncio.open_connection(*tcp)
                writer.write(raw + b"\xfd\x20half of a frame")
                if number % 3:
                    await asyncio.sleep(0.01)
                if number % 2:
                    writer.transport.abort()
                else:
                    writer.close()
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
                    one.sendto(raw, udp)
                await asyncio.sleep(0.02)
                vehicle.received.clear()
                if number == count // 4:
                    await asyncio.sleep(SILENT_S + 1.0)
                    vehicle.received.clear()
                    warm = held()
            await asyncio.sleep(SILENT_S + 1.0)
            vehicle.received.clear()
            assert companion.router.clients == []
            assert vehicle.asked[ATTITUDE] == -1.0
            objects, files = held()
            # One object kept of each, of two clients, would be three times as many.
            assert objects - warm[0] < count // 2
            assert files <= warm[1]

    run_virtual(work())


@pytest.mark.long
def test_clients_that_come_and_go_leave_nothing_behind() -> None:
    come_and_go(160)


@pytest.mark.soak
def test_ten_thousand_clients_that_come_and_go_leave_nothing_behind() -> None:
    come_and_go(10_000)


@on_virtual_time
async def test_companions_in_a_circle_pass_nothing_round_for_ever() -> None:
    """Each takes the other for its flight controller, as a mistaken address makes them."""
    one = Companion("mem://two", [Serve("memin://one", "none")])
    two = Companion("mem://one", [Serve("memin://two", "none")])
    async with one, two:
        await until(lambda: one.line.transport is not None and two.line.transport is not None)
        async with Listener(await open_transport("mem://one"), beats=False) as client:
            client.command(512, 148.0)
            client.command(400, 0.0, 21196.0)
            await asyncio.sleep(5.0)
            assert one.line.sent_bytes + two.line.sent_bytes < 200 * LONGEST_FRAME
            before = one.line.sent_bytes
            await asyncio.sleep(0.9)
            assert one.line.sent_bytes - before < 10 * LONGEST_FRAME, "heartbeats alone, and nothing goes round"


def test_only_what_comes_again_from_others_goes_round() -> None:
    ends = Ends("none", "none")
    ends.settle()
    for _ in range(50):  # a client that never counts its frames, and sends the same set-point over and over
        ends.says(ends.clients[0], "COMMAND_LONG", 250, command=400, **TO)
    for _ in range(50):
        ends.says(ends.clients[1], "COMMAND_LONG", 250, command=400, **TO)
    for _ in range(50):
        ends.says(ends.clients[0], "COMMAND_LONG", 250, command=400, **TO)
    assert len(ends.up.take()) == 100 + MOST_ROUNDS
    ends.now += 1.0
    ends.says(ends.clients[1], "COMMAND_LONG", 250, command=400, **TO)
    assert len(ends.up.take()) == 1
    for number in range(2 * MOST_PASSED):
        ends.says(ends.clients[0], "MANUAL_CONTROL", 250, target=1, x=number % 1000)
    assert len(ends.router._passed) <= MOST_PASSED


def test_a_stranger_on_the_line_shuts_out_no_client_for_ever() -> None:
    """A frame from the line under a client's identity, an echo or a neighbour's, is forgotten after a while."""
    ends = Ends("onboard")
    ends.settle()
    ends.router.from_vehicle(frame("HEARTBEAT", 250, 190))
    ends.says(ends.clients[0], "COMMAND_LONG", 250, command=400, **TO)
    assert ends.up.take() == []
    ends.now += BEHIND_S
    ends.says(ends.clients[0], "COMMAND_LONG", 250, command=400, **TO)
    assert len(ends.up.take()) == 1
    ends.says(ends.clients[0], "HEARTBEAT", 1, 1)  # in the vehicle's own name never
    assert ends.up.take() == []


def test_a_program_on_board_is_not_told_the_truth() -> None:
    ends = Ends("onboard", "onboard")
    ends.settle()
    app, ground = ends.clients
    app.on_board = True
    for command in (511, 512, 510):
        ends.says(app, "COMMAND_LONG", 1, 192, command=command, param1=float(TRUTH), param2=4000.0, **TO)
        answer = decode(ends.heard(app)[0])
        assert (answer.get_type(), answer.command, answer.result) == ("COMMAND_ACK", command, 2)
        assert TRUTH not in [number for number, _ in ends.answer()]
    ends.says(ground, "COMMAND_LONG", 250, **asks(TRUTH))
    assert (TRUTH, 4000.0) in ends.answer()


@in_loop
async def test_a_peer_that_is_gone_without_a_word_is_noticed() -> None:
    """A pulled cable, a machine without power: TCP is told to find out on both ends, in half a minute."""
    async with await open_transport("tcpin://:0") as there:
        assert isinstance(there, TcpTransport)
        async with await open_transport(there.url.replace("in:", ":")) as here:
            assert isinstance(here, TcpTransport)
            while not there.peers:
                await asyncio.sleep(0.001)
            for end in (here, there):
                (stream,) = end._streams
                assert stream.socket is not None
                raw = stream.socket.get_extra_info("socket")
                assert raw.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
                for name, value in (("TCP_USER_TIMEOUT", 1000 * GONE_S), ("TCP_KEEPIDLE", GONE_S // 3)):
                    if hasattr(socket, name):
                        assert raw.getsockopt(socket.IPPROTO_TCP, getattr(socket, name)) == value


@pytest.mark.parametrize("garbage", [b"", b"\xfd", b"\xfe", b"\xfd\xff\x00\x00", random.Random(3).randbytes(300)])
@on_virtual_time
async def test_a_line_that_is_joined_in_the_middle_of_a_frame_costs_that_frame_only(garbage: bytes) -> None:
    """At each byte, with the garbage that a wrong baud rate made of those before, and broken off again."""
    raw = encode(message("STATUSTEXT", severity=6, text="sound"), 1, 1, 0)
    async with await open_transport("tcpin://:0") as line:
        url = line.url.replace("in:", ":")
        async with (
            Companion(url, [Serve("memin://clients", "onboard")]),
            Listener(await open_transport("mem://clients")) as client,
        ):
            await until(lambda: bool(line.peers))
            for cut in range(len(raw)):
                client.received.clear()
                line.send(garbage + raw[cut:] + raw + raw[:7])
                await until(lambda: len(client.heard("STATUSTEXT", component=1)) > 0)
                await asyncio.sleep(0.3)  # what has begun is given up
                assert len(client.heard("STATUSTEXT", component=1)) == (garbage + raw[cut:] + raw).count(raw)
