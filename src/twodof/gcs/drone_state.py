"""State of a drone from its heartbeat, rig, battery and safety messages, and its STATUSTEXT lines."""

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from twodof.errors import Rejected
from twodof.gcs.clock import DroneClock
from twodof.gcs.session import Deadline, DroneSession
from twodof.gcs.telemetry import share, volts
from twodof.link.connection import LinkStatistics
from twodof.link.mavlink import dialect
from twodof.link.mavlink.modes import mode_name
from twodof.signals import SEVERITIES

KEPT = 1000
MOST_PIECES = 20
_PIECE_BYTES = 50
_WARNING = SEVERITIES.index("warning")
_TICKS_FOR_AN_ANSWER = 250
PIECES_S = 0.2
"""Longest wait for the next piece of a line [s]: pieces are sent together."""


class StatusText(NamedTuple):
    """Line of text from the drone: its number in order, its syslog severity in words, the text."""

    number: int
    severity: str
    text: str

    def __str__(self) -> str:
        return f"{self.severity}: {self.text}"


class StatusTexts:
    """Last KEPT lines of text, the oldest first. Each is emitted as an event of the session too."""

    def __init__(self, session: DroneSession) -> None:
        self.lines: deque[StatusText] = deque(maxlen=KEPT)
        self.count = 0
        self._pieces: dict[int, bytes] = {}
        self._number = self._severity = 0
        self._waiting: asyncio.TimerHandle | None = None
        self._loop = asyncio.get_running_loop()
        self._session = session
        session.on(self._take, "STATUSTEXT")

    def reasons_since(self, count: int) -> list[StatusText]:
        """Return the lines after the first `count` that may explain a refusal: warnings and worse."""
        rows = [line for line in self.lines if line.number >= count]
        return [line for line in rows if SEVERITIES.index(line.severity) <= _WARNING]

    def note(self, severity: str, text: str) -> None:
        """Add a line by this client about the drone."""
        line = StatusText(self.count, severity, text)
        self.lines.append(line)
        self.count += 1
        self._session.emit(line)

    def _take(self, got: Any) -> None:
        piece = bytes(got._text_raw).split(b"\0")[0]  # UTF-8; pymavlink's own field keeps ASCII only
        if got.id != self._number or (got.id == 0 and got.chunk_seq == 0):
            self._end()
            self._number = got.id
        self._severity = got.severity
        if got.chunk_seq < MOST_PIECES:
            self._pieces[got.chunk_seq] = piece
        last = [place for place, one in self._pieces.items() if len(one) < _PIECE_BYTES]
        if last and len(self._pieces) == last[0] + 1:
            self._end()
        elif self._waiting is None:
            # PX4 numbers its lines from 0, and a line that fills its last piece has no end mark: wait a moment.
            self._waiting = self._loop.call_later(PIECES_S, self._end)

    def _end(self) -> None:
        """Take the pieces so far as the whole line."""
        if self._waiting is not None:
            self._waiting.cancel()
            self._waiting = None
        line, self._pieces = b"".join(self._pieces[at] for at in sorted(self._pieces)), {}
        if line:
            text = line.decode("utf-8", "replace")
            severity = SEVERITIES[self._severity] if self._severity < len(SEVERITIES) else "info"
            self.note(severity, "".join(c if c.isprintable() else " " for c in text).strip())


ARMED = 128
RINGS, SAFETY_OFF, VIRTUAL, LOCKSTEP = 1, 2, 4, 8


@dataclass(frozen=True)
class SafetyState:
    """State of the failsafe: its `action` since the tick `since`, the deciding `reason`, and all present `causes`.

    `killed_by` is the system and component whose kill holds the drone; None without a kill or if it is unknown.
    """

    action: str = "none"
    reason: str = ""
    causes: tuple[str, ...] = ()
    since: int = 0
    tick: int = 0
    killed_by: tuple[int, int] | None = None

    def in_words(self) -> str:
        """Return action and reason as a sentence; "" without an action or a reason.

        An example: "descend (level, the thrust fades to 0, then off): nothing came over the link for a while".
        """
        if self.action == "none" or not self.reason:
            return ""
        explained = explanation_of("TWODOF_ACTION", self.action)
        action = f"{self.action} ({explained})" if explained else self.action
        return f"{action}: {explanation_of('TWODOF_CAUSE', self.reason) or self.reason}"


@dataclass(frozen=True)
class RigState:
    """State of the rig: name, controller that flies, settings; `changed` parameters differ from their defaults."""

    name: str = ""
    controller: str = ""
    diagram: int = 0
    seed: int = 0
    virtual: bool = False
    lockstep: bool = False
    rings_locked: bool = False
    safety_off: bool = False
    changed: int = 0
    noise: float = 0.0


@dataclass(frozen=True)
class BatteryState:
    """Voltage [V] and charge (0 empty, 1 full); NaN while unknown."""

    voltage: float = float("nan")
    charge: float = float("nan")


@dataclass(frozen=True)
class DroneState:
    """State of the drone when it was last heard; `autopilot` is its MAV_AUTOPILOT in words ("px4").

    Its parts come in separate messages: `mode`, `armed`, `status` (and `killed`) in HEARTBEAT, `safety` in
    TWODOF_SAFETY, `rig` in TWODOF_RIG. One part may be newer than another for a moment: after a wait for
    `safety.action` to be "off", `armed` may still be True. Wait for each part that you want to look at.
    """

    mode: str = "unknown"
    armed: bool = False
    status: str = "unknown"
    safety: SafetyState = SafetyState()
    rig: RigState = RigState()
    battery: BatteryState = BatteryState()
    autopilot: str = "unknown"

    @property
    def killed(self) -> bool:
        """True while a kill holds the drone disarmed, until it is released."""
        return self.status == "terminated"

    def __str__(self) -> str:
        text = f"{'armed' if self.armed else 'killed' if self.killed else 'disarmed'}, {self.mode}"
        if self.rig.rings_locked:
            text += ", rings locked"
        if self.safety.action != "none" and (self.armed or self.safety.reason):
            text += f", failsafe: {self.safety.action} because of {self.safety.reason or 'nothing that it names'}"
        return text


_STATUS = ("uninit", "boot", "calibrating", "standby", "active", "critical", "emergency", "power off", "terminated")


class StateTracker:
    """Tracker of the latest `state` of one drone, which can wait for a state."""

    def __init__(self, session: DroneSession, clock: DroneClock) -> None:
        self.state = DroneState()
        self._clock = clock
        self.heartbeats = 0
        session.on(self._heartbeat, "HEARTBEAT")
        session.on(self._safety, "TWODOF_SAFETY")
        session.on(self._rig, "TWODOF_RIG")
        session.on(self._battery, "BATTERY_STATUS")
        session.on(self._status, "SYS_STATUS")
        self._session = session

    async def wait_until(self, condition: Callable[[DroneState], bool], deadline: Deadline, remedy: str = "") -> None:
        """Wait until `condition` of the state holds; in lockstep grant tick after tick. Raises Timeout, LinkLost."""
        last = self._clock.tick + _TICKS_FOR_AN_ANSWER
        with self._session.listen("HEARTBEAT") as heard:
            while not condition(self.state):
                if self._clock.granting and self._clock.tick < last:
                    await self._clock.one_tick(deadline)
                elif await heard.next(deadline.end) is None:
                    raise deadline.error(remedy or "it acknowledged, but its heartbeat disagrees: read its messages")

    def check_not_killed(self) -> None:
        """Raise Rejected if a kill holds the drone: it would accept set-points and fly none."""
        if self.state.killed:
            by = self.state.safety.killed_by
            who = f" by system {by[0]}, component {by[1]}" if by is not None else ""
            where = self._session.where
            raise Rejected(f"the drone was killed{who}", where, "see why, then drone.release(), and arm it again")

    def _change(self, **changes: Any) -> None:
        self.state = DroneState(**{**vars(self.state), **changes})

    def _heartbeat(self, got: Any) -> None:
        self.heartbeats += 1
        status = _STATUS[got.system_status] if got.system_status < len(_STATUS) else "unknown"
        autopilot = word_of("MAV_AUTOPILOT", got.autopilot)
        armed = bool(got.base_mode & ARMED)
        self._change(mode=mode_name(got.custom_mode), armed=armed, status=status, autopilot=autopilot)

    def _safety(self, got: Any) -> None:
        causes = names_of("TWODOF_CAUSE", got.flags)
        reason = names_of("TWODOF_CAUSE", 1 << got.reason) if 0 <= got.reason < 32 else ()
        action = word_of("TWODOF_ACTION", got.action)
        by = (got.killed_system, got.killed_component) if got.killed else None
        self._change(safety=SafetyState(action, ", ".join(reason), causes, got.since, got.tick, by))

    def _rig(self, got: Any) -> None:
        flags = got.flags
        self._session.lockstep = bool(flags & LOCKSTEP)
        rig = RigState(
            _text(got.name),
            _text(got.controller),
            got.diagram,
            got.seed,
            bool(flags & VIRTUAL),
            bool(flags & LOCKSTEP),
            bool(flags & RINGS),
            bool(flags & SAFETY_OFF),
            got.changed,
            got.noise,
        )
        self._change(rig=rig)

    def _status(self, got: Any) -> None:
        if got.voltage_battery not in (0, 0xFFFF):
            self._change(battery=BatteryState(got.voltage_battery / 1000.0, share(got.battery_remaining)))

    def _battery(self, got: Any) -> None:
        self._change(battery=BatteryState(volts(got.voltages), share(got.battery_remaining)))


def names_of(enum: str, mask: int) -> tuple[str, ...]:
    """Return the names of the bits of a mask in the dialect's enumeration; an unknown bit gives its number."""
    return tuple(word_of(enum, bit) for k in range(32) if mask & (bit := 1 << k))


def word_of(enum: str, value: int) -> str:
    """Return the name of a value in the dialect's enumeration, in lower case; its number if it is unknown."""
    row = dialect.load().enums.get(enum, {}).get(value)
    return str(row.name).removeprefix(f"{enum}_").lower() if row is not None else str(value)


def words_of(enum: str, value: int) -> str:
    """Return the name of a value as words: "temporarily rejected"."""
    return word_of(enum, value).replace("_", " ")


def explanation_of(enum: str, word: str) -> str:
    """Return the dialect's description of the value called `word`; "" for an unknown one."""
    rows = dialect.load().enums.get(enum, {})
    return next((str(row.description) for value, row in rows.items() if word_of(enum, value) == word), "")


def _text(value: Any) -> str:
    text = value if isinstance(value, str) else bytes(value).decode("utf-8", "replace")
    return "".join(c if c.isprintable() else " " for c in text.split("\0")[0])


_RELEASE_KINDS = ((255, "release"), (192, "rc"), (128, "beta"), (64, "alpha"), (0, "dev"))
"""FIRMWARE_VERSION_TYPE: first number of each kind of version; numbers between count the versions of a kind."""
_OUR_BUILD = b"twodof"


class DroneVersion(NamedTuple):
    """Version of a drone's program, from AUTOPILOT_VERSION.

    `firmware` is the PX4 whose protocol it speaks ("1.16.1 rc 2"). `build` names its sources (hexadecimal, or
    "twodof"). `twodof` is the version of this package on a drone of ours, else "". `uid` tells machines apart; 0 is
    unknown.
    """

    autopilot: str
    firmware: str
    build: str
    twodof: str
    uid: int

    def __str__(self) -> str:
        if self.twodof:
            return f"twodof {self.twodof}, speaks as {self.autopilot} {self.firmware}"
        return f"{self.autopilot} {self.firmware} ({self.build})"


def version_of(got: Any, autopilot: str) -> DroneVersion:
    """Return the version in an AUTOPILOT_VERSION of an `autopilot`."""
    custom = bytes(got.flight_custom_version)
    ours = custom.startswith(_OUR_BUILD)
    # PX4 sends up to sixteen digits of its commit, the last byte first.
    build = custom.rstrip(b"\0").decode("ascii", "replace") if ours else custom[::-1].hex().rstrip("0")
    own = _version_number(got.middleware_sw_version).removesuffix(" release") if ours else ""
    uid2 = bytes(got.uid2)
    uid = int(got.uid) or int.from_bytes(uid2, "big")
    return DroneVersion(autopilot, _version_number(got.flight_sw_version), build, own, uid)


def _version_number(packed: int) -> str:
    kind = packed & 0xFF
    start, name = next((row for row in _RELEASE_KINDS if kind >= row[0]), _RELEASE_KINDS[-1])
    count = f" {kind - start}" if kind > start else ""
    return f"{packed >> 24 & 0xFF}.{packed >> 16 & 0xFF}.{packed >> 8 & 0xFF} {name}{count}"


class DroneView:
    """Latest data from one drone; `telemetry(name)` gives a signal.

    An estimate raises LinkLost if no newer one will come, and Timeout if none has come: `Drone` waits a while for the
    first one, `AsyncDrone` does not.
    """

    telemetry: Any

    def __init__(self, session: DroneSession, watcher: StateTracker, texts: StatusTexts, clock: DroneClock) -> None:
        self.session, self.watcher, self.texts, self.clock = session, watcher, texts, clock

    def __repr__(self) -> str:
        state = self.state
        stands = f"{state.mode}, {'armed' if state.armed else 'disarmed'}"
        return f"<drone {self.session.system} at {self.url}: {'closed' if self.session.closed else stands}>"

    @property
    def ours(self) -> bool:
        """True for a twodof drone, False for a plain PX4."""
        return self.session.ours

    @property
    def state(self) -> DroneState:
        """State of the drone as last heard: mode, armed, failsafe, rig, battery."""
        return self.watcher.state

    @property
    def tick(self) -> int:
        """The drone's time as a number of control periods of 4 ms; in lockstep the next one to be run."""
        return self.clock.tick

    @property
    def messages(self) -> list[StatusText]:
        """The last 1000 lines of text (STATUSTEXT) from the drone."""
        return list(self.texts.lines)

    @property
    def battery(self) -> BatteryState:
        """Voltage [V] and charge, 0 to 1; NaN while unknown."""
        return self.state.battery

    @property
    def statistics(self) -> LinkStatistics:
        """Loss, round trips and rates of the link."""
        return self.session.connection.statistics

    @property
    def url(self) -> str:
        """URL of the link."""
        return self.session.url

    @property
    def theta(self) -> float:
        """The latest estimate of the pitch [rad]."""
        return self._estimate("theta")

    @property
    def q(self) -> float:
        """The latest estimate of the pitch rate [rad/s]."""
        return self._estimate("q")

    @property
    def x(self) -> float:
        """The latest estimate of the position along the rail [m]."""
        return self._estimate("x")

    @property
    def v(self) -> float:
        """The latest estimate of the velocity along the rail [m/s]."""
        return self._estimate("v")

    def _estimate(self, name: str) -> float:
        return float(self.telemetry(f"estimate.{name}").value)
