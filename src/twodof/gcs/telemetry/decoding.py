"""Messages into samples of TOPICS: which signals a message carries, in which fields, with which stamp."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from math import asin, isfinite
from types import MappingProxyType
from typing import Any

from twodof.link.control_period import TICK_S
from twodof.link.mavlink.messages import BATCH_VALUES, channel_bits
from twodof.signals import TOPICS

Decoded = Iterator[tuple[str, float, float | tuple[float, ...]]]
"""Topic, the drone's time [s], value."""


def _imu(got: Any) -> Decoded:
    time = got.time_usec * 1e-6
    yield "imu.acc", time, (got.xacc, got.yacc, got.zacc)
    yield "imu.gyro", time, (got.xgyro, got.ygyro, got.zgyro)


def _attitude(got: Any) -> Decoded:
    time = got.time_boot_ms / 1000
    yield "estimate.theta", time, got.pitch
    yield "estimate.q", time, got.pitchspeed


def _position(got: Any) -> Decoded:
    time = got.time_boot_ms / 1000
    yield "estimate.x", time, got.x
    yield "estimate.v", time, got.vx


def _attitude_target(got: Any) -> Decoded:
    time = got.time_boot_ms / 1000
    w, x, y, z = got.q
    yield "setpoint.theta", time, asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    yield "setpoint.q", time, got.body_pitch_rate
    yield "setpoint.thrust", time, -got.thrust


def _position_target(got: Any) -> Decoded:
    time = got.time_boot_ms / 1000
    yield "setpoint.x", time, got.x
    yield "setpoint.v", time, got.vx


def _actuators(got: Any) -> Decoded:
    time = got.time_usec * 1e-6
    yield "command.M", time, got.controls[1]
    yield "command.T", time, got.controls[3]


def _tof(got: Any) -> Decoded:
    if got.valid:
        yield "tof.distance", got.time_usec * 1e-6, got.distance


def _openloop(got: Any) -> Decoded:
    yield "openloop", got.tick * TICK_S, (got.M, got.T, float(got.openloop), float(got.enableM), float(got.enableT))


def _truth(got: Any) -> Decoded:
    time = got.time_usec * 1e-6
    for name in ("theta", "q", "x", "v"):
        yield f"truth.{name}", time, getattr(got, name)


def _batch(got: Any) -> Decoded:
    """The newest row in which a topic has a sample; recordings take all of them."""
    width = int(got.channels).bit_count()
    rows = min(got.rows, BATCH_VALUES // width) if width else 0
    values, ticks = got.values, [(got.tick + got.every * k) & 0xFFFFFFFF for k in range(rows)]
    for name, places, several in _layout(got.channels):
        for k in range(rows - 1, -1, -1):
            sample = [values[k * width + place] for place in places]
            if all(map(isfinite, sample)):
                yield name, ticks[k] * TICK_S, tuple(sample) if several else sample[0]
                break


@lru_cache(maxsize=64)
def columns_of(mask: int) -> Mapping[str, int]:
    """Column of TOPICS -> its place in the rows of a batch with these channels."""
    bits = channel_bits()
    named = {column: bits.get(column.replace(".", "_").upper(), 0) for row in TOPICS for column in row.columns}
    places = {bit: place for place, bit in enumerate(1 << k for k in range(64) if mask >> k & 1)}
    return MappingProxyType({column: places[bit] for column, bit in named.items() if bit & mask})


@lru_cache(maxsize=64)
def _layout(mask: int) -> tuple[tuple[str, tuple[int, ...], bool], ...]:
    """Topics that are whole in a batch: name, places of its numbers in a row, whether it has fields."""
    columns = columns_of(mask)
    return tuple(
        (row.name, tuple(columns[column] for column in row.columns), bool(row.fields))
        for row in TOPICS
        if all(column in columns for column in row.columns)
    )


def _battery(got: Any) -> Decoded:
    cells = [one for one in got.voltages if one != 0xFFFF]
    if cells:
        yield "battery.voltage", float("nan"), sum(cells) / 1000.0
    if got.battery_remaining >= 0:
        yield "battery.charge", float("nan"), got.battery_remaining / 100.0


def _finite(decode: Callable[[Any], Decoded]) -> Callable[[Any], Decoded]:
    def checked(got: Any) -> Decoded:
        for name, time, value in decode(got):
            if all(map(isfinite, value)) if isinstance(value, tuple) else isfinite(value):
                yield name, time, value

    return checked


DECODERS: Mapping[str, Callable[[Any], Decoded]] = MappingProxyType(
    {
        "HIGHRES_IMU": _finite(_imu),
        "ATTITUDE": _finite(_attitude),
        "LOCAL_POSITION_NED": _finite(_position),
        "ATTITUDE_TARGET": _finite(_attitude_target),
        "POSITION_TARGET_LOCAL_NED": _finite(_position_target),
        "ACTUATOR_CONTROL_TARGET": _finite(_actuators),
        "TWODOF_TOF": _finite(_tof),
        "TWODOF_OPENLOOP": _finite(_openloop),
        "TWODOF_TRUTH": _finite(_truth),
        "TWODOF_BATCH": _batch,
        "BATTERY_STATUS": _finite(_battery),
    }
)
"""Message -> its samples; a number that is none is no sample."""
