"""Our programs as a user starts them: `twodof fcu` and `twodof companion`, in processes of their own, on free ports."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

START_S = 120.0  # a loaded machine that compiles for the first time
END_S = 20.0
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

    def wait_for(self, urls: int) -> None:
        """Until it listens at so many; AssertionError with what it said if it ends or takes too long."""
        end = time.monotonic() + START_S
        while len(self.urls) < urls:
            assert self.process.poll() is None, "\n".join(self.lines)
            assert time.monotonic() < end, "\n".join(self.lines)
            time.sleep(0.02)


@contextmanager
def running(*arguments: str, urls: int, folder: Path) -> Iterator[Running]:
    """`twodof ARGUMENTS` until the end of the block, then asked to end, which it must do cleanly."""
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
        assert process.poll() is None, "\n".join(program.lines)
        process.terminate()
        status = process.wait(END_S)
        assert status == 0, f"status {status}\n" + "\n".join(program.lines)
    finally:
        process.kill()
        process.wait(END_S)
        thread.join(END_S)
        if process.stdout is not None:
            process.stdout.close()


def port(url: str) -> int:
    """The port that a URL ends with."""
    return int(url.rpartition(":")[2])


def free_udp_port() -> int:
    """A port at which nobody listens."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        found: int = probe.getsockname()[1]
        return found
