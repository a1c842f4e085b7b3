"""A small chart of block characters: what was measured as a line of quarter blocks, the set-point as a thin rule.

It reads the same without colour: the two have different characters.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray
from rich.text import Text

_QUARTERS = " ▘▝▀▖▌▞▛▗▚▐▜▄▙▟█"
"""By the sum of 1 (upper left), 2 (upper right), 4 (lower left), 8 (lower right)."""
_EIGHTHS = "▁▂▃▄▅▆▇█"
_UPPER, _LOWER, _BOTH, _ZERO = "▔", "▁", "┊", "┈"

MEASURED, SET_POINT, FAINT = "cyan", "yellow", "dim"

Columns = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Smallest and largest value in each column, NaN where nothing is known."""


def bound(values: Sequence[NDArray[np.float64]], ladder: Sequence[float]) -> float:
    """The first rung of the ladder that no finite value exceeds, the last one if all are exceeded."""
    largest = max((float(np.nanmax(np.abs(one))) for one in values if np.isfinite(one).any()), default=0.0)
    return next((rung for rung in ladder if largest <= rung), ladder[-1])


def chart(measured: Columns, wanted: Columns | None, height: int, limit: float) -> list[Text]:
    """The lines of a chart from -limit to +limit, `height` of them; two columns of data are one character.

    `wanted` is the set-point. What lies beyond the limits is drawn at the edge.
    """
    if height == 1:
        return [_low_chart(measured, limit)]
    levels = 2 * height
    ours = _dots(measured, levels, limit)
    theirs = _dots(wanted, levels, limit) if wanted is not None else np.zeros_like(ours)
    lines = []
    for row in range(height):
        cells = [(slice(2 * row, 2 * row + 2), slice(2 * k, 2 * k + 2)) for k in range(ours.shape[1] // 2)]
        drawn = [_character(ours[cell], theirs[cell], middle=2 * row + 1 == height) for cell in cells]
        # In runs: a style a letter would be ten times the bytes.
        runs = ((style, "".join(letter for letter, _ in run)) for style, run in groupby(drawn, itemgetter(1)))
        lines.append(Text.assemble(*((letters, style) for style, letters in runs)))
    return lines


def _character(ours: NDArray[np.bool_], theirs: NDArray[np.bool_], middle: bool) -> tuple[str, str]:
    if ours.any():
        return _QUARTERS[int((ours.ravel() * (1, 2, 4, 8)).sum())], MEASURED
    upper, lower = bool(theirs[0].any()), bool(theirs[1].any())
    if upper or lower:
        return _BOTH if upper and lower else _UPPER if upper else _LOWER, SET_POINT
    return (_ZERO, FAINT) if middle else (" ", "")


def _dots(columns: Columns, levels: int, limit: float) -> NDArray[np.bool_]:
    """Which of (levels, columns) are on; from column to column the line is closed."""
    low, high = columns
    out = np.zeros((levels, len(low)), dtype=bool)
    before: tuple[int, int] | None = None
    for k, (smallest, largest) in enumerate(zip(low, high, strict=True)):
        if not np.isfinite(smallest):
            before = None
            continue
        top, bottom = _level(largest, levels, limit), _level(smallest, levels, limit)
        if before is not None:
            top, bottom = min(top, before[1]), max(bottom, before[0])
        out[top : bottom + 1, k] = True
        before = _level(largest, levels, limit), _level(smallest, levels, limit)
    return out


def _level(value: float, levels: int, limit: float) -> int:
    """From 0 at the top to levels - 1."""
    return int(np.clip((limit - value) / (2.0 * limit) * levels, 0, levels - 1))


def _low_chart(measured: Columns, limit: float) -> Text:
    """One line: the height of each block is the value farthest from 0 of its two columns."""
    low, high = measured
    line = Text()
    for k in range(0, len(low) - 1, 2):
        values = [float(v) for part in (low, high) for v in part[k : k + 2] if np.isfinite(v)]
        if not values:
            line.append(" ")
            continue
        farthest = max(values, key=abs)
        step = int(np.clip((farthest + limit) / (2.0 * limit) * len(_EIGHTHS), 0, len(_EIGHTHS) - 1))
        line.append(_EIGHTHS[step], MEASURED)
    return line
