"""Log files of each format: a log or a LogError; what is recovered of one is a whole recording."""

import contextlib

import numpy as np

from tests.flightlog.synthetic import attitude_steps
from tests.flightlog.test_ulog_file import px4_log
from tests.fuzz.target import Target, file
from twodof.errors import LogError
from twodof.flightlog.contents import describe
from twodof.flightlog.files import read_log, write_log
from twodof.flightlog.log import FlightLog
from twodof.flightlog.mcap_encoder import MAGIC, Attachment
from twodof.flightlog.mcap_file import recover
from twodof.flightlog.recorder import Recorder

SUFFIXES = (".mat", ".mcap", ".parquet", ".csv", ".ulg")
RECOVERED = (".mcap", ".ulg")


def seeds() -> list[bytes]:
    """Logs of each format behind the number of their suffix; recordings that were closed, cut, and not begun."""
    found = [(".ulg", px4_log()[:6000]), (".ulg", px4_log(12)), (".mcap", MAGIC)]
    log = attitude_steps().slice(100.0, 100.02)
    for suffix in SUFFIXES:
        path = file(f"seed{suffix}", b"")
        write_log(log, path, overwrite=True)
        found.append((suffix, path.read_bytes()[:6000] if suffix == ".ulg" else path.read_bytes()))
    path = file("seed.mcap", b"")
    path.unlink()
    with Recorder(path, ["imu.gyro", "openloop"], {"seed": 3}, [Attachment("a", "b", b"c")]) as recorder:
        for block in range(2):
            for k in range(3):
                recorder.write("imu.gyro", 10 * block + k, (1.0, 2.0, 3.0))
            recorder.flush()
    found += [(".mcap", path.read_bytes()), (".mcap", path.read_bytes()[:-200])]
    return [bytes([SUFFIXES.index(suffix)]) + data for suffix, data in found]


def attempt(data: bytes) -> None:
    """Read and described; recovered, and what was recovered read."""
    suffix = SUFFIXES[data[0] % len(SUFFIXES)] if data else ".csv"
    path = file(f"a{suffix}", data[1:])
    with contextlib.suppress(LogError):
        _check(read_log(path))
    if suffix in RECOVERED:
        with contextlib.suppress(LogError):
            found = recover(path)
            target = file("b.mcap", b"")
            found.write(target, overwrite=True)
            again = read_log(target)
            assert list(again) == list(found.log)
            assert sum(map(len, again.channels.values())) == found.samples
            _check(again)


def _check(log: FlightLog) -> None:
    describe(log)
    assert all(np.isfinite(channel.value).all() for channel in log.channels.values())


TARGET = Target("logs", seeds, attempt, 16_000)
