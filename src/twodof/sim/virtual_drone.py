"""A virtual drone: the virtual rig and the flight controller's program, as one thing that speaks MAVLink."""

import asyncio
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from twodof.blocks import Diagram
from twodof.errors import ParameterError
from twodof.fcu.assembly import Assembly
from twodof.fcu.command.commander import Commander
from twodof.fcu.control.controllers import ControllerIdentity, Controllers
from twodof.fcu.control.loop import FlightController
from twodof.fcu.server import Server
from twodof.link.mavlink.rates import PROFILES
from twodof.link.signing import Signing
from twodof.parameters import ParameterSet
from twodof.rig.parameters import load_rig
from twodof.sim.rig_host import VirtualRig


class VirtualDrone:
    """Drone number `index` (system `index` + 1) on a virtual rig, in real time or in `lockstep`.

    `rig` is "paper", "lab", a file or a set of parameters; `conditions` further parameters of it (`seed`, `noise`,
    `rings`, ...). `controllers` are diagrams, their JSON files, or names of starter diagrams, which fly in a sandbox
    unless `trusted`. `precision` is that of everything. `state` is the folder of what it keeps, None for nothing.
    `rate` names the streams that every client gets, "onboard" or "ground". `fresh` forgets what is kept in `state`,
    except its logs.

    Use it as an asynchronous context manager: within, it runs; `listen` opens links. Raises ParameterError,
    DiagramError, CompileError and LinkError for what cannot be.
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
        state: Path | None = None,
        signing: Signing | None = None,
        position_filter: str = "joint",
        fuel: int | None = None,
        rate: str = "onboard",
        fresh: bool = False,
    ) -> None:
        parameters = rig if isinstance(rig, ParameterSet) else load_rig(rig)
        name = "own" if isinstance(rig, ParameterSet) else Path(rig).stem
        self.rig = VirtualRig(parameters, conditions, precision, name, safety_off)
        uploads, kept = (None, None) if state is None else (state / "controllers", state / "flying")
        chosen = Controllers(controllers, trusted, uploads, kept, position_filter, precision, fuel)
        if rate not in PROFILES:
            raise ParameterError(f"no rates called {rate!r:.40}", "rate", f"there are: {', '.join(PROFILES)}")
        self.assembly = Assembly(self.rig, chosen, index + 1, lockstep, signing, state, PROFILES[rate], fresh)
        self.rig.settle(self.controller.code)
        self.urls: list[str] = []
        self._running: asyncio.Task[None] | None = None

    @property
    def controller(self) -> FlightController:
        """The control loop."""
        return self.assembly.controller

    @property
    def commander(self) -> Commander:
        """Who decides what is flown."""
        return self.assembly.commander

    @property
    def flown(self) -> ControllerIdentity:
        """Which controller flies, and how many parameters differ from their defaults."""
        return self.assembly.configuration.identity

    @property
    def server(self) -> Server:
        """The shell: links and services."""
        return self.assembly.server

    async def __aenter__(self) -> Self:
        self._running = asyncio.create_task(self.server.run(), name=f"drone {self.server.system}")
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def listen(self, url: str) -> str:
        """Opens a link and returns its URL, with the port that the system chose for port 0. Raises LinkError."""
        self.urls.append(await self.server.listen(url))
        return self.urls[-1]

    async def wait(self) -> None:
        """Until it ends, which it does by an error only. Raises that."""
        if self._running is not None:
            await self._running

    async def close(self) -> None:
        """Motors off, links and log closed; a second time does nothing. Raises what ended it, if that was an error."""
        running, self._running = self._running, None
        try:
            if running is not None:
                running.cancel()
                with suppress(asyncio.CancelledError):
                    await running
        finally:
            await self.server.close()
            self.assembly.close()
