"""The tables of hazards and faults in docs/safety.md: the tests that they name are there, and none is left out."""

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


def test_the_table_of_hazards_names_tests_that_there_are() -> None:
    section = PAGE.read_text(encoding="utf-8").partition("## Hazards")[2].partition("\n## ")[0]
    rows = [row for row in section.splitlines() if row.startswith("| ") and not row.startswith("| hazard")]
    assert len(rows) >= 20
    named = [re.findall(r"`([\w/]+\.py)::(\w+)`", row.rpartition(" | ")[2]) for row in rows]
    assert all(named), "each hazard has a test"
    tests = FOLDER.parent
    for file, name in (one for row in named for one in row):
        path = next(found for found in (tests / "fcu" / file, tests / file) if found.is_file())
        there = ast.parse(path.read_text(encoding="utf-8")).body
        names = {node.name for node in there if isinstance(node, ast.FunctionDef)}
        names |= {target.id for node in there if isinstance(node, ast.Assign) for target in _names(node)}
        assert name in names, f"{file}::{name}"


def _names(node: ast.Assign) -> list[ast.Name]:
    return [target for target in node.targets if isinstance(target, ast.Name)]
