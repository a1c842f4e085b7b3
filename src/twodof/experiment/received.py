"""Samples received over the link in a flight, by row and on the grid of control steps, with the true states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.flight.core import OUTPUTS
from twodof.flightlog.log import Channel, FlightLog
from twodof.flightlog.steps import TRUTH, safety_channel, step_channels, truth_channels
from twodof.rig.rig import MEASUREMENTS
from twodof.signals import MODES, TOPICS

_SIMULATED = {*MEASUREMENTS, *(name for name, _, _ in OUTPUTS), "mode", "voltage", "charge"}
_LOGGED = [
    (column, name)
    for row in TOPICS
    for column, name in zip(row.columns, row.source, strict=bool(row.source))
    if name in _SIMULATED and row.rate_hz
]

COLUMNS = tuple(column for column, _ in _LOGGED)
"""Columns of `signals.TOPICS` in the log of a flight."""

NAMES = tuple(name for _, name in _LOGGED)
"""Names of these columns in the closed loop, in the same order."""


@dataclass(frozen=True, eq=False)
class ReceivedSamples:
    """Received rows of `COLUMNS`: `values` (n, k) at the `ticks` (n,), NaN where a channel had no new sample.

    `truth` (m, 4) has the states `flightlog.steps.TRUTH` of a virtual rig at `truth_ticks` (m,); m is 0 with a real
    drone.
    """

    ticks: NDArray[np.int64]
    values: NDArray[np.float64]
    truth_ticks: NDArray[np.int64]
    truth: NDArray[np.float64]

    @classmethod
    def of(
        cls,
        ticks: ArrayLike,
        values: ArrayLike,
        first: int,
        steps: int,
        truth_ticks: ArrayLike = (),
        truth: ArrayLike = (),
    ) -> ReceivedSamples:
        """Return the samples of `steps` control steps from the tick `first` on, sorted, without repetitions."""
        rows = _within(ticks, np.reshape(np.asarray(values, dtype=np.float64), (-1, len(COLUMNS))), first, steps)
        return cls(
            *rows, *_within(truth_ticks, np.reshape(np.asarray(truth, np.float64), (-1, len(TRUTH))), first, steps)
        )

    def column(self, name: str) -> NDArray[np.float64]:
        """Return a column by its name in the closed loop, (n,)."""
        return self.values[:, NAMES.index(name)]

    def log(self, provenance: dict[str, Any], safety: Channel | None = None) -> FlightLog:
        """Return a flight log, with the channel `safety` if given; lost samples are gaps."""
        out: dict[str, NDArray[Any]] = {name: self.column(name) for name in NAMES}
        mode = np.nan_to_num(out["mode"], nan=0.0)
        out |= {row.when: np.isfinite(out[row.source[0]]) for row in TOPICS if row.own_rate}
        channels = step_channels(self.ticks, out, np.clip(mode, 0, len(MODES) - 1).astype(np.int32))
        if len(self.truth_ticks):
            channels |= truth_channels(self.truth_ticks, dict(zip(TRUTH, self.truth.T, strict=True)))
        return FlightLog(channels if safety is None else {**channels, "safety": safety}, provenance)

    def on_grid(self, first: int, steps: int) -> tuple[dict[str, NDArray[Any]], NDArray[np.bool_]]:
        """Return signals by their names in the closed loop, and a mask of the received steps: (steps,) each.

        NaN marks a missing sample. True states (`true_theta`, ...) are included if any were received.
        """
        have = np.zeros(steps, dtype=bool)
        have[self.ticks - first] = True
        out = _spread(NAMES, self.ticks - first, self.values, steps)
        if len(self.truth_ticks):
            out |= _spread([f"true_{name}" for name in TRUTH], self.truth_ticks - first, self.truth, steps)
        return out, have


def safety_in(told: Sequence[tuple[int, tuple[int, ...]]], first: int, steps: int) -> Channel | None:
    """Return the channel `safety` of the messages (tick, row) in `steps` steps from the tick `first`; None if none."""
    rows = {tick: row for tick, row in told if first <= tick < first + steps}
    ticks = np.array(sorted(rows), dtype=np.int64)
    values = np.array([rows[tick] for tick in ticks.tolist()], dtype=np.float64)
    return safety_channel(ticks, values) if len(ticks) else None


def _within(
    ticks: ArrayLike, rows: NDArray[np.float64], first: int, steps: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the ticks within `steps` steps from `first` on and their rows, sorted, without repetitions."""
    tick = np.asarray(ticks, dtype=np.int64)
    inside = np.flatnonzero((tick >= first) & (tick < first + steps))
    tick, index = np.unique(tick[inside], return_index=True)
    return tick, rows[inside[index]]


def _spread(
    names: Sequence[str], place: NDArray[np.int64], rows: NDArray[np.float64], steps: int
) -> dict[str, NDArray[Any]]:
    """Put each column of `rows` on a grid of `steps`, by name; NaN marks a missing row."""
    grid = np.full((steps, len(names)), np.nan)
    grid[place] = rows
    return {name: grid[:, k] for k, name in enumerate(names)}
