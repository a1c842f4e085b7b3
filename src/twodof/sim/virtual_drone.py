"""A virtual drone: the virtual rig and the flight controller's program, as one thing that speaks MAVLink."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from twodof.blocks import Diagram
from twodof.fcu.assembly import assemble
from twodof.fcu.flight_code import FlightCode
from twodof.fcu.server import Server
from twodof.flight.starters import load_diagram
from twodof.parameters import ParameterSet
from twodof.rig.parameters import load_rig
from twodof.sim.rig_host import VirtualRig


class VirtualDrone:
    """Drone number `index` on a virtual rig, in real time or in `lockstep`.

    `rig` is "paper", "lab", a file or a set of parameters; `conditions` further parameters of it. `controllers` are
    diagrams, their JSON files, or names of starter diagrams, which fly in a sandbox unless `trusted`. `precision` is
    that of everything. Use it as an asynchronous context manager: within, it runs, and `urls` says where. Raises
    ParameterError, DiagramError, CompileError and LinkError for what cannot be.
    """

    def __init__(
        self,
        rig: str | Path | ParameterSet = "lab",
        conditions: Mapping[str, Any] | None = None,
        controllers: Iterable[str | Path | Diagram] = (),
        trusted: bool = False,
        precision: str = "float64",
        lockstep: bool = False,
        index: int = 0,
        safety_off: bool = True,
        position_filter: str = "joint",
    ) -> None:
        parameters = rig if isinstance(rig, ParameterSet) else load_rig(rig)
        name = "own" if isinstance(rig, ParameterSet) else Path(rig).stem
        self.rig = VirtualRig(parameters, conditions, precision, name, safety_off)
        code = FlightCode(
            [c if isinstance(c, Diagram) else load_diagram(c) for c in controllers],
            trusted,
            position_filter,
            precision,
        )
        self.rig.settle(code)
        self.lockstep = lockstep
        self.controller, self._server = assemble(self.rig, code, index + 1, lockstep)
        self.urls: list[str] = []
        self._running: asyncio.Task[None] | None = None

    @property
    def server(self) -> Server:
        """The program's shell."""
        return self._server

    async def __aenter__(self) -> Self:
        """Starts it; `listen` opens links."""
        self._running = asyncio.create_task(self._server.run(), name=f"drone {self._server.system}")
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def listen(self, url: str) -> str:
        """Opens a link and returns its URL, with the port that the system chose for port 0. Raises LinkError."""
        self.urls.append(await self._server.listen(url))
        return self.urls[-1]

    async def wait(self) -> None:
        """Until it ends, which it does by an error only. Raises that."""
        if self._running is not None:
            await self._running

    async def close(self) -> None:
        """Motors off, links closed; a second time does nothing. Raises what ended it, if that was an error."""
        running, self._running = self._running, None
        try:
            if running is not None:
                running.cancel()
                with suppress(asyncio.CancelledError):
                    await running
        finally:
            await self._server.close()
