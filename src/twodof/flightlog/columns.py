"""A table of somebody else's: columns of any names, one of which holds the time stamps."""

from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LogError, nearest, shown
from twodof.flightlog import provenance
from twodof.flightlog.log import Channel, FlightLog
from twodof.flightlog.mat.variables import variables
from twodof.flightlog.memory_budget import MemoryBudget
from twodof.flightlog.table.table_file import read_csv, read_parquet

SUFFIXES = (".csv", ".parquet", ".mat")


def read_columns(path: str | Path, time: str) -> FlightLog:
    """Reads a .csv or .parquet table, or the vectors of a .mat file, whose time stamps [s] are in the column `time`.

    The other columns become channels under their own names; of a heading such as `speed [m/s]` the bracket is the
    unit. Raises LogError for another suffix, a column that is not there, and a file that is damaged or no table.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".csv":
        return read_csv(path, time)
    if suffix == ".parquet":
        return read_parquet(path, time)
    if suffix == ".mat":
        return _read_vectors(path, time)
    raise LogError(f"no table has the suffix {suffix!r:.40}", str(path), f"use {', '.join(SUFFIXES)}")


def _read_vectors(path: str | Path, time: str) -> FlightLog:
    """The real vectors of a MATLAB v5 file that are as long as `time`."""
    data = provenance.read_bytes(path)
    where = str(path)
    # It refuses what is damaged, and what would grow beyond bounds when it is inflated.
    held = [one.name for one in variables(data, where, MemoryBudget(len(data), where))]
    if time not in held:
        raise LogError(f"there is no variable {shown(time)}", where, f"there are: {nearest(time, held)}")
    from scipy.io import loadmat  # imported late: most commands start without it

    try:
        found = loadmat(BytesIO(data), variable_names=held)
    except (ValueError, TypeError, OSError, IndexError, KeyError) as reason:
        raise LogError(f"cannot be read: {reason!s:.100}", where, "write it again with -v7") from reason
    vectors = {name: vector for name in held if (vector := _vector(found.get(name))) is not None}
    if time not in vectors:
        raise LogError(f"{time!r:.80} is not a vector of numbers", where, "name the vector of time stamps")
    stamps = vectors.pop(time)
    channels = {
        name: Channel(stamps, vector, name=f"{where}: {name}")
        for name, vector in vectors.items()
        if vector.size == stamps.size
    }
    if not channels:
        raise LogError(f"no vector is as long as {time!r:.80} ({stamps.size})", where, "give vectors of one length")
    return FlightLog(channels, {"file": provenance.of_file(path, data, "mat")})


def _vector(value: object) -> NDArray[np.float64] | None:
    """A 1 x n or n x 1 array of real numbers as (n,), None for anything else."""
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiub" or value.ndim > 2:
        return None
    return np.asarray(value, dtype=np.float64).ravel() if value.size == max(value.shape, default=0) else None
