"""Channels of a flight of which every step is known, simulated or logged on board, stamped as the drone's logs are."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.flightlog.log import Channel
from twodof.signals import BY_MAT, OPEN_LOOP, PERIOD, TOPICS, topic

BOOT = 10.0
"""Time stamp of tick 0 [s]: the drone's logs count from when the flight controller booted."""

STEP_TOPIC = "twodof_step"
"""The ULog topic with every step of the flight code; what was asked for has names that begin with `ASKED`."""
ASKED = "asked_"

TRUTH = ("theta", "q", "x", "v")
"""Names of a virtual rig's true state, [rad], [rad/s], [m], [m/s]; `rig.rig.TRUTH`."""

SAFETY = ("action", "reasons", "causes")
"""Fields of the channel `safety`: an index into flight.causes.ACTIONS, and masks of its CAUSES, of those that decided
it and of those that hold."""

_SLOWEST_HZ = 10.0
"""Below this a signal is logged after the events and the truth."""

MESSAGE_PERIOD = round(0.02 / PERIOD)
"""Steps between two open-loop messages."""
_ORDER = {"imu_new": 0, "": 1, "published": 3}  # sensors with a rate of their own are between
_COMPUTED = ("-|T|", "mode")
_LOGGED = sorted(
    (row for row in TOPICS if row.source and row.rate_hz),
    key=lambda row: (row.rate_hz < _SLOWEST_HZ, _ORDER.get(row.when, 2), row.source[0] in _COMPUTED),
)
"""The signals that a step tells, in the order of a log's channels; the open-loop messages are events."""


class OpenLoopMessages:
    """The open-loop messages of a flight: where the loop opens, closes or M steps, and 50 a second while it is open.

    The steps of a flight may come in several parts.
    """

    def __init__(self) -> None:
        self._was, self._before, self._count = False, 0.0, 0

    def sent(
        self, mode: NDArray[Any], M: NDArray[np.float64], T: NDArray[np.float64]
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        """In which of the next steps (n,) there is a message, and the messages (m, 5); none where M or T is NaN."""
        opened = mode == OPEN_LOOP
        changed = np.diff(opened.astype(np.int8), prepend=self._was) != 0
        stepped = opened & (np.append(self._before, M[:-1]) != M)
        number = self._count + np.cumsum(opened)
        due = opened & (number % MESSAGE_PERIOD == 1)
        if len(M):
            self._was, self._before, self._count = bool(opened[-1]), float(M[-1]), int(number[-1])
        sent = (changed | stepped | due) & np.isfinite(M) & np.isfinite(T)
        flag = opened[sent].astype(np.float64)
        return sent, np.column_stack([M[sent] * flag, T[sent] * flag, flag, flag, flag])


def step_channels(
    tick: NDArray[np.int64], out: Mapping[str, NDArray[Any]], mode: NDArray[np.int32]
) -> dict[str, Channel]:
    """The channels of the steps whose signals (n,) are `out`. `tick` (n,) rises; ticks may be missing.

    `out` holds the measurements: acc_x, acc_z, gyro_y, dist, dist_new, voltage, charge. It may hold acc_y, gyro_x and
    gyro_z too. It holds the flight code's outputs: theta, q, x, v, theta0, q0, x0, v0, M, T. Of a simulation it also
    holds the truth (true_theta, ...). Samples that are not finite, which a user's controller may give, are left out: a
    gap.
    """
    time = np.asarray(BOOT + PERIOD * tick, dtype=np.float64)
    out = {**out, "mode": mode.astype(np.float64), "-|T|": -np.abs(out["T"])}
    held, after = _published(tick)
    fast: dict[str, Channel] = {}
    slow: dict[str, Channel] = {}
    for row in _LOGGED:
        if not any(name in out for name in row.source):
            continue  # a log that was written before there was this signal
        values = np.column_stack([out.get(name, np.zeros(len(tick))) for name in row.source])
        values = values if row.fields else values[:, 0]
        if row.when == "published":
            fast[row.mat] = _channel(row.mat, time[held], values[after])
        elif row.own_rate:
            new = out[row.when].astype(bool)
            fast[row.mat] = _channel(row.mat, time[new], values[new])
        elif row.rate_hz < _SLOWEST_HZ:
            due = tick % round(1.0 / (row.rate_hz * PERIOD)) == 0
            slow[row.mat] = _channel(row.mat, time[due], values[due])
        else:
            fast[row.mat] = _channel(row.mat, time, values)
    truth = truth_channels(tick, {name: out[f"true_{name}"] for name in TRUTH if f"true_{name}" in out})
    return {**fast, "lmnf": _messages(time, out, mode), **truth, **slow}


def truth_channels(tick: NDArray[np.int64], state: Mapping[str, NDArray[Any]]) -> dict[str, Channel]:
    """The channels of a virtual rig's true state (`TRUTH`): `state` (n,) has the values at the rising `tick` (n,)."""
    time = np.asarray(BOOT + PERIOD * tick, dtype=np.float64)
    rows = {name: topic(f"truth.{name}").mat for name in state}
    return {row: _channel(row, time, state[name]) for name, row in rows.items()}


def safety_channel(tick: NDArray[np.int64], values: NDArray[np.float64]) -> Channel:
    """What the failsafe did at `tick` (n,), rising, and why: `values` (n, 3) of `SAFETY`."""
    return Channel(np.asarray(BOOT + PERIOD * tick, dtype=np.float64), values, "", SAFETY, "safety")


def is_published(tick: NDArray[np.int64]) -> NDArray[np.bool_]:
    """In which steps the estimator publishes x and v: 100 Hz out of 250, two of five."""
    return (2 * (tick + 1)) % 5 < 2


def shift(name: str) -> float:
    """How much later [s] than M of the same step a .mat channel is stamped; negative for what was measured before."""
    row = BY_MAT.get(name)
    return row.later if row else 0.0


def _published(tick: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Where an estimate of x and v was published, and where it is first read: in the next step, if that is there."""
    at = np.flatnonzero(is_published(tick[:-1]) & (np.diff(tick) == 1))
    return at, at + 1


def _channel(name: str, time: NDArray[np.float64], values: NDArray[Any]) -> Channel:
    values = np.asarray(values, dtype=np.float64)
    good = np.isfinite(values) if values.ndim == 1 else np.isfinite(values).all(axis=1)
    return Channel(time[good] + shift(name), values[good], topic(name).unit, topic(name).fields, name)


def _messages(time: NDArray[np.float64], out: Mapping[str, NDArray[Any]], mode: NDArray[np.int32]) -> Channel:
    sent, values = OpenLoopMessages().sent(mode, out["M"], out["T"])
    return _channel("lmnf", time[sent], values)
