"""The process of the workbench: does one thing after another until it is told to end. It stays warm."""

from __future__ import annotations

import os
import resource
import signal
import sys
from multiprocessing.connection import Connection
from types import FrameType

from twodof.errors import TwodofError
from twodof.lab.finite_json import dumps

MEMORY = 8 << 30
"""Bytes of address space: what a diagram may take (docs/reference/diagram-files.md), and what is imported."""


def run(talk: Connection) -> None:
    """Answers each (function, arguments) by ("done", JSON text) or ("failed", what, where, remedy).

    SIGTERM ends it, and with it the compiler that runs.
    """
    os.setsid()  # Ctrl-C in the terminal is for the server
    signal.signal(signal.SIGTERM, _end)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    while True:
        try:
            work, arguments = talk.recv()
        except (EOFError, OSError):  # the server has ended
            return
        try:
            talk.send(("done", dumps(work(*arguments))))
        except TwodofError as error:
            talk.send(("failed", error.what, error.where, error.remedy))
        except (MemoryError, RecursionError):
            talk.send(("failed", "it is too large for this computer", "workbench", "make it smaller"))
        except Exception as fault:  # noqa: BLE001  whatever it was, the next diagram may be a good one
            text = f"a fault of the program: {type(fault).__name__}: {fault}"[:1000]
            talk.send(("failed", text, "workbench", "report it"))


def _end(number: int, frame: FrameType | None) -> None:
    sys.exit(0)
