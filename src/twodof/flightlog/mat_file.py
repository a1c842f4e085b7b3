"""Flight logs in the drone's .mat layout, a struct {timestamp, value} for each channel; scipy.io has the format."""

import re
import warnings
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from struct import unpack_from
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat, savemat
from scipy.io.matlab import MatlabOpaque

from twodof.errors import LogError, nearest, shown
from twodof.flightlog import provenance
from twodof.flightlog.atomic import atomic_write
from twodof.flightlog.log import Channel, FlightLog, row_times
from twodof.signals import BY_MAT

_NOTE = "provenance"
# Channels whose parts are fields of their own, and the parts that MATLAB keeps as logical.
_SPREAD = frozenset({"lmnf"})
_LOGICAL = frozenset({"openloop", "enableM", "enableT"})
_MATLAB_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")


def decode_mat(data: bytes, where: str, time: str = "", period: str = "") -> FlightLog:
    """Return the log in the bytes of a .mat file. Channels that TOPICS does not know are kept, without a unit.

    `time` names a vector of time stamps [s], if the file is not such a log: its vectors of that length become channels.
    With a `period`, a number of seconds or the name of a scalar, all vectors become channels. Vectors in a struct are
    named as in MATLAB, `data.u`.

    Raises LogError for a file that is truncated, foreign or damaged and for channels that Channel refuses. Variables
    that are not channels are named in provenance["ignored"].
    """
    held = _variables(data, where)
    if time or period:
        channels = _vectors(held, where, time, period)
        ignored = [_described(name, value) for name, value in held.items() if isinstance(value, MatlabOpaque)]
        kept = {"file": provenance.of_file(where, data, "mat"), **({"ignored": ignored} if ignored else {})}
        return FlightLog(channels, kept)
    channels = {}
    for name, value in held.items():
        fields = _struct(value)
        if "timestamp" in fields and len(fields) > 1:
            channels[name] = _channel(name, fields, f"{where}: {name}")
        elif name in BY_MAT:
            what = f"channel {name!r} is not a struct {{timestamp, value}} of real numbers"
            raise LogError(what, where, "export the log again")
    if not channels:
        names = ", ".join(_described(*item) for item in held.items()) or "nothing"
        remedy = "give a log of the drone; `twodof identify` reads vectors: --time NAME or --period SECONDS"
        raise LogError(f"no struct {{timestamp, value}} in the file, which holds: {names}", where, remedy)
    note = held.get(_NOTE)
    noted = isinstance(note, np.ndarray) and note.dtype.kind == "U" and note.size == 1
    kept = provenance.from_json(str(note.item()), where) if isinstance(note, np.ndarray) and noted else {}
    kept["file"] = provenance.of_file(where, data, "mat")
    ignored = [name for name in held if name not in channels and not (noted and name == _NOTE)]
    if ignored:
        kept["ignored"] = ignored
    return FlightLog(channels, kept)


def write_mat(log: FlightLog, path: str | Path) -> None:
    """Write a log in the drone's layout, atomically. Raises LogError for names that MATLAB cannot hold."""
    note = provenance.to_json(log)
    content: dict[str, Any] = {}
    for name, channel in log.channels.items():
        if not _MATLAB_NAME.fullmatch(name) or name == _NOTE:
            raise LogError(f"{name!r} cannot name a MATLAB variable", str(path), "rename the channel")
        content[name] = {"timestamp": channel.time[:, None], **_parts(name, channel, str(path))}
    content[_NOTE] = note
    buffer = BytesIO()
    savemat(buffer, content, do_compression=True, long_field_names=True)
    with atomic_write(path) as file:
        file.write(buffer.getbuffer())


def _variables(data: bytes, where: str) -> dict[str, Any]:
    """Return the variables of a MATLAB v5 file by name, objects (datetime, string, table) as MatlabOpaque.

    Raises LogError.
    """
    if data[:10] == b"MATLAB 7.3" or b"\x89HDF" in (data[:4], data[512:516]):
        raise LogError("is a MATLAB v7.3 (HDF5) file", where, "save it in MATLAB with save(..., '-v7')")
    if data[126:128] not in (b"IM", b"MI"):
        raise LogError("is not a MATLAB v5 file", where, "save it in MATLAB with save(..., '-v7')")
    found: dict[str, Any] = {}
    at = 128
    while at < len(data):
        # One by one: scipy gives every object the name "None".
        size = unpack_from("<I" if data[126:128] == b"IM" else ">I", data, at + 4)[0] if at + 8 <= len(data) else 0
        with warnings.catch_warnings(action="ignore"):
            one = loadmat(BytesIO(data[:128] + data[at : at + 8 + size]))
        for name, value in one.items():
            name = value["s0"].item().decode("latin-1") if isinstance(value, MatlabOpaque) else name
            if name in found and not name.startswith("__"):
                raise LogError(f"variable {shown(name)} is there twice", where, "save the file again")
            found[name] = value
        at += 8 + size
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _described(name: str, value: object) -> str:
    """Return the name of a variable, and its class if it is a MATLAB object."""
    return f"{name} (a MATLAB {value['s2'].item().decode('latin-1')})" if isinstance(value, MatlabOpaque) else name


def _vectors(held: Mapping[str, Any], where: str, time: str, period: str) -> dict[str, Channel]:
    """Return the real vectors as channels, with `time` those of its length. Raises LogError."""
    # The fields of a 1 x 1 struct of matrices are variables too.
    fields = {f"{name}.{field}": part for name, value in held.items() for field, part in _struct(value).items()}
    numbers = {
        name: np.asarray(value, dtype=np.float64).ravel()
        for name, value in {**held, **fields}.items()
        if isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and value.size == max(value.shape, default=0)
    }
    there = nearest(time or period, [_described(*item) for item in held.items()])

    def scalar(name: str) -> float:
        if name not in numbers or numbers[name].size != 1:
            raise LogError(f"no scalar is called {shown(name)}", where, f"give seconds, or one of: {there}")
        return float(numbers[name][0])

    vectors = {name: vector for name, vector in numbers.items() if vector.size > 1}
    if period:
        times = {size: row_times(size, period, scalar, where) for size in {one.size for one in vectors.values()}}
    elif time not in held and time not in numbers:
        remedy = f"there are: {there}; without time stamps: --period SECONDS"
        raise LogError(f"variable {shown(time)} is missing", where, remedy)
    elif time not in vectors:
        raise LogError(f"{time!r:.80} is not a vector of numbers", where, "name the vector of time stamps")
    else:
        times = {vectors[time].size: vectors.pop(time)}
    channels = {
        name: Channel(times[vector.size], vector, name=f"{where}: {name}")
        for name, vector in vectors.items()
        if vector.size in times
    }
    if not channels:
        what = f"no vector is as long as {time!r:.80} ({next(iter(times))})" if time else "holds no vector"
        raise LogError(what, where, f"give vectors of one length; there are: {there}")
    return channels


def _struct(value: object) -> dict[str, NDArray[np.float64]]:
    """Return the fields of a 1 x 1 struct of real matrices; none of anything else."""
    if not isinstance(value, np.ndarray) or value.dtype.names is None or value.shape != (1, 1):
        return {}
    fields = {name: value[0, 0][name] for name in value.dtype.names}
    if not all(isinstance(one, np.ndarray) and one.dtype.kind in "fiub" and one.ndim == 2 for one in fields.values()):
        return {}
    return {name: np.asarray(one, dtype=np.float64) for name, one in fields.items()}


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
            raise LogError(f"it has {width} columns, {name!r} has {row.width}", where, "export the log again")
        return Channel(time, value, row.unit if row else "", row.fields if row else (), where)
    names = tuple(parts) if row is None else row.fields
    if set(names) != set(parts) or any(part.ndim != 1 for part in parts.values()):
        raise LogError(f"its fields are {', '.join(parts)}", where, f"give columns called {', '.join(names)}")
    table = np.column_stack([parts[field] for field in names]) if len(time) else np.empty((0, len(names)))
    return Channel(time, table, row.unit if row else "", names, where)


def _column(array: NDArray[np.float64], samples: int, where: str) -> NDArray[np.float64]:
    """Return (n,) for an array n x 1 or 1 x n, else (n, k). Raises LogError for another number of samples."""
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
        raise LogError(f"a field of {name!r} cannot name a MATLAB field", where, "rename the field")
    if len(channel.fields) != table.shape[1]:
        raise LogError(f"channel {name!r} needs a name for each column", where, "give the channel `fields`")
    return {
        field: table[:, [k]].astype(bool) if field in _LOGICAL else table[:, [k]]
        for k, field in enumerate(channel.fields)
    }
