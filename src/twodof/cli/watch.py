"""`twodof watch`: drones in a table that follows them, as lines in a pipe, or as JSON; it commands nothing."""

import asyncio
import sys
import time
from collections import deque
from collections.abc import Sequence
from contextlib import AsyncExitStack, suppress
from math import degrees, isfinite
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Group
from rich.live import Live
from rich.text import Text

from twodof.cli.connection import KeyOfDrone, SystemOfDrone, run_until_signal
from twodof.cli.options import Json, argument, flag, option
from twodof.cli.output import one_line, print_json, table, table_console
from twodof.errors import LinkLost, Rejected, Timeout, TwodofError
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.clock import DroneRestarted
from twodof.gcs.discovery import LOOPBACK, discover, urls
from twodof.gcs.drone_state import DroneState, StatusText
from twodof.link.mavlink.messages import channel_mask
from twodof.link.signing import read_key
from twodof.signals import ATTITUDE, POSITION, RATE

FIRST_VALUES_S = 2.0
"""Time to wait for the first samples of a connected drone [s]."""
_LISTEN_S = 3.0
_CONNECT_S = 10.0
_POLL_S = 0.2
_TABLE_S, _LINES_S = 0.2, 1.0
_TEXTS = 10
_FRESH_S = 0.5
_SIGNALS = {
    "theta": "estimate.theta",
    "q": "estimate.q",
    "x": "estimate.x",
    "v": "estimate.v",
    "M": "command.M",
    "T": "command.T",
}
_SETPOINTS = {"theta": ATTITUDE, "q": RATE, "x": POSITION}
"""Set-point -> the mode from which on it is followed."""


class WatchedDrone:
    """Drone at `url` that is watched without its lease, and connected to again when its link is lost.

    `lost` is the reason while it is not heard. `system` picks one of several drones at `url`. `texts` holds the last
    lines that it sent, with the wall-clock time of each [s].
    """

    def __init__(self, url: str, system: int | None, key: Path | None) -> None:
        self.url, self.system, self._key = url, system, key
        self.drone: AsyncDrone | None = None
        self.lost: TwodofError | None = None
        self.texts: deque[dict[str, Any]] = deque(maxlen=_TEXTS)
        self._last_sample = time.monotonic()

    @property
    def is_heard(self) -> bool:
        """Return True while the link stands."""
        return self.drone is not None and self.lost is None

    @property
    def age(self) -> float:
        """Return how long ago the newest sample came [s]."""
        return time.monotonic() - self._last_sample

    @property
    def time(self) -> float | None:
        """Return the drone's time of its newest estimate [s], None before the first."""
        latest = None if self.drone is None else self.drone.telemetry("estimate.theta").latest
        return None if latest is None else latest.time

    def value(self, name: str, newest: float = float("inf")) -> float | None:
        """Return the latest value of a signal; None if there is none, or if it is older than `newest` [s]."""
        latest = None if self.drone is None else self.drone.telemetry(name).latest
        if latest is None or self.time is None or self.time - latest.time > newest:
            return None
        return latest.value if isinstance(latest.value, float) and isfinite(latest.value) else None

    def setpoint(self, name: str) -> float | None:
        """Return the set-point "theta", "q" or "x" that is followed now, else None."""
        mode = self.value("state.mode")
        if mode is not None and mode < _SETPOINTS[name]:
            return None
        return self.value(f"setpoint.{name}", _FRESH_S)

    async def connect(self) -> None:
        """Connect and listen. Raises as AsyncDrone.connect."""
        drone = await AsyncDrone.connect(self.url, _CONNECT_S, key=self._key, take_lease=False, drone=self.system)
        self.drone, self.system, self.lost = drone, drone.session.system, None
        drone.telemetry("estimate.theta").on(lambda _: self._note_sample())
        for line in drone.messages:  # of the time in which it was connected
            self._note_text(line)
        drone.session.on(self._note_text, StatusText)
        # Subscriptions are gone after a restart: a new session asks for all of them again.
        drone.session.on(lambda _: drone.session.end(LinkLost("it has restarted", drone.url)), DroneRestarted)

    async def follow(self) -> None:
        """Listen until cancelled; connect again each time the link is lost."""
        while True:
            try:
                if not self.is_heard:
                    await self.connect()
                await self._listen()
            except TwodofError as error:
                self.lost = self.lost or error
            finally:
                await self.leave()
            await asyncio.sleep(_POLL_S)

    async def leave(self) -> None:
        """Close the link and keep the last values."""
        if self.drone is not None:
            with suppress(TwodofError):
                await self.drone.close()

    async def _listen(self) -> None:
        """Take what comes in. Raises LinkLost."""
        drone = self.drone
        assert drone is not None
        async with AsyncExitStack() as stack:
            if drone.ours:  # what the flight code closes comes in batches alone
                with suppress(Rejected, Timeout):
                    batches = drone.batches.to(lambda _: None, channel_mask(["state.mode"]))
                    await stack.enter_async_context(batches)
            while True:
                drone.session.check(drone.session.now)
                await asyncio.sleep(_POLL_S)

    def _note_sample(self) -> None:
        self._last_sample = time.monotonic()

    def _note_text(self, line: StatusText) -> None:
        self.texts.append({"heard": time.time(), "severity": line.severity, "text": line.text})


def watch(
    at: Annotated[
        list[str] | None,
        argument("Addresses of drones, as `twodof up` prints them; default: all drones of this computer.", "URL"),
    ] = None,
    drone: SystemOfDrone = None,
    key: KeyOfDrone = None,
    every: Annotated[
        float | None,
        option(
            "Time between two tables (default .2), or two lines of a pipe or of --json (default 1) [s].",
            min=0.05,
            max=60.0,
        ),
    ] = None,
    once: Annotated[bool, flag("Print the state of each drone and end.", "--once")] = False,
    json: Json = False,
) -> None:
    """Show the drones in a table until Ctrl-C: state, mode, failsafe, theta, q, x, battery, last message.

    It takes no lease, changes nothing, and reconnects to a drone that was lost. In a pipe it writes one line per drone,
    with --json one JSON document per line. Exit status: 0 ended by Ctrl-C or --once, 2 no drone answered.
    """
    if key is not None:
        read_key(key)
    raise typer.Exit(asyncio.run(_watch(at or [], drone, key, every, once, json)))


async def _watch(
    at: list[str], system: int | None, key: Path | None, every: float | None, once: bool, json: bool
) -> int:
    async def work() -> None:
        drones = [WatchedDrone(url, number, key) for url, number in await _places(at, system)]
        await _connect_all(drones)
        tasks = [asyncio.create_task(one.follow()) for one in drones]
        try:
            if once:
                await _wait_for_values(drones)
                _print(drones, json, indent=2)
            else:
                await _show(drones, every, json)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    await run_until_signal(work())
    return 0


async def _places(at: Sequence[str], system: int | None) -> list[tuple[str, int | None]]:
    """Return URL and system of each drone to watch: those of `at`, else those that are heard. Raises LinkLost."""
    if at:
        return [(url, system) for url in at]
    # Not the ports to which drones send: a watcher must not keep another program from them.
    places = [url for url in urls([LOOPBACK]) if not url.startswith("udpin")]
    found = [one for one in await discover(_LISTEN_S, places=places) if system in (None, one.system)]
    if not found:
        which = "no drone" if system is None else f"no drone {system}"
        remedy = "start one with `twodof up`, or say where it is: twodof watch URL"
        raise LinkLost(f"{which} was heard on this machine within {_LISTEN_S:g} s", LOOPBACK, remedy)
    return [(one.url, one.system) for one in found]


async def _connect_all(drones: Sequence[WatchedDrone]) -> None:
    """Connect to all side by side; drones that do not answer are looked for later. Raises if none answers."""
    ends = await asyncio.gather(*(one.connect() for one in drones), return_exceptions=True)
    errors = [end for end in ends if isinstance(end, BaseException)]
    for one, end in zip(drones, ends, strict=True):
        if isinstance(end, TwodofError):
            one.lost = end
    if len(errors) == len(drones) or not all(isinstance(error, TwodofError) for error in errors):
        for one in drones:
            await one.leave()
        raise errors[0]


async def _wait_for_values(drones: Sequence[WatchedDrone]) -> None:
    """Wait until each connected drone has sent its estimate, FIRST_VALUES_S at most."""
    with suppress(TimeoutError):
        async with asyncio.timeout(FIRST_VALUES_S):
            while any(
                one.is_heard and None in (one.value("estimate.theta"), one.value("estimate.x")) for one in drones
            ):
                await asyncio.sleep(0.02)


async def _show(drones: Sequence[WatchedDrone], every: float | None, json: bool) -> None:
    """Draw the table on a terminal, else print lines, until cancelled or until the reader of the lines has left."""
    console = table_console()
    if json or not console.is_terminal or console.is_dumb_terminal:
        await _wait_for_values(drones)
        while _print(drones, json, indent=None):
            await asyncio.sleep(every or _LINES_S)
        return
    with Live(console=console, screen=True, auto_refresh=False, transient=True) as live:
        while True:
            live.update(screen(drones), refresh=True)
            await asyncio.sleep(every or _TABLE_S)


def screen(drones: Sequence[WatchedDrone]) -> Group:
    """Return the table of all drones, and the last words of each below it."""
    heads = ("drone", "state", "mode", "theta, deg", "q, deg/s", "x, m", "battery", "age, s")
    rows = table(*heads, right=range(3, 8))
    for column in rows.columns[1:3]:  # "disarmed" and "offboard" stay whole on 80 columns, where a URL is cut
        column.min_width = 8
    for column in rows.columns[3:]:
        column.no_wrap = True
    words = []
    for one in drones:
        state = DroneState() if one.drone is None else one.drone.state
        alarm = "bold red" if not one.is_heard or state.killed or state.safety.reason else ""
        rows.add_row(
            _name(one),
            _state(one, state),
            state.mode,
            _number(one.value("estimate.theta"), degrees(1.0), "+.1f"),
            _number(one.value("estimate.q"), degrees(1.0), "+.0f"),
            _number(one.value("estimate.x"), 1.0, "+.3f"),
            _battery(state),
            f"{one.age:.1f}",
            style=alarm,
        )
        if one.texts:
            said = f"{one.system or one.url} {one.texts[-1]['severity']}: {one.texts[-1]['text']}"
            words.append(Text(one_line(said), alarm))
    return Group(rows, "", *words, "Ctrl-C ends watching")


def _name(one: WatchedDrone) -> str:
    return one_line(one.url) if one.system is None else f"{one.system} {one_line(one.url)}"


def _state(one: WatchedDrone, state: DroneState) -> str:
    if not one.is_heard:
        return f"LINK LOST: {one_line(one.lost.what)}" if one.lost is not None else "looking for it"
    stands = "KILLED" if state.killed else "ARMED" if state.armed else "disarmed"
    rings = ", rings locked" if state.rig.rings_locked else ""
    words = state.safety.in_words()
    return f"{stands}{rings}{f', FAILSAFE: {words}' if words else ''}"


def _battery(state: DroneState) -> str:
    voltage, charge = state.battery.voltage, state.battery.charge
    share = f" {charge:.0%}" if isfinite(charge) else ""
    return f"{voltage:.1f} V{share}" if isfinite(voltage) else ""


def _number(value: float | None, scale: float, form: str) -> str:
    return "-" if value is None else format(scale * value, form)


def _print(drones: Sequence[WatchedDrone], json: bool, indent: int | None) -> bool:
    """Print the drones; return False if the reader of the JSON has left."""
    if json:
        return print_json({"drones": [reading(one) for one in drones]}, indent)
    sys.stdout.writelines(f"{line(one)}\n" for one in drones)
    sys.stdout.flush()
    return True


def reading(one: WatchedDrone) -> dict[str, Any]:
    """Return state, latest values (SI and radians, None while unknown) and last words for --json."""
    row: dict[str, Any] = {"system": one.system, "url": one.url, "link": "heard" if one.is_heard else "lost"}
    if one.lost is not None:
        row["lost_because"] = one.lost.what
    drone = one.drone
    if drone is None:
        return row
    state, rig = drone.state, drone.state.rig
    return row | {
        "ours": drone.ours,
        "virtual": rig.virtual,
        "rig": rig.name,
        "controller": rig.controller,
        "changed": rig.changed,
        "armed": state.armed,
        "mode": state.mode,
        "safety_switch_off": rig.safety_off,
        "rings_locked": rig.rings_locked,
        "killed": state.killed,
        "failsafe": state.safety.action,
        "failsafe_reason": state.safety.reason,
        "failsafe_in_words": state.safety.in_words(),
        "lease_holder": list(drone.lease.holder) if drone.lease.holder else None,
        "battery": {"voltage": state.battery.voltage, "charge": state.battery.charge},
        "time": one.time,
        **{short: one.value(name) for short, name in _SIGNALS.items()},
        "setpoint": {name: one.setpoint(name) for name in _SETPOINTS},
        "texts": list(one.texts),
    }


def line(one: WatchedDrone) -> str:
    """Return state and latest values in a line."""
    name = f"drone {one.system}" if one.system is not None else one.url
    if not one.is_heard or one.drone is None:
        why = f": {one.lost.what}" if one.lost is not None else ""
        return f"{name}  link lost{why}"
    parts = [name, f"t {one.time or 0.0:.1f} s", str(one.drone.state)]
    for short, scale, unit in (
        ("theta", degrees(1.0), " deg"),
        ("q", degrees(1.0), " deg/s"),
        ("x", 1.0, " m"),
        ("M", 1.0, ""),
    ):
        value = one.value(_SIGNALS[short])
        if value is not None:
            parts.append(f"{short} {scale * value:+.3g}{unit}")
    return "  ".join(parts)
