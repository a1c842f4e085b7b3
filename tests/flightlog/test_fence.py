"""The fence: how a reader ends is told, and the next file is read."""

import json
import mmap
import os
import signal
import sys
from pathlib import Path
from typing import Any

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


def forge(data: bytes, where: str, text: str) -> fence.Answer:
    """Run behind the fence as a reader that a hostile file has taken over: write any answer into the parent's file."""
    for place in Path("/proc/self/fd").iterdir():
        try:
            if "answer" in str(place.readlink()):
                with mmap.mmap(int(place.name), 8 + len(text)) as memory:
                    memory.write(len(text).to_bytes(8, "little") + text.encode())
                os._exit(0)
        except OSError:
            continue
    os.abort()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="finds the answer's file as Linux names it")
@pytest.mark.parametrize(
    "answer",
    [
        {},
        [],
        {"answer": 1},
        {"error": ["a", "b"], "arrays": []},
        {"answer": 1, "arrays": [["<f8", [-1_000_000_000_000]], ["<f8", [100_000_000_000]]]},
        {"answer": 1, "arrays": [["<f8", [-1]]]},
        {"answer": 1, "arrays": [["<f8", [1.5]]]},
        {"answer": 1, "arrays": [["|O", [1]]]},
        {"answer": 1, "arrays": [[]]},
        {"answer": 1, "arrays": [["<f8", 3]]},
    ],
    ids=repr,
)
def test_a_forged_answer_is_an_error_of_the_file(tmp_path: Path, answer: Any) -> None:
    path = tmp_path / "a.log"
    path.write_bytes(b"content")
    with pytest.raises(LogError, match="has ended"):
        fence.read(forge, path, json.dumps(answer))
    assert fence.read(misbehave, path, "not at all")[0]["bytes"] == 7
