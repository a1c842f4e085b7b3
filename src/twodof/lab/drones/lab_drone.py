"""Drones of the server: each is kept connected, also over its restarts, watched, and commanded for clients."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Mapping
from contextlib import ExitStack, asynccontextmanager, suppress
from typing import Any

from twodof.errors import LinkError, LinkLost, Rejected, Timeout, TwodofError
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.clock import DroneRestarted
from twodof.gcs.drone_state import StatusText
from twodof.gcs.recording import seconds
from twodof.lab.answers import NotThere
from twodof.lab.drones.connection import DroneConnection
from twodof.lab.drones.drone_report import lost_report
from twodof.lab.settings import LabSettings
from twodof.lab.telemetry_rows import Audience, Feeds
from twodof.link.transport.url import Port

CONNECT_S = 5.0
AGAIN_S, AGAIN_MOST_S = 0.3, 2.0
MOST_TEXTS = 200


class LabDrone:
    """The drone at `url`. `number` is its MAVLink system, 0 until it was heard for the first time.

    `texts` are the last lines that it said, and that the server said of it, with the time [s] as in its logs.
    """

    def __init__(self, url: str, settings: LabSettings, audience: Audience) -> None:
        self.url, self.number = url, 0
        self.feeds = Feeds()
        self.texts: deque[dict[str, Any]] = deque(maxlen=MOST_TEXTS)
        self._settings, self._audience = settings, audience
        self._connection: DroneConnection | None = None
        self._why_lost = "it was not heard yet"
        self._last: dict[str, Any] = {}
        self._lendings = 0

    @property
    def state(self) -> dict[str, Any]:
        """How it stands, for clients; see docs/reference/lab-routes.md."""
        if self._connection is None:
            return lost_report(self.number, self.url, self._why_lost, self._last)
        return self._connection.report()

    @property
    def connection(self) -> DroneConnection:
        """What goes on while it is connected. Raises LinkLost while it is not."""
        if self._connection is None:
            raise LinkLost(self._why_lost, self.url, "see that it runs; the server connects again by itself")
        return self._connection

    @property
    def drone(self) -> AsyncDrone:
        """The connected drone. Raises LinkLost while there is none."""
        return self.connection.drone

    @asynccontextmanager
    async def commanded(self) -> AsyncIterator[AsyncDrone]:
        """The drone with the lease ours, taken where it is not. Raises Rejected where another keeps it, LinkLost."""
        async with self.connection.pilot.commanded() as drone:
            yield drone

    def lend(self) -> ExitStack:
        """Let a program of ours fly it that records by itself and may begin its time anew, until `close` of what is
        returned."""
        lent = ExitStack()
        if self._connection is not None:
            lent.enter_context(self._connection.drone.clock.resetting())
        self._lendings += 1
        lent.callback(self._lent_back)
        return lent

    def _lent_back(self) -> None:
        self._lendings -= 1

    async def run(self) -> None:
        """Keep it connected until cancelled; then it is left, disarmed if it was ours."""
        again = AGAIN_S
        while True:
            try:
                key = self._settings.key
                drone = await AsyncDrone.connect(self.url, CONNECT_S, key=key, take_lease=False)
            except (LinkError, Timeout, Rejected) as error:
                self._why_lost = error.what
                await asyncio.sleep(again)
                again = min(AGAIN_MOST_S, 2 * again)
                continue
            again = AGAIN_S
            try:
                await self._attend(drone)
            except (LinkError, Timeout, Rejected) as error:
                self._why_lost = error.what
            finally:
                if self._connection is not None:
                    self._last = self._connection.report()
                self._connection = None
                self.tell_state(self.state)
                with suppress(TwodofError):
                    await drone.close()

    async def _attend(self, drone: AsyncDrone) -> None:
        session = drone.session
        self.number = session.system
        session.on(lambda line: self.say(line.severity, line.text), StatusText)
        # What was subscribed to is gone with what it was: a new session asks for all of it again.
        session.on(lambda _: session.end(LinkLost("it has restarted", session.url, "wait a moment")), DroneRestarted)
        self._connection = DroneConnection(drone, self, self._settings.folder)
        await self._connection.run()

    @property
    def commanding(self) -> int:
        """How many clients are connected that may command."""
        return self._audience.commanding

    @property
    def lent(self) -> bool:
        """Whether a program of ours flies it that records by itself."""
        return self._lendings > 0

    def tell_state(self, state: Mapping[str, Any]) -> None:
        """Tell all clients how it stands."""
        if self.number:
            self._audience.tell({"event": "drone", "drone": self.number, "state": state})

    def say(self, severity: str, text: str) -> None:
        """Tell all clients a line about it."""
        at = None if self._connection is None else seconds(self._connection.drone.tick)
        line = {"severity": severity, "text": text, "time": at}
        self.texts.append(line)
        self._audience.tell({"event": "text", "drone": self.number, **line})

    def tell_parameters(self, names: list[str]) -> None:
        """Tell all clients which parameters changed, whoever changed them."""
        self._audience.tell({"event": "parameters", "drone": self.number, "names": names})

    def tell_log(self, name: str) -> None:
        """Tell all clients of a flight that was recorded."""
        self._audience.tell({"event": "log", "name": name})


MOST_DRONES = 8
CLOSE_S = 8.0
"""What leaving all drones may take: each is disarmed if it was ours."""


class LabDrones:
    """The drones at the URLs of the settings; none given: those that run on this computer, as they come."""

    def __init__(self, settings: LabSettings, audience: Audience) -> None:
        places = [f"udp://127.0.0.1:{Port.COMPANION_ONBOARD + index}" for index in range(MOST_DRONES)]
        self._always = bool(settings.connect)
        self._drones = [LabDrone(url, settings, audience) for url in settings.connect or places]
        self._tasks: list[asyncio.Task[None]] = []

    def __getitem__(self, number: int) -> LabDrone:
        """The drone of that MAVLink system. Raises NotThere."""
        for one in self._drones:
            if one.number == number:
                return one
        known = [str(one.number) for one in self._drones if one.number]
        raise NotThere("there is no such drone", f"drone {number}", f"there are: {', '.join(known) or 'none yet'}")

    @property
    def all(self) -> list[LabDrone]:
        """Those that were heard."""
        return sorted((one for one in self._drones if one.number), key=lambda one: one.number)

    @property
    def states(self) -> list[dict[str, Any]]:
        """How they stand."""
        return [one.state for one in self.all]

    @property
    def recordings(self) -> frozenset[str]:
        """Names of the logs that are being recorded: they cannot be read yet."""
        return frozenset(str(state.get("recording") or "") for state in self.states) - {""}

    def start(self) -> None:
        """Begin to connect."""
        self._tasks = [asyncio.create_task(one.run()) for one in self._drones]

    async def close(self) -> None:
        """Leave all: those that were ours stand disarmed."""
        for task in self._tasks:
            task.cancel()
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=CLOSE_S)
