"""The drone's own log layout: a MATLAB v5 file in which every channel is a struct {timestamp, value}.

The open-loop message `lmnf` has a field for each of its parts instead of `value`. What is written reads back
bit for bit; one more variable, the text `provenance`, says as JSON where the log came from.
"""

import re
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LogError
from twodof.flightlog import provenance
from twodof.flightlog.atomic import atomic_write
from twodof.flightlog.log import Channel, FlightLog
from twodof.flightlog.mat.variables import variables
from twodof.flightlog.memory_budget import MemoryBudget
from twodof.signals import BY_MAT

_NOTE = "provenance"
# Channels whose parts are fields of their own, and the parts that MATLAB keeps as logical.
_SPREAD = frozenset({"lmnf"})
_LOGICAL = frozenset({"openloop", "enableM", "enableT"})
_MATLAB_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")


def read_mat(path: str | Path) -> FlightLog:
    """Reads a .mat log. Channels that TOPICS does not know are kept, without a unit.

    Raises LogError for a file that is missing, truncated, foreign or damaged and for channels that Channel
    refuses. Variables that are not channels are named in provenance["ignored"].
    """
    data = provenance.read_bytes(path)
    where = str(path)
    budget = MemoryBudget(len(data), where)
    held = variables(data, where, budget)
    channels = {}
    for name, _, fields in held:
        if fields and "timestamp" in fields and len(fields) > 1:
            channels[name] = _channel(name, fields, f"{where}: {name}")
        elif name in BY_MAT:
            what = f"channel {name!r} is not a struct {{timestamp, value}} of real numbers"
            raise LogError(what, where, "export the log again")
    if not channels:
        names = ", ".join(variable.name for variable in held) or "nothing"
        raise LogError(
            f"no struct {{timestamp, value}} in the file, which holds: {names}", where, "give a log of the drone"
        )
    notes = {variable.name: variable.text for variable in held if variable.text and variable.name == _NOTE}
    kept = provenance.from_json(notes[_NOTE], where, budget) if notes else {}
    kept["file"] = provenance.of_file(path, data, "mat")
    ignored = [variable.name for variable in held if variable.name not in (*channels, *notes)]
    if ignored:
        kept["ignored"] = ignored
    return FlightLog(channels, kept)


def write_mat(log: FlightLog, path: str | Path) -> None:
    """Writes a log in the drone's layout, atomically. Raises LogError for names that MATLAB cannot hold."""
    note = provenance.to_json(log)
    content: dict[str, Any] = {}
    for name, channel in log.channels.items():
        if not _MATLAB_NAME.fullmatch(name) or name == _NOTE:
            raise LogError(f"{name!r} cannot name a MATLAB variable", str(path), "rename the channel")
        content[name] = {"timestamp": channel.time[:, None], **_parts(name, channel, str(path))}
    content[_NOTE] = note
    from scipy.io import savemat  # imported late: most commands start without it

    buffer = BytesIO()
    savemat(buffer, content, do_compression=True, long_field_names=True)
    with atomic_write(path) as file:
        file.write(buffer.getbuffer())


def _channel(name: str, struct: Mapping[str, NDArray[np.float64]], where: str) -> Channel:
    stamps = struct["timestamp"]
    if stamps.size and 1 not in stamps.shape:
        raise LogError(f"timestamp is {stamps.shape}, not a column", where, "export the log again")
    time = stamps.ravel()
    row = BY_MAT.get(name)
    parts = {
        field: _column(values, len(time), f"{where}.{field}")
        for field, values in struct.items()
        if field != "timestamp"
    }
    if set(parts) == {"value"} and name not in _SPREAD:
        value = parts["value"]
        width = 1 if value.ndim == 1 else value.shape[1]
        if row is not None and width != row.width and len(time):
            raise LogError(f"{width} columns where {name!r} has {row.width}", where, "export the log again")
        return Channel(time, value, row.unit if row else "", row.fields if row else (), where)
    names = tuple(parts) if row is None else row.fields
    if set(names) != set(parts) or any(part.ndim != 1 for part in parts.values()):
        raise LogError(f"its fields are {', '.join(parts)}", where, f"expected {', '.join(names)}")
    table = np.column_stack([parts[field] for field in names]) if len(time) else np.empty((0, len(names)))
    return Channel(time, table, row.unit if row else "", names, where)


def _column(array: NDArray[np.float64], samples: int, where: str) -> NDArray[np.float64]:
    """(n,) from n x 1 or 1 x n, else (n, k). It must have n samples."""
    if samples == 0 and array.size == 0:
        return np.empty(0)
    if array.shape == (1, samples):
        array = array.T
    if len(array) != samples:
        raise LogError(f"{len(array)} samples for {samples} time stamps", where, "record or export the log again")
    return array[:, 0] if array.shape[1] == 1 else array


def _parts(name: str, channel: Channel, where: str) -> dict[str, NDArray[Any]]:
    table = channel.value if channel.value.ndim == 2 else channel.value[:, None]
    if name not in _SPREAD and not (name not in BY_MAT and channel.fields):
        return {"value": table}
    if not all(_MATLAB_NAME.fullmatch(field) and field != "timestamp" for field in channel.fields):
        raise LogError(f"a field of {name!r} cannot name a MATLAB field", where, "rename it")
    if len(channel.fields) != table.shape[1]:
        raise LogError(f"channel {name!r} needs a name for each column", where, "give Channel its fields")
    return {
        field: table[:, [k]].astype(bool) if field in _LOGICAL else table[:, [k]]
        for k, field in enumerate(channel.fields)
    }
