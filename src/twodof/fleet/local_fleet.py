"""Virtual drones on this computer, each with its flight controller and companion, supervised until they are ended."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Self

from twodof.fleet.local_drone import ControllerReport, LocalDrone, wait_until_heard
from twodof.fleet.supervisor import ChildProcess, ProcessSupervisor
from twodof.link.signing.key import Key

ANSWER_S = 60.0
"""How long a program may take until it is heard [s]: the first one compiles the flight code and the rig."""


class LocalFleet:
    """`drones`, whose flight controllers are started with the options `given` of `twodof fcu`; for `async with`.

    `reports` say what each drone, by index, flies. `tell` is called with a line for people where a program ends.
    """

    def __init__(
        self, drones: Sequence[LocalDrone], given: Sequence[str], key: Key | None, tell: Callable[[str], None]
    ) -> None:
        self.reports: dict[int, ControllerReport] = {}
        self._key = key
        self._of: dict[str, tuple[str, LocalDrone]] = {}
        programs = []
        for drone in drones:
            for name, url, arguments in (
                (f"flight controller {drone.system}", drone.fcu, ["fcu", *drone.options, *drone.own, *given]),
                (f"companion {drone.system}", drone.companion, ["companion", *drone.options]),
            ):
                self._of[name] = (url, drone)
                programs.append(ChildProcess(name, arguments))
        self._supervisor = ProcessSupervisor(programs, tell, self._answers)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._supervisor.end()

    async def start(self) -> None:
        """Starts all, and waits until all answer. Raises LinkError for the first that does not."""
        await self._supervisor.start()

    async def run(self) -> None:
        """Keeps all running; returns once one cannot be kept."""
        await self._supervisor.run()

    async def _answers(self, child: ChildProcess) -> None:
        await child.listening.wait()  # else it might be another one at the same port that is heard
        url, drone = self._of[child.name]
        found = await wait_until_heard(url, drone.system, ANSWER_S, self._key)
        if url == drone.fcu:
            self.reports[drone.index] = found
            # Fresh once: one that is started again flies what was sent to it meanwhile.
            child.arguments = [one for one in child.arguments if one != "--fresh"]
