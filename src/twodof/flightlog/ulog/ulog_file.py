"""PX4's logs (ULog) as flight logs: which topic and field becomes which of the drone's channels."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LogError
from twodof.flightlog import provenance
from twodof.flightlog.log import Channel, FlightLog
from twodof.flightlog.memory_budget import MemoryBudget
from twodof.flightlog.sanitise import naming_file, noted, sanitise
from twodof.flightlog.steps import ASKED, BOOT, STEP_TOPIC, safety_channel, step_channels
from twodof.flightlog.ulog.decoder import Logged, ULog, scan_ulog
from twodof.signals import BY_MAT, PERIOD, SEVERITIES, TOPICS

_Rows = NDArray[np.void]
_Values = Callable[[_Rows], NDArray[np.float64]]

OWN = "twodof"
"""sys_name in the logs of the virtual flight controller, whose topics are those of TOPICS."""
MAX_OWN_FIELDS = 1000


def _field(name: str) -> _Values:
    return lambda rows: rows[name].astype(np.float64)


def _item(name: str, index: int) -> _Values:
    return lambda rows: rows[name][:, index].astype(np.float64)


def _opposite(name: str, index: int) -> _Values:
    # Not negated, so that thrust 0 is not written as -0.
    return lambda rows: 0.0 - rows[name][:, index].astype(np.float64)


def _pitch(name: str) -> _Values:
    """Pitch of a quaternion (w, x, y, z); its sine is kept in its range against rounding."""

    def pitch(rows: _Rows) -> NDArray[np.float64]:
        w, x, y, z = rows[name].astype(np.float64).T
        return np.asarray(np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)))

    return pitch


# Channel -> topic and value; of several, the first that the log has (later ones are of older PX4 versions).
# The rail is PX4's local x axis, as for the modules that `twodof px4 export` makes.
_SAFETY = ("action", "reason", "causes")
"""What a step's row calls the fields of the channel `safety`."""

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
"""Which topic of PX4, and which value of its records, becomes which channel."""


def read_ulog(path: str | Path) -> FlightLog:
    """Reads a log of PX4 or of the virtual flight controller. Raises LogError for what is none or damaged.

    The time of a sample is its `timestamp_sample` where the topic has one, else its `timestamp`. A module that `twodof
    px4 export` made gives a channel for each of its signals, such as `twodof_mine_out_m`. The provenance says what is
    left out. Its "left_out" counts samples that are not finite or repeat a stamp. Its "ignored" names topics that do
    not become a channel, and "lost_bytes" is the size of a last message that was cut off. A log of the virtual flight
    controller has the channels, stamps and bits of the log of a simulated flight, without the ground truth. It also has
    `safety`: what the failsafe did and why.
    """
    data = provenance.read_bytes(path)
    where = str(path)
    budget = MemoryBudget(len(data), where)
    with naming_file(path):
        return ulog_to_log(scan_ulog(data, where, budget=budget), provenance.of_file(path, data, "ulog"), where, budget)


def ulog_to_log(found: ULog, file: dict[str, Any], where: str, budget: MemoryBudget) -> FlightLog:
    """The channels of a log. Raises LogError if none of its topics becomes one."""
    channels: dict[str, Channel] = {}
    counts: dict[str, dict[str, int]] = {}
    used = set()
    own = found.info.get("sys_name") == OWN
    steps = found.topic(STEP_TOPIC) if own else None
    rows = _own_topics(found) if own else {**_px4_topics(found), **_modules(found)}
    if steps is not None and len(steps.rows):
        budget.samples(len(steps.rows), 2 * len(TOPICS))
        channels, rows = _of_steps(steps, where), {}
        used = {one.name for one in found.topics}
    for name, (logged, value) in rows.items():
        if not len(logged.rows) or "timestamp" not in (logged.rows.dtype.names or ()):
            continue
        known = BY_MAT.get(name)
        unit, fields = (known.unit, known.fields) if known else ("", ())
        budget.samples(len(logged.rows), known.width if known else 1)
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
        there = ", ".join(sorted({one.name for one in found.topics})[:20]) or "none"
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
    """A stamp of our own flight controller's log on the clock of its channels [s]."""
    return round(BOOT + stamp_us / 1e6, 6)


def _px4_topics(found: ULog) -> dict[str, tuple[Logged, _Values]]:
    rows = {}
    for channel, sources in PX4_SOURCES.items():
        for topic, value in sources:
            logged = found.topic(topic)
            if logged is not None and len(logged.rows):
                rows[channel] = (logged, value)
                break
    return rows


def _modules(found: ULog) -> dict[str, tuple[Logged, _Values]]:
    """The signals of modules made by `twodof px4 export`: what they read, commanded and logged."""
    rows: dict[str, tuple[Logged, _Values]] = {}
    for logged in found.topics:
        if not logged.name.startswith("twodof_") or logged.instance:
            continue
        for name in (logged.rows.dtype.names or ())[:MAX_OWN_FIELDS]:
            if name.startswith(("in_", "out_", "log_")) and logged.rows.dtype[name].base.kind in "biuf":
                rows[f"{logged.name}_{name}"] = (logged, _field(name))
    return rows


def _own_topics(found: ULog) -> dict[str, tuple[Logged, _Values]]:
    rows = {}
    for topic in TOPICS:
        logged = found.topic(topic.name.replace(".", "_"))
        names = topic.fields or ("value",)
        if logged is not None and {"timestamp", *names} <= set(logged.rows.dtype.names or ()):
            rows[topic.mat] = (logged, _columns(names))
    return rows


def _of_steps(steps: Logged, where: str) -> dict[str, Channel]:
    """The channels of a log that has every step; the other topics in it say the same in PX4's words."""
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
    """What the failsafe did and why (bit masks of flight.causes.CAUSES), at each change and once a second."""
    if not {*_SAFETY} <= set(rows.dtype.names or ()):
        return {}
    values = np.column_stack([rows[name].astype(np.float64) for name in _SAFETY])
    changed = np.append(True, (np.diff(values, axis=0) != 0.0).any(axis=1)) if len(values) else np.empty(0, np.bool_)
    told = changed | (ticks % round(1.0 / PERIOD) == 0)
    return {"safety": safety_channel(ticks[told], values[told])}


def _columns(names: tuple[str, ...]) -> _Values:
    if len(names) == 1:
        return _field(names[0])
    return lambda rows: np.stack([rows[name].astype(np.float64) for name in names], axis=1)


def _stamps(rows: _Rows) -> NDArray[np.float64]:
    """Time of each sample [s]: when it was measured, where the topic says so."""
    stamp = rows["timestamp"]
    if "timestamp_sample" in (rows.dtype.names or ()):
        stamp = np.where(rows["timestamp_sample"] > 0, rows["timestamp_sample"], stamp)
    return np.asarray(stamp, dtype=np.float64) / 1e6


def _plain(value: Any) -> Any:
    """A value that JSON has: a NaN or infinity as text."""
    numbers = value if isinstance(value, list) else [value]
    return value if all(np.isfinite(one) for one in numbers if isinstance(one, float)) else repr(value)
