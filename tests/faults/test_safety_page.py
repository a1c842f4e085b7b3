"""The tables of hazards, faults and threats in docs: the tests that they name are there, and none is left out."""

import ast
import re
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parent
TESTS = FOLDER.parent
DOCS = TESTS.parent / "docs" / "explanation"
PAGE = DOCS / "safety.md"


def test_the_table_names_the_tests_that_there_are() -> None:
    section = PAGE.read_text(encoding="utf-8").partition("## Faults tried on the whole system")[2].partition("\n## ")[0]
    named = re.findall(r"`(test_\w+\.py::test_\w+)` \|$", section, re.MULTILINE)
    there = {
        f"{path.name}::{node.name}"
        for path in FOLDER.glob("test_*.py")
        if path != Path(__file__)
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and node.name.startswith("test_")
        and not node.name.endswith("_for_long")
    }
    assert len(named) == len(set(named))
    assert set(named) == there


@pytest.mark.parametrize(
    ("page", "heading", "least"),
    [("safety.md", "## Hazards", 20), ("threat-model.md", "## How each threat is met, and where that is tested", 20)],
)
def test_each_row_of_hazards_and_of_threats_names_tests_that_there_are(page: str, heading: str, least: int) -> None:
    section = (DOCS / page).read_text(encoding="utf-8").partition(f"{heading}\n")[2].partition("\n## ")[0]
    rows = [row for row in section.splitlines() if row.startswith("| ")][1:]
    assert len(rows) >= least
    named = [re.findall(r"`([\w/]+\.py)::(\w+)`", row.rpartition(" | ")[2]) for row in rows]
    assert all(named), "each has a test"
    for file, name in (one for row in named for one in row):
        path = next(found for found in (TESTS / "fcu" / file, TESTS / file) if found.is_file())
        there = ast.parse(path.read_text(encoding="utf-8")).body
        names = {node.name for node in there if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)}
        names |= {target.id for node in there if isinstance(node, ast.Assign) for target in _names(node)}
        assert name in names, f"{file}::{name}"


def _names(node: ast.Assign) -> list[ast.Name]:
    return [target for target in node.targets if isinstance(target, ast.Name)]
