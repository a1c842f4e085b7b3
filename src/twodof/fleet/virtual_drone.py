"""A virtual drone of a command's own: `twodof fcu` as a child process in lockstep, for as long as it is needed."""

from __future__ import annotations

import re
import selectors
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from tempfile import TemporaryDirectory
from typing import IO

from twodof.errors import LinkError
from twodof.fleet.child_output import child_error

START_S = 120.0
"""How long it may take until it listens [s]: the first time it compiles flight code and rig."""

END_S = 5.0
"""How long it may take to end [s]; then it is killed."""

_LISTENING = re.compile(rb"listening on tcpin(\S+)\s")  # the whole of the line
_MOST_SAID = 4000


@contextmanager
def virtual_drone(rig: str, *options: str) -> Iterator[str]:
    """The URL of a drone on the virtual rig `rig` whose time a client grants; it ends with the block.

    It listens on this machine only, on a port that the system chooses, and keeps nothing. `options` are further ones of
    `twodof fcu`. Raises LinkError if it does not come up.
    """
    with TemporaryDirectory(prefix="twodof-") as folder, _started(rig, folder, options) as process:
        yield _listening(process, rig)


@contextmanager
def _started(rig: str, folder: str, options: Sequence[str]) -> Iterator[subprocess.Popen[bytes]]:
    command = [sys.executable, "-m", "twodof.fleet.child", "fcu", "--lockstep", "--rig", rig, "--state", folder]
    process = subprocess.Popen(
        [*command, "--listen", "tcpin://127.0.0.1:0", *options],
        stdin=subprocess.PIPE,  # never written to: it ends with us
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
        bufsize=0,
    )
    try:
        yield process
    finally:
        _end(process)


def _listening(process: subprocess.Popen[bytes], rig: str) -> str:
    """Where it listens, once it does."""
    pipe, said, end = process.stdout, b"", time.monotonic() + START_S
    if pipe is None:
        raise LinkError("the flight controller has no output", f"rig {rig}", "report this")
    with selectors.DefaultSelector() as selector:
        selector.register(pipe, selectors.EVENT_READ)
        while selector.select(max(0.0, end - time.monotonic())) and (piece := pipe.read(4096)):
            said = (said + piece)[-_MOST_SAID:]
            if found := _LISTENING.search(said):
                # A pipe that nobody reads holds up who writes.
                threading.Thread(target=_drain, args=(pipe,), daemon=True).start()
                return "tcp" + found[1].decode()
    pipe.close()
    raise child_error(said.decode(errors="replace").splitlines(), f"virtual drone on the rig {rig}")


def _drain(pipe: IO[bytes]) -> None:
    with pipe:
        while pipe.read(4096):
            pass


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdin is not None:
        process.stdin.close()
