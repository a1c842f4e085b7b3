"""A log as ULog, the format of PX4's tools: the signals of TOPICS, a topic each."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from twodof.errors import LogError
from twodof.flightlog.log import FlightLog
from twodof.flightlog.steps import BOOT
from twodof.flightlog.ulog.writer import LEVELS, ULogWriter, topic_format
from twodof.signals import BY_MAT, SEVERITIES

_PARAMETER = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,15}")
_LAST_US = 2.0**63
_PIECE = 10_000
"""Records handed over at once: the writer takes no more than fit into what it lets wait."""


def write_ulg(log: FlightLog, path: str | Path) -> tuple[str, ...]:
    """Writes the log into a new ULog file that `read_ulog` reads; returns the channels that ULog cannot name.

    Stamps are rounded to microseconds. Words and the parameters at the start go with it. Raises LogError where the log
    has none of our signals or a time before 0, and where the file exists; RecordingError where the disk refuses.
    """
    topics = {name: BY_MAT[name] for name in log if name in BY_MAT and len(log[name])}
    if not topics:
        raise LogError("none of its channels is a signal of ours", log.source, "write .mcap, .mat or .parquet")
    start, end = log.span
    if start < 0.0 or end * 1e6 >= _LAST_US:
        raise LogError(f"it reaches from {start:g} to {end:g} s", log.source, "ULog counts microseconds from 0")
    formats = dict(topic_format(topic) for topic in topics.values())
    parameters = _parameters(log.provenance)
    with ULogWriter(path, formats, {"sys_uuid": "exported"}, parameters, round(1e6 * start), full="wait") as writer:
        for name, topic in topics.items():
            channel = log[name]
            record = topic.name.replace(".", "_")
            rows = np.zeros(len(channel), dtype=writer.layout(record))
            rows["timestamp"] = np.rint(1e6 * channel.time).astype(np.uint64)
            values = channel.value if channel.value.ndim == 2 else channel.value[:, None]
            for place, field in enumerate(topic.fields or ("value",)):
                rows[field] = values[:, place]
            for first in range(0, len(rows), _PIECE):
                writer.write_many(record, rows[first : first + _PIECE])
        for time, severity, text in _texts(log.provenance):
            writer.text(severity, max(0, round(1e6 * (time - BOOT))), text)
    return tuple(name for name in log if name not in topics)


def _parameters(told: Mapping[str, Any]) -> dict[str, float]:
    rows = told.get("parameters")
    known = rows.items() if isinstance(rows, dict) else ()
    return {name: value for name, value in known if _PARAMETER.fullmatch(name) and isinstance(value, int | float)}


def _texts(told: Mapping[str, Any]) -> list[tuple[float, str, str]]:
    rows = told.get("texts")
    found = []
    for row in rows if isinstance(rows, list) else ():
        match row:
            case [int() | float() as time, str() as severity, str() as text]:
                urgent = severity in SEVERITIES and SEVERITIES.index(severity) < SEVERITIES.index("error")
                known = "error" if urgent else severity if severity in LEVELS else "info"
                found.append((float(time), known, text))
            case _:
                continue
    return found
