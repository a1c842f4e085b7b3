"""MCAP: a recording is read or refused with a LogError, and what is recovered of it is a whole file."""

import contextlib

from tests.flightlog.synthetic import attitude_steps
from tests.fuzz.target import Target, file
from twodof.errors import LogError
from twodof.flightlog.files import read_log
from twodof.flightlog.mcap_encoder import MAGIC, Attachment
from twodof.flightlog.mcap_file import recover, write_mcap
from twodof.flightlog.recorder import Recorder


def seeds() -> list[bytes]:
    """A closed recording, a cut one, a log."""
    path = file("seed.mcap", b"")
    path.unlink()
    with Recorder(path, ["imu.gyro", "openloop"], {"seed": 3}, [Attachment("a", "b", b"c")]) as recorder:
        for block in range(2):
            for k in range(3):
                recorder.write("imu.gyro", 10 * block + k, (1.0, 2.0, 3.0))
            recorder.flush()
    whole = path.read_bytes()
    log = attitude_steps().slice(100.0, 100.02)
    write_mcap(log, path)
    return [whole, whole[:-200], path.read_bytes(), MAGIC]


def attempt(data: bytes) -> None:
    """Read, recovered, and what was recovered read."""
    path = file("a.mcap", data)
    with contextlib.suppress(LogError):
        read_log(path)
    try:
        found = recover(path)
        target = file("b.mcap", b"")
        found.write(target)
    except LogError:
        return
    again = read_log(target)
    assert list(again) == list(found.log)
    assert sum(map(len, again.channels.values())) == found.samples


TARGET = Target("mcap", seeds, attempt, 8000)
