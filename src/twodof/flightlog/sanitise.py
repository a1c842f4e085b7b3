"""Makes channels of what was received: what a Channel cannot hold is left out and counted, never silently."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LogError
from twodof.flightlog.log import Channel

RECOVER = "get what is sound with: twodof log recover"
"""The remedy for a file that was cut off or damaged; `naming_file` adds the file's name."""


@contextmanager
def naming_file(path: str | Path) -> Iterator[None]:
    """Adds the name of the file to the remedy RECOVER of a LogError, so that the command can be typed as it stands."""
    try:
        yield
    except LogError as reason:
        if reason.remedy != RECOVER:
            raise
        raise LogError(reason.what, reason.where, f"{RECOVER} {quote(str(path))}") from reason


@dataclass(frozen=True)
class Loss:
    """A part of a file that cannot be used: `size` bytes from byte `at` on."""

    at: int
    size: int
    why: str


def sanitise(
    time: NDArray[np.float64], value: NDArray[np.float64], unit: str, fields: tuple[str, ...], name: str
) -> tuple[Channel, dict[str, int]]:
    """The channel of samples in any order, and how many were left out: `not_finite`, `repeated` (same stamp).

    `time` (n,) [s], `value` (n,) or (n, k). Of samples with one stamp the first received is kept; `reordered`
    counts those that came after a later one. Raises LogError as Channel does.
    """
    counts: dict[str, int] = {}
    finite = np.isfinite(time) & (np.isfinite(value) if value.ndim == 1 else np.isfinite(value).all(axis=1))
    if not finite.all():
        counts["not_finite"] = int((~finite).sum())
        time, value = time[finite], value[finite]
    late = np.diff(time) < 0.0
    if late.any():
        counts["reordered"] = int((time < np.maximum.accumulate(time)).sum())
        order = np.argsort(time, kind="stable")
        time, value = time[order], value[order]
    fresh = np.concatenate(([True], np.diff(time) > 0.0))[: len(time)]
    if not fresh.all():
        counts["repeated"] = int((~fresh).sum())
        time, value = time[fresh], value[fresh]
    return Channel(time, value, unit, fields, name), counts


def noted(kept: dict[str, Any], counts: dict[str, dict[str, int]]) -> dict[str, Any]:
    """Provenance with what was left out of each channel, if anything was."""
    some = {name: row for name, row in counts.items() if row}
    return {**kept, "left_out": some} if some else kept
