"""Serving: the application behind uvicorn on a socket that is opened here, until it is told to end."""

from __future__ import annotations

import asyncio
import errno
import os
import socket
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager

import uvicorn

from twodof.errors import LinkError
from twodof.lab.server import create_app
from twodof.lab.settings import LabSettings
from twodof.lab.telemetry.request import LONGEST

BACKLOG = 128
SEND_BUFFER = 128 * 1024
"""Bytes that the kernel keeps for one client."""
END_S = 5
"""What requests have to end when the server is told to [s]."""


async def serve(settings: LabSettings, ready: Callable[[int], None]) -> None:
    """Serve until cancelled; `ready` is called with the port once it listens. Raises LinkError where it cannot."""
    # For the processes of jobs: matrices are small, and two fits at once would have four threads wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with closing(_listening(settings)) as listening:
        port = int(listening.getsockname()[1])
        config = uvicorn.Config(
            create_app(settings),
            log_config=None,
            access_log=False,  # the link holds a token
            server_header=False,
            lifespan="on",
            ws="websockets-sansio",
            ws_max_size=4 * LONGEST,
            ws_per_message_deflate=False,  # rows hardly shrink, and it would cost more than all else
            ws_ping_interval=10.0,
            ws_ping_timeout=20.0,
            timeout_graceful_shutdown=END_S,
            timeout_keep_alive=30,
            h11_max_incomplete_event_size=16 * 1024,
            limit_concurrency=400,
        )
        server = _Server(config)
        serving = asyncio.create_task(server.serve(sockets=[listening]))
        try:
            while not server.started and not serving.done():
                await asyncio.sleep(0.01)
            if server.started:
                ready(port)
            await asyncio.shield(serving)
        finally:
            server.should_exit = True
            await asyncio.wait([serving], timeout=4 * END_S)


class _Server(uvicorn.Server):
    """Uvicorn's server, whose signals are its caller's."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """No signal is captured."""
        yield


def _listening(settings: LabSettings) -> socket.socket:
    """A socket that listens. Raises LinkError with the remedy where it cannot be had."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    where = f"http://{settings.host}:{settings.port}"
    made = socket.socket(family, socket.SOCK_STREAM)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        # What the kernel holds back for a client that is slow is stale: its share is small.
        made.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        made.bind((settings.host, settings.port))
        made.listen(BACKLOG)
        os.set_inheritable(made.fileno(), False)
    except OSError as error:
        made.close()
        what = f"cannot listen: {error.strerror or error}"
        taken = error.errno in (errno.EADDRINUSE, errno.EACCES)
        other = "give another --port, or --port 0 for a free one"
        remedy = other if taken else "give --host an address of this computer, such as 127.0.0.1 or 0.0.0.0"
        raise LinkError(what, where, remedy) from error
    return made
