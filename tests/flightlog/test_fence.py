"""The fence: how a reader ends is told, and the next file is read."""

import os
import signal
from pathlib import Path

import pytest

from twodof.errors import LogError
from twodof.flightlog import fence


def misbehave(data: bytes, where: str, how: str) -> fence.Answer:
    """Run behind the fence: end in the way `how`."""
    match how:
        case "time":
            while True:
                pass
        case "memory":
            return bytearray(1 << 40), []
        case "killed":
            os.kill(os.getpid(), signal.SIGKILL)
        case "crash":
            os.abort()
        case "fault":
            raise ZeroDivisionError("by the library")
    return {"where": where, "bytes": len(data)}, []


@pytest.mark.parametrize(
    ("how", "says"),
    [
        pytest.param("time", r"takes more than 4 s of processor time", marks=pytest.mark.long),
        ("memory", "asks for more memory than a file of 7 bytes may"),
        ("killed", "was killed, perhaps because the computer has run out of memory .close other programs"),
        ("crash", "ends its reader by the signal SIGABRT"),
        ("fault", "cannot be read: ZeroDivisionError: by the library"),
    ],
)
def test_end_of_a_reader_is_told_by_its_cause(tmp_path: Path, how: str, says: str) -> None:
    path = tmp_path / "a.log"
    path.write_bytes(b"content")
    with pytest.raises(LogError, match=says):
        fence.read(misbehave, path, how)
    assert fence.read(misbehave, path, "not at all")[0] == {"where": str(path), "bytes": 7}
