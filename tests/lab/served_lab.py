"""A laboratory that serves one drone on a virtual rig whose time the clients grant, and a client of its API."""

from __future__ import annotations

import asyncio
import json
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.patience import PATIENCE_S, patiently
from twodof.fleet.virtual_drone import virtual_drone
from twodof.lab.server import serve
from twodof.lab.settings import LabSettings


@dataclass(frozen=True)
class ServedLab:
    """The API at `port` and the user's data `folder`; `drone` is the number of the drone there."""

    port: int
    folder: Path
    drone: int = 1
    token: str = ""

    def call(self, method: str, path: str, body: Any = None) -> tuple[int, Any]:
        """Status and JSON of an answer; bytes are sent and answered as they are."""
        content = body if isinstance(body, bytes) or body is None else json.dumps(body).encode()
        headers = {"content-type": "application/json"} | (
            {"authorization": f"Bearer {self.token}"} if self.token else {}
        )
        request = urllib.request.Request(
            f"http://127.0.0.1:{self.port}/api/{path}", data=content, method=method, headers=headers
        )
        try:
            with urllib.request.urlopen(request, timeout=PATIENCE_S) as answer:
                status, text = answer.status, answer.read()
        except urllib.error.HTTPError as refusal:
            status, text = refusal.code, refusal.read()
        try:
            return status, json.loads(text)
        except ValueError:
            return status, text

    def done(self, started: tuple[int, Any]) -> Any:
        """The result of a job that was started, once it is done."""
        job = self.ended(started)
        assert job["state"] == "done", job["error"]
        return job["result"]

    def ended(self, started: tuple[int, Any]) -> Any:
        """A job that was started, once it has ended."""
        status, job = started
        assert status == 202, job
        for _ in patiently():
            job = self.call("GET", f"jobs/{job['id']}")[1]
            if job["state"] != "running":
                return job
        raise AssertionError(job)


@contextmanager
def served_lab(folder: Path, rig: str = "paper", watch_token: str = "") -> Iterator[ServedLab]:
    """Serve a drone on `rig`; ends with the block."""
    with virtual_drone(rig) as url:
        settings = LabSettings(folder, port=0, connect=(url,), watch_token=watch_token)
        ports: list[int] = []
        listens, loop = threading.Event(), asyncio.new_event_loop()

        def ready(port: int) -> None:
            ports.append(port)
            listens.set()

        serving = loop.create_task(serve(settings, ready))

        def run() -> None:
            with closing(loop):
                loop.run_until_complete(asyncio.wait([serving]))

        thread = threading.Thread(target=run, name="lab", daemon=True)
        thread.start()
        try:
            assert listens.wait(PATIENCE_S), "the laboratory does not listen"
            lab = ServedLab(ports[0], folder)
            assert any(lab.call("GET", "drones")[1] for _ in patiently()), "the drone is not heard"
            yield lab
        finally:
            loop.call_soon_threadsafe(serving.cancel)
            thread.join(PATIENCE_S)
