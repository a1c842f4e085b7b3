"""`make quick` runs every file but those of tests/slow.txt; `make test` and `make thorough` run each test once."""

from __future__ import annotations

import subprocess
import sys

from tests.conftest import BRIEF_S, PROJECT, QUICK_S, long_tests, slow_files
from tests.patience import PATIENCE_S


def test_the_list_names_files_that_there_are_and_that_are_slow() -> None:
    slow = slow_files()
    assert [file for file in slow if not file.is_file()] == []
    assert all(seconds >= QUICK_S or file.parent.name == "web" for file, seconds in slow.items())
    assert [*slow] == sorted(slow)


def test_quick_leaves_out_what_is_named_and_nothing_else() -> None:
    command = [sys.executable, "-m", "pytest", "--quick", "--collect-only", "-q", "-p", "no:cacheprovider"]
    options = {"cwd": PROJECT, "capture_output": True, "text": True, "check": False, "timeout": PATIENCE_S}
    told = subprocess.run([*command, "tests/fuzz", "tests/test_patience.py"], **options).stdout
    assert "tests/test_patience.py::" in told
    assert PROJECT / "tests/fuzz/test_fuzz.py" in slow_files()
    assert "test_fuzz" not in told


def test_brief_and_long_divide_the_tests() -> None:
    long = long_tests()
    assert all(seconds >= BRIEF_S for seconds in long.values())
    file = "tests/identify/test_coverage.py"
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-p", "no:cacheprovider", file]
    options = {"cwd": PROJECT, "capture_output": True, "text": True, "check": False, "timeout": PATIENCE_S}
    every, brief, rest = (
        {line for line in subprocess.run([*command, *more], **options).stdout.splitlines() if "::" in line}
        for more in ([], ["--brief"], ["--long"])
    )
    assert brief | rest == every
    assert rest == {test for test in every if test in long}
    assert brief
    assert rest
    assert not brief & rest


def test_the_tests_that_are_left_out_are_there() -> None:
    """A renamed test would come back into `make test` by itself; this says that the list is old."""
    for test in long_tests():
        file, _, name = test.partition("::")
        function = name.partition("[")[0].rpartition("::")[2]
        assert f"def {function}(" in (PROJECT / file).read_text(encoding="utf-8"), test
