"""Program: a command of ours that runs as a process, with everything it prints."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from tests.patience import PATIENCE_S
from tests.processes import children


class Program:
    """A command of ours in `folder`, in a process group of its own: lines on stdout in `out`, on stderr in `err`."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "twodof.cli", *arguments],
            cwd=folder,
            env=os.environ | {"XDG_DATA_HOME": str(folder), "TWODOF_DATA": str(folder)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self.out: list[str] = []
        self.err: list[str] = []
        self._threads = [
            threading.Thread(target=lambda: self.out.extend(iter(self.process.stdout.readline, ""))),
            threading.Thread(target=lambda: self.err.extend(iter(self.process.stderr.readline, ""))),
        ]
        for thread in self._threads:
            thread.start()

    def wait(self, condition: Callable[[], object], what: str) -> None:
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, f"{what}: {self.out} {self.err}"
            time.sleep(0.02)

    def document(self) -> dict[str, Any]:
        """Wait for the first line on stdout and return its JSON document."""
        self.wait(lambda: self.out or self.process.poll() is not None, "nothing was printed")
        assert self.out, self.err
        found: dict[str, Any] = json.loads(self.out[0])
        return found

    def children(self) -> dict[int, str]:
        """Return process id -> command line of the child processes."""
        return {one: " ".join([*words, ""]) for one, words in children(self.process.pid).items()}

    def interrupted(self) -> int:
        """Send Ctrl-C and return the exit status."""
        self.process.send_signal(signal.SIGINT)
        return self.ended()

    def ended(self) -> int:
        """Wait for the end and return the exit status; `out` and `err` are then complete."""
        status = self.process.wait(PATIENCE_S)
        for thread in self._threads:
            thread.join(PATIENCE_S)
            assert not thread.is_alive(), "another process has its other end"
        return status

    def close(self) -> None:
        self.process.kill()
        self.ended()
        self.process.stdout.close()
        self.process.stderr.close()


@contextmanager
def program(folder: Path, *arguments: str) -> Iterator[Program]:
    running = Program(folder, *arguments)
    try:
        yield running
    finally:
        running.close()


class Said(NamedTuple):
    """Output and errors of a command, as printed."""

    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)


Shell = Callable[..., Said]
"""A command line that runs in this process and must end with a status, by default 0: `shell(arguments, status)`."""
