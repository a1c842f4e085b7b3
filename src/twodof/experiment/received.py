"""The samples of a flight as they came over the link, row by row and on the grid of control steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.flightlog.log import FlightLog
from twodof.flightlog.steps import step_channels
from twodof.signals import MODES

COLUMNS = (
    "imu.acc_x",
    "imu.acc_z",
    "imu.gyro_y",
    "tof.distance",
    "estimate.theta",
    "estimate.q",
    "estimate.x",
    "estimate.v",
    "setpoint.theta",
    "setpoint.q",
    "setpoint.x",
    "setpoint.v",
    "command.M",
    "command.T",
    "state.mode",
    "battery.voltage",
    "battery.charge",
)
"""Columns of `signals.TOPICS` that a flight's log is made of."""

NAMES = (
    *("acc_x", "acc_z", "gyro_y", "dist", "theta", "q", "x", "v", "theta0", "q0", "x0", "v0", "M", "T"),
    *("mode", "voltage", "charge"),
)
"""What the closed loop calls them, in the same order."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Rows of `COLUMNS` that came: `values` (n, k), NaN where a channel had no new sample, at the `ticks` (n,)."""

    ticks: NDArray[np.int64]
    values: NDArray[np.float64]

    @classmethod
    def of(cls, ticks: ArrayLike, values: ArrayLike, first: int, steps: int) -> Samples:
        """Those of the `steps` control steps from the tick `first` on, in their order, each once."""
        tick = np.asarray(ticks, dtype=np.int64)
        rows = np.asarray(values, dtype=np.float64).reshape(-1, len(COLUMNS))
        inside = np.flatnonzero((tick >= first) & (tick < first + steps))
        tick, index = np.unique(tick[inside], return_index=True)
        return cls(tick, rows[inside[index]])

    def column(self, name: str) -> NDArray[np.float64]:
        """A column by the closed loop's name, (n,)."""
        return self.values[:, NAMES.index(name)]

    def log(self, provenance: dict[str, Any]) -> FlightLog:
        """As a flight log; what was lost is a gap."""
        out: dict[str, NDArray[Any]] = {name: self.column(name) for name in NAMES}
        mode = np.nan_to_num(out["mode"], nan=0.0)
        out["dist_new"] = np.isfinite(out["dist"])
        return FlightLog(step_channels(self.ticks, out, np.clip(mode, 0, len(MODES) - 1).astype(np.int32)), provenance)

    def on_grid(self, first: int, steps: int) -> tuple[dict[str, NDArray[Any]], NDArray[np.bool_]]:
        """Signals by the closed loop's names, NaN where a sample is missing, and which steps came: (steps,) each."""
        place = self.ticks - first
        have = np.zeros(steps, dtype=bool)
        have[place] = True
        grid = np.full((steps, len(NAMES)), np.nan)
        grid[place] = self.values
        return {name: grid[:, k] for k, name in enumerate(NAMES)}, have
