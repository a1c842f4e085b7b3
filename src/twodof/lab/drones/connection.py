"""DroneConnection: all that goes on with a drone while it is connected: rows, records, parameters, its pilot."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from twodof.errors import Rejected, Timeout
from twodof.gcs.async_drone import AsyncDrone
from twodof.lab.drones.drone_report import report
from twodof.lab.drones.flight_recorder import FlightRecorder
from twodof.lab.drones.parameter_table import ParameterTable
from twodof.lab.drones.pilot import Pilot
from twodof.lab.drones.telemetry_source import TelemetrySource
from twodof.lab.side_by_side import until_one_ends
from twodof.lab.telemetry.feeds import Feeds
from twodof.link.mavlink.rates import RATES

REPORT_S = 0.1
REPORT_ANYWAY_S = 1.0
TIME, TIME_HZ = "ATTITUDE", 20.0
"""The message that tells its time, so often."""
FAST_HZ = 10.0
"""What comes as often as this by default, and is of no use here."""
_PASSES = frozenset({"time"})
"""What passes by itself: a state in which nothing else differs is told once a second only."""


class Hearer(Protocol):
    """Who is told what happens, and says how many are there that may command."""

    feeds: Feeds

    @property
    def commanding(self) -> int:
        """How many clients are connected that may command."""
        ...

    @property
    def lent(self) -> bool:
        """Whether who flies it records by itself."""
        ...

    def tell_state(self, state: Mapping[str, Any]) -> None:
        """The drone stands so now."""

    def say(self, severity: str, text: str) -> None:
        """A line about it."""

    def tell_parameters(self, names: list[str]) -> None:
        """These parameters changed."""

    def tell_log(self, name: str) -> None:
        """A flight was recorded."""


class DroneConnection:
    """The parts that attend to a connected drone; `run` goes on until it is lost.

    `asked` is the set-point that clients gave last, as they gave it.
    """

    def __init__(self, drone: AsyncDrone, hearer: Hearer, folder: Path) -> None:
        self.drone = drone
        self.asked: dict[str, Any] | None = None
        self.pilot = Pilot(drone, lambda: hearer.commanding, hearer.say)
        self.parameters = ParameterTable(drone, hearer.tell_parameters)
        self.recorder = FlightRecorder(
            drone,
            folder / "flights",
            self.parameters.active,
            hearer.tell_log,
            lambda why: hearer.say("error", why),
            lambda: hearer.lent,
        )
        self._hearer = hearer

    async def run(self) -> None:
        """Attend to it. Raises LinkLost at the end of that."""
        await self._ask_for_less()
        work = [self._report(), self.pilot.watch()]
        if self.drone.ours:
            work.append(self.parameters.run())
            if not self.drone.session.lockstep:
                work += TelemetrySource(self.drone, self._hearer.feeds).work()
                work.append(self.recorder.run())
        await until_one_ends(work)

    async def _ask_for_less(self) -> None:
        """Of streams at high rates none but that of its time: what clients want comes in batches."""
        if not self.drone.ours or self.drone.session.lockstep:
            return
        self.drone.telemetry.stop()
        with suppress(Rejected, Timeout):  # it costs more then, and harms nothing
            for row in RATES:
                if row.onboard is not None and row.onboard >= FAST_HZ:
                    await self.drone.stream(row.name, TIME_HZ if row.name == TIME else -1.0)
            await self.drone.stream("TWODOF_TOF", -1.0)

    def report(self) -> dict[str, Any]:
        """How it stands, for clients."""
        drone = self.drone
        if drone.setpoints.current is None:
            self.asked = None
        playback = drone.exciter.playback
        plays = playback is not None and playback.state in ("waiting", "playing")
        return report(drone) | {
            "setpoint": self.asked,
            "excitation": {"start_tick": playback.start_tick, "end_tick": playback.end_tick}
            if plays and playback is not None
            else None,
            "recording": self.recorder.name,
            "experiment": self._hearer.lent,
        }

    async def _report(self) -> None:
        """Tell how it stands when that changes, and once a second."""
        told: dict[str, Any] = {}
        session = self.drone.session
        due = 0.0
        while True:
            session.check(session.now)
            state = self.report()
            steady = {key: value for key, value in state.items() if key not in _PASSES}
            if steady != told or session.now >= due:
                told, due = steady, session.now + REPORT_ANYWAY_S
                self._hearer.tell_state(state)
            await asyncio.sleep(REPORT_S)
