"""The table of faults in docs/safety.md: the tests that it names are there, and no test of a fault is left out."""

from __future__ import annotations

import ast
import re
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
PAGE = FOLDER.parents[1] / "docs" / "safety.md"


def test_the_table_names_the_tests_that_there_are() -> None:
    section = PAGE.read_text(encoding="utf-8").partition("## Faults tried on the whole system")[2].partition("\n## ")[0]
    named = re.findall(r"`(test_\w+\.py::test_\w+)` \|$", section, re.MULTILINE)
    there = {
        f"{path.name}::{node.name}"
        for path in FOLDER.glob("test_*.py")
        if path != Path(__file__)
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_") and not node.name.endswith("_for_long")
    }
    assert len(named) == len(set(named))
    assert set(named) == there
