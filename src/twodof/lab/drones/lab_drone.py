"""Drones of the server: each is kept connected over its restarts, watched, and commanded for clients."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Iterator
from contextlib import AbstractAsyncContextManager, contextmanager, suppress
from math import isfinite
from pathlib import Path
from typing import Any

from twodof.errors import LinkError, LinkLost, Rejected, Timeout, TwodofError
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.clock import DroneRestarted
from twodof.gcs.drone_state import StatusText, explanation_of
from twodof.gcs.recording import seconds
from twodof.lab.answers import NotThere
from twodof.lab.drones.parameter_table import ParameterTable
from twodof.lab.drones.pilot import FlightRecorder, Pilot
from twodof.lab.drones.telemetry_source import TelemetrySource, until_one_ends
from twodof.lab.settings import LabSettings
from twodof.lab.telemetry_rows import Audience, Feeds
from twodof.link.mavlink.dialect import RATES
from twodof.link.transport.url import Ports

CONNECT_S = 5.0
AGAIN_S, AGAIN_MOST_S = 0.3, 2.0
MOST_TEXTS = 200
REPORT_S = 0.1
REPORT_ANYWAY_S = 1.0
TIME, TIME_HZ = "ATTITUDE", 20.0
"""Message with the drone's time, and its rate [Hz]."""
FAST_HZ = 10.0
"""Messages that come at this rate or faster are stopped: batches have the samples."""


def state_of(drone: AsyncDrone) -> dict[str, Any]:
    """Return the state of a connected drone.

    `time` is the drone's time as in its logs [s]; the battery's voltage is in V, its charge 0 to 1, both None while
    unknown.
    """
    state, holder = drone.state, drone.lease.holder
    safety, rig = state.safety, state.rig
    fails = safety.action != "none" and (state.armed or bool(safety.reason))
    return {
        "system": drone.session.system,
        "name": rig.name or f"drone {drone.session.system}",
        "url": drone.url,
        "link": "heard",
        "why_lost": "",
        "ours": drone.ours,
        "lease_holder": None if holder is None else list(holder),
        "ours_leases": drone.lease.ours,
        "tuning_withheld": drone.lease.tuning_withheld,
        "time": seconds(drone.tick),
        "autopilot": state.autopilot,
        "virtual": rig.virtual,
        "lockstep": rig.lockstep,
        "armed": state.armed,
        "mode": state.mode,
        "safety_switch": "off" if rig.safety_off else "on",
        "killed": state.killed,
        "killed_by": None if safety.killed_by is None else list(safety.killed_by),
        "failsafe": safety.action if fails else "none",
        "failsafe_reason": _in_words(safety.reason) if fails else "",
        "warnings": [_in_words(cause) for cause in safety.causes],
        "controller": rig.controller,
        "changed_parameters": rig.changed,
        "rings_locked": rig.rings_locked,
        "seed": rig.seed,
        "noise": round(rig.noise, 6),
        "battery": {"voltage": _known(state.battery.voltage), "charge": _known(state.battery.charge)},
        "rig": rig.name,
    }


def _in_words(cause: str) -> str:
    return explanation_of("TWODOF_CAUSE", cause).rstrip(".") or cause


def _known(value: float) -> float | None:
    return round(value, 4) if isfinite(value) else None


class DroneConnection:
    """Connection to a lab drone, with its pilot, parameters, recorder and telemetry.

    `asked` is the last set-point of a client, in the form of the request.
    """

    def __init__(self, drone: AsyncDrone, lab_drone: LabDrone, folder: Path) -> None:
        self.drone = drone
        self.asked: dict[str, Any] | None = None
        self.pilot = Pilot(drone, lambda: lab_drone.audience.commanding, lab_drone.say)
        self.parameters = ParameterTable(drone, lambda names: lab_drone.tell("parameters", names=names))
        self.recorder = FlightRecorder(
            drone,
            folder / "flights",
            self.parameters.active,
            lambda name: lab_drone.tell("log", name=name),
            lambda why: lab_drone.say("error", why),
            lambda: lab_drone.lent,
        )
        self._lab_drone = lab_drone

    async def run(self) -> None:
        """Report, pilot, tune and record until the drone is lost. Raises LinkLost."""
        await self._ask_for_less()
        work = [self._report(), self.pilot.watch()]
        if self.drone.ours:
            work.append(self.parameters.run())
            if not self.drone.session.lockstep:
                work += [*TelemetrySource(self.drone, self._lab_drone.feeds).work(), self.recorder.run()]
        await until_one_ends(work)

    async def _ask_for_less(self) -> None:
        """Stop the fast streams except that with the time: the rows for clients come in batches."""
        if not self.drone.ours or self.drone.session.lockstep:
            return
        self.drone.telemetry.stop()
        with suppress(Rejected, Timeout):  # the streams only cost time
            for row in RATES:
                if row.onboard is not None and row.onboard >= FAST_HZ:
                    await self.drone.stream(row.name, TIME_HZ if row.name == TIME else -1.0)
            await self.drone.stream("TWODOF_TOF", -1.0)

    def report(self) -> dict[str, Any]:
        """Return the drone's state for clients."""
        drone = self.drone
        if drone.setpoints.current is None:
            self.asked = None
        playback = drone.exciter.playback
        plays = playback is not None and playback.state in ("waiting", "playing")
        return state_of(drone) | {
            "ours_killed": drone.state.safety.killed_by in self._lab_drone.sources,
            "setpoint": self.asked,
            "excitation": {"start_tick": playback.start_tick, "end_tick": playback.end_tick}
            if plays and playback is not None
            else None,
            "recording": self.recorder.name,
            "experiment": self._lab_drone.lent,
        }

    async def _report(self) -> None:
        """Send the state at each change, and once a second."""
        told, due, session = dict[str, Any](), 0.0, self.drone.session
        while True:
            session.check(session.now)
            state = self.report()
            steady = {key: value for key, value in state.items() if key != "time"}
            if steady != told or session.now >= due:
                told, due = steady, session.now + REPORT_ANYWAY_S
                self._lab_drone.tell("drone", state=state)
            await asyncio.sleep(REPORT_S)


class LabDrone:
    """Drone at `url`, kept connected. `number` is its MAVLink system, 0 before the first heartbeat.

    `texts` are the last lines of text from the drone and about it, with the time [s] as in its logs. `sources` has
    system and component of each connection that this server has had to it.
    """

    def __init__(self, url: str, settings: LabSettings, audience: Audience) -> None:
        self.url, self.number = url, 0
        self.feeds = Feeds(audience.allowance)
        self.texts: deque[dict[str, Any]] = deque(maxlen=MOST_TEXTS)
        self.audience, self._settings = audience, settings
        self._connection: DroneConnection | None = None
        self._why_lost = "the drone was not heard yet"
        self._last: dict[str, Any] = {}
        self.sources, self._lendings = set[tuple[int, int]](), 0

    @property
    def state(self) -> dict[str, Any]:
        """State for clients; see docs/reference/lab-routes.md."""
        if self._connection is None:
            return dict(self._last, link="lost", why_lost=self._why_lost, ours_leases=False, lease_holder=None)
        return self._connection.report()

    @property
    def connection(self) -> DroneConnection:
        """The present connection. Raises LinkLost without one."""
        if self._connection is None:
            raise LinkLost(self._why_lost, self.url, "check that it runs; the server connects again by itself")
        return self._connection

    @property
    def drone(self) -> AsyncDrone:
        """The connected drone. Raises LinkLost without one."""
        return self.connection.drone

    def commanded(self) -> AbstractAsyncContextManager[AsyncDrone]:
        """Take the lease, if this server lacks it, and yield the drone. Raises Rejected, LinkLost, Timeout."""
        return self.connection.pilot.commanded()

    @contextmanager
    def lend(self) -> Iterator[None]:
        """Lend the drone to a job, which records by itself and may restart it. Raises LinkLost."""
        with self.drone.clock.resetting():
            self._lendings += 1
            try:
                yield
            finally:
                self._lendings -= 1

    async def run(self) -> None:
        """Keep the drone connected until cancelled; then leave it, disarmed if this server has the lease."""
        again = AGAIN_S
        while True:
            try:
                key = self._settings.key
                drone = await AsyncDrone.connect(self.url, CONNECT_S, key=key, take_lease=False)
                again = AGAIN_S
                await self._attend(drone)
            except (LinkError, Timeout, Rejected) as error:
                self._why_lost = error.what
            await asyncio.sleep(again)
            again = min(AGAIN_MOST_S, 2 * again)

    async def _attend(self, drone: AsyncDrone) -> None:
        session = drone.session
        self.number = session.system
        self.sources.add((session.connection.system, session.connection.component))
        session.on(lambda line: self.say(line.severity, line.text), StatusText)
        # Subscriptions are gone after a restart: a new session asks for all of them again.
        restarted = LinkLost("it has restarted", session.url, "try again in a moment")
        session.on(lambda _: session.end(restarted), DroneRestarted)
        self._connection = DroneConnection(drone, self, self._settings.folder)
        for line in drone.messages:  # of the time in which it was connected
            self.say(line.severity, line.text)
        try:
            await self._connection.run()
        finally:
            self._last, self._connection = self._connection.report(), None
            self.tell("drone", state=self.state)
            with suppress(TwodofError):
                await drone.close()

    @property
    def lent(self) -> bool:
        """True while a job flies the drone and records by itself."""
        return self._lendings > 0

    def tell(self, event: str, **fields: Any) -> None:
        """Send an event about the drone to all clients, see docs/reference/lab-routes.md."""
        self.audience.tell({"event": event, "drone": self.number, **fields})

    def say(self, severity: str, text: str) -> None:
        """Send a line about the drone to all clients."""
        at = None if self._connection is None else seconds(self._connection.drone.tick)
        line = {"severity": severity, "text": text, "time": at}
        self.texts.append(line)
        self.tell("text", **line)


MOST_DRONES = 8
CLOSE_S = 8.0
"""Longest time for leaving all drones; a drone under command is disarmed."""


class LabDrones:
    """Drones at the URLs of the settings; without URLs the drones on this computer."""

    def __init__(self, settings: LabSettings, audience: Audience) -> None:
        places = [f"udp://127.0.0.1:{Ports.COMPANION_ONBOARD + index}" for index in range(MOST_DRONES)]
        self._drones = [LabDrone(url, settings, audience) for url in settings.connect or places]
        self._tasks: list[asyncio.Task[None]] = []

    def __getitem__(self, number: int) -> LabDrone:
        """Return the drone with the MAVLink system `number`. Raises NotThere."""
        for one in self._drones:
            if one.number == number:
                return one
        known = [str(one.number) for one in self._drones if one.number]
        raise NotThere("there is no such drone", f"drone {number}", f"there are: {', '.join(known) or 'none yet'}")

    @property
    def states(self) -> list[dict[str, Any]]:
        """States of the drones that were heard, by number."""
        return [one.state for one in sorted(self._drones, key=lambda one: one.number) if one.number]

    @property
    def recordings(self) -> frozenset[str]:
        """Names of logs in recording, which cannot be read yet."""
        return frozenset(str(state.get("recording") or "") for state in self.states) - {""}

    def start(self) -> None:
        """Start connecting."""
        self._tasks = [asyncio.create_task(one.run()) for one in self._drones]

    async def close(self) -> None:
        """Leave all drones; a drone under command is disarmed."""
        for task in self._tasks:
            task.cancel()
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=CLOSE_S)
