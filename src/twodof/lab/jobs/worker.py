"""The process of a job: runs one function, tells how far it is, ends. Started by a fork server that is warm."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from twodof.errors import TwodofError
from twodof.lab.finite_json import dumps

NICENESS = 10
_REAL_TIME = "__lab_in_real_time__"
TOLD_EVERY_S = 0.05
Progress = Callable[[float, str], None]
Work = TypeVar("Work", bound=Callable[..., object])


def in_real_time(work: Work) -> Work:
    """Declare that a job keeps up with a drone: it gives way to nobody."""
    setattr(work, _REAL_TIME, True)
    return work


def keeps_up(work: Callable[..., object]) -> bool:
    """Whether a job was declared so."""
    return bool(getattr(work, _REAL_TIME, False))


def run(told: Connection, work: Callable[..., object], arguments: tuple[Any, ...]) -> None:
    """Run `work(progress, *arguments)` and tell its end: ("done", JSON text) or ("failed", what, where, remedy)."""
    # Ctrl-C in the terminal is for the server. A session of its own would give it as much as every drone's program.
    os.setpgid(0, 0)
    if not keeps_up(work):
        os.nice(NICENESS)
    last = 0.0

    def progress(fraction: float, text: str = "") -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= TOLD_EVERY_S or fraction >= 1.0:
            last = now
            told.send(("progress", min(1.0, max(0.0, float(fraction))), str(text)[:500]))

    try:
        told.send(("done", dumps(work(progress, *arguments))))
    except TwodofError as error:
        told.send(("failed", error.what, error.where, error.remedy))
    except MemoryError:
        told.send(("failed", "the memory of this computer does not suffice", "job", "ask for less"))
    except Exception as fault:
        told.send(("failed", f"a fault of the program: {type(fault).__name__}: {fault}"[:1000], "job", "report it"))
        raise
