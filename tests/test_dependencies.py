"""Every package that twodof imports is declared in pyproject.toml."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Iterator
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from tests.patience import PATIENCE_S

pytestmark = pytest.mark.slow

PROJECT = Path(__file__).resolve().parents[1]


def statements(body: Iterable[ast.AST]) -> Iterator[ast.AST]:
    """Yield all statements of a module, at any depth."""
    for node in body:
        yield node
        for part in ("body", "orelse", "handlers", "finalbody"):
            inside = getattr(node, part, None)
            yield from statements(inside if isinstance(inside, list) else ())


def imported(files: Iterable[Path]) -> dict[str, Path]:
    """Top-level modules of others that `files` import, each with a file that does."""
    found = {}
    for path in files:
        for node in statements(ast.parse(path.read_text()).body):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and not node.level and node.module:
                names = [node.module]
            found |= {name.split(".")[0]: path for name in names}
    return {name: path for name, path in found.items() if name not in {*sys.stdlib_module_names, "twodof"}}


def declared() -> set[str]:
    """Distributions that an installation may have: the dependencies and the extras for users."""
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    rows = [*project["dependencies"], *(row for name in extras if name != "dev" for row in extras[name])]
    return {_plain(re.split(r"[ <>=;\[]", row)[0]) for row in rows}


@pytest.mark.long
def test_every_import_is_a_declared_dependency() -> None:
    distributions = packages_distributions()
    known = declared()
    missing = {
        name: str(path.relative_to(PROJECT))
        for name, path in imported((PROJECT / "src").rglob("*.py")).items()
        if not {_plain(one) for one in distributions.get(name, [name])} & known
    }
    assert missing == {}


def test_an_import_that_is_not_declared_is_found(tmp_path: Path) -> None:
    file = tmp_path / "module.py"
    file.write_text("import os, serial.tools\nfrom lxml.etree import parse\nfrom . import neighbour\n")
    assert imported([file]) == {"serial": file, "lxml": file}


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


@pytest.mark.long
@pytest.mark.parametrize("program", ["cli.fly", "cli.fcu", "lab.server"])
def test_a_flight_and_the_lab_start_without_scipy(program: str) -> None:
    """Its import takes half a second to two seconds of processor time, in each command and each virtual drone."""
    code = f"import sys, twodof.{program}; print([n for n in sys.modules if n == 'scipy'])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE_S, check=True)
    assert done.stdout.strip() == "[]"
