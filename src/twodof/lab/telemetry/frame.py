"""The binary message of telemetry, little-endian: a header of 24 bytes, the times, then column by column."""

from __future__ import annotations

import struct
import time

import numpy as np
from numpy.typing import NDArray

ROWS = 1
"""The first byte: rows of a subscription. Others may come, and are to be passed over."""
_HEADER = struct.Struct("<BBHIIId")


def header(number: int, count: int, dropped: int) -> bytes:
    """What stands before the rows: kind, 0, subscription, rows, rows dropped so far, 0, the server's unix time [s].

    It has 24 bytes, so that the times behind it are aligned.
    """
    return _HEADER.pack(ROWS, 0, number, count, dropped & 0xFFFFFFFF, 0, time.time())


def body(times: NDArray[np.float64], values: NDArray[np.float32]) -> bytes:
    """The drone's times (n,) [s] and the values (n, columns), column by column."""
    columns = np.ascontiguousarray(values.T, dtype="<f4")
    return np.asarray(times, dtype="<f8").tobytes() + columns.tobytes()
