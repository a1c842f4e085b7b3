"""PX4's logs (ULog) as flight logs: pyulog reads the records, a table says which field becomes which channel."""

import re
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from io import BytesIO, StringIO
from types import MappingProxyType
from typing import Any

import numpy as np
import pyulog
from numpy.typing import NDArray
from pyulog.exceptions import ULogException

from twodof.errors import LogError
from twodof.flightlog import provenance
from twodof.flightlog.log import Channel, FlightLog, sanitise
from twodof.flightlog.provenance import RECOVER, Loss, noted
from twodof.flightlog.steps import ASKED, BOOT, STEP_TOPIC, safety_channel, step_channels
from twodof.flightlog.ulog_writer import HEADER, LETTERS, MAGIC, MARK, MESSAGE, OWN
from twodof.signals import BY_MAT, PERIOD, SEVERITIES, TOPICS

_Rows = NDArray[np.void]
_Values = Callable[[_Rows], NDArray[np.float64]]

MAX_OWN_FIELDS = 1000
MAX_LOST = 5000
# In the information of our own logs, which have a mark at the end of each part that reached the disk.
_MARKED = b"\x10char[6] sys_nametwodof"
_ELEMENT = re.compile(r"(.+)\[(\d+)\]")
# The byte with the flag that data was appended, at offsets that the message holds.
_FLAGS_AT = HEADER.size + MESSAGE.size + 8


@dataclass(frozen=True)
class Logged:
    """Records of one topic: `rows` is a table with a column for each field."""

    name: str
    instance: int
    rows: NDArray[np.void]


@dataclass
class ULogContents:
    """Contents of a ULog file.

    `parameters` are those at the start; `changes` (time of the last record before it [us], name, value) later ones.
    `texts` are (level, time [us], text). `dropouts_ms` are the times that the logger could not write. `lost` lists the
    damaged parts; `finished` is False if there are any.
    """

    start_us: int = 0
    info: dict[str, Any] = field(default_factory=dict)
    parameters: dict[str, float] = field(default_factory=dict)
    changes: list[tuple[int, str, float]] = field(default_factory=list)
    topics: list[Logged] = field(default_factory=list)
    texts: list[tuple[int, int, str]] = field(default_factory=list)
    dropouts_ms: list[int] = field(default_factory=list)
    lost: list[Loss] = field(default_factory=list)
    formats: tuple[str, ...] = ()
    finished: bool = True

    def topic(self, name: str, instance: int = 0) -> Logged | None:
        """Return the records of a topic; None where it was not logged."""
        return next((one for one in self.topics if (one.name, one.instance) == (name, instance)), None)


def decode_ulog(data: bytes, where: str) -> FlightLog:
    """Return the log in the bytes of a ULog file of PX4 or of the virtual flight controller.

    The time of a sample is its `timestamp_sample` where the topic has one, else its `timestamp`. A module that `twodof
    px4 export` made gives a channel for each of its signals, such as `twodof_mine_out_m`. The provenance counts in
    "left_out" the samples that are not finite or repeat a stamp. Its "ignored" names topics that do not become a
    channel, and "lost_bytes" is the size of a last message that was cut off. A log of the virtual flight controller has
    the channels, stamps and bits of the log of a simulated flight, without the ground truth. It also has `safety`, the
    actions of the failsafe and their causes. Raises LogError for a file that is damaged or no ULog.
    """
    return ulog_to_log(scan_ulog(data, where), provenance.of_file(where, data, "ulog"), where)


def scan_ulog(data: bytes, where: str, salvage: bool = False) -> ULogContents:
    """Return the contents of a ULog file; a last message that is cut off, the rule on a drone, is named in `lost`.

    Raises LogError for a file that is no ULog and, without `salvage`, for any other damage.
    """
    if data[: len(MAGIC)] != MAGIC or len(data) < HEADER.size:
        raise LogError("is no ULog file", where, "give a log of PX4 or of the virtual flight controller")
    if data[len(MAGIC)] > 1:
        raise LogError(f"is of ULog version {data[len(MAGIC)]}", where, "version 1 is read")
    found = ULogContents()
    sound = bytearray(data[: HEADER.size])
    for start, end in _stretches(data, where, salvage, found):
        sound += data[start:end]
    if found.lost and len(sound) > _FLAGS_AT:
        sound[_FLAGS_AT] &= 0xFE  # the offsets of appended data no longer hold
    try:
        with redirect_stdout(StringIO()):
            theirs = pyulog.ULog(BytesIO(sound))
    except ULogException as reason:
        raise LogError(f"cannot be read: {reason}", where, "use a newer twodof") from reason
    except (ArithmeticError, LookupError, RecursionError, TypeError, ValueError, struct.error) as reason:
        raise LogError(f"a description in it is damaged: {reason!s:.200}", where, RECOVER) from reason
    if theirs.file_corruption:
        what = "a message is not described, or is not as long as its description says"
        if not salvage:
            raise LogError(what, where, RECOVER)
        found.finished = False
        found.lost.append(Loss(0, 0, what))
    _take(found, theirs)
    return found


def _stretches(data: bytes, where: str, salvage: bool, found: ULogContents) -> Iterator[tuple[int, int]]:
    """Yield the parts of the file whose messages follow each other without a break; list the others as lost."""
    size = len(data)
    start = at = HEADER.size
    synced, marked = 0, False
    while at < size:
        length, letter = MESSAGE.unpack_from(data, at) if size - at >= MESSAGE.size else (size, 0)
        after = at + MESSAGE.size + length
        if after <= size and letter in LETTERS:
            if letter == 0x53:  # S: a mark
                synced = after
            elif letter == 0x49:  # I: information
                marked = marked or data[at + MESSAGE.size : after] == _MARKED
            at = after
            continue
        # A tail that is only cut is the rule with logs on a flight controller; the messages before it are whole.
        cut = at + MESSAGE.size > size or letter in LETTERS
        if not cut and not salvage:
            raise LogError(f"no message at byte {at}", where, RECOVER)
        resume = data.find(MARK, at) if salvage else size
        resume = size if resume < 0 else resume
        # Between the last mark and rubbish no message can be trusted. In a log of others that just ends, all before
        # its end is taken; in our own nothing behind the last mark was acknowledged.
        ends = cut and resume == size
        sound = at if (ends and not marked) or not synced else max(synced, start)
        if sound > start:
            yield start, sound
        found.finished = False
        found.lost.append(Loss(sound, resume - sound, "the last message is cut off" if ends else "rubbish"))
        if len(found.lost) > MAX_LOST:
            raise LogError(f"more than {MAX_LOST} damaged parts", where, "nothing can be trusted in it")
        start = at = resume
    if min(at, size) > start:
        yield start, at


def _take(found: ULogContents, theirs: Any) -> None:
    """Take over what pyulog has read."""
    found.start_us = theirs.start_timestamp
    found.info = {name: value for name, value in theirs.msg_info_dict.items() if not isinstance(value, bytes)}
    found.parameters = dict(theirs.initial_parameters)
    found.changes = [*theirs.changed_parameters]
    tagged = [one for every in theirs.logged_messages_tagged.values() for one in every]
    found.texts = [(one.log_level, one.timestamp, one.message) for one in (*theirs.logged_messages, *tagged)]
    found.dropouts_ms = [one.duration for one in theirs.dropouts]
    found.topics = [Logged(one.name, one.multi_id, _rows(one.data)) for one in theirs.data_list]
    found.formats = tuple(theirs.message_formats)


def _rows(columns: Mapping[str, NDArray[Any]]) -> NDArray[np.void]:
    """Return a table of pyulog's columns, in which the elements of an array, `xyz[0]` and so on, are one column."""
    parts: dict[str, list[NDArray[Any]]] = {}
    arrays = set()
    for name, column in columns.items():
        match = _ELEMENT.fullmatch(name)
        parts.setdefault(match[1] if match else name, []).append(column)
        if match:
            arrays.add(match[1])
    fields = [
        (name, some[0].dtype, (len(some),)) if name in arrays else (name, some[0].dtype) for name, some in parts.items()
    ]
    rows = np.empty(len(next(iter(columns.values()))), dtype=fields)
    for name, some in parts.items():
        rows[name] = np.stack(some, axis=1) if name in arrays else some[0]
    return rows


def _field(name: str) -> _Values:
    return lambda rows: rows[name].astype(np.float64)


def _item(name: str, index: int) -> _Values:
    return lambda rows: rows[name][:, index].astype(np.float64)


def _opposite(name: str, index: int) -> _Values:
    # Not negated, so that thrust 0 is not written as -0.
    return lambda rows: 0.0 - rows[name][:, index].astype(np.float64)


def _pitch(name: str) -> _Values:
    """Return the pitch of a quaternion (w, x, y, z); its sine is kept in its range against rounding."""

    def pitch(rows: _Rows) -> NDArray[np.float64]:
        w, x, y, z = rows[name].astype(np.float64).T
        return np.asarray(np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)))

    return pitch


_SAFETY = ("action", "reason", "causes")
"""The fields of the channel `safety` in a step's row."""

# Of several sources, the first that the log has; the later ones are of older PX4 versions. The rail is PX4's local
# x axis, as for the modules that `twodof px4 export` makes.
PX4_SOURCES: Mapping[str, tuple[tuple[str, _Values], ...]] = MappingProxyType(
    {
        "acc": (("sensor_combined", _field("accelerometer_m_s2")), ("vehicle_acceleration", _field("xyz"))),
        "gyr": (("sensor_combined", _field("gyro_rad")),),
        "dist": (("distance_sensor", _field("current_distance")),),
        "theta": (("vehicle_attitude", _pitch("q")),),
        "q": (("vehicle_angular_velocity", _item("xyz", 1)),),
        "x": (("vehicle_local_position", _field("x")),),
        "v": (("vehicle_local_position", _field("vx")),),
        "theta0": (("vehicle_attitude_setpoint", _pitch("q_d")),),
        "q0": (("vehicle_rates_setpoint", _field("pitch")),),
        "x0": (
            ("vehicle_local_position_setpoint", _field("x")),
            ("trajectory_setpoint", _item("position", 0)),
        ),
        "v0": (
            ("vehicle_local_position_setpoint", _field("vx")),
            ("trajectory_setpoint", _item("velocity", 0)),
        ),
        "thrust0": (("vehicle_thrust_setpoint", _item("xyz", 2)), ("actuator_controls_0", _opposite("control", 3))),
        "M": (("vehicle_torque_setpoint", _item("xyz", 1)), ("actuator_controls_0", _item("control", 1))),
        "T": (("vehicle_thrust_setpoint", _opposite("xyz", 2)), ("actuator_controls_0", _item("control", 3))),
        "voltage": (("battery_status", _field("voltage_v")),),
        "charge": (("battery_status", _field("remaining")),),
    }
)
"""The topic of PX4, and the value of its records, of each channel."""


def ulog_to_log(found: ULogContents, file: dict[str, Any], where: str) -> FlightLog:
    """Return the channels of a log. Raises LogError if none of its topics becomes one."""
    channels: dict[str, Channel] = {}
    counts: dict[str, dict[str, int]] = {}
    used = set()
    own = found.info.get("sys_name") == OWN
    steps = found.topic(STEP_TOPIC) if own else None
    rows = _own_topics(found) if own else {**_px4_topics(found), **_modules(found)}
    if steps is not None and len(steps.rows):
        channels, rows = _of_steps(steps, where), {}
        used = {one.name for one in found.topics}
    for name, (logged, value) in rows.items():
        if not len(logged.rows) or "timestamp" not in (logged.rows.dtype.names or ()):
            continue
        known = BY_MAT.get(name)
        unit, fields = (known.unit, known.fields) if known else ("", ())
        try:
            # A NaN or infinity in a quaternion is no pitch: such samples are counted below.
            with np.errstate(invalid="ignore", over="ignore"):
                values = value(logged.rows)
        except (ValueError, IndexError, TypeError):
            continue  # of a PX4 that lays this topic out differently: it is named among those ignored
        if values.ndim > 2 or (known and values[:1].size != known.width):
            continue
        used.add(logged.name)
        time = _stamps(logged.rows)
        channel, counts[name] = sanitise(time, values, unit, fields, f"{where}: {name}")
        if len(channel):
            channels[name] = channel
    if not channels:
        there = ", ".join(sorted({*found.formats})[:20]) or "none"
        remedy = "log those that docs/reference/logs.md names"
        raise LogError(f"no topic in it becomes a channel; topics: {there}", where, remedy)
    kept: dict[str, Any] = {
        "ulog": {"start_s": found.start_us / 1e6, "info": {name: _plain(one) for name, one in found.info.items()}}
    }
    kept["parameters"] = {name: _plain(value) for name, value in found.parameters.items()}
    if own and found.changes:
        kept["changes"] = [[_on_board(stamp), name, _plain(value)] for stamp, name, value in found.changes]
    if own and found.texts:
        severities = dict(zip(range(ord("0"), 256), SEVERITIES, strict=False))
        texts = found.texts[:MAX_OWN_FIELDS]
        kept["texts"] = [[_on_board(stamp), severities.get(level, "info"), text] for level, stamp, text in texts]
    ignored = sorted({one.name for one in found.topics} - used)
    if ignored:
        kept["ignored"] = ignored
    if found.dropouts_ms:
        kept["dropouts"] = {"count": len(found.dropouts_ms), "total_s": sum(found.dropouts_ms) / 1e3}
    if found.lost:
        kept["lost_bytes"] = sum(loss.size for loss in found.lost)
    return FlightLog(channels, {**noted(kept, counts), "file": file})


def _on_board(stamp_us: int) -> float:
    """Return a stamp of our own flight controller's log on the clock of its channels [s]."""
    return round(BOOT + stamp_us / 1e6, 6)


def _px4_topics(found: ULogContents) -> dict[str, tuple[Logged, _Values]]:
    rows = {}
    for channel, sources in PX4_SOURCES.items():
        for topic, value in sources:
            logged = found.topic(topic)
            if logged is not None and len(logged.rows):
                rows[channel] = (logged, value)
                break
    return rows


def _modules(found: ULogContents) -> dict[str, tuple[Logged, _Values]]:
    """Return the signals of modules made by `twodof px4 export`: inputs, outputs and logged ones."""
    rows: dict[str, tuple[Logged, _Values]] = {}
    for logged in found.topics:
        if not logged.name.startswith("twodof_") or logged.instance:
            continue
        for name in (logged.rows.dtype.names or ())[:MAX_OWN_FIELDS]:
            if name.startswith(("in_", "out_", "log_")) and logged.rows.dtype[name].base.kind in "biuf":
                rows[f"{logged.name}_{name}"] = (logged, _field(name))
    return rows


def _own_topics(found: ULogContents) -> dict[str, tuple[Logged, _Values]]:
    rows = {}
    for topic in TOPICS:
        logged = found.topic(topic.name.replace(".", "_"))
        names = topic.fields or ("value",)
        if logged is not None and {"timestamp", *names} <= set(logged.rows.dtype.names or ()):
            rows[topic.mat] = (logged, _columns(names))
    return rows


def _of_steps(steps: Logged, where: str) -> dict[str, Channel]:
    """Return the channels of a log that has every step; its other topics repeat them in PX4's layout."""
    ticks = steps.rows["tick"].astype(np.int64) if "tick" in (steps.rows.dtype.names or ()) else np.empty(0, np.int64)
    # A tick that comes twice is of a file that was damaged: the first stays.
    rising = np.append(True, ticks[1:] > np.maximum.accumulate(ticks)[:-1]) if len(ticks) else np.empty(0, np.bool_)
    rows = steps.rows[rising] if len(ticks) else steps.rows[:0]
    out = {name: rows[name] for name in rows.dtype.names or ()}
    try:
        channels = step_channels(ticks[rising], out, rows[f"{ASKED}mode"].astype(np.int32))
        return channels | _safety(ticks[rising], rows)
    except (KeyError, ValueError, TypeError) as reason:
        what = f"{STEP_TOPIC} is not laid out as it is now: {reason}"
        raise LogError(what, where, "read it with the twodof that wrote it") from reason


def _safety(ticks: NDArray[np.int64], rows: _Rows) -> dict[str, Channel]:
    """Return the actions of the failsafe and their causes (flight.causes), at each change and once a second."""
    if not {*_SAFETY} <= set(rows.dtype.names or ()):
        return {}
    values = np.column_stack([rows[name].astype(np.float64) for name in _SAFETY])
    changed = np.append(True, (np.diff(values, axis=0) != 0.0).any(axis=1)) if len(values) else np.empty(0, np.bool_)
    logged = changed | (ticks % round(1.0 / PERIOD) == 0)
    return {"safety": safety_channel(ticks[logged], values[logged])}


def _columns(names: tuple[str, ...]) -> _Values:
    if len(names) == 1:
        return _field(names[0])
    return lambda rows: np.stack([rows[name].astype(np.float64) for name in names], axis=1)


def _stamps(rows: _Rows) -> NDArray[np.float64]:
    """Return the time of each sample [s]: that of its measurement, where the topic has it."""
    stamp = rows["timestamp"]
    if "timestamp_sample" in (rows.dtype.names or ()):
        stamp = np.where(rows["timestamp_sample"] > 0, rows["timestamp_sample"], stamp)
    return np.asarray(stamp, dtype=np.float64) / 1e6


def _plain(value: Any) -> Any:
    """Return a value that JSON can hold: a NaN or infinity becomes text."""
    numbers = value if isinstance(value, list) else [value]
    return value if all(np.isfinite(one) for one in numbers if isinstance(one, float)) else repr(value)
