"""What a process of its own computes of logs, as plain data: views and comparisons, replays and conversions."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LogError
from twodof.flightlog.files import write_log
from twodof.flightlog.log import FlightLog
from twodof.flightlog.thinning import thinned
from twodof.flightlog.ulog_writer import write_ulg
from twodof.lab.logbook.log_summary import summary
from twodof.lab.logbook.read_logs import kept_log
from twodof.report.plots.comparison_view import Align, comparison_view, flight_steps
from twodof.report.plots.flight_view import Curve, FlightView, flight_view
from twodof.report.step_responses import step_responses

MOST_POINTS = 4000
MOST_SAID = 2000
"""Words, and changes of parameters, that are told of one log."""
REPLAY_HZ, MOST_REPLAYED = 50.0, 20_000
_REPLAYED = ("theta", "x", "M", "T", "theta0", "x0", "theta_true", "x_true")
_FIRST_CHANNELS = 6


def facts(path: str) -> dict[str, Any]:
    """The summary, the channels (name, unit, samples), and what was set at the start."""
    log = kept_log(path)
    channels = [{"name": name, "unit": one.unit, "samples": len(one)} for name, one in log.channels.items()]
    parameters = log.provenance.get("parameters")
    known = sorted(parameters.items())[:MOST_SAID] if isinstance(parameters, dict) else []
    return {
        **summary(path),
        "all_channels": channels,
        "parameters": [[str(name)[:80], value] for name, value in known if isinstance(value, int | float)],
        "texts": _rows(log, "texts", (float, str, str)),
        "changes": _rows(log, "changes", (float, str, float)),
    }


def view(path: str, window: tuple[float, float] | None, topics: list[str], points: int) -> dict[str, Any]:
    """What a plot shows within `window` [s], each curve thinned to about `points`. Raises LogError."""
    log = kept_log(path)
    try:
        found = flight_view(log, topics, window)
    except LogError:
        if topics or (window is not None and not _overlaps(log, window)):
            raise
        found = flight_view(log, [*log][:_FIRST_CHANNELS], window)  # a log of others
    return _told(found, points)


def steps(path: str) -> dict[str, Any]:
    """The responses to the steps of set-points, and why there are none where they cannot be told."""
    try:
        return {"steps": [step.to_json() for step in step_responses(kept_log(path))], "unclear": ""}
    except LogError as reason:
        return {"steps": [], "unclear": reason.what}


def compare(paths: dict[str, str], align: str, window: tuple[float, float] | None, points: int) -> dict[str, Any]:
    """Flights over each other, by the names that `paths` gives them: the view, the steps of each, and each one's 0 [s].

    Raises LogError as `comparison_view` does.
    """
    logs = {name: kept_log(path) for name, path in paths.items()}
    found = comparison_view(logs, Align(align), window)
    stepped = flight_steps(logs) if align == Align.step else {}
    zero = {name: stepped[name][0].time if stepped else log.span[0] for name, log in logs.items()}
    rows = {name: [step.to_json() for step in one] for name, one in stepped.items()}
    return {**_told(found, points), "steps": rows, "zero": zero}


def replay(path: str) -> dict[str, Any]:
    """Pitch, place, motors, set-points and truth at equal times: `start` and `rate`, each column float32 in base 64.

    NaN is where nothing is known. The rate is 50 Hz, less for a log longer than 400 s.
    """
    log = kept_log(path)
    start, end = log.span
    rate = min(REPLAY_HZ, MOST_REPLAYED / max(end - start, 1e-9))
    times = start + np.arange(max(1, int((end - start) * rate) + 1)) / rate
    columns = {name: _sampled(log, name, times) for name in _REPLAYED if name in log and log[name].value.ndim == 1}
    return {
        "start": start,
        "rate": rate,
        "count": len(times),
        "columns": {name: base64.b64encode(column.tobytes()).decode() for name, column in columns.items()},
    }


def converted(path: str, target: str) -> dict[str, Any]:
    """Write the log into a new file, whose suffix says the format. Raises LogError."""
    log = kept_log(path)
    if Path(target).suffix == ".ulg":
        return {"left_out": list(write_ulg(log, target))}
    write_log(log, target)
    return {"left_out": []}


def _overlaps(log: FlightLog, window: tuple[float, float]) -> bool:
    start, end = log.span
    return window[0] < window[1] and window[1] > start and window[0] < end


def _sampled(log: FlightLog, name: str, times: NDArray[np.float64]) -> NDArray[np.float32]:
    channel = log[name]
    place = channel.index(times)
    known = np.where(place >= 0, channel.value[np.maximum(place, 0)], np.nan)
    return known.astype("<f4")


def _told(found: FlightView, points: int) -> dict[str, Any]:
    return {
        "title": found.title,
        "about": found.about,
        "window": list(found.span),
        "views": [
            {"label": one.label, "curves": [_curve(curve, points) for curve in one.curves]} for one in found.views
        ],
        "modes": [vars(band) for band in found.modes],
        "failsafe": [vars(band) for band in found.failsafe],
        "excitations": [vars(band) for band in found.excitations],
        "notes": list(found.notes),
    }


def _curve(curve: Curve, points: int) -> dict[str, Any]:
    time, value = thinned(curve.time, curve.value, min(points, MOST_POINTS))
    packed = {"time": time.astype("<f8"), "value": value.astype("<f4")}
    return {
        "label": curve.label,
        "channel": curve.channel,
        "held": curve.held,
        **{name: base64.b64encode(column.tobytes()).decode() for name, column in packed.items()},
    }


def _rows(log: FlightLog, name: str, kinds: tuple[type, ...]) -> list[list[Any]]:
    """Rows of the provenance that are laid out as ours are; of others' logs what is."""
    rows = log.provenance.get(name)
    found = []
    for row in rows[:MOST_SAID] if isinstance(rows, list) else ():
        if isinstance(row, list) and len(row) == len(kinds):
            cells = [
                cell if kind is str or not isinstance(cell, int) else float(cell)
                for cell, kind in zip(row, kinds, strict=True)
            ]
            if all(isinstance(cell, kind) for cell, kind in zip(cells, kinds, strict=True)):
                found.append([cell[:400] if isinstance(cell, str) else cell for cell in cells])
    return found
