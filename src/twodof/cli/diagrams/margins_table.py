"""The table of margins, as `twodof diagram margins` and `twodof flash` print it."""

import math
from collections.abc import Mapping

from rich.console import Console
from rich.table import Table

from twodof.design import LoopMargins


def print_margins(console: Console, found: Mapping[str, LoopMargins]) -> None:
    """A row for each loop, and below them what an unstable one does."""
    table = Table(box=None, pad_edge=False)
    table.add_column("loop")
    for title in (
        "crossover\nrad/s",
        "gain margin\ndB",
        "phase margin\ndeg",
        "delay margin\nms",
        "disk margin\ndB and deg",
        "Ms",
        "Mt",
        "bandwidth\nrad/s",
    ):
        table.add_column(title, justify="right")
    for name, m in found.items():
        table.add_row(name, *(_cells(m) if m.stable else ("unstable", *[""] * 7)))
    console.print(table)
    for name, m in found.items():
        if not m.stable and m.motion is not None:
            console.print(f"{name}: unstable: {m.motion.text}{_cure(m)}")


def _cells(m: LoopMargins) -> tuple[str, ...]:
    return (
        _number(m.crossover, 3),
        _gains(m),
        _number(m.phase_margin_deg, 3),
        _number(1e3 * m.delay_margin, 3),
        f"{_decibels(m.disk.gain[1])}, {math.degrees(m.disk.phase):.0f}",
        f"{m.ms:.2f}",
        f"{m.mt:.2f}",
        _number(m.bandwidth, 3),
    )


def _gains(m: LoopMargins) -> str:
    """Up, and down where less gain makes it unstable too."""
    up = _decibels(m.increase.factor) if m.increase else "-"
    return up if m.decrease is None else f"{_decibels(m.decrease.factor)}, {up}"


def _cure(m: LoopMargins) -> str:
    """What less gain would do to it."""
    if m.decrease is not None and m.motion is not None and m.motion.omega > 0.0:
        return f" (with {m.decrease.factor:.2g} times the gain it would be on the border)"
    return ""


def _decibels(factor: float) -> str:
    return "-" if math.isinf(factor) else f"{20.0 * math.log10(factor):.1f}"


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}g}" if math.isfinite(value) else "-"
