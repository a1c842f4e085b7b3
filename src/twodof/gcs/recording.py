"""Recording of a flight on the ground: every topic at full rate into MCAP, with a count of the lost rows."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LogError, RecordingError, Timeout
from twodof.flightlog import steps
from twodof.flightlog.append_only_file import Acknowledged
from twodof.flightlog.mcap_encoder import Attachment
from twodof.flightlog.mcap_stream import McapStream
from twodof.flightlog.recorder import Recorder
from twodof.flightlog.steps import BOOT, OpenLoopMessages, shift
from twodof.gcs.active_controller import ActiveController, ParameterChanges
from twodof.gcs.clock import OLDEST_TICKS, DroneClock
from twodof.gcs.drone_state import DroneState, StatusText
from twodof.gcs.full_rate import FullRateSubscription
from twodof.gcs.session import DroneSession, Handler
from twodof.gcs.telemetry import DECODERS, Decoded, columns_of
from twodof.link.mavlink.messages import batch_rows, channel_mask
from twodof.signals import TICK_S, TICK_US, TOPICS, Topic, topic

SAFETY = McapStream(
    "/safety",
    "twodof_msgs/msg/Safety",
    "safety",
    "",
    steps.SAFETY,
    3,
    about="what the failsafe does, and masks of causes",
)
MOST_TEXTS = 1000
TOGETHER = 32
"""Rows handed to the writer together: an eighth of a second, which a crash loses too."""
MOST_TRUTHS = 1024
"""True states remembered to find copies: four seconds."""
_EVENTS = "openloop"
_TOLD_BY = ("state.mode", "command.M", "command.T")
_LATEST_US = 1 << 52
_LATEST_S = 4e9
BATTERY_TICKS = 125
"""The battery's topics come at 2 Hz."""
# Position and velocity are first read in the step after their publication.
_READ_LATER = ("x", "v")


class Recording:
    """Recording of a flight: `samples` recorded, rows `lost` on the link, samples `dropped` because of a slow disk."""

    def __init__(
        self,
        path: str | Path,
        topics: Iterable[Topic],
        provenance: Mapping[str, object],
        wait: bool,
        flies: ActiveController | None = None,
        overwrite: bool = False,
    ) -> None:
        self.topics = tuple(topics)
        self.onboard = tuple(row for row in self.topics if row.onboard and row.name != _EVENTS)
        flies = flies or ActiveController(known=False)
        self._changes = ParameterChanges(flies)
        attached = [Attachment(f"{name}.json", "application/json", data) for name, data in flies.diagrams.items()]
        self.recorder = Recorder(
            path, [*self.topics, SAFETY], provenance, attached, full="wait" if wait else "drop", overwrite=overwrite
        )
        self.path = self.recorder.path
        self.texts: list[tuple[float, str, str]] = []
        self._with_events = any(row.name == _EVENTS for row in self.topics)
        self._waiting: list[Any] = []
        self._waiting_rows = 0
        self._seen: set[int] = set()
        self._first = self._last = -1
        self._rows = 0
        self._truths: dict[int, None] = {}  # times [us] of the true states that came last
        self._true: list[tuple[int, list[float]]] = []  # time [us] and state of those that wait
        self._true_fields = [row.name.split(".")[1] for row in self.topics if not row.onboard]
        self._open = OpenLoopMessages()
        self._names = frozenset(row.name for row in self.topics)
        self._time = 0.0  # the drone's time of the last telemetry [s]
        self._newest = 0  # tick of the drone
        self._shift = 0  # from the drone's ticks to those of the recording, which never go back

    @property
    def samples(self) -> int:
        """Number of samples recorded; those that are not acknowledged yet are in memory."""
        return self.recorder.accepted

    @property
    def acknowledged(self) -> Acknowledged:
        """The part on the disk, readable after a crash."""
        return self.recorder.acknowledged

    @property
    def dropped(self) -> dict[str, int]:
        """Number of samples dropped as the disk was too slow, by topic."""
        return self.recorder.dropped

    @property
    def failure(self) -> RecordingError | None:
        """The error that ended the recording, or None; `finish` raises it too."""
        return self.recorder.failure

    @property
    def lost(self) -> int:
        """Number of rows missing between the first tick and the last."""
        return self._last - self._first + 1 - self._rows if self._rows else 0

    def take(self, got: Any) -> None:
        """Add a TWODOF_BATCH."""
        self._newest = max(self._newest, got.tick + got.rows * got.every)
        self._waiting.append(got)
        self._waiting_rows += max(1, got.rows)  # an empty one takes memory too
        if self._waiting_rows >= TOGETHER:
            self.write()

    def rig(self, got: Any) -> None:
        """Handle a TWODOF_RIG: after a restart of the drone, let later stamps continue those recorded before."""
        if got.tick + OLDEST_TICKS <= self._newest:
            self.write()
            self._shift, self._newest, self._open = self._last + 1, got.tick, OpenLoopMessages()

    def write(self) -> None:
        """Hand the waiting rows to the writer."""
        waiting, self._waiting, self._waiting_rows = self._waiting, [], 0
        by_mask: dict[int, list[Any]] = {}
        for got in waiting:
            by_mask.setdefault(got.channels, []).append(got)
        for mask, some in by_mask.items():
            parts = [batch_rows(got) for got in some]
            ticks = np.concatenate([part[0] for part in parts]).astype(np.int64)
            values = np.concatenate([part[1] for part in parts]).astype(np.float64)
            self._write(columns_of(mask), *self._new(ticks, values))
        self._write_truth()

    def _write_truth(self) -> None:
        waiting, self._true = self._true, []
        if waiting:
            times = round(BOOT * 1e9) + 1000 * np.array([since for since, _ in waiting], dtype=np.int64)
            for field, values in zip(self._true_fields, np.array([states for _, states in waiting]).T, strict=True):
                self._put(f"truth.{field}", times, values)

    def _new(self, ticks: NDArray[np.int64], values: NDArray[np.float64]) -> tuple[Any, Any]:
        """Return the rows with new ticks."""
        ticks, first = np.unique(ticks + self._shift, return_index=True)
        fresh = np.array([tick not in self._seen for tick in ticks.tolist()], dtype=bool)
        ticks, values = ticks[fresh], values[first][fresh]
        if len(ticks):
            self._seen.update(ticks.tolist())
            self._rows += len(ticks)
            self._first = int(ticks[0]) if self._first < 0 else min(self._first, int(ticks[0]))
            self._last = max(self._last, int(ticks[-1]))
            if len(self._seen) > 4096:
                self._seen = {tick for tick in self._seen if tick > self._last - 2048}
        return ticks, values

    def _write(self, columns: Mapping[str, int], ticks: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        for row in self.onboard:
            places = [columns[column] for column in row.columns if column in columns]
            if len(places) != row.width:
                continue
            some = values[:, places]
            there = np.isfinite(some).all(axis=1)
            if row.name.startswith("battery."):
                there &= ticks % BATTERY_TICKS == 0
            if there.any():
                self._put(row.name, stamps(row.mat, ticks[there]), some[there])
        if self._with_events and all(name in columns for name in _TOLD_BY):
            sent, rows = self._open.sent(*(values[:, columns[name]] for name in _TOLD_BY))
            if len(rows):
                self._put(_EVENTS, stamps("lmnf", ticks[sent]), rows)

    def safety(self, got: Any) -> None:
        """Add a TWODOF_SAFETY."""
        values = np.array([safety_row(got)], dtype=np.float64)
        self._put(SAFETY.topic, stamps("", np.array([got.tick + self._shift], dtype=np.int64)), values)

    def truth(self, got: Any) -> None:
        """Add a TWODOF_TRUTH, unless it is a copy."""
        since = min(got.time_usec, _LATEST_US) + self._shift * TICK_US
        if since in self._truths:
            return
        self._truths[since] = None
        if len(self._truths) > MOST_TRUTHS:
            del self._truths[next(iter(self._truths))]
        self._true.append((since, [getattr(got, field) for field in self._true_fields]))
        if len(self._true) >= TOGETHER:
            self._write_truth()

    def telemetry(self, decode: Callable[[Any], Decoded], got: Any) -> None:
        """Add the samples of a message of MAVLink's `common` dialect, from a drone that sends no batches."""
        for name, time, value in decode(got):
            self._time = time if isfinite(time) else self._time  # the battery's messages have no stamp
            if name in self._names and self._time < _LATEST_S:
                at = np.array([round((BOOT + self._time) * 1e9)], dtype=np.int64)
                self._put(name, at, np.reshape(np.array(value, dtype=np.float64), (1, -1)))

    def _put(self, topic: str, times: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Hand samples to the writer; after an error of the disk they are left out, and `finish` raises it."""
        if self.recorder.failure is None:
            with suppress(RecordingError):
                self.recorder.write_many(topic, times, values)

    def add_text(self, tick: int, line: StatusText) -> None:
        """Add a line of text that the drone sent at `tick`."""
        if len(self.texts) < MOST_TEXTS:
            self.texts.append((self._seconds(tick), line.severity, line.text))

    def parameter(self, tick: int, got: Any) -> None:
        """Add a PARAM_VALUE, which the drone sends after each change."""
        self._changes.add(self._seconds(tick), got)

    def _seconds(self, tick: int) -> float:
        """Return the stamp [s] of a message that comes now; in lockstep samples are ahead of the clock."""
        return seconds(max(tick, self._newest) + self._shift)

    def finish(self) -> None:
        """Write the waiting rows, the number of lost rows and the texts, and close the file. Raises RecordingError."""
        try:
            self.write()
            if self._rows:  # telemetry without batches does not show what is missing
                self.recorder.note("lost", self.lost)
            self.recorder.note("texts", [list(row) for row in self.texts])
            self.recorder.note("changes", [list(row) for row in self._changes.rows])
        finally:
            self.recorder.close()


def safety_row(got: Any) -> tuple[int, int, int]:
    """Return a TWODOF_SAFETY as a row of the channel `safety`: action, mask of the deciding cause, mask of causes."""
    return got.action, 1 << got.reason if 0 <= got.reason < 32 else 0, got.flags


def seconds(tick: int) -> float:
    """Return the time stamp [s] of a tick in a log."""
    return round(BOOT + TICK_S * tick, 6)


def stamps(mat: str, ticks: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the time stamps [ns] that the drone's own log gives to samples of the channel `mat` at these ticks."""
    published = ticks - (mat in _READ_LATER)
    return np.asarray(np.rint((BOOT + shift(mat) + TICK_S * published) * 1e9), dtype=np.int64)


def chosen(topics: Iterable[str] | None, truth: bool, ours: bool = True) -> list[Topic]:
    """Return the TOPICS to record; None is all, with the true state if `truth`. Raises LogError for an unknown one.

    If the drone is not a twodof drone (`ours` False), only topics in messages of `common` exist.
    """
    if topics is None:
        return [row for row in TOPICS if (row.onboard or truth) and (ours or not row.mavlink.startswith("TWODOF_"))]
    rows = [topic(name) for name in topics]
    if not ours and (unknown := [row.name for row in rows if row.mavlink.startswith("TWODOF_")]):
        remedy = "leave it out; docs/how-to/connect-clients.md says what there is"
        raise LogError("only a twodof drone sends this topic", unknown[0], remedy)
    if not truth and (unknown := [row.name for row in rows if not row.onboard]):
        what = "the true state is known only to a ground station with a virtual drone"
        raise LogError(what, unknown[0], "leave it out")
    return rows


class RecordedDrone(Protocol):
    """Parts of a drone that a recording needs."""

    session: DroneSession
    clock: DroneClock
    batches: FullRateSubscription
    rig_truth: FullRateSubscription

    @property
    def state(self) -> DroneState:
        """State as last heard."""
        ...


@asynccontextmanager
async def record(
    drone: RecordedDrone,
    path: str | Path,
    topics: Iterable[str] | None,
    provenance: Mapping[str, object],
    flying: Callable[[], Awaitable[ActiveController]] | None,
    overwrite: bool,
) -> AsyncIterator[Recording]:
    """Record into a new file during the block: all samples of a twodof drone, or the messages of a plain PX4.

    `flying` reads the active controller of a twodof drone; None for a plain PX4. Raises LogError for an existing file
    or an unknown topic; RecordingError for an error of the disk; Rejected, LinkLost, Timeout.
    """
    ours, session, clock, rig = flying is not None, drone.session, drone.clock, drone.state.rig
    rows = chosen(topics, rig.virtual and not session.on_board, ours)
    about: dict[str, object] = {
        "autopilot": drone.state.autopilot,
        "rig": rig.name,
        "virtual": rig.virtual,
        "controller": rig.controller,
        "diagram": f"{rig.diagram:016x}",
        "seed": rig.seed,
        "url": session.url,
        "system": session.system,
        "lockstep": rig.lockstep,
    }
    given = {"drone": about, **provenance}
    flies = ActiveController(known=False)
    if flying is not None:
        with suppress(Timeout):  # the recording goes on without it
            flies = await flying()
    told = given["drone"]
    given["drone"] = {**(told if isinstance(told, dict) else {}), **flies.provenance()}
    recording = Recording(path, rows, given, session.lockstep, flies, overwrite)
    handlers: dict[str | type, Handler] = {
        StatusText: lambda line: recording.add_text(clock.tick, line),
        "TWODOF_RIG": recording.rig,
        "TWODOF_SAFETY": recording.safety,
        "PARAM_VALUE": lambda got: recording.parameter(clock.tick, got),
    }
    if not ours:
        handlers |= {name: partial(recording.telemetry, decode) for name, decode in DECODERS.items()}
    begun = False
    try:
        async with AsyncExitStack() as stack:
            for name, handler in handlers.items():
                stack.enter_context(session.handling(handler, name))
            if any(not row.onboard for row in rows):
                await stack.enter_async_context(drone.rig_truth.to(recording.truth))
            columns = [column for row in recording.onboard for column in row.columns]
            if ours and columns:
                await stack.enter_async_context(drone.batches.to(recording.take, channel_mask(columns)))
            begun = True
            yield recording
    finally:
        # Another thread waits for the writer's, so that heartbeats go on.
        await asyncio.to_thread(recording.finish)
        if not begun and not recording.samples:  # the drone sent no sample, and the caller has not got the file
            recording.path.unlink(missing_ok=True)
