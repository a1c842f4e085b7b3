"""Workbench: has a process of its own check diagrams or read logs, one thing at a time, each within its time."""

from __future__ import annotations

import asyncio
import json
import multiprocessing
from collections.abc import Awaitable, Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from twodof.errors import DiagramError, Rejected, Timeout, TwodofError
from twodof.lab.workbench import bench_process

MOST_WAITING = 16
LOOK_S = 0.1
END_S = 1.0
"""How long the process may take to end its compiler and itself."""


class Workbench:
    """One warm process, for things called `subject`, whose mistakes are told as `failure`.

    What takes longer than it may, or what nobody waits for any more, ends it; the next is new.
    """

    def __init__(self, subject: str = "diagram", failure: type[TwodofError] = DiagramError) -> None:
        self._subject, self._failure = subject, failure
        self._context = multiprocessing.get_context("forkserver")
        self._process: BaseProcess | None = None
        self._talk: Connection | None = None
        self._turn = asyncio.Lock()
        self._waiting = 0

    async def do(
        self,
        work: Callable[..., object],
        *arguments: Any,
        seconds: float,
        gone: Callable[[], Awaitable[bool]] | None = None,
    ) -> Any:
        """What `work(*arguments)` returns, a function of a module that returns plain data, in its turn.

        `gone` says whether the one who asked has left: then it is cancelled. Raises what `work` raises as `failure`,
        Timeout after `seconds`, Rejected where too many wait, and for one who has left.
        """
        if self._waiting >= MOST_WAITING:
            raise Rejected("too many wait for the workbench", self._subject, "try again in a moment")
        self._waiting += 1
        try:
            async with self._turn:
                return await self._done(work, arguments, seconds, gone)
        finally:
            self._waiting -= 1

    async def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        if self._talk is not None:
            self._talk.close()
            self._talk = None
        if process is None or process.pid is None:
            return
        process.terminate()
        await asyncio.to_thread(process.join, END_S)
        process.kill()
        await asyncio.to_thread(process.join, END_S)

    async def _done(
        self,
        work: Callable[..., object],
        arguments: tuple[Any, ...],
        seconds: float,
        gone: Callable[[], Awaitable[bool]] | None,
    ) -> Any:
        talk = await self._open()
        try:
            async with asyncio.timeout(seconds):
                talk.send((work, arguments))
                while not await asyncio.to_thread(talk.poll, LOOK_S):
                    if gone is not None and await gone():
                        raise Rejected("nobody waits for it any more", self._subject, "ask again")
                said = talk.recv()
        except TimeoutError:
            await self.close()
            raise Timeout(f"it took longer than {seconds:g} s", self._subject, "make it smaller") from None
        except (EOFError, OSError):
            await self.close()
            raise self._failure("the process that reads it has ended", self._subject, "make it smaller") from None
        except BaseException:
            with suppress(BaseException):
                await asyncio.shield(self.close())
            raise
        kind, *rest = said
        if kind == "done":
            return json.loads(rest[0])
        what, where, remedy = rest
        raise self._failure(what, where, remedy)

    async def _open(self) -> Connection:
        """The connection to the process, which is started where there is none."""
        if self._process is not None and self._talk is not None and self._process.is_alive():
            return self._talk
        await self.close()
        here, there = self._context.Pipe()
        process = self._context.Process(target=bench_process.run, args=(there,), daemon=True)
        await asyncio.to_thread(process.start)
        there.close()
        self._process, self._talk = process, here
        return here
