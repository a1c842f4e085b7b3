"""Work on logs in a process of its own: summaries, views, comparisons, replays and conversions, as plain data."""

import base64
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, TypeAdapter, ValidationError

from twodof.errors import LogError
from twodof.flightlog.contents import log_summary
from twodof.flightlog.files import read_log, write_log
from twodof.flightlog.log import FlightLog, decimate, log_of_rows
from twodof.flightlog.mcap_file import recover
from twodof.flightlog.provenance import versions
from twodof.flightlog.ulog_file import write_ulg
from twodof.report.plots.comparison_view import Align, common_steps, comparison_view, flight_names
from twodof.report.plots.flight_view import Curve, FlightView, flight_view, signal_names, signals_panel
from twodof.report.step_responses import folded_steps, step_responses

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


def summary(path: str) -> dict[str, Any]:
    """Return `log_summary` of the log in a file. Raises LogError."""
    return log_summary(kept_log(path))


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
        **log_summary(log),
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
        start, end = log.span
        if topics or (window is not None and not (window[0] < window[1] and start < window[1] and window[0] < end)):
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
    return [one.to_json(MOST_FOLDED) for one in folded_steps(log, step_responses(log))]


def compare(
    paths: dict[str, str], align: str, window: tuple[float, float] | None, points: int, zero: list[float]
) -> dict[str, Any]:
    """Compare flights, named by `paths`: the view, and the steps and the time 0 [s] of each, given as `zero` or found.

    `names` has a name of each by what differs among them, as curves are called. Flights without steps of one loop are
    aligned at their starts; `unaligned` says why. Raises LogError otherwise.
    """
    logs = {name: kept_log(path) for name, path in paths.items()}
    given = dict(zip(paths, zero, strict=False))
    stepped, why = common_steps(logs) if align == Align.step else ({}, "")
    zeros = {name: stepped[name][0].time if stepped else log.span[0] for name, log in logs.items()} | given
    names, kind = flight_names(logs), Align.step if stepped else Align.start
    called = {names[name]: log for name, log in logs.items()}
    found = comparison_view(called, kind, window, {names[name]: time for name, time in given.items()})
    rows = {name: [step.to_json() for step in one] for name, one in stepped.items()}
    return {**_told(found, points), "steps": rows, "zero": zeros, "names": names, "unaligned": why}


def replay(path: str) -> dict[str, Any]:
    """Sample pitch, place, motors, set-points and truth at equal times, each column float32 in base 64.

    Unknown values are NaN. The rate is 50 Hz, less for a log longer than 400 s.
    """
    log = kept_log(path)
    start, end = log.span
    rate = min(REPLAY_HZ, MOST_REPLAYED / max(end - start, 1e-9))
    times = start + np.arange(max(1, int((end - start) * rate) + 1)) / rate
    names = [name for name in _REPLAYED if name in log and log[name].value.ndim == 1]
    columns = {name: log[name].held(times).astype("<f4") for name in names}
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


def _told(found: FlightView, points: int) -> dict[str, Any]:
    views = [{"label": one.label, "curves": [_curve(curve, points) for curve in one.curves]} for one in found.views]
    return {
        "title": found.title,
        "about": found.about,
        "window": list(found.span),
        "views": views,
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
