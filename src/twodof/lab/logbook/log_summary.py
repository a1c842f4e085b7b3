"""What the list of logs says about one: when, how long, what flew on which drone, and a small curve."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from twodof.errors import LogError
from twodof.flightlog.contents import excitations
from twodof.flightlog.log import FlightLog
from twodof.lab.logbook.read_logs import kept_log
from twodof.signals import BY_MAT

COLUMNS = 96
_SPARKS = ("theta", "x", "q", "M")
_MOST_TEXT = 200


def summary(path: str) -> dict[str, Any]:
    """The summary of the log in a file, as plain data; what it does not tell is None. Raises LogError."""
    log = kept_log(path)
    start, end = log.span
    told = log.provenance
    flown, drone, recorded = (_part(told, name) for name in ("flown", "drone", "recorded"))
    return {
        "span": [start, end],
        "duration": end - start,
        "began": _text(recorded.get("began")),
        "experiment": _text(told.get("experiment")) or _likely(log),
        "rig": _text(told.get("rig")) or _text(drone.get("rig")),
        "virtual": _flag(flown.get("virtual"), drone.get("virtual")),
        "drone": drone.get("system") if isinstance(drone.get("system"), int) else None,
        "controller": _text(flown.get("controller")) or _text(drone.get("controller")),
        "seed": told["seed"] if isinstance(told.get("seed"), int) else None,
        "reason": _text(flown.get("reason")),
        "channels": len(log.channels),
        "spark": _spark(log),
    }


def _part(told: dict[str, Any], name: str) -> dict[str, Any]:
    found = told.get(name)
    return found if isinstance(found, dict) else {}


def _text(value: object) -> str | None:
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
    """Lowest and highest value of each of `COLUMNS` parts of the flight; None for a part without a sample."""
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
