"""Our programs as a user starts them (`twodof fcu`, `twodof companion`, ...): processes of their own, on free ports."""

import os
import random
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

START_S = 120.0
"""For a loaded machine that compiles for the first time."""

END_S = 120.0
"""For logs to be written; what ends only then hangs."""

FREE = (20_000, 32_000)
"""Ports that can be waited for: those that Linux itself gives begin at 32768 (ip_local_port_range)."""

TWODOF = Path(sys.executable).with_name("twodof")


@dataclass
class Running:
    """A program that runs, what it has said, and the URLs at which it said that it listens."""

    process: subprocess.Popen[str]
    lines: list[str] = field(default_factory=list)

    @property
    def urls(self) -> list[str]:
        """In the order in which they were asked for."""
        return [m[1] for line in self.lines if (m := re.search(r"listening on (\S+)", line))]

    @property
    def said(self) -> str:
        """All that it said."""
        return "".join(self.lines)

    def cpu_seconds(self) -> float:
        """Processor time that it has used so far, all its threads together (Linux)."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def wait_for(self, urls: int) -> None:
        """Until it listens at so many; RuntimeError with what it said if it ends before or takes too long."""
        end = time.monotonic() + START_S
        while len(self.urls) < urls:
            if self.process.poll() is not None or time.monotonic() > end:
                raise RuntimeError(f"status {self.process.poll()}, listens at {self.urls}\n{self.said}")
            time.sleep(0.02)

    def end(self) -> None:
        """Ask it to end; RuntimeError if it ended by itself, or not with status 0, or not in time."""
        if self.process.poll() is None:
            self.process.terminate()
            if self.process.wait(END_S) == 0:
                return
        raise RuntimeError(f"status {self.process.poll()}\n{self.said}")


@contextmanager
def running(*arguments: str, urls: int, folder: Path) -> Iterator[Running]:
    """`twodof ARGUMENTS`, with `folder` as the present one, until the end of the block."""
    process = subprocess.Popen(
        [sys.executable, str(TWODOF), *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    program = Running(process)

    def listen() -> None:
        assert process.stdout is not None
        program.lines.extend(iter(process.stdout.readline, ""))

    thread = threading.Thread(target=listen, daemon=True)
    thread.start()
    try:
        program.wait_for(urls)
        yield program
        program.end()
    finally:
        process.kill()
        process.wait(END_S)
        thread.join(END_S)
        if process.stdout is not None:
            process.stdout.close()


def port(url: str) -> int:
    """The port that a URL ends with."""
    return int(url.rpartition(":")[2])


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """A port on this machine where no program listens, and that the system does not hand out by itself.

    Raises RuntimeError if there is none.
    """
    for number in random.SystemRandom().sample(range(*FREE), 100):
        with socket.socket(socket.AF_INET, kind) as probe, suppress(OSError):
            probe.bind(("127.0.0.1", number))
            return number
    raise RuntimeError(f"a hundred ports from {FREE[0]} to {FREE[1]} are taken")
