"""Work on logs in a process of its own: summaries, views, comparisons, replays and conversions, as plain data."""

from __future__ import annotations

import base64
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, TypeAdapter, ValidationError

from twodof.errors import LogError
from twodof.flightlog.contents import excitations
from twodof.flightlog.files import read_log, write_log
from twodof.flightlog.log import FlightLog, decimate, log_of_rows
from twodof.flightlog.provenance import versions
from twodof.flightlog.recovery import recover
from twodof.flightlog.ulog_file import write_ulg
from twodof.report.plots.comparison_view import Align, common_steps, comparison_view
from twodof.report.plots.flight_view import Curve, FlightView, flight_view, signal_names, signals_panel
from twodof.report.step_responses import folded_steps, step_responses
from twodof.signals import BY_MAT

MOST_BYTES = 96 << 20
"""Most bytes of the files whose logs are kept in memory, where a log takes 5 to 12 times the size of its file."""

_KEPT: OrderedDict[tuple[str, int, int, bool], FlightLog] = OrderedDict()


def kept_log(path: str, topics: bool = False) -> FlightLog:
    """Return the log in a file, kept in memory until the file changes; `topics` as read_log. Raises LogError."""
    try:
        found = Path(path).stat()
    except OSError as reason:  # deleted since it was asked for
        raise LogError("is not there any more", Path(path).name, "choose one of the list") from reason
    topics = topics and path.lower().endswith(".ulg")
    key = (path, found.st_mtime_ns, found.st_size, topics)
    if key in _KEPT:
        _KEPT.move_to_end(key)
        return _KEPT[key]
    while _KEPT and sum(size for _, _, size, _ in _KEPT) + found.st_size > MOST_BYTES:
        _KEPT.popitem(last=False)
    log = read_log(path, topics)
    if found.st_size <= MOST_BYTES:
        _KEPT[key] = log
    return log


def mat_of_rows(path: str, columns: list[str], target: str) -> None:
    """Write the rows in a file, as `log_of_rows` reads them, to a .mat file. Raises LogError."""
    now = datetime.now().astimezone().isoformat(timespec="seconds")
    log = log_of_rows(Path(path).read_bytes(), columns, {"seen": {"saved": now}, "versions": versions()})
    write_log(log, target)


COLUMNS = 96
_SPARKS = ("theta", "x", "q", "M")
_MOST_TEXT = 200


def summary(path: str) -> dict[str, Any]:
    """Return the summary of the log in a file, with None for unknown fields. Raises LogError."""
    log = kept_log(path)
    start, end = log.span
    told = log.provenance
    flown, drone, recorded = (_table(told, name) for name in ("flown", "drone", "recorded"))
    return {
        "span": [start, end],
        "duration": end - start,
        "began": _short_text(recorded.get("began")),
        "experiment": _short_text(told.get("experiment")) or _likely(log),
        "rig": _short_text(told.get("rig")) or _short_text(drone.get("rig")),
        "virtual": _flag(flown.get("virtual"), drone.get("virtual")),
        "drone": drone.get("system") if isinstance(drone.get("system"), int) else None,
        "controller": _short_text(flown.get("controller")) or _short_text(drone.get("controller")),
        "seed": told["seed"] if isinstance(told.get("seed"), int) else None,
        "reason": _short_text(flown.get("reason")),
        "channels": len(log.channels),
        "spark": _spark(log),
    }


def _table(told: dict[str, Any], name: str) -> dict[str, Any]:
    found = told.get(name)
    return found if isinstance(found, dict) else {}


def _short_text(value: object) -> str | None:
    return value[:_MOST_TEXT] if isinstance(value, str) and value else None


def _flag(*values: object) -> bool | None:
    return next((value for value in values if isinstance(value, bool)), None)


def _likely(log: FlightLog) -> str | None:
    try:
        found = excitations(log)
    except LogError:  # a log of others that lacks what tells it
        return None
    return max(found, key=lambda one: one.duration).name if found else None


def _spark(log: FlightLog) -> dict[str, Any] | None:
    """Return a small curve: the lowest and highest value of each of `COLUMNS` parts, None for an empty part."""
    known = [name for name in (*_SPARKS, *log) if name in log and len(log[name]) > 1 and log[name].value.ndim == 1]
    if not known:
        return None
    channel = log[known[0]]
    start, end = log.span
    edges = np.searchsorted(channel.time, np.linspace(start, end, COLUMNS + 1))
    edges[-1] = len(channel)
    parts = [channel.value[first:last] for first, last in pairwise(edges.tolist())]
    row = BY_MAT.get(known[0])
    return {
        "channel": known[0],
        "text": row.text if row else known[0],
        "unit": channel.unit,
        "low": [float(part.min()) if part.size else None for part in parts],
        "high": [float(part.max()) if part.size else None for part in parts],
    }


MOST_POINTS = 4000
MOST_SIGNALS = 20
"""Most signals of a plot."""
MOST_SAID = 2000
"""Most texts, and most changes of parameters, of one log."""
_Short = Annotated[str, AfterValidator(lambda text: text[:400])]
_TEXT = TypeAdapter(tuple[float, _Short, _Short])
_CHANGE = TypeAdapter(tuple[float, _Short, float])
MOST_FOLDED = 100
"""Most responses of steps that are laid over each other, of each loop and set of parameters."""
REPLAY_HZ, MOST_REPLAYED = 50.0, 20_000
_REPLAYED = ("theta", "x", "M", "T", "theta0", "x0", "theta_true", "x_true")
_FIRST_CHANNELS = 6


def facts(path: str) -> dict[str, Any]:
    """Return the summary, the channels (name, unit, samples), the parameters at the start, texts and changes."""
    log = kept_log(path)
    channels = [{"name": name, "unit": one.unit, "samples": len(one)} for name, one in log.channels.items()]
    parameters = log.provenance.get("parameters")
    known = sorted(parameters.items())[:MOST_SAID] if isinstance(parameters, dict) else []
    return {
        **summary(path),
        "all_channels": channels,
        "parameters": [[str(name)[:80], value] for name, value in known if isinstance(value, int | float)],
        "texts": _rows(log, "texts", _TEXT),
        "changes": _rows(log, "changes", _CHANGE),
    }


def view(
    path: str, window: tuple[float, float] | None, topics: list[str], points: int, panels: list[str]
) -> dict[str, Any]:
    """Return the curves of a plot within `window` [s], each thinned to about `points`. Raises LogError.

    Each of `panels` has the names of its signals, a line each. They come before the others.
    """
    log = kept_log(path, topics=bool(panels))
    try:
        found = flight_view(log, topics, window)
    except LogError:
        if topics or (window is not None and not _overlaps(log, window)):
            raise
        found = flight_view(log, [*log][:_FIRST_CHANNELS], window)  # a log of others
    own = tuple(signals_panel(log, panel.splitlines()[:MOST_SIGNALS], window) for panel in panels)
    return _told(replace(found, views=own + found.views), points)


def signals(path: str) -> list[list[str]]:
    """Return name, description and unit of each signal; of another vehicle's .ulg, of each field of each topic too."""
    return [[name, *words] for name, words in signal_names(kept_log(path, topics=True)).items()]


def steps(path: str) -> dict[str, Any]:
    """Return the responses to the steps of set-points; `unclear` has the reason if they are unknown."""
    try:
        return {"steps": [step.to_json() for step in step_responses(kept_log(path))], "unclear": ""}
    except LogError as reason:
        return {"steps": [], "unclear": reason.what}


def fold(path: str) -> list[dict[str, Any]]:
    """Return the steps of each loop over each other, by parameters flown: all responses, mean and deviation."""
    log = kept_log(path)
    return [
        {
            "loop": one.loop,
            "after_s": one.after_s,
            "statistics": one.statistics(),
            "time": one.time.tolist(),
            "shares": one.shares[-MOST_FOLDED:].tolist(),
            "mean": one.shares.mean(axis=0).tolist(),
            "deviation": one.shares.std(axis=0, ddof=int(len(one.shares) > 1)).tolist(),
        }
        for one in folded_steps(log, step_responses(log))
    ]


def compare(
    paths: dict[str, str], align: str, window: tuple[float, float] | None, points: int, zero: list[float]
) -> dict[str, Any]:
    """Compare flights, named by `paths`: the view, and the steps and the time 0 [s] of each, given as `zero` or found.

    Flights without steps of one loop are aligned at their starts; `unaligned` says why. Raises LogError otherwise.
    """
    logs = {name: kept_log(path) for name, path in paths.items()}
    given = dict(zip(paths, zero, strict=False))
    stepped, why = common_steps(logs) if align == Align.step else ({}, "")
    found = comparison_view(logs, Align.step if stepped else Align.start, window, given)
    zeros = {name: stepped[name][0].time if stepped else log.span[0] for name, log in logs.items()} | given
    rows = {name: [step.to_json() for step in one] for name, one in stepped.items()}
    return {**_told(found, points), "steps": rows, "zero": zeros, "unaligned": why}


def replay(path: str) -> dict[str, Any]:
    """Sample pitch, place, motors, set-points and truth at equal times, each column float32 in base 64.

    Unknown values are NaN. The rate is 50 Hz, less for a log longer than 400 s.
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


def converted(path: str, target: str) -> None:
    """Write the log into a new file, whose suffix gives the format. Raises LogError."""
    write: Callable[..., object] = write_ulg if target.endswith(".ulg") else write_log
    write(kept_log(path), target)


def recovered(path: str, target: str) -> dict[str, Any]:
    """Write the sound parts of a damaged recording into a new file. Raises LogError if nothing of it can be read."""
    found = recover(path)
    found.write(target)
    return {"samples": found.samples, "what": list(found.what)}


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
        **{key: [vars(band) for band in getattr(found, key)] for key in ("modes", "failsafe", "excitations")},
        "notes": list(found.notes),
    }


def _curve(curve: Curve, points: int) -> dict[str, Any]:
    time, value = decimate(curve.time, curve.value, min(points, MOST_POINTS))
    packed = {"time": time.astype("<f8"), "value": value.astype("<f4")}
    return {
        "label": curve.label,
        "channel": curve.channel,
        "held": curve.held,
        **{name: base64.b64encode(column.tobytes()).decode() for name, column in packed.items()},
    }


def _rows(log: FlightLog, name: str, kind: TypeAdapter[Any]) -> list[list[Any]]:
    """Return those rows of the provenance's entry `name` that have the type `kind`."""
    rows, found = log.provenance.get(name), []
    for row in rows[:MOST_SAID] if isinstance(rows, list) else ():
        with suppress(ValidationError):
            found.append([*kind.validate_python(row)])
    return found
