"""Processes of this machine, as tests look at them."""

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tests.patience import patiently


def alive(process: int) -> bool:
    """Return True if a process runs; False for one that ended, even if its parent did not wait for it."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def children(parent: int) -> dict[int, list[str]]:
    """Return process id -> words of the command line of the children of all threads of a process."""
    found = {}
    for task in Path(f"/proc/{parent}/task").iterdir():
        with suppress(OSError):  # the thread has ended meanwhile
            for number in (task / "children").read_text().split():
                with suppress(OSError):  # the child has ended meanwhile
                    found[int(number)] = Path(f"/proc/{number}/cmdline").read_bytes().decode().split("\0")[:-1]
    return found


@contextmanager
def started(command: list[str], **options: Any) -> Iterator[subprocess.Popen[Any]]:
    """Runs a program as Popen does; an error in the block ends it, so that nobody waits for it."""
    with subprocess.Popen(command, **options) as process:
        try:
            yield process
        finally:
            process.kill()


def child(parent: int, program: str) -> int:
    """The process among the children of `parent` that runs one of our programs: "lab", "fcu", "companion"."""
    for _ in patiently():
        for number, words in children(parent).items():
            if program in words[:4]:
                return number
    raise AssertionError(f"no {program} runs")


@contextmanager
def stopped(process: int) -> Iterator[None]:
    """It stands still in the block, as if its computer or its link did."""
    os.kill(process, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(process, signal.SIGCONT)
