"""LabServer: `twodof up` with one drone and its page, as a test drives both, and breaks them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.fleet.drone_numbers import free_numbers
from tests.patience import PATIENCE_S, patiently
from tests.processes import child, stopped


@dataclass(frozen=True)
class LabServer:
    """`link` opens the page that commands, `watch_link` the one that watches.

    `drone` is the number in calls, `url` where a client of our own connects, `folder` the user's data folder.
    """

    link: str
    watch_link: str
    drone: int
    url: str
    folder: Path
    process: subprocess.Popen[str]

    def call(self, method: str, path: str, body: Any = None) -> Any:
        """Return the answer of the API to a call: `call("POST", "drones/1/arm")`. Raises HTTPError."""
        base, _, token = self.link.partition("?token=")
        data = None if body is None else json.dumps(body).encode()
        headers = {"Content-Type": "application/json"} | ({"Authorization": f"Bearer {token}"} if token else {})
        request = urllib.request.Request(f"{base}api/{path}", data, headers, method=method)
        with urllib.request.urlopen(request, timeout=PATIENCE_S) as answer:
            text = answer.read()
        return json.loads(text) if text else None

    def tell(self, what: str, body: Any = None, method: str = "POST") -> Any:
        """A call about the drone: `tell("arm")`."""
        return self.call(method, f"drones/{self.drone}/{what}", body)

    @property
    def state(self) -> dict[str, Any]:
        """How the drone stands."""
        found: dict[str, Any] = self.call("GET", f"drones/{self.drone}")
        return found

    def until(self, **wanted: Any) -> dict[str, Any]:
        """The drone's state, once it has these values."""
        state: dict[str, Any] = {}
        for _ in patiently():
            with suppress(OSError):
                state = self.state
            if all(state.get(name) == value for name, value in wanted.items()):
                return state
            time.sleep(0.02)
        raise AssertionError(f"{wanted} did not come: {state}")

    def calm(self, rings: bool = False) -> None:
        """The drone as at its start: disarmed, released, at the middle of the rail, commanded by nobody."""
        self.until(link="heard")
        for _ in patiently():
            with suppress(OSError):  # a busy computer answers too late
                self.tell("disarm")
                if self.state["killed"]:
                    self.tell("release")
                self.tell("reset", {"seed": 1, "x": 0.0, "noise": 1.0, "rings": rings})
                self.tell("lease", method="DELETE")
                break
        # The estimator needs some tenths of a second from the reset on until it may be armed.
        for _ in patiently():
            if not self.state["warnings"] and self.state["lease_holder"] is None:
                return
            time.sleep(0.02)

    def warm(self) -> None:
        """Have the first preview behind us: it compiles, on a loaded machine for longer than a page waits."""
        impulse = {"kind": "impulse", "unit": "m", "amplitude": 0.1, "width": 2.0, "settle": 2.0}
        asked = {"excitation": impulse, "loop": "x", "drone": self.drone}
        for _ in patiently():
            with suppress(OSError):
                if self.call("POST", "excitations/preview", asked)["motion"]:
                    return

    def child(self, program: str) -> int:
        """The process of one of its programs: "lab", "fcu", "companion"."""
        return child(self.process.pid, program)

    def stopped(self, program: str) -> AbstractContextManager[None]:
        """One of its programs stands still in the block."""
        return stopped(self.child(program))


@contextmanager
def served(folder: Path, *options: str) -> Iterator[LabServer]:
    """`twodof up` with one drone on free ports, whose data are kept in `folder`, until the end of the block."""
    with free_numbers(1) as first:
        # As a child of ours, which ends with us however we end: a test session that is killed leaves no drone behind.
        command = [sys.executable, "-m", "twodof.fleet.child", "up", "--json", "--page-port", "0"]
        command += ["--first", str(first + 1), *options]
        environment = {**os.environ, "TWODOF_DATA": str(folder)}
        with (folder / "said").open("w+") as said:
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=said,
                text=True,
                env=environment,
                bufsize=1,
            )
            assert process.stdin is not None
            assert process.stdout is not None
            try:
                line = process.stdout.readline()  # it comes once all answer, or ends
                assert line, (folder / "said").read_text()
                told = json.loads(line)
                (drone,), page = told["drones"], told["page"]
                server = LabServer(page["command"], page["watch"], drone["system"], drone["drone"], folder, process)
                server.until(link="heard")
                yield server
            finally:
                process.terminate()
                try:
                    process.wait(PATIENCE_S)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()
                process.stdin.close()
                process.stdout.close()
