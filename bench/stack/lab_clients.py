"""The lab's server under load: drones that fly, clients that watch at the full rate, and one that stops reading.

Everything is on this machine: drones with their companions, the server, which flies and records them all, and the
clients. Real time is real here: what else the machine does shows in the figures.
"""

import asyncio
import json
import os
import socket
import struct
import time
import urllib.error
import urllib.request
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from bench.measure import Figure
from bench.stack.flight_stack import start_pair
from bench.stack.programs import START_S, Running, running
from twodof.gcs.async_drone import AsyncDrone
from twodof.lab.settings import WATCH_TOKEN
from twodof.signals import TOPICS

DRONES, CLIENTS = 8, 20
SETTLES_S = 3.0
RATE_HZ = 250.0
COLUMNS = [column for row in TOPICS if row.onboard and row.places for column in row.columns][:15]
LATE_MS = 50.0
"""What a row may take from the drone to a client at the median; the page draws it in the next picture."""
NOTHING_MB = 2.0
"""What the memory may grow by while one client reads nothing: its outbox takes 128 KiB, the records of the flights keep
a list of what they wrote."""
_HEADER = struct.Struct("<BBHIIId")
_TOKEN = "watch-token-of-the-bench"


@dataclass
class Watcher:
    """A client: the rows that it got, what it lost, and how long after its tick each message of rows came [s].

    The start of the drone, an unknown constant, is taken from the message with the shortest delay.
    """

    drone: int
    rows: int = 0
    dropped: int = 0
    first: float = 0.0
    last: float = 0.0
    ages: list[float] = field(default_factory=list)

    def take(self, message: bytes) -> None:
        """Rows came."""
        now = time.monotonic()
        _, _, _, count, self.dropped, _, _ = _HEADER.unpack_from(message)
        first, last = (
            struct.unpack_from("<d", message, _HEADER.size + 8 * place)[0] for place in (0, max(0, count - 1))
        )
        self.first = self.first or first
        self.last = last
        self.rows += count
        self.ages.append(now - last)

    @property
    def expected(self) -> int:
        """Ticks from the first row to the last."""
        return round((self.last - self.first) * RATE_HZ) + 1 if self.rows else 1

    @property
    def late(self) -> list[float]:
        """Each message's age beyond the least [s]."""
        least = min(self.ages, default=0.0)
        return [age - least for age in self.ages]


class Load:
    """Server at `port` with the flying drones 1 to `drones`, and the clients that watch them."""

    def __init__(self, port: int, drones: int) -> None:
        self.port, self.drones = port, drones

    def ask(self, method: str, path: str, body: object = None) -> Any:
        """One request of the API."""
        url = f"http://127.0.0.1:{self.port}/api/{path}"
        content = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(url, content, {"content-type": "application/json"}, method=method)
        try:
            with urllib.request.urlopen(request, timeout=START_S) as answer:
                return json.loads(answer.read())
        except urllib.error.HTTPError as refusal:
            raise RuntimeError(f"{method} {path}: {refusal.code} {refusal.read().decode()}") from None

    async def ready(self) -> None:
        """Wait until the server hears all drones. Raises TimeoutError."""
        async with asyncio.timeout(START_S):
            while len(await asyncio.to_thread(self.ask, "GET", "drones")) < self.drones:
                await asyncio.sleep(0.1)

    async def fly(self, seconds: float) -> None:
        """Arm all, and give each another set-point every second, as somebody at the page would; keeps a socket open."""
        async with connect(f"ws://127.0.0.1:{self.port}/api/telemetry") as page:
            reading = asyncio.create_task(_read_nothing(page))
            for number in range(1, self.drones + 1):
                await asyncio.to_thread(self.ask, "POST", f"drones/{number}/arm")
            theta, end = 0.05, time.monotonic() + seconds
            while time.monotonic() < end:
                for number in range(1, self.drones + 1):
                    asked = {"loop": "theta", "value": theta, "thrust": 0.4}
                    await asyncio.to_thread(self.ask, "PUT", f"drones/{number}/setpoint", asked)
                theta = -theta
                await asyncio.sleep(1.0)
            for number in range(1, self.drones + 1):
                await asyncio.to_thread(self.ask, "POST", f"drones/{number}/disarm")
            reading.cancel()

    async def watch(self, watcher: Watcher, seconds: float) -> None:
        """Read every message, as one client."""
        url = f"ws://127.0.0.1:{self.port}/api/telemetry?token={_TOKEN}"
        async with connect(url, compression=None, max_queue=64) as websocket:
            await websocket.send(_subscription(watcher.drone))
            counts = time.monotonic() + SETTLES_S
            with suppress(TimeoutError):
                async with asyncio.timeout(SETTLES_S + seconds):
                    async for message in websocket:
                        if isinstance(message, bytes) and time.monotonic() >= counts:
                            watcher.take(message)

    async def stall(self, drone: int, seconds: float) -> None:
        """One client that asks for rows and reads none of them."""
        with socket.create_connection(("127.0.0.1", self.port)) as raw:
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            raw.sendall(
                f"GET /api/telemetry?token={_TOKEN} HTTP/1.1\r\nHost: 127.0.0.1:{self.port}\r\n"
                "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
                "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
            )
            text = _subscription(drone).encode()
            raw.sendall(b"\x81" + bytes([0xFE]) + struct.pack(">H", len(text)) + b"\0\0\0\0" + text)
            await asyncio.sleep(seconds)


async def _read_nothing(websocket: Any) -> None:
    with suppress(ConnectionClosed):
        async for _ in websocket:
            pass


def _subscription(drone: int) -> str:
    asked = {"do": "subscribe", "id": 1, "drone": drone, "columns": COLUMNS, "rate": RATE_HZ}
    return json.dumps(asked)


async def timing(url: str, drone: int, seconds: float) -> tuple[int, int, float]:
    """Periods missed and steps that ran over during `seconds`, and the latest start of a step [us]."""
    async with await AsyncDrone.connect(url, START_S, drone=drone, take_lease=False) as there:
        with there.session.listen("TWODOF_TIMING") as heard:
            first = await heard.next(there.session.now + START_S)
            end, late, got = time.monotonic() + seconds, 0.0, first
            while time.monotonic() < end:
                got = await heard.next(there.session.now + START_S) or got
                late = max(late, got.late_worst)
    if first is None or got is None:
        raise RuntimeError(f"drone {drone} does not say how it keeps its time")
    return got.missed - first.missed, got.overruns - first.overruns, late


def resident_mb(program: Running) -> float:
    """Memory of a program [MB] (Linux)."""
    pages = int(Path(f"/proc/{program.process.pid}/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


async def settled_mb(program: Running, seconds: float) -> float:
    """Return the memory of the server [MB] when its buffers of drones and clients are full."""
    await asyncio.sleep(SETTLES_S + seconds / 3)
    return resident_mb(program)


def run(quick: bool) -> list[Figure]:
    """Eight drones and twenty clients for a minute; `quick` takes two drones and four clients for three seconds."""
    return measure(2, 4, 3.0) if quick else measure(DRONES, CLIENTS, 60.0)


def measure(drones: int, clients: int, seconds: float) -> list[Figure]:
    """The figures of so many; one client more stops reading."""
    with TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        for variable, value in ((WATCH_TOKEN, _TOKEN), ("TWODOF_DATA", str(folder / "data"))):
            stack.callback(_set, variable, os.environ.get(variable))
            os.environ[variable] = value
        pairs = [start_pair(stack, folder, index) for index in range(drones)]
        urls = [url for _, _, url in pairs]
        connecting = [word for url in urls for word in ("--connect", url)]
        server = stack.enter_context(running("lab", "--port", "0", *connecting, urls=1, folder=folder))
        load = Load(int(server.urls[0].rpartition(":")[2]), drones)
        return asyncio.run(_measured(load, server, [p for pair in pairs for p in pair[:2]], urls, clients, seconds))


def _set(variable: str, value: str | None) -> None:
    """A variable of the environment as it was."""
    os.environ.pop(variable, None)
    if value is not None:
        os.environ[variable] = value


async def _measured(
    load: Load, server: Running, programs: list[Running], urls: list[str], clients: int, seconds: float
) -> list[Figure]:
    await load.ready()
    watchers = [Watcher(1 + number % load.drones) for number in range(clients)]
    flying = asyncio.create_task(load.fly(seconds + 2 * SETTLES_S))
    await asyncio.sleep(SETTLES_S)
    begun = [program.cpu_seconds() for program in (server, *programs)]
    cpu, wall = time.process_time(), time.monotonic()
    stalling = asyncio.create_task(load.stall(1, seconds + SETTLES_S))
    kept, before, *_ = await asyncio.gather(
        asyncio.gather(*(timing(url, 1 + k, seconds) for k, url in enumerate(urls))),
        settled_mb(server, seconds),
        *(load.watch(watcher, seconds) for watcher in watchers),
    )
    wall = time.monotonic() - wall
    client = (time.process_time() - cpu) / wall
    ended = [program.cpu_seconds() for program in (server, *programs)]
    grown = resident_mb(server) - before
    await asyncio.gather(stalling, flying)
    late = np.sort(np.concatenate([watcher.late for watcher in watchers])) * 1e3
    worst = min(watcher.rows / watcher.expected for watcher in watchers)
    periods = load.drones * seconds * RATE_HZ
    return [
        Figure("periods missed", sum(one[0] for one in kept), "", 0.0, True, f"of {periods:.0f}"),
        Figure("steps that ran over", sum(one[1] for one in kept), "", 0.0, True),
        Figure("latest start of a period", max(one[2] for one in kept), "us"),
        Figure("rows that the worst served client got", worst, "of those that there were", 1.0),
        Figure("rows dropped for clients that read", sum(watcher.dropped for watcher in watchers), "", 0.0, True),
        Figure("a row's way to a client, median", float(np.median(late)), "ms", LATE_MS, True, "beyond the quickest"),
        Figure("a row's way to a client, p99", float(late[int(0.99 * len(late))]), "ms"),
        Figure("memory that the server gained", grown, "MB", NOTHING_MB, True, "one client reads nothing meanwhile"),
        Figure("cores of the server", (ended[0] - begun[0]) / wall, ""),
        Figure("cores of all drones", (sum(ended[1:]) - sum(begun[1:])) / wall, ""),
        Figure("cores of all clients", client, "", remark=f"{len(watchers)} that read, in one program"),
    ]
