"""The drone's own log layout: a MATLAB v5 file in which every channel is a struct {timestamp, value}.

The open-loop message `lmnf` has a field for each of its parts instead of `value`. What is written reads back
bit for bit; one more variable, the text `provenance`, says as JSON where the log came from.
"""

import re
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LogError
from twodof.flightlog import provenance
from twodof.flightlog.atomic import atomic_write
from twodof.flightlog.log import Channel, FlightLog
from twodof.flightlog.mat.structure_check import Variable, variables
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
    from scipy.io.matlab import MatReadError, loadmat  # imported late: most commands start without it

    budget = MemoryBudget(len(data), where)
    held = variables(data, where, budget)
    wanted = [variable for variable in held if _is_channel(variable, where)]
    if not wanted:
        names = ", ".join(variable.name for variable in held) or "nothing"
        raise LogError(
            f"no struct {{timestamp, value}} in the file, which holds: {names}", where, "give a log of the drone"
        )
    texts = [variable.name for variable in held if variable.text and variable.name == _NOTE]
    chosen = [*(variable.name for variable in wanted), *texts]
    for variable in held:
        if variable.name in chosen:
            # Inflated once more, and a float64 of each number, before it becomes samples; letters are four bytes.
            budget.take(16 * (variable.numbers + variable.letters))
            budget.samples(variable.numbers, 0)
    try:
        loaded = loadmat(BytesIO(data), mat_dtype=True, chars_as_strings=True, variable_names=chosen)
    except (MatReadError, ValueError, TypeError, KeyError, OSError, OverflowError) as reason:
        raise LogError(f"cannot be read: {reason}", where, "export it again as a MATLAB v7 file") from reason
    note = loaded[_NOTE] if texts else np.empty(0)
    kept = provenance.from_json(str(note[0]), where, budget) if note.size else {}
    kept["file"] = provenance.of_file(path, data, "mat")
    ignored = [variable.name for variable in held if variable.name not in chosen]
    if ignored:
        kept["ignored"] = ignored
    channels = {
        variable.name: _channel(variable.name, loaded[variable.name][0, 0], f"{where}: {variable.name}")
        for variable in wanted
    }
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


def _is_channel(variable: Variable, where: str) -> bool:
    fields = variable.fields or {}
    if "timestamp" in fields and len(fields) > 1:
        return True
    if variable.name in BY_MAT:
        raise LogError(
            f"channel {variable.name!r} is not a struct {{timestamp, value}} of real numbers",
            where,
            "export the log again",
        )
    return False


def _channel(name: str, struct: Any, where: str) -> Channel:
    stamps = struct["timestamp"]
    if stamps.size and 1 not in stamps.shape:
        raise LogError(f"timestamp is {stamps.shape}, not a column", where, "export the log again")
    time = np.asarray(stamps, dtype=np.float64).ravel()
    row = BY_MAT.get(name)
    parts = {
        field: _column(struct[field], len(time), f"{where}.{field}")
        for field in struct.dtype.names
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


def _column(array: NDArray[Any], samples: int, where: str) -> NDArray[np.float64]:
    """(n,) from n x 1 or 1 x n, else (n, k). It must have n samples."""
    if samples == 0 and array.size == 0:
        return np.empty(0)
    if array.shape == (1, samples):
        array = array.T
    if len(array) != samples:
        raise LogError(f"{len(array)} samples for {samples} time stamps", where, "record or export the log again")
    return np.asarray(array[:, 0] if array.shape[1] == 1 else array, dtype=np.float64)


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
