"""The page of drones on this computer: `twodof lab` kept running beside them at a lower priority."""

import asyncio
import errno
import socket
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from typing import Self

from twodof.errors import LinkError
from twodof.fleet.child_output import child_error, indented_lines
from twodof.fleet.local_fleet import AGAIN_S, MOST_RESTARTS, WITHIN_S, ChildProcess

NICENESS = 5
"""What flies goes before what shows it."""
ANSWER_S = 40.0
"""How long the server may take until it listens [s]."""


class LocalPage:
    """The server of the page for the drones at `urls`, at `port`; for `async with`.

    One that ends is started again, with the same port and tokens, so that the links stay. Where it cannot be kept
    running that is told, and the drones go on without it. `options` are further ones of `twodof lab`, and `environment`
    carries the tokens.
    """

    def __init__(
        self,
        urls: Sequence[str],
        port: int,
        options: Sequence[str],
        environment: Mapping[str, str],
        tell: Callable[[str], None],
    ) -> None:
        connect = [word for url in urls for word in ("--connect", url)]
        arguments = ["lab", "--port", str(port), *connect, *options]
        self._child = ChildProcess(
            "the page's server", arguments, f"http://127.0.0.1:{port}", None, environment, NICENESS
        )
        self._tell = tell
        self._keeping: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        self._keeping = asyncio.create_task(self._keep())
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._keeping is not None:
            self._keeping.cancel()
            await asyncio.gather(self._keeping, return_exceptions=True)
        await self._child.end()

    async def listens(self) -> bool:
        """Whether it listens, waited for until it does, has failed or takes too long."""
        assert self._keeping is not None
        listening = asyncio.create_task(self._child.listening.wait())
        await asyncio.wait([listening, self._keeping], timeout=ANSWER_S, return_when=asyncio.FIRST_COMPLETED)
        listening.cancel()
        return self._child.listening.is_set()

    async def _keep(self) -> None:
        child, clock = self._child, asyncio.get_running_loop()
        while True:
            await child.start()
            status = await child.wait()
            child.ended.append(clock.time())
            first = not child.listening.is_set()
            if first:  # it would fail again
                self._tell(f"there is no page: {child_error(list(child.said), child.name, status)}")
                return
            if len(child.ended) > MOST_RESTARTS and child.ended[-1] - child.ended[0] < WITHIN_S:
                self._tell(f"{child.name} ended with status {status}; too often, the drones go on without a page")
                return
            last = f"; it last said:{indented_lines(child.said)}" if child.said else ""
            self._tell(f"{child.name} ended with status {status}; it is started again{last}")
            await asyncio.sleep(AGAIN_S)


def page_port(wanted: int, host: str) -> int:
    """The port `wanted` of the address `host`, or a free one where somebody has it.

    Raises LinkError where nobody can listen there, told before drones are started for it.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for port in (wanted, 0):
        with closing(socket.socket(family)) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, port))
                probe.listen(1)
            except OSError as refusal:
                if refusal.errno == errno.EADDRINUSE:
                    continue
                what = f"cannot listen: {refusal.strerror or refusal}"
                remedy = "give --host an address of this computer, 127.0.0.1 or 0.0.0.0, and a --page-port from 1024 on"
                raise LinkError(what, f"http://{host}:{port}", remedy) from refusal
            return int(probe.getsockname()[1])
    return wanted
