"""What a simulated flight looks like on the ground: the drone's log, channel for channel, with its time stamps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.flight.core import PERIOD
from twodof.flightlog.log import Channel, FlightLog
from twodof.rig.parameters import Q_AGE
from twodof.signals import MODES, topic

BOOT = 10.0
"""Time stamp of the first step [s]: the drone's logs count from when the flight controller booted."""

# Stamps against that of the moment M of the same step, as the real logs have them (docs/physics.md, sensors).
_AGE = {"acc": 1.1e-3, "gyr": 1.1e-3, "dist": 1.0e-3, "q": Q_AGE}
_LATER = {"theta": 0.33e-3, "x": 1.3e-3, "v": 1.3e-3, "q0": 3e-6, "theta0": 5e-6, "v0": 7e-6, "x0": 9e-6, "T": 11e-6}
_LATER |= {"thrust0": 13e-6, "mode": 15e-6}

MESSAGE_PERIOD = round(0.02 / PERIOD)
"""Steps between two open-loop messages."""


def flight_log(out: Mapping[str, NDArray[Any]], mode: NDArray[np.int32], provenance: dict[str, Any]) -> FlightLog:
    """The log of a flight whose signals at the control steps are `out`, as `ClosedLoop.fly` gives them.

    Samples that are not finite, which a user's controller may give, are left out: the channel has a gap there.
    """
    steps = len(mode)
    time = BOOT + PERIOD * np.arange(steps)
    zero = np.zeros(steps)
    gravity_side = zero  # nothing on the rig accelerates it sideways
    columns: dict[str, NDArray[Any]] = {
        "acc": np.column_stack([out["acc_x"], gravity_side, out["acc_z"]]),
        "gyr": np.column_stack([zero, out["gyro_y"], zero]),
        **{name: out[name] for name in ("theta", "q", "theta0", "q0", "x0", "v0", "M", "T")},
        "thrust0": -np.abs(out["T"]),
        "mode": mode.astype(np.float64),
    }
    channels = {name: _channel(name, time, values) for name, values in columns.items()}
    new = out["dist_new"].astype(bool)
    channels["dist"] = _channel("dist", time[new], out["dist"][new])
    # What is published in a step is read from the next one on: the estimate in hand at step k stands since k - 1.
    published = np.append(published_steps(steps - 1), False)
    held = np.append(published[:-1], False)
    after = np.flatnonzero(held) + 1
    for name in ("x", "v"):
        channels[name] = _channel(name, time[held], out[name][after])
    channels["lmnf"] = _messages(time, out, mode)
    for name in ("theta", "q", "x", "v"):
        row = topic(f"truth.{name}")
        channels[row.mat] = _channel(row.mat, time, out[f"true_{name}"])
    slow = slice(None, None, 125)
    for name in ("voltage", "charge"):
        channels[name] = _channel(name, time[slow], out[name][slow])
    return FlightLog(channels, provenance)


def published_steps(steps: int) -> NDArray[np.bool_]:
    """In which of `steps` steps the estimator publishes x and v: 100 Hz out of 250, two of five."""
    return (2 * np.arange(1, steps + 1)) % 5 < 2


def _channel(name: str, time: NDArray[np.float64], values: NDArray[Any]) -> Channel:
    shift = _LATER.get(name, 0.0) - _AGE.get(name, 0.0)
    return _finite(time + shift, np.asarray(values, dtype=np.float64), name)


def _finite(time: NDArray[np.float64], values: NDArray[np.float64], name: str) -> Channel:
    good = np.isfinite(values) if values.ndim == 1 else np.isfinite(values).all(axis=1)
    return Channel(time[good], values[good], topic(name).unit, topic(name).fields, name)


def _messages(time: NDArray[np.float64], out: Mapping[str, NDArray[Any]], mode: NDArray[np.int32]) -> Channel:
    """The open-loop messages: at 50 Hz while the loop is open, and one that closes it."""
    opened = mode == MODES.index("open-loop")
    changed = np.flatnonzero(np.diff(opened.astype(np.int8), prepend=0) != 0)
    stepped = np.flatnonzero(opened & (out["M"] != np.append(0.0, out["M"][:-1])))
    steps = np.union1d(np.union1d(changed, stepped), np.flatnonzero(opened)[::MESSAGE_PERIOD]).astype(np.intp)
    flag = opened[steps].astype(np.float64)
    values = np.column_stack([out["M"][steps] * flag, out["T"][steps] * flag, flag, flag, flag])
    return _finite(time[steps] - 1.5e-3, values, "lmnf")
