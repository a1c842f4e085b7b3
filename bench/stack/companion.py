"""The companion: its own share of a frame, and what the system adds between processes on loopback."""

import asyncio
import socket
import subprocess
import sys
import time
from collections.abc import Hashable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import cast

from bench.measure import Figure, one_core, timed
from bench.stack.programs import END_S, START_S, running
from twodof.companion.client import CompanionClient, profile
from twodof.companion.router import Router
from twodof.companion.uplink_queue import UplinkQueue
from twodof.link.mavlink.framing import Parser, encode
from twodof.link.mavlink.messages import message
from twodof.link.transport import open_transport
from twodof.link.transport.base import Transport

FRAME_US = 15.0
ADDED_MS = 0.3
RATE_HZ = 250.0
ATTITUDE, MANUAL_CONTROL, COMMAND_LONG, COMMAND_ACK = 30, 69, 76, 77
MODULUS = 1 << 15  # what MANUAL_CONTROL carries there and back
ANSWER_S = 0.3
LAST_S = 10.0
"""After so long without one more, what has not come is lost."""


# What any asyncio program pays to pass on each packet by itself, with no MAVLink in it.
BARE = """
import asyncio, os, socket, sys
async def work():
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    out.setblocking(False)
    ended = asyncio.Event()
    class Pass(asyncio.Protocol):
        def data_received(self, data): out.sendto(data, ("127.0.0.1", int(sys.argv[2])))
        def connection_lost(self, error): ended.set()
    await asyncio.get_running_loop().create_connection(Pass, "127.0.0.1", int(sys.argv[1]))
    before = sum(os.times()[:2])
    await ended.wait()
    print(sum(os.times()[:2]) - before)
asyncio.run(work())
"""


class Nowhere:
    """A transport that takes everything."""

    backlog = 0

    def send(self, data: bytes, to: Hashable | None = None) -> None:
        """Drop the data."""


def own_share(clients: int, count: int, repeats: int) -> tuple[float, float]:
    """CPU time [s] of a frame down to one client, and of a frame up, without system calls."""
    nowhere = cast(Transport, Nowhere())
    line = UplinkQueue()
    line.connect(nowhere)
    router = Router(1, line, lambda: 0.0)
    for number in range(clients):
        router.add(CompanionClient(nowhere, number, profile("none"), 0.0))
        asked = message("COMMAND_LONG", command=511, target_system=1, target_component=1, param1=ATTITUDE, param2=4000)
        for frame in Parser().feed(encode(asked, 200 + number, 1, 0)):
            router.from_client(router.clients[-1], frame)
    to = {"target_system": 1, "target_component": 1}
    down = [encode(message("ATTITUDE", time_boot_ms=4 * k, yawspeed=1.0), 1, 1, k & 255) for k in range(count)]
    up = [
        encode(message("SET_ATTITUDE_TARGET", time_boot_ms=k, thrust=0.4, **to), 200, 1, k & 255) for k in range(count)
    ]
    parser = Parser()

    def all_down() -> None:
        for raw in down:
            for frame in parser.feed(raw):
                router.from_vehicle(frame)

    def all_up() -> None:
        for raw in up:
            for frame in parser.feed(raw):
                router.from_client(router.clients[0], frame)

    one, other = (timing.median / count for timing in timed([all_down, all_up], repeats))
    return one / clients, other


class Ends:
    """A flight controller and a client around a companion: when frames were sent, and how late they came."""

    def __init__(self, vehicle: Transport, client: Transport) -> None:
        self.vehicle = vehicle
        self.client = client
        self.sent: dict[int, float] = {}
        self.down: list[float] = []
        self.up: list[float] = []
        self.granted = asyncio.Event()

    async def read_client(self) -> None:
        """Note the age of each frame that reaches the client."""
        parser = Parser()
        while True:
            packet = await self.client.receive(1.0)
            for frame in parser.feed(packet.data, self.client.whole) if packet is not None else ():
                if frame.message_id == COMMAND_ACK:
                    self.granted.set()
                elif frame.message_id == ATTITUDE:
                    sent = self.sent.get(int.from_bytes(frame.payload[:4], "little"))
                    self.down += [] if sent is None else [time.perf_counter() - sent]

    async def read_vehicle(self) -> None:
        """Note the age of each frame that reaches the vehicle, and grant requests for streams."""
        parser = Parser()
        while True:
            packet = await self.vehicle.receive(1.0)
            for frame in parser.feed(packet.data) if packet is not None else ():
                if frame.message_id == COMMAND_LONG:
                    to = {"target_system": frame.system, "target_component": frame.component}
                    self.vehicle.send(encode(message("COMMAND_ACK", command=511, **to), 1, 1, 0))
                elif frame.message_id == MANUAL_CONTROL:
                    sent = self.sent.get(-int.from_bytes(frame.payload[:2], "little"))
                    self.up += [] if sent is None else [time.perf_counter() - sent]

    async def subscribe(self) -> None:
        """Asks the companion for ATTITUDE at 250 Hz until it is granted. Raises TimeoutError."""
        asked = message("COMMAND_LONG", command=511, target_system=1, target_component=1, param1=ATTITUDE, param2=4000)
        async with asyncio.timeout(START_S):
            while not self.granted.is_set():
                self.client.send(encode(asked, 200, 1, 0))
                with suppress(TimeoutError):
                    await asyncio.wait_for(self.granted.wait(), ANSWER_S)

    async def exchange(self, count: int) -> None:
        """`count` of ATTITUDE at 250 Hz down, a fifth of MANUAL_CONTROL up, with the number that they are known by."""
        loop = asyncio.get_running_loop()
        start = loop.time()
        for number in range(1, count + 1):
            self.sent[4 * number] = time.perf_counter()
            attitude = message("ATTITUDE", time_boot_ms=4 * number, yawspeed=1.0)
            self.vehicle.send(encode(attitude, 1, 1, number & 255))
            if number % 5 == 0:
                self.sent[-(number % MODULUS)] = time.perf_counter()
                stick = message("MANUAL_CONTROL", target=1, x=number % MODULUS, buttons=1)
                self.client.send(encode(stick, 200, 1, number // 5 & 255))
            await asyncio.sleep(max(0.0, start + number / RATE_HZ - loop.time()))
        come, until = 0, loop.time() + LAST_S
        while come < len(self.sent) and loop.time() < until:
            if len(self.down) + len(self.up) > come:
                come, until = len(self.down) + len(self.up), loop.time() + LAST_S
            await asyncio.sleep(0.01)


async def through(seconds: float, folder: Path) -> tuple[Ends, float]:
    """Frames through a companion in a process of its own, and the CPU time [s] it took for each that it passed on."""
    vehicle = await open_transport("tcpin://127.0.0.1:0")
    arguments = ("companion", "--fcu", vehicle.url.replace("in:", ":"), "--onboard", "udpin://127.0.0.1:0")
    with running(*arguments, urls=1, folder=folder) as program:
        client = await open_transport(program.urls[0].replace("udpin:", "udp:"))
        ends = Ends(vehicle, client)
        reading = [asyncio.create_task(ends.read_client()), asyncio.create_task(ends.read_vehicle())]
        await ends.subscribe()
        before = program.cpu_seconds()
        await ends.exchange(round(seconds * RATE_HZ))
        each = (program.cpu_seconds() - before) / max(len(ends.down) + len(ends.up), 1)
        for task in reading:
            task.cancel()
        await asyncio.gather(*reading, return_exceptions=True)
        await client.close()
    await vehicle.close()
    return ends, each


def bare(count: int) -> float:
    """CPU time [s] for each packet of a program that passes bytes on from TCP to UDP, at 250 Hz."""
    with socket.create_server(("127.0.0.1", 0)) as server, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.bind(("127.0.0.1", 0))
        ports = [str(one.getsockname()[1]) for one in (server, out)]
        with subprocess.Popen([sys.executable, "-c", BARE, *ports], stdout=subprocess.PIPE, text=True) as process:
            try:
                server.settimeout(START_S)
                with server.accept()[0] as vehicle:
                    start = time.perf_counter()
                    for number in range(count):
                        vehicle.send(bytes(40))
                        time.sleep(max(0.0, start + (number + 1) / RATE_HZ - time.perf_counter()))
                return float(process.communicate(timeout=END_S)[0]) / count
            finally:
                process.kill()  # one that never connected ends by nothing else


def run(quick: bool) -> list[Figure]:
    """All figures of the companion; `quick` takes fewer frames."""
    count, repeats, seconds = (2_000, 3, 1.0) if quick else (10_000, 9, 20.0)
    with one_core():
        one, up = own_share(1, count, repeats)
        four, _ = own_share(4, count, repeats)
    with TemporaryDirectory() as folder:
        ends, each = asyncio.run(through(seconds, Path(folder)))
    down, raised = sorted(ends.down), sorted(ends.up)
    wall = "both ways over loopback, one process to the next, at 250 Hz"
    return [
        Figure("a frame to one client", one * 1e6, "us", FRAME_US, at_most=True, remark="no system calls"),
        Figure("a frame to each of four clients", four * 1e6, "us", FRAME_US, at_most=True),
        Figure("a frame to the flight controller", up * 1e6, "us", FRAME_US, at_most=True),
        Figure("a frame with the system's share", each * 1e6, "us", remark="waking up for each frame by itself"),
        Figure("the same, bytes passed on by asyncio", bare(round(seconds * RATE_HZ)) * 1e6, "us", remark="no MAVLink"),
        Figure("down, median", down[len(down) // 2] * 1e3, "ms", ADDED_MS, at_most=True, remark=wall),
        Figure("down, p99", down[len(down) * 99 // 100] * 1e3, "ms"),
        Figure("up, median", raised[len(raised) // 2] * 1e3, "ms", ADDED_MS, at_most=True),
        Figure("up, p99", raised[len(raised) * 99 // 100] * 1e3, "ms"),
        Figure("lost", 1.0 - len(down) / max(sum(key > 0 for key in ends.sent), 1), "of the frames", 0.0, at_most=True),
    ]
