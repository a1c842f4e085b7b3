"""ULog: a log or a LogError, read and recovered."""

import contextlib

from tests.flightlog.test_ulog_file import px4_log
from tests.fuzz.target import Target, file
from twodof.errors import LogError
from twodof.flightlog.files import read_log
from twodof.flightlog.mcap_file import recover
from twodof.flightlog.ulog_writer import ULogWriter


def seeds() -> list[bytes]:
    """As PX4 writes it, and as ours does."""
    path = file("seed.ulg", b"")
    path.unlink()
    with ULogWriter(path):
        pass
    return [px4_log()[:6000], path.read_bytes()[:6000]]


def attempt(data: bytes) -> None:
    """Read and recovered."""
    path = file("a.ulg", data)
    with contextlib.suppress(LogError):
        read_log(path)
    with contextlib.suppress(LogError):
        recover(path)


TARGET = Target("ulog", seeds, attempt, 8000)
