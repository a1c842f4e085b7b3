"""A kill sent to the motors stopped: by a third party and by the pilot, with no load and under a flood of TCP.

Sent to first control period with the motors off, one clock. Each kill is said once, and again each 50 ms, as `Drone`
says it. Floods come from four processes, all on the cores of this machine.
"""

import json
import queue
import random
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from bench.measure import Figure
from bench.stack.programs import START_S, port, running
from twodof.link.mavlink.dialect import GROUND_STATION
from twodof.link.mavlink.framing import encode
from twodof.link.mavlink.messages import message
from twodof.link.signing import Key, Signing, Stamps, write_key

CONNECTIONS, PROCESSES = 50, 4
IDLE_S, FLOODED_S = 0.05, 0.3
"""What 99 of 100 kills must keep to, with no load and flooded [s]."""
AGAIN_S = 0.05
BEAT_S = 0.2
LONGEST_S = 20.0
"""A kill that has not acted by then is late by so much."""
BETWEEN_S = (0.002, 0.02)
PILOT, OTHER = 250, 240


class Process:
    """A process of ours that says lines, read as they come."""

    def __init__(self, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        self.said: queue.Queue[str] = queue.Queue()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout:
            for line in self.process.stdout:
                self.said.put(line)

    def tell(self, line: str) -> None:
        """One line on its standard input."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()

    def end(self) -> None:
        """End it."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        try:
            self.process.wait(START_S)
        finally:
            self.process.kill()
            self.process.wait()
            self._reader.join()


@contextmanager
def process(*arguments: str) -> Iterator[Process]:
    """One that runs until the block ends."""
    made = Process(*arguments)
    try:
        yield made
    finally:
        made.end()


class Client:
    """A client of one transport that says that it is there, and kills."""

    def __init__(self, url: str, system: int, key: Key | None) -> None:
        self.system = system
        kind = socket.SOCK_STREAM if url.startswith("tcp") else socket.SOCK_DGRAM
        self._socket = socket.socket(socket.AF_INET, kind)
        self._socket.connect(("127.0.0.1", port(url)))
        if kind == socket.SOCK_STREAM:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._signing = (Signing(key, Stamps(None), random.randrange(1, 190)),) if key else ()
        self._sequence = 0
        self._lock = threading.Lock()
        self._open = True
        for work in (self._beat, self._drain):
            threading.Thread(target=work, daemon=True).start()

    def send(self, sent: Any) -> None:
        """One message."""
        with self._lock:
            signed = (self._signing[0].outgoing(),) if self._signing else ()
            self._socket.sendall(encode(sent, self.system, GROUND_STATION, self._sequence, *signed))
            self._sequence = self._sequence + 1 & 255

    def kill(self) -> None:
        """Say it once."""
        where = {"target_system": 1, "target_component": 1}
        self.send(message("COMMAND_LONG", command=400, param2=21196.0, **where))

    def close(self) -> None:
        """Go."""
        self._open = False
        self._socket.close()

    def _beat(self) -> None:
        while self._open:
            try:
                self.send(message("HEARTBEAT", type=6, autopilot=8, system_status=4))
            except OSError:
                return
            time.sleep(BEAT_S)

    def _drain(self) -> None:
        while self._open:
            try:
                if not self._socket.recv(1 << 16):
                    return
            except OSError:
                return


def latencies(drone: Process, client: Client, count: int) -> list[float]:
    """Seconds from a kill of `client` to the motors, of `count`, in rising order."""
    rng, found = random.Random(client.system), []
    for _ in range(count):
        while heard(drone, "", 0.0) is not None:  # of a kill that was said again and came later
            pass
        drone.tell(str(PILOT))
        if heard(drone, "armed", START_S) is None:
            raise RuntimeError(f"the drone does not arm within {START_S:g} s")
        time.sleep(rng.uniform(*BETWEEN_S))
        sent = time.monotonic_ns()
        killed = None
        while killed is None and time.monotonic_ns() < sent + LONGEST_S * 1e9:
            client.kill()
            killed = heard(drone, "killed", AGAIN_S)
        found.append(LONGEST_S if killed is None else (killed - sent) * 1e-9)
        if found[-1] > AGAIN_S:
            time.sleep(2.0 * found[-1])  # what was said again comes too
    return sorted(found)


def heard(drone: Process, what: str, timeout: float) -> int | None:
    """When it did so last [ns], "": anything; None if it says nothing of it for so long."""
    end = time.monotonic() + timeout
    while True:
        try:
            said: dict[str, int] = json.loads(drone.said.get(timeout=max(0.0, end - time.monotonic())))
        except queue.Empty:
            return None
        if what in said or not what:
            return said.get(what, 0)


@contextmanager
def flooded(url: str | None) -> Iterator[None]:
    """CONNECTIONS of them from PROCESSES processes at a TCP port; None: nothing."""
    with ExitStack() as stack:
        for number in range(PROCESSES if url else 0):
            share = CONNECTIONS // PROCESSES + (number < CONNECTIONS % PROCESSES)
            flooder = stack.enter_context(process("bench.stack.flooder", f"127.0.0.1:{port(url or '')}", str(share)))
            flooder.said.get(timeout=START_S)
        if url:
            time.sleep(1.0)
        yield


def figure(name: str, times: list[float], goal: float) -> Figure:
    """The 99th percentile of rising times [s]."""
    remark = f"{len(times)} kills, median {times[len(times) // 2] * 1e3:.1f}, worst {times[-1] * 1e3:.0f} ms"
    p99 = times[min(len(times) - 1, len(times) * 99 // 100)]
    return Figure(f"{name}, p99", p99 * 1e3, "ms", goal * 1e3, at_most=True, remark=remark)


def cells(signed: bool, counts: tuple[int, int], loads: Sequence[str], folder: Path) -> list[Figure]:
    """One figure for each way that a kill may go under each load, and what came of each."""
    key = None
    if signed:
        write_key(folder / "drone.key", key := Key.fresh())
    named = [str(folder / "drone.key")] if signed else []
    figures = []
    with process("bench.stack.killed_drone", *named) as drone:
        fcu: list[str] = json.loads(drone.said.get(timeout=START_S))["urls"]
        command = ["companion", "--fcu", fcu[0].replace("tcpin", "tcp"), *(["--key", *named] if signed else [])]
        links = [word for kind in ("tcpin", "udpin") for word in ("--onboard", f"{kind}://127.0.0.1:0")]
        with running(*command, *links, urls=2, folder=folder) as companion:
            time.sleep(1.0)
            floods = {"idle": None, "flight controller flooded": fcu[0], "companion flooded": companion.urls[0]}
            for load in loads:
                goal, count = (IDLE_S, counts[0]) if load == "idle" else (FLOODED_S, counts[1])
                with ExitStack() as stack:
                    ways = []
                    for name, urls in (("direct", fcu), ("companion", companion.urls)):
                        for kind, url in zip(("TCP", "UDP"), urls, strict=True):
                            for who, system in (("third party", OTHER), ("pilot", PILOT)):
                                client = Client(url, system, key)  # there before the flood: a port has 32 places
                                stack.callback(client.close)
                                ways.append((f"{load}: {who}, {kind}, {name}", client))
                    time.sleep(3 * BEAT_S)
                    stack.enter_context(flooded(floods[load]))
                    for way, client in ways:
                        name = f"{way}, {'signed' if signed else 'unsigned'}"
                        figures.append(figure(name, latencies(drone, client, count), goal))
    return figures


def run(quick: bool) -> list[Figure]:
    """All of them."""
    figures = []
    loads = ("idle", "flight controller flooded", "companion flooded")
    for signed in (False,) if quick else (False, True):
        with TemporaryDirectory() as folder:
            figures += cells(signed, (2, 0) if quick else (100, 50), loads[:1] if quick else loads, Path(folder))
    return figures
