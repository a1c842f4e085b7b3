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
        for number in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
            with suppress(OSError):
                words = Path(f"/proc/{number}/cmdline").read_bytes().decode().split("\0")
                if program in words[:4]:
                    return int(number)
    raise AssertionError(f"no {program} runs")


@contextmanager
def stopped(process: int) -> Iterator[None]:
    """It stands still in the block, as if its computer or its link did."""
    os.kill(process, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(process, signal.SIGCONT)
