"""`make quick` leaves out the files with the mark `slow`."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.conftest import PROJECT
from tests.patience import PATIENCE_S


@pytest.mark.long
def test_quick_leaves_out_slow_files_only() -> None:
    command = [sys.executable, "-m", "pytest", "--quick", "--collect-only", "-q", "-p", "no:cacheprovider"]
    options = {"cwd": PROJECT, "capture_output": True, "text": True, "check": False, "timeout": PATIENCE_S}
    listed = subprocess.run([*command, "tests/fuzz", "tests/web", "tests/test_patience.py"], **options).stdout
    assert "tests/test_patience.py::" in listed
    assert "test_fuzz" not in listed
    assert "built_page" not in "".join((PROJECT / name).read_text() for name in _files(listed)), "it builds the page"


def _files(listed: str) -> set[str]:
    return {line.partition("::")[0] for line in listed.splitlines() if "::" in line}
