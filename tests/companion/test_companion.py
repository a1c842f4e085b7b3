"""The companion as a whole: clients that vanish, flood and send rubbish; a line that is cut and comes back."""

import asyncio
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from tests.companion.scripted import Listener, Vehicle, until
from tests.faults.virtual_time import on_virtual_time
from tests.link.ends import in_loop
from tests.patience import PATIENCE_S
from twodof.companion import links
from twodof.companion import uplink_queue as line_module
from twodof.companion.client import SILENT_S
from twodof.companion.companion import Companion
from twodof.companion.component import ACTIVE, CRITICAL
from twodof.companion.links import LONGEST_BACK_OFF_S, OPEN_S, REMIND_S, VEHICLE_SILENT_S, Serve, px4_links
from twodof.errors import LinkError
from twodof.link.mavlink.framing import Parser, encode
from twodof.link.mavlink.messages import message
from twodof.link.signing import Key, Signing, SigningVerdict, Stamps
from twodof.link.transport import open_transport
from twodof.link.transport.base import MOST_OUT_BYTES
from twodof.link.transport.url import parse

pytestmark = pytest.mark.slow

CLIENTS = (Serve("memin://clients", "onboard"),)


def texts(client: Listener) -> list[str]:
    """Return the texts of the companion."""
    return [one.text for one in client.heard("STATUSTEXT", component=191)]


@on_virtual_time
async def test_a_line_that_is_cut_is_told_and_opened_again() -> None:
    vehicle = Vehicle(await open_transport("memin://fcu"))
    async with Companion("mem://fcu", CLIENTS), Listener(await open_transport("mem://clients")) as client:
        await until(lambda: len(client.heard("ATTITUDE")) > 100)
        assert client.heard("HEARTBEAT", component=191)[-1].system_status == ACTIVE
        await vehicle.close()
        await until(lambda: "flight controller lost: the other end was closed" in texts(client))
        assert client.heard("HEARTBEAT", component=191)[-1].system_status == CRITICAL
        client.command(400, 1.0)
        await asyncio.sleep(7.0)
        before = len(client.heard("ATTITUDE"))
        async with Vehicle(await open_transport("memin://fcu")) as back:
            await until(lambda: len(client.heard("ATTITUDE")) > before + 100)
            assert back.asked[30] == 10_000.0  # a vehicle that forgot everything is told again
            assert client.heard("HEARTBEAT", component=191)[-1].system_status == ACTIVE
            assert texts(client)[-1] == "flight controller heard"
            assert not [one for one in back.heard("COMMAND_LONG") if one.command == 400]


@on_virtual_time
async def test_a_vehicle_that_falls_silent_is_told_of() -> None:
    async with (
        Vehicle(await open_transport("memin://fcu")) as vehicle,
        Companion("mem://fcu", CLIENTS),
        Listener(await open_transport("mem://clients")) as client,
    ):
        await until(lambda: len(client.heard("ATTITUDE")) > 10)
        vehicle.silent = True
        began = asyncio.get_running_loop().time()
        await until(lambda: client.heard("HEARTBEAT", component=191)[-1].system_status == CRITICAL)
        assert asyncio.get_running_loop().time() - began == pytest.approx(VEHICLE_SILENT_S, abs=0.2)
        vehicle.asked.clear()
        vehicle.silent = False
        await until(lambda: vehicle.asked.get(30) == 10_000.0)  # it may have started anew meanwhile
        await until(lambda: client.heard("HEARTBEAT", component=191)[-1].system_status == ACTIVE)


@on_virtual_time
async def test_that_the_vehicle_is_not_there_is_said_at_once_and_then_seldom() -> None:
    said: list[str] = []
    async with Companion("mem://fcu", CLIENTS, tell=said.append):
        await asyncio.sleep(2.0 * OPEN_S)
        assert len(said) == 1
        assert said[0].startswith("flight controller not reached yet: mem://fcu: ")
        await asyncio.sleep(REMIND_S)
        assert said[1:] == said[:1]
        async with Vehicle(await open_transport("memin://fcu")) as vehicle:
            vehicle.silent, vehicle.steps = True, 125
            await asyncio.sleep(LONGEST_BACK_OFF_S + 2.0 * VEHICLE_SILENT_S)
            assert "no heartbeat comes" in said[2]
            vehicle.silent = False
            await until(lambda: len(said) > 3)
            await asyncio.sleep(2.0 * REMIND_S)
    assert said[3:] == ["flight controller heard"]


@on_virtual_time
async def test_nothing_speaks_for_a_client_that_fell_silent() -> None:
    async with (
        Vehicle(await open_transport("memin://fcu")) as vehicle,
        Companion("mem://fcu", CLIENTS) as companion,
        Listener(await open_transport("mem://clients")) as client,
    ):
        await until(lambda: len(vehicle.heard("HEARTBEAT", system=250)) > 2)
        client.beats = False
        await asyncio.sleep(0.5)
        vehicle.received.clear()
        vehicle.steps = 125
        await asyncio.sleep(10.0)
        assert {(one.frame.system, one.frame.component) for one in vehicle.received} == {(1, 191)}
        assert len(companion.router.clients) == 1


@on_virtual_time
async def test_a_client_on_udp_that_vanishes_is_forgotten_and_a_default_address_stays() -> None:
    with _port() as (there, default):
        serve = [Serve(f"udp://127.0.0.1:{default}?bind=0", "ground")]
        async with Vehicle(await open_transport("memin://fcu")) as vehicle, Companion("mem://fcu", serve) as companion:
            await until(lambda: len(_datagrams(there)) > 0)  # PX4's way: sent to without having spoken
            address = parse(companion.urls[0][0])
            async with Listener(await open_transport(f"udp://127.0.0.1:{address.bind_port}")) as client:
                await until(lambda: len(client.heard("ATTITUDE")) > 20)
                client.command(511, 30.0, 4000.0)
                await until(lambda: vehicle.asked[30] == 4000.0)
                assert len(companion.router.clients) == 2
            began, vehicle.steps = asyncio.get_running_loop().time(), 125
            await until(lambda: vehicle.asked[30] > 60_000.0, 2 * SILENT_S)
            assert asyncio.get_running_loop().time() - began == pytest.approx(SILENT_S, abs=1.5)
            assert [client.stays for client in companion.router.clients] == [True]
            _datagrams(there)
            await asyncio.sleep(1.0)
            assert _datagrams(there)


@on_virtual_time
async def test_strangers_take_all_places_of_one_link_and_keep_nobody_from_a_kill(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(links, "MOST_CLIENTS", 3)
    serve = [Serve("memin://one", "ground"), Serve("memin://two", "ground")]
    async with Vehicle(await open_transport("memin://fcu")) as vehicle, Companion("mem://fcu", serve) as companion:
        strangers = [await open_transport("mem://one") for _ in range(5)]
        for number, stranger in enumerate(strangers):
            stranger.send(encode(message("HEARTBEAT", type=6), 20 + number, 190, 0))
        await until(lambda: len(companion.router.clients) == 3)
        late = strangers[-1]
        kill = {"target_system": 1, "target_component": 1, "command": 400, "param2": 21196.0}
        late.send(encode(message("COMMAND_LONG", **kill), 1, 1, 0))  # in the vehicle's own name
        for fields in (kill | {"param1": 1.0}, kill | {"target_system": 9}, kill):
            late.send(encode(message("COMMAND_LONG", **fields), 24, 190, 0))
        await until(lambda: bool(vehicle.heard("COMMAND_LONG", system=24)))
        # Its kill, and nothing else: no heartbeat, no arming, not what is for another.
        assert [one.param1 for one in vehicle.heard("COMMAND_LONG", system=24)] == [0.0]
        assert not vehicle.heard("HEARTBEAT", system=24)
        kills = [one for one in vehicle.heard("COMMAND_LONG") if one.command == 400]
        assert len(kills) == 1
        async with Listener(await open_transport("mem://two")) as client:  # the other link has places of its own
            await until(lambda: len(client.heard("ATTITUDE")) > 2)
        for stranger in strangers:
            await stranger.close()


@on_virtual_time
async def test_with_a_key_what_is_not_signed_freshly_ends_here_and_who_is_behind_is_told_the_time() -> None:
    key, clock = Key.fresh(), [10**12]
    beat = message("HEARTBEAT", type=6, autopilot=8)
    ours, theirs = (Signing(key, Stamps(None, lambda: clock[0]), link) for link in (191, 5))
    async with (
        Vehicle(await open_transport("memin://fcu")) as vehicle,
        Companion("mem://fcu", [Serve("memin://one", "none")], signing=ours) as companion,
    ):
        client = await open_transport("mem://one")
        fresh = encode(beat, 24, 190, 0, theirs.outgoing())
        for raw in (encode(beat, 25, 190, 0), encode(beat, 25, 190, 0, Signing(Key.fresh(), Stamps(None)).outgoing())):
            client.send(raw)
        client.send(fresh)
        await until(lambda: bool(vehicle.heard("HEARTBEAT", system=24)))
        for _ in range(5):
            client.send(fresh)  # replayed
        await asyncio.sleep(1.0)
        assert [len(vehicle.heard("HEARTBEAT", system=number)) for number in (24, 25)] == [1, 0]
        assert (
            ours.counts[SigningVerdict.FORGED],
            ours.counts[SigningVerdict.REPEATED],
            ours.counts[SigningVerdict.ACCEPTED],
        ) == (1, 5, 1)
        assert [one.identities for one in companion.router.clients] == [{(24, 190)}]
        told = []
        while (packet := client.receive_now()) is not None:
            told += [frame for frame in Parser().feed(packet.data) if frame.message_id == 111]
        assert len(told) == 1  # ten times a second at most
        assert theirs.check(told[0]) is SigningVerdict.ACCEPTED
        await client.close()


@contextmanager
def _port() -> Iterator[tuple[socket.socket, int]]:
    """A UDP socket of this machine and its port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as there:
        there.bind(("127.0.0.1", 0))
        there.setblocking(False)
        yield there, there.getsockname()[1]


def _datagrams(there: socket.socket) -> list[bytes]:
    found = []
    while True:
        try:
            found.append(there.recv(65536))
        except BlockingIOError:
            return found


@pytest.mark.long
@on_virtual_time
async def test_a_client_that_stops_reading_holds_nobody_up() -> None:
    serve = (*CLIENTS, Serve("tcpin://127.0.0.1:0"))
    async with Vehicle(await open_transport("memin://fcu")) as vehicle, Companion("mem://fcu", serve) as companion:
        narrow = socket.socket()
        narrow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)  # the system keeps little for it
        narrow.connect(("127.0.0.1", parse(companion.urls[1][0]).port))
        reader, writer = await asyncio.open_connection(sock=narrow, limit=1024)
        async with Listener(await open_transport("mem://clients")) as client:
            client.command(511, 30.0, 4000.0)
            await until(lambda: len(companion.router.clients) == 2 and vehicle.asked.get(30) == 4000.0)
            stuck = next(one for one in companion.router.clients if one.transport.url.startswith("tcpin"))
            await until(lambda: len(client.heard("ATTITUDE")) > 10)
            start = client.heard("ATTITUDE")[-1].time_boot_ms
            padding = [message("FILE_TRANSFER_PROTOCOL", payload=[1] * 251) for _ in range(100)]
            for _ in range(400):
                for one in padding:
                    vehicle.connection.send(one)
                await asyncio.sleep(0.004)
                client.received[:] = [one for one in client.received if one.message.get_type() == "ATTITUDE"]
                if stuck.transport.counts.dropped_out:
                    break
            assert stuck.transport.counts.dropped_out > 0
            assert stuck.transport.backlog <= MOST_OUT_BYTES
            await until(lambda: vehicle.tick * 4 - client.heard("ATTITUDE")[-1].time_boot_ms < 20)
            times = [one.time_boot_ms for one in client.heard("ATTITUDE") if one.time_boot_ms >= start]
            assert times == list(range(start, times[-1] + 1, 4))  # not one was lost, all in order
        writer.close()
        del reader


@on_virtual_time
async def test_lockstep_passes_without_a_moments_delay() -> None:
    async with (
        Vehicle(await open_transport("memin://fcu"), lockstep=True),
        Companion("mem://fcu", CLIENTS),
        Listener(await open_transport("mem://clients")) as client,
    ):
        await asyncio.sleep(2.0)
        loop = asyncio.get_running_loop()
        began, client.beats = loop.time(), False
        to = {"target_system": 1, "target_component": 1}
        for number in range(1, 1001):
            client.connection.send(message("TWODOF_GRANT", until=number, number=number, **to))
            while not client.heard("TWODOF_TICK") or client.heard("TWODOF_TICK")[-1].number != number:
                await asyncio.sleep(0)
            client.received.clear()
        # Everything happened at once in virtual time: nothing on the way waited for a clock.
        assert loop.time() - began < 0.1


@on_virtual_time
async def test_it_answers_for_itself() -> None:
    async with (
        Vehicle(await open_transport("memin://fcu")) as vehicle,
        Companion("mem://fcu", CLIENTS),
        Listener(await open_transport("mem://clients")) as client,
    ):
        await asyncio.sleep(1.5)
        for number, result in ((148, 0), (390, 0), (242, 3)):
            client.command(512, float(number), component=191)
            await until(lambda: bool(client.heard("COMMAND_ACK", component=191)))
            assert client.heard("COMMAND_ACK", component=191)[-1].result == result
            client.received.clear()
            await asyncio.sleep(0.1)
        client.command(400, 0.0, component=191)
        await until(lambda: bool(client.heard("COMMAND_ACK", component=191)))
        assert vehicle.heard("COMMAND_LONG", system=250) == []
        await until(lambda: len(client.heard("ONBOARD_COMPUTER_STATUS")) > 2)
        status = client.heard("ONBOARD_COMPUTER_STATUS")[-1]
        assert 0 < status.ram_usage < status.ram_total
        assert status.link_rx_rate[0] == round(250 * 40 / 1024)  # ATTITUDE has 40 bytes; in KiB/s
        heartbeats = vehicle.heard("HEARTBEAT", system=1)
        assert {(one.type, one.autopilot) for one in heartbeats} == {(18, 8)}


@on_virtual_time
async def test_a_fault_of_ours_ends_it_instead_of_being_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    transport = await open_transport("tcpin://127.0.0.1:0")
    async with Vehicle(transport):
        companion = await Companion(transport.url.replace("in:", ":"), CLIENTS).__aenter__()
        monkeypatch.setattr(companion.router, "receivers", None)
        with pytest.raises(TypeError, match="not callable"):
            await asyncio.wait_for(companion.run(), PATIENCE_S)
        with pytest.raises(TypeError, match="not callable"):
            await companion.close()


def test_px4s_addresses_are_those_of_the_instance() -> None:
    assert [parse(one.url) for one in px4_links(3)] == [
        parse("udp://127.0.0.1:14543?bind=127.0.0.1:14583"),
        parse("udp://127.0.0.1:14550?bind=127.0.0.1:18573"),
        parse("tcpin://127.0.0.1:5763"),
    ]
    assert all(parse(one.url).bind_name == "127.0.0.1" or parse(one.url).name == "127.0.0.1" for one in px4_links(0))


@on_virtual_time
async def test_an_address_that_is_taken_is_an_error_and_leaves_nothing_open() -> None:
    async with await open_transport("memin://taken"):
        with pytest.raises(LinkError, match="is taken"):
            async with Companion("mem://fcu", [Serve("memin://free"), Serve("memin://taken")]):
                pass
    async with await open_transport("memin://free"):
        pass


class Serial:
    """A serial line whose flight controller's end is ours: a pseudo-terminal behind a name that stays."""

    def __init__(self, folder: Path) -> None:
        self.name = folder / "ttyFCU"
        self.frames: list[Any] = []
        self._parser = Parser()
        self.plug()

    def plug(self) -> None:
        """Plug it in."""
        self.master, slave = os.openpty()
        os.set_blocking(self.master, False)
        self.name.unlink(missing_ok=True)
        self.name.symlink_to(os.ttyname(slave))
        self._slave = slave

    def pull(self) -> None:
        """Pull the cable."""
        os.close(self._slave)
        os.close(self.master)

    def read(self) -> list[Any]:
        """All frames that have come."""
        with suppress(OSError):  # nothing there
            self.frames += self._parser.feed(os.read(self.master, 65536))
        return self.frames


@pytest.mark.parametrize("baud", [57_600])
@in_loop
async def test_a_serial_line_is_shared_fairly_and_survives_its_cable(
    tmp_path: Path, baud: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(line_module, "STALE_S", PATIENCE_S)  # nothing grows old while this machine stands still
    line = Serial(tmp_path)
    async with Companion(f"serial://{line.name}?baud={baud}", CLIENTS) as companion:
        flooder = await open_transport("mem://clients")
        modest = await open_transport("mem://clients")
        await until(lambda: len(line.read()) > 0)
        loop = asyncio.get_running_loop()
        flood = encode(message("TUNNEL", target_system=1, payload=[1] * 128), 7, 1, 0)
        began, flooded, sent = loop.time(), 0, 0
        while flooded < 4000:
            due = min(int(4000 * (loop.time() - began)), 4000)  # a hundred times what the line carries
            for _ in range(flooded, due):
                flooder.send(flood)
            flooded = due
            if loop.time() - began > 0.05 * sent:
                modest.send(encode(message("MANUAL_CONTROL", target=1, x=sent), 8, 1, sent))
                sent += 1
            await asyncio.sleep(0.005)
            line.read()
        flooder.send(encode(message("COMMAND_LONG", target_system=1, command=400), 7, 1, 0))
        await until(lambda: any(one.message_id == 76 and one.system == 7 for one in line.read()))
        assert sum(len(one.raw) for one in line.frames) < baud / 10 * (loop.time() - began + 0.1) + 300
        # Not one of the modest is lost; after a stall several are still on their way.
        await until(lambda: bool(line.read()) and sum(one.system == 8 for one in line.frames) == sent)
        assert sum(one.system == 7 for one in line.frames) < flooded, "the excess is dropped"
        line.pull()
        await until(lambda: companion.line.transport is None)
        line.plug()
        line.frames.clear()
        await until(lambda: any(one.system == 1 and one.component == 191 for one in line.read()))
        await flooder.close()
        await modest.close()
    line.pull()
