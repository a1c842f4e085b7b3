"""Channels of a flight from its steps, simulated or logged on board, with the time stamps of the drone's logs."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.flightlog.log import Channel
from twodof.signals import BY_MAT, OPEN_LOOP, PERIOD, TOPICS, topic

BOOT = 10.0
"""Time stamp of tick 0 [s]: the drone's logs count from when the flight controller booted."""

STEP_TOPIC = "twodof_step"
"""The ULog topic with every step of the flight code; names of its set-points begin with `ASKED`."""
ASKED = "asked_"

TRUTH = ("theta", "q", "x", "v")
"""Names of a virtual rig's true state, [rad], [rad/s], [m], [m/s]; `rig.rig.TRUTH`."""

SAFETY = ("action", "reasons", "causes")
"""Fields of the channel `safety`: index into ACTIONS, mask of the deciding CAUSES, mask of all CAUSES that hold."""

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
"""The signals of a step, in the order of a log's channels; the open-loop messages are events."""


class OpenLoopMessages:
    """Open-loop messages of a flight: one when the loop opens, closes or M steps, and 50 a second while it is open.

    The steps of a flight may come in several parts.
    """

    def __init__(self) -> None:
        self._was, self._before, self._count = False, 0.0, 0

    def sent(
        self, mode: NDArray[Any], M: NDArray[np.float64], T: NDArray[np.float64]
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        """Return a flag for each of the next steps (n,), and the messages (m, 5) of the flagged steps.

        A step with NaN in M or T has no message.
        """
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
    """Return the log channels of the steps whose signals (n,) are `out`. `tick` (n,) rises; ticks may be missing.

    `out` holds:
    - measurements: acc_x, acc_z, gyro_y, dist, dist_new, voltage, charge; if known acc_y, gyro_x, gyro_z;
    - outputs of the flight code: theta, q, x, v, theta0, q0, x0, v0, M, T;
    - of a simulation the truth: true_theta and so on.
    NaN and infinity, which a user's controller may give, are left out as gaps.
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
    """Return the channels of a virtual rig's true `state` (n,), named as in `TRUTH`, at the rising `tick` (n,)."""
    time = np.asarray(BOOT + PERIOD * tick, dtype=np.float64)
    rows = {name: topic(f"truth.{name}").mat for name in state}
    return {row: _channel(row, time, state[name]) for name, row in rows.items()}


def safety_channel(tick: NDArray[np.int64], values: NDArray[np.float64]) -> Channel:
    """Return the channel `safety`: the failsafe's `values` (n, 3) of `SAFETY` at the rising `tick` (n,)."""
    return Channel(np.asarray(BOOT + PERIOD * tick, dtype=np.float64), values, "", SAFETY, "safety")


def is_published(tick: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return True for the steps in which the estimator publishes x and v: 100 Hz out of 250, two of five."""
    return (2 * (tick + 1)) % 5 < 2


def shift(name: str) -> float:
    """Return the delay [s] of a .mat channel's stamp after M's of the same step; negative for measurements."""
    row = BY_MAT.get(name)
    return row.later if row else 0.0


def _published(tick: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the steps in which an estimate of x and v was published, and the next steps, which first read it."""
    at = np.flatnonzero(is_published(tick[:-1]) & (np.diff(tick) == 1))
    return at, at + 1


def _channel(name: str, time: NDArray[np.float64], values: NDArray[Any]) -> Channel:
    values = np.asarray(values, dtype=np.float64)
    good = np.isfinite(values) if values.ndim == 1 else np.isfinite(values).all(axis=1)
    return Channel(time[good] + shift(name), values[good], topic(name).unit, topic(name).fields, name)


def _messages(time: NDArray[np.float64], out: Mapping[str, NDArray[Any]], mode: NDArray[np.int32]) -> Channel:
    sent, values = OpenLoopMessages().sent(mode, out["M"], out["T"])
    return _channel("lmnf", time[sent], values)
