"""`twodof fcu` as a process of its own, for tests that need it as its users have it."""

import os
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from tests.patience import PATIENCE_S


@contextmanager
def twodof_fcu(*options: str, ends_by: signal.Signals = signal.SIGTERM) -> Iterator[str]:
    """The URL for clients of a `twodof fcu` on a port of the system's choice; it must end cleanly by a signal."""
    command = [sys.executable, "-m", "twodof.cli", "fcu", "--listen", "tcpin://127.0.0.1:0", *options]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        yield _first_url(process)
        process.send_signal(ends_by)
        _, complained = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0, complained.decode()
        assert complained == b"", complained.decode()
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()


def _first_url(process: subprocess.Popen[bytes]) -> str:
    assert process.stdout is not None
    line, end = b"", time.monotonic() + PATIENCE_S
    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        while not line.endswith(b"\n"):
            assert selector.select(max(0.0, end - time.monotonic())), "it says nothing"
            piece = os.read(process.stdout.fileno(), 1)
            assert piece, (process.stderr.read() if process.stderr else b"").decode()
            line += piece
    assert line.startswith(b"listening on tcpin://"), line
    return line.split()[-1].decode().replace("tcpin", "tcp")
