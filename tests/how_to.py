"""Carries the steps of a how-to page out on a copy of the source.

A page's blocks are marked by their language. `diff` changes the file that its first line names: lines with "-" go,
those with "+" come, others stay and say where. `python` runs against the changed copy, all blocks of a page as one
program. `sh` runs there too.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from tests.patience import PATIENCE_S

PROJECT = Path(__file__).resolve().parents[1]
COPIED = ("src", "tools", "docs", "tests/fmea", "bench/computing/hand")


def copied(folder: Path) -> Path:
    """A copy of what a step may change, in `folder`."""
    for name in COPIED:
        # With what is compiled, which counts for a copy of the same age: each step would compile all of it again.
        shutil.copytree(PROJECT / name, folder / name, ignore=shutil.ignore_patterns("node_modules"))
    shutil.copy(PROJECT / "tests" / "test_layers.py", folder / "tests")  # a page has a table of its rows
    return folder


def carry_out(page: str, root: Path) -> set[str]:
    """Does what the page says in the copy `root`; returns the files under src that it changed by hand."""
    text = (PROJECT / "docs" / "how-to" / page).read_text(encoding="utf-8")
    blocks = re.findall(r"^```(diff|python|sh)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    changed = {_change(root, body) for kind, body in blocks if kind == "diff"}
    program = "\n".join(body for kind, body in blocks if kind == "python")
    _run([sys.executable, "-c", program], root)
    for kind, body in blocks:
        if kind == "sh":
            for line in body.splitlines():
                _run([sys.executable, *line.split()[1:]] if line.startswith("python ") else line.split(), root)
    return changed


def _change(root: Path, body: str) -> str:
    head, *lines = body.splitlines()
    name = head.removeprefix("--- ")
    old = "".join(f"{line[1:]}\n" for line in lines if not line.startswith("+"))
    new = "".join(f"{line[1:]}\n" for line in lines if not line.startswith("-"))
    path = root / name
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    assert text.count(old) == 1 or not text, f"{name} has the lines {text.count(old)} times:\n{old}"
    path.write_text(text.replace(old, new) if text else new, encoding="utf-8")
    return name


def _run(command: list[str], root: Path) -> None:
    done = subprocess.run(
        command,
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root / "src"), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        timeout=3 * PATIENCE_S,  # it compiles
        check=False,
    )
    assert done.returncode == 0, f"{command[-1]}\n{done.stdout}\n{done.stderr}"
