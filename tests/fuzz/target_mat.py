"""MATLAB files: a log or a LogError."""

import contextlib
import io

import numpy as np
from scipy.io import savemat

from tests.fuzz.target import Target, file
from twodof.errors import LogError
from twodof.flightlog.files import read_log


def seeds() -> list[bytes]:
    """Plain and compressed, with numbers of several kinds and a text."""
    found = []
    for compressed in (False, True):
        sink = io.BytesIO()
        stamps = np.arange(3.0)[:, None]
        q = {"timestamp": stamps, "value": np.ones((3, 1))}
        acc = {"timestamp": stamps, "value": np.zeros((3, 3), np.int8)}
        savemat(sink, {"q": q, "acc": acc, "provenance": '{"seed": 1}', "x": np.eye(2)}, do_compression=compressed)
        found.append(sink.getvalue())
    return found


def attempt(data: bytes) -> None:
    """Read."""
    with contextlib.suppress(LogError):
        log = read_log(file("a.mat", data))
        assert all(np.isfinite(channel.value).all() for channel in log.channels.values())


TARGET = Target("mat", seeds, attempt, 4000)
