"""PX4's logs (ULog) as flight logs, and back. pyulog reads the records; a table has the fields of each channel."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pyulog
from numpy.typing import NDArray

from twodof.errors import LogError
from twodof.flightlog import provenance
from twodof.flightlog.log import MAX_CHANNELS, Channel, FlightLog, near_the_others, sanitise
from twodof.flightlog.provenance import RECOVER, Loss, noted
from twodof.flightlog.steps import ASKED, BOOT, STEP_TOPIC, safety_channel, step_channels
from twodof.flightlog.ulog_writer import HEADER, LETTERS, LEVELS, MAGIC, MARK, MESSAGE, OWN, ULogWriter, topic_format
from twodof.signals import BY_MAT, OFF, OPEN_LOOP, PERIOD, RATE, SEVERITIES, TOPICS

_PARAMETER = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,15}")
_LAST_US = 2.0**63
_PIECE = 10_000
"""Records handed over at once: the writer takes no more than fit into its queue."""
MAX_TEXTS = 1000
MAX_LOST = 5000
# In the information of our own logs, which have a mark at the end of each part that reached the disk.
_MARKED = b"\x10char[6] sys_nametwodof"
# The byte with the flag that data was appended, at offsets that the message holds.
_FLAGS_AT = HEADER.size + MESSAGE.size + 8
_MODULE_FIELD = re.compile("(in|out|log)_.*")

Columns = Mapping[str, NDArray[Any]]
"""The records of a topic: the values (n,) of each field, of an array those of each element, `xyz[1]`."""


@dataclass
class ULogContents:
    """Contents of a ULog file.

    `topics` are columns by name and instance. `parameters` are those at the start, `changes` the later changes (time of
    the last record before [us], name, value). `texts` are (level, time [us], text). `dropouts_ms` are the times for
    which the logger could not write. `lost` lists the damaged parts.
    """

    start_us: int = 0
    info: dict[str, Any] = field(default_factory=dict)
    parameters: dict[str, float] = field(default_factory=dict)
    changes: list[tuple[int, str, float]] = field(default_factory=list)
    topics: dict[tuple[str, int], Columns] = field(default_factory=dict)
    texts: list[tuple[int, int, str]] = field(default_factory=list)
    dropouts_ms: list[int] = field(default_factory=list)
    lost: list[Loss] = field(default_factory=list)
    formats: tuple[str, ...] = ()

    @property
    def finished(self) -> bool:
        """Return True if nothing is lost."""
        return not self.lost

    def topic(self, name: str) -> Columns | None:
        """Return the records of the first instance of a topic; None where it was not logged."""
        return self.topics.get((name, 0))


def decode_ulg(data: bytes, where: str) -> FlightLog:
    """Return the log in the bytes of a ULog file of PX4 or of the virtual flight controller.

    The time of a sample is its `timestamp_sample` where the topic has one, else its `timestamp`. A module that `twodof
    px4 export` made gives a channel for each of its signals, such as `twodof_mine_out_m`. The provenance counts in
    "left_out" the samples that are not finite, repeat a stamp, or have a stamp hours from all others ("far_off"). Its
    "ignored" names topics that do not become a channel, and "lost_bytes" is the size of a last message that was cut
    off. A log of the virtual flight controller has the channels, stamps and bits of the log of a simulated flight,
    without the ground truth. It also has `safety`, the actions of the failsafe and their causes. Raises LogError for a
    file that is damaged or no ULog.
    """
    return ulog_to_log(scan_ulog(data, where), provenance.of_file(where, data, "ulog"), where)


def decode_ulg_topics(data: bytes, where: str) -> FlightLog:
    """Return the log as `decode_ulg` does, with a channel `TOPIC/FIELD` for each numeric field of each topic as well.

    `TOPIC.1` is the second instance of a topic. At most MAX_CHANNELS channels are returned. Raises LogError.
    """
    found = scan_ulog(data, where)
    log = ulog_to_log(found, provenance.of_file(where, data, "ulog"), where)
    times = [_stamps(columns) for columns in found.topics.values()]
    channels = dict(log.channels)
    for ((topic, instance), columns), time, rows in zip(
        found.topics.items(), times, near_the_others(times), strict=True
    ):
        for name, values in columns.items():
            field = f"{topic}.{instance}/{name}" if instance else f"{topic}/{name}"
            told = values.dtype.kind in "biuf" and not re.match(r"timestamp|.*_padding\d", name)
            if told and len(channels) < MAX_CHANNELS:
                numbers = values[rows].astype(np.float64)
                channels[field], _ = sanitise(time[rows], numbers, "", (), f"{where}: {field}")
    return FlightLog(channels, log.provenance)


def scan_ulog(data: bytes, where: str, salvage: bool = False) -> ULogContents:
    """Return the contents of a ULog file; a last message that is cut off, the rule on a drone, is named in `lost`.

    Raises LogError for a file that is no ULog and, without `salvage`, for any other damage.
    """
    if data[: len(MAGIC)] != MAGIC or len(data) < HEADER.size:
        raise LogError("is not a ULog file", where, "give a log of PX4 or of the virtual flight controller")
    if data[len(MAGIC)] > 1:
        raise LogError(f"has the ULog version {data[len(MAGIC)]}", where, "give a log of version 1")
    found = ULogContents()
    sound = bytearray(data[: HEADER.size])
    for start, end in _stretches(data, where, salvage, found):
        sound += data[start:end]
    if found.lost and len(sound) > _FLAGS_AT:
        sound[_FLAGS_AT] &= 0xFE  # the offsets of appended data no longer hold
    theirs = pyulog.ULog(BytesIO(sound))
    if theirs.file_corruption:
        what = "a message is not described, or is not as long as its description says"
        if not salvage:
            raise LogError(what, where, RECOVER)
        found.lost.append(Loss(0, 0, what))
    tagged = [one for every in theirs.logged_messages_tagged.values() for one in every]
    found.start_us = theirs.start_timestamp
    found.info = {name: value for name, value in theirs.msg_info_dict.items() if not isinstance(value, bytes)}
    found.parameters = dict(theirs.initial_parameters)
    found.changes = [*theirs.changed_parameters]
    found.texts = [(one.log_level, one.timestamp, one.message) for one in (*theirs.logged_messages, *tagged)]
    found.dropouts_ms = [one.duration for one in theirs.dropouts]
    for one in sorted(theirs.data_list, key=lambda one: one.msg_id):
        # A topic that was subscribed to again, under another number, goes on.
        before = found.topics.get((one.name, one.multi_id))
        joined = before and {name: np.append(before[name], column) for name, column in one.data.items()}
        found.topics[one.name, one.multi_id] = joined or one.data
    found.formats = tuple(theirs.message_formats)
    return found


def _stretches(data: bytes, where: str, salvage: bool, found: ULogContents) -> Iterator[tuple[int, int]]:
    """Yield the sound parts of the file, as (start, end); list the parts between them as lost."""
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
        found.lost.append(Loss(sound, resume - sound, "the last message is cut off" if ends else "rubbish"))
        if len(found.lost) > MAX_LOST:
            raise LogError(
                f"more than {MAX_LOST} damaged parts", where, "copy the file again from where it was recorded"
            )
        start = at = resume
    if min(at, size) > start:
        yield start, at


_SAFETY = ("action", "reason", "causes")
"""The fields of the channel `safety` in a step's row."""


def _elements(name: str, count: int) -> tuple[str, ...]:
    return tuple(f"{name}[{k}]" for k in range(count))


# Of several sources, the first that the log has; the later ones are of older PX4 versions. The rail is PX4's local
# x axis, as for the modules that `twodof px4 export` makes.
PX4_SOURCES: Mapping[str, tuple[tuple[str, tuple[str, ...]], ...]] = MappingProxyType(
    {
        "acc": (("sensor_combined", _elements("accelerometer_m_s2", 3)), ("vehicle_acceleration", _elements("xyz", 3))),
        "gyr": (("sensor_combined", _elements("gyro_rad", 3)),),
        "dist": (("distance_sensor", ("current_distance",)),),
        "theta": (("vehicle_attitude", _elements("q", 4)),),
        "q": (("vehicle_angular_velocity", ("xyz[1]",)),),
        "x": (("vehicle_local_position", ("x",)),),
        "v": (("vehicle_local_position", ("vx",)),),
        "theta0": (("vehicle_attitude_setpoint", _elements("q_d", 4)),),
        "q0": (("vehicle_rates_setpoint", ("pitch",)),),
        "x0": (("vehicle_local_position_setpoint", ("x",)), ("trajectory_setpoint", ("position[0]",))),
        "v0": (("vehicle_local_position_setpoint", ("vx",)), ("trajectory_setpoint", ("velocity[0]",))),
        "thrust0": (("vehicle_thrust_setpoint", ("xyz[2]",)), ("actuator_controls_0", ("-control[3]",))),
        "M": (("vehicle_torque_setpoint", ("xyz[1]",)), ("actuator_controls_0", ("control[1]",))),
        "T": (("vehicle_thrust_setpoint", ("-xyz[2]",)), ("actuator_controls_0", ("control[3]",))),
        "voltage": (("battery_status", ("voltage_v",)),),
        "charge": (("battery_status", ("remaining",)),),
    }
)
"""The topic of PX4, and the fields, of each channel; a sign before a field negates it, and four are a quaternion."""


_LOOPS = ("rates", "attitude", "velocity", "position")
"""Loops of PX4 from the inner to the outer one, as its `vehicle_control_mode` names them: the modes from RATE on."""


def _px4_modes(found: ULogContents) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return stamps and modes (n,) as indices into `signals.MODES`, by the outermost loop that PX4 closes."""
    columns = found.topic("vehicle_control_mode") or {}
    flags = [f"flag_control_{loop}_enabled" for loop in _LOOPS]
    if not {"timestamp", "flag_armed", *flags} <= columns.keys():
        return None
    closed = np.stack([columns[flag] != 0 for flag in flags])
    mode = np.max(closed * np.arange(RATE, RATE + len(flags))[:, None], axis=0, initial=OPEN_LOOP)
    return _stamps(columns), np.where(columns["flag_armed"] != 0, mode, OFF).astype(np.float64)


def _values(columns: Columns, fields: Sequence[str]) -> NDArray[np.float64]:
    """Return the values (n,) or (n, k) of a channel, of a quaternion (w, x, y, z) its pitch."""
    # Not negated, so that thrust 0 is not written as -0.
    parts = [0.0 - columns[name[1:]] if name.startswith("-") else columns[name] for name in fields]
    table = np.stack([np.asarray(part, dtype=np.float64) for part in parts], axis=1)
    if len(fields) != 4:
        return table[:, 0] if len(fields) == 1 else table
    w, x, y, z = table.T
    # The sine is kept in its range against rounding. A NaN or infinity is no pitch: `sanitise` counts it.
    with np.errstate(invalid="ignore", over="ignore"):
        return np.asarray(np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)))


def ulog_to_log(found: ULogContents, file: dict[str, Any], where: str) -> FlightLog:
    """Return the flight log in the contents of a ULog file. Raises LogError if no topic becomes a channel."""
    channels: dict[str, Channel] = {}
    counts: dict[str, dict[str, int]] = {}
    used = set()
    own = found.info.get("sys_name") == OWN
    steps = found.topic(STEP_TOPIC) if own else None
    if steps is not None:
        channels = _of_steps(steps, where)
        used = {name for name, _ in found.topics}
    rows: dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]] = {}
    for name, topic, fields in () if steps is not None else _own_topics() if own else _px4_topics(found):
        columns = found.topic(topic)
        if columns is None or not {"timestamp", *(one.removeprefix("-") for one in fields)} <= columns.keys():
            continue  # of a PX4 that lays this topic out differently: it is named among those ignored
        used.add(topic)
        rows[name] = _stamps(columns), _values(columns, fields)
    if not own and (modes := _px4_modes(found)):
        used.add("vehicle_control_mode")
        rows["mode"] = modes
    near = near_the_others([stamps for stamps, _ in rows.values()])
    for (name, (stamps, values)), kept_rows in zip(rows.items(), near, strict=True):
        if found.start_us:  # 0 is no time then
            kept_rows &= stamps > 0.0
        known = BY_MAT.get(name)
        unit, names = (known.unit, known.fields) if known else ("", ())
        channel, left_out = sanitise(stamps[kept_rows], values[kept_rows], unit, names, f"{where}: {name}")
        far = {"far_off": int(np.sum(~kept_rows))} if not kept_rows.all() else {}
        counts[name] = far | left_out
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
        texts = found.texts[:MAX_TEXTS]
        kept["texts"] = [[_on_board(stamp), severities.get(level, "info"), text] for level, stamp, text in texts]
    ignored = sorted({name for name, _ in found.topics} - used)
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


def _own_topics() -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Yield channel, topic and fields of each signal in a log of the virtual flight controller."""
    for topic in TOPICS:
        yield topic.mat, topic.name.replace(".", "_"), topic.fields or ("value",)


def _px4_topics(found: ULogContents) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Yield channel, topic and fields of what PX4 logged, and of modules made by `twodof px4 export`."""
    for channel, sources in PX4_SOURCES.items():
        there = [(topic, fields) for topic, fields in sources if found.topic(topic) is not None]
        if there:
            yield channel, *there[0]
    for (topic, instance), columns in found.topics.items():
        if topic.startswith("twodof_") and not instance:
            fields = [name for name in columns if _MODULE_FIELD.fullmatch(name) and columns[name].dtype.kind in "biuf"]
            yield from ((f"{topic}_{name}", topic, (name,)) for name in fields)


def _of_steps(steps: Columns, where: str) -> dict[str, Channel]:
    """Return the channels of a log that has every step; its other topics repeat them in PX4's layout."""
    try:
        ticks = steps["tick"].astype(np.int64)
        # A tick that is far off, or comes twice, is of a file that was damaged: of two the first stays.
        kept = np.flatnonzero(near_the_others([np.asarray(PERIOD * ticks)])[0])
        kept = kept[np.append(True, ticks[kept][1:] > np.maximum.accumulate(ticks[kept])[:-1])[: kept.size]]
        ticks, out = ticks[kept], {name: column[kept] for name, column in steps.items()}
        channels = step_channels(ticks, out, out[f"{ASKED}mode"].astype(np.int32))
        return channels | _safety(ticks, out)
    except (KeyError, ValueError, TypeError) as reason:
        what = f"{STEP_TOPIC} is not laid out as it is now: {reason}"
        raise LogError(what, where, "read it with the twodof that wrote it") from reason


def _safety(ticks: NDArray[np.int64], out: Columns) -> dict[str, Channel]:
    """Return the actions of the failsafe and their causes (flight.causes), at each change and once a second."""
    if not {*_SAFETY} <= out.keys():
        return {}
    values = np.column_stack([out[name].astype(np.float64) for name in _SAFETY])
    changed = np.append(True, (np.diff(values, axis=0) != 0.0).any(axis=1))
    logged = changed | (ticks % round(1.0 / PERIOD) == 0)
    return {"safety": safety_channel(ticks[logged], values[logged])}


def _stamps(columns: Columns) -> NDArray[np.float64]:
    """Return the time of each sample [s]: that of its measurement, where the topic has it."""
    stamp = columns["timestamp"]
    sampled = columns.get("timestamp_sample", stamp)
    return np.where(sampled > 0, sampled, stamp).astype(np.float64) / 1e6


def _plain(value: Any) -> Any:
    """Return a value that JSON can hold: a NaN or infinity becomes text."""
    numbers = value if isinstance(value, list) else [value]
    return value if all(np.isfinite(one) for one in numbers if isinstance(one, float)) else repr(value)


def write_ulg(log: FlightLog, path: str | Path) -> tuple[str, ...]:
    """Write a log into a new ULog file; return the names of the channels left out because they are not in TOPICS.

    Stamps are rounded to microseconds. Texts and the parameters at the start are written too. Raises LogError for a log
    without a signal of TOPICS, for a time before 0 and for a file that exists, RecordingError when the disk refuses.
    """
    topics = {name: BY_MAT[name] for name in log if name in BY_MAT and len(log[name])}
    if not topics:
        raise LogError("no channel is a signal of twodof", log.source, "write .mcap, .mat or .parquet")
    start, end = log.span
    if start < 0.0 or end * 1e6 >= _LAST_US:
        what = f"times from {start:g} to {end:g} s are out of range"
        raise LogError(what, log.source, "shift the time: ULog counts microseconds from 0")
    formats = dict(topic_format(topic) for topic in topics.values())
    parameters = _parameters(log.provenance)
    with ULogWriter(path, formats, {"sys_uuid": "exported"}, parameters, round(1e6 * start), full="wait") as writer:
        for name, topic in topics.items():
            channel = log[name]
            record = topic.name.replace(".", "_")
            rows = np.zeros(len(channel), dtype=writer.layout(record))
            rows["timestamp"] = np.rint(1e6 * channel.time).astype(np.uint64)
            values = channel.value if channel.value.ndim == 2 else channel.value[:, None]
            for place, field in enumerate(topic.fields or ("value",)):
                rows[field] = values[:, place]
            for first in range(0, len(rows), _PIECE):
                writer.write_many(record, rows[first : first + _PIECE])
        for time, severity, text in _texts(log.provenance):
            writer.text(severity, max(0, round(1e6 * (time - BOOT))), text)
    return tuple(name for name in log if name not in topics)


def _parameters(told: Mapping[str, Any]) -> dict[str, float]:
    rows = told.get("parameters")
    known = rows.items() if isinstance(rows, dict) else ()
    return {name: value for name, value in known if _PARAMETER.fullmatch(name) and isinstance(value, int | float)}


def _texts(told: Mapping[str, Any]) -> list[tuple[float, str, str]]:
    rows = told.get("texts")
    found = []
    for row in rows if isinstance(rows, list) else ():
        match row:
            case [int() | float() as time, str() as severity, str() as text]:
                urgent = severity in SEVERITIES and SEVERITIES.index(severity) < SEVERITIES.index("error")
                known = "error" if urgent else severity if severity in LEVELS else "info"
                found.append((float(time), known, text))
            case _:
                continue
    return found
