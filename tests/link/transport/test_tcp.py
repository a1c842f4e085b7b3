"""TCP: several clients on one server, each bounded in what it may keep and how long it may keep the others waiting."""

import asyncio
import os
import select
import socket
import threading
import time
from contextlib import ExitStack, suppress
from typing import Any

import pytest

from tests.link.ends import SOON, gather, in_loop, port
from twodof.link.transport import base as bounds
from twodof.link.transport import open_transport, tcp
from twodof.link.transport.base import Transport


def streams(there: Transport) -> list[Any]:
    """The connections that stand, each with its `name`, `socket` and whether it is `paused`."""
    return [*there.peers]


@in_loop
async def test_a_tcp_peer_that_does_not_read_costs_bounded_memory() -> None:
    async with await open_transport("tcpin://:0") as there:
        deaf = socket.create_connection(("127.0.0.1", port(there)), timeout=SOON)
        with deaf:
            while not there.peers:
                await asyncio.sleep(0.01)
            start = time.monotonic()
            for _ in range(2000):
                there.send(b"x" * 10_000)
            assert time.monotonic() - start < SOON  # it never waits: nobody will ever read
            assert there.counts.dropped_out > 0
            (stream,) = streams(there)
            assert stream.socket.get_write_buffer_size() <= bounds.MOST_OUT_BYTES
        # The deaf one is gone with a reset; the server goes on.
        async with await open_transport(f"tcp://127.0.0.1:{port(there)}") as here:
            here.send(b"hello")
            assert await gather(there, 5) == b"hello"


@in_loop
async def test_a_slow_tcp_reader_slows_its_sender_and_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bounds, "MOST_BYTES", 200_000)
    size = 3_000_000
    async with await open_transport("tcpin://:0") as there:
        data = os.urandom(size)

        def pour() -> None:
            with socket.create_connection(("127.0.0.1", port(there)), timeout=SOON) as out:
                out.sendall(data)

        pouring = threading.Thread(target=pour)
        pouring.start()
        while not any(stream.paused for stream in streams(there)):
            await asyncio.sleep(0.01)
        assert await gather(there, size) == data
        pouring.join(SOON)
        assert there.counts.dropped_in == 0


@in_loop
async def test_of_many_that_flood_no_more_is_read_than_leaves_the_reader_time() -> None:
    """Eight that send what they can for half a second: a round of all for each seven rests, and what was there before.

    A machine that is slow reads less. Without rests a hundred times as much is read.
    """
    floods, seconds = 8, 0.5
    async with await open_transport("tcpin://:0") as there:
        with ExitStack() as stack:
            links = [socket.create_connection(("127.0.0.1", port(there)), timeout=SOON) for _ in range(floods)]
            for link in links:
                stack.callback(link.close)
                link.setblocking(False)
            while len(there.peers) < floods:
                await asyncio.sleep(0.001)
            began = asyncio.get_running_loop().time()
            while (now := asyncio.get_running_loop().time()) < began + seconds:
                for link in links:
                    with suppress(BlockingIOError):
                        link.send(b"x" * 100_000)
                with suppress(TimeoutError):
                    await there.receive(0.0)
                await asyncio.sleep(0)
            rounds = (now - began) / ((floods - 1) * tcp.REST_S)
            # The first round is read before anybody is known to flood, and one may be amid its rest at either end.
            assert floods * tcp.LEAST_BYTES <= there.counts.bytes_in <= (rounds + 3) * tcp.ROUND_BYTES


@in_loop
async def test_a_tcp_client_that_floods_keeps_no_other_waiting() -> None:
    """Behind a reader that is busy elsewhere at most two windows of the flood are ahead of another's few bytes."""
    async with await open_transport("tcpin://:0") as there:
        flooder = socket.create_connection(("127.0.0.1", port(there)), timeout=SOON)
        other = socket.create_connection(("127.0.0.1", port(there)), timeout=SOON)
        with flooder, other:
            while len(there.peers) < 2:
                await asyncio.sleep(0.001)
            flooder.setblocking(False)
            for _ in range(200):
                with suppress(BlockingIOError):
                    flooder.send(b"x" * 100_000)
                await asyncio.sleep(0)
            other.sendall(b"kill")
            name = f"127.0.0.1:{other.getsockname()[1]}"
            (stream,) = [stream for stream in streams(there) if stream.name == name]
            # It has arrived before the first is taken, however late the system delivers it.
            assert select.select([stream.socket.get_extra_info("socket")], [], [], SOON)[0]
            ahead = 0
            while (packet := await there.receive(SOON)) is not None and packet.data != b"kill":
                ahead += len(packet.data)
            assert packet is not None
            assert 0 < ahead <= 2 * tcp.WINDOW_SHARES * tcp.ROUND_BYTES


@in_loop
async def test_tcp_clients_are_several_and_one_that_goes_harms_nobody() -> None:
    async with await open_transport("tcpin://:0") as there:
        url = f"tcp://127.0.0.1:{port(there)}"
        async with await open_transport(url) as one, await open_transport(url) as two:
            one.send(b"1")
            two.send(b"2")
            packets = [await there.receive(SOON), await there.receive(SOON)]
            assert {p.data for p in packets if p} == {b"1", b"2"}
            await one.close()
            while len(there.peers) > 1:
                await asyncio.sleep(0.01)
            there.send(b"still here")
            assert await gather(two, 10) == b"still here"
            gone = next(p.peer for p in packets if p and p.data == b"1")
            there.send(b"x", to=gone)  # no error, nothing sent
            assert there.counts.dropped_out == 1


async def _come(there: Transport, count: int, source: str = "127.0.0.1") -> list[socket.socket]:
    """Connect `count` more clients from an address of this machine, one after the other."""
    came = []
    for _ in range(count):
        one = socket.create_connection(("127.0.0.1", port(there)), SOON, (source, 0))
        name = f"{source}:{one.getsockname()[1]}"
        end = asyncio.get_running_loop().time() + 0.5
        while not any(stream.name == name for stream in streams(there)) and asyncio.get_running_loop().time() < end:
            await asyncio.sleep(0.005)
        came.append(one)
    return came


def _names(there: Transport) -> set[int]:
    """The ports of those that have a place."""
    return {int(stream.name.rpartition(":")[2]) for stream in streams(there)}


@in_loop
async def test_idle_clients_lock_no_port_and_who_speaks_or_is_kept_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tcp, "MOST_CLIENTS", 4)
    monkeypatch.setattr(tcp, "SPEAKS_S", 0.0)
    monkeypatch.setattr(tcp, "SILENT_S", 0.3)
    async with await open_transport("tcpin://:0") as there:
        ends = await _come(there, 4)
        ports = [one.getsockname()[1] for one in ends]
        (talker,) = (stream for stream in streams(there) if stream.name.endswith(f":{ports[0]}"))
        there.keeps = lambda peer: f":{ports[1]}>" in repr(peer)
        there.confirm(talker)
        (new,) = await _come(there, 1)  # of those that never spoke the first goes, but not who is kept
        assert _names(there) == {ports[0], ports[1], ports[3], new.getsockname()[1]}
        for stream in streams(there):
            there.confirm(stream)
        (late,) = await _come(there, 1)
        assert late.getsockname()[1] not in _names(there)
        await asyncio.sleep(0.35)
        there.confirm(talker)
        (later,) = await _come(there, 1)  # the longest silent goes
        assert later.getsockname()[1] in _names(there)
        assert {ports[0], ports[1]} <= _names(there)
        for one in (*ends, new, late, later):
            one.close()


@in_loop
async def test_one_address_takes_not_all_places_from_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tcp, "MOST_CLIENTS", 4)
    async with await open_transport("tcpin://:0") as there:
        greedy = await _come(there, 4)
        for stream in streams(there):
            there.confirm(stream)
        others = await _come(there, 3, "127.0.0.2")
        assert [one.getsockname()[1] in _names(there) for one in greedy] == [True, True, False, False]
        assert [one.getsockname()[1] in _names(there) for one in others] == [True, True, False]
        for one in (*greedy, *others):
            one.close()
