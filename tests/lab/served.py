"""Server of the lab on a free port, in a thread of its own, with clients of its API and its web socket."""

from __future__ import annotations

import asyncio
import http.client
import json
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from tests.patience import PATIENCE_S, patiently
from twodof.errors import LogError
from twodof.fleet.virtual_drone import virtual_drone
from twodof.flightlog.mcap_file import recover
from twodof.gcs.loop_thread import LoopThread
from twodof.lab.server import serve
from twodof.lab.settings import LabSettings

COMMAND, WATCH = "command-token-of-a-test", "watch-token-of-a-test"
_HEADER = struct.Struct("<BBHIIId")


class Answer(NamedTuple):
    """Status, headers (lower case) and body of an answer."""

    status: int
    headers: dict[str, str]
    content: bytes

    @property
    def json(self) -> Any:
        """The body as JSON has it."""
        return json.loads(self.content)


class Frame(NamedTuple):
    """Rows of a binary message: times (n,) [s], columns (k, n), and the header's fields."""

    id: int
    dropped: int
    sent: float
    times: NDArray[np.float64]
    columns: NDArray[np.float32]


def read_frame(message: bytes) -> Frame:
    """A binary message, read by the description in docs/reference alone."""
    kind, zero, number, count, dropped, reserved, sent = _HEADER.unpack_from(message)
    assert (kind, zero, reserved) == (1, 0, 0)
    times = np.frombuffer(message, "<f8", count, _HEADER.size)
    values = np.frombuffer(message, "<f4", -1, _HEADER.size + 8 * count)
    return Frame(number, dropped, sent, times, values.reshape(-1, count))


@dataclass
class Served:
    """A server at `port` of the loopback, which keeps its files in `folder`."""

    port: int
    folder: Path
    token: str = ""

    @property
    def host(self) -> str:
        """Value of `Host` for it."""
        return f"127.0.0.1:{self.port}"

    def ask(
        self,
        method: str,
        path: str,
        body: object = None,
        headers: dict[str, str] | None = None,
        token: str | None = None,
    ) -> Answer:
        """One request. A body of bytes is sent as it is, anything else as JSON."""
        token = self.token if token is None else token
        sent = {"Authorization": f"Bearer {token}"} if token else {}
        content = body if isinstance(body, bytes) else None if body is None else json.dumps(body).encode()
        if content is not None:
            sent["Content-Type"] = "application/json"
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)
        try:
            connection.request(method, path, content, sent | (headers or {}))
            got = connection.getresponse()
            return Answer(got.status, {key.lower(): value for key, value in got.getheaders()}, got.read())
        finally:
            connection.close()

    @contextmanager
    def socket(self, token: str | None = None, **options: Any) -> Iterator[Client]:
        """A web socket for telemetry."""
        token = self.token if token is None else token
        url = f"ws://{self.host}/api/telemetry" + (f"?token={token}" if token else "")
        with connect(url, open_timeout=PATIENCE_S, **options) as websocket:
            yield Client(websocket)


class Client:
    """One web socket: what it asks for and what it hears."""

    def __init__(self, websocket: ClientConnection) -> None:
        self.websocket = websocket

    def send(self, **asked: object) -> None:
        """Ask for something."""
        self.websocket.send(json.dumps(asked))

    def subscribe(self, columns: list[str], rate: float = 250.0, drone: int = 1, number: int = 1) -> None:
        """Ask for rows."""
        self.send(do="subscribe", id=number, drone=drone, columns=columns, rate=rate)

    def next(self) -> str | bytes:
        """The next message."""
        return self.websocket.recv(PATIENCE_S)

    def event(self, kind: str, **fields: object) -> dict[str, Any]:
        """The next event of that kind whose fields are so; others, and rows, are passed over."""
        while True:
            got = self.next()
            if isinstance(got, str):
                found: dict[str, Any] = json.loads(got)
                said = {**found, **found.get("state", {})}
                if found["event"] == kind and all(said.get(name) == value for name, value in fields.items()):
                    return found

    def closed(self) -> tuple[int, str]:
        """Code and reason with which the server closes it."""
        try:
            while True:
                self.next()
        except ConnectionClosed as end:
            return (1006, "") if end.rcvd is None else (end.rcvd.code, end.rcvd.reason)

    def frame(self) -> Frame:
        """The next rows; events are passed over."""
        while True:
            got = self.next()
            if isinstance(got, bytes):
                return read_frame(got)


@contextmanager
def served(folder: Path, *urls: str, token: str = "", **settings: Any) -> Iterator[Served]:
    """A server of the drones at `urls` while the block runs; `token` is that of our own requests."""
    given = LabSettings(folder, port=0, connect=urls or ("udp://127.0.0.1:9",), **settings)
    runner = LoopThread("lab")
    listening = threading.Event()
    ports: list[int] = []

    def ready(port: int) -> None:
        ports.append(port)
        listening.set()

    async def begin() -> asyncio.Task[None]:
        return asyncio.create_task(serve(given, ready))

    async def end() -> None:
        serving.cancel()
        with suppress(asyncio.CancelledError):
            await serving

    serving = runner.run(begin())
    try:
        assert listening.wait(PATIENCE_S)
        yield Served(ports[0], folder, token)
    finally:
        runner.run(end())
        runner.close()


def holds_samples(recording: Path) -> bool:
    """Return True if a sample of the pitch is on the disk, in a recording that goes on."""
    try:
        return len(recover(recording).log["theta"]) > 0
    except LogError:
        return False


def wait_for_drone(server: Served, number: int = 1) -> dict[str, Any]:
    """The state of a drone, once the server hears it."""
    with server.socket() as client:
        state: dict[str, Any] = client.event("drone", drone=number, link="heard")["state"]
        return state


@dataclass
class ServedLab(Served):
    """Server of one drone on a virtual rig whose time the clients grant."""

    drone: int = 1

    def call(self, method: str, path: str, body: Any = None) -> tuple[int, Any]:
        """Return status and JSON of an answer; bytes are sent and returned as they are."""
        answer = self.ask(method, f"/api/{path}", body)
        try:
            return answer.status, answer.json
        except ValueError:
            return answer.status, answer.content

    def done(self, started: tuple[int, Any]) -> Any:
        """Return the result of a started job, once it is done."""
        job = self.ended(started)
        assert job["state"] == "done", job["error"]
        return job["result"]

    def ended(self, started: tuple[int, Any]) -> Any:
        """Return a started job, once it has ended."""
        status, job = started
        assert status == 202, job
        for _ in patiently():
            job = self.call("GET", f"jobs/{job['id']}")[1]
            if job["state"] != "running":
                return job
        raise AssertionError(job)


@contextmanager
def served_lab(folder: Path, rig: str = "paper", watch_token: str = "") -> Iterator[ServedLab]:
    """Serve a drone on `rig` while the block runs."""
    with virtual_drone(rig) as url, served(folder, url, watch_token=watch_token) as server:
        lab = ServedLab(server.port, folder)
        assert any(lab.call("GET", "drones")[1] for _ in patiently()), "the drone is not heard"
        yield lab
