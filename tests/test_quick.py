"""`make quick` runs the tests of every file but those that tests/slow.txt names."""

from __future__ import annotations

import subprocess
import sys

from tests.conftest import PROJECT, QUICK_S, slow_files
from tests.patience import PATIENCE_S


def test_the_list_names_files_that_there_are_and_that_are_slow() -> None:
    slow = slow_files()
    assert [file for file in slow if not file.is_file()] == []
    assert all(seconds >= QUICK_S for seconds in slow.values())
    assert [*slow] == sorted(slow)


def test_quick_leaves_out_what_is_named_and_nothing_else() -> None:
    command = [sys.executable, "-m", "pytest", "--quick", "--collect-only", "-q", "-p", "no:cacheprovider"]
    options = {"cwd": PROJECT, "capture_output": True, "text": True, "check": False, "timeout": PATIENCE_S}
    told = subprocess.run([*command, "tests/fuzz", "tests/test_patience.py"], **options).stdout
    assert "tests/test_patience.py::" in told
    assert PROJECT / "tests/fuzz/test_fuzz.py" in slow_files()
    assert "test_fuzz" not in told
