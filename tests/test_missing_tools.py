"""No tool chain there: each target's error names the package that gives it, and what can run without one still does."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.slow

PROJECT = Path(__file__).resolve().parents[1]
TIMEOUT_S = 120

# What a user with the bare package has: no wheel of the extras, and a PATH with `programs` in it.
USER = """
import json, sys, warnings
hidden = set(json.loads(sys.argv[1]))
class Finder:  # as those there are, but for the hidden packages
    def __init__(self, finder):
        self.finder = finder
    def find_spec(self, name, path=None, target=None):
        return None if name.split(".")[0] in hidden else self.finder.find_spec(name, path, target)
sys.meta_path[:] = map(Finder, sys.meta_path)
from tests.compile.examples import loop
from twodof.compile import build
from twodof.errors import CompileError
said = {}
for target in json.loads(sys.argv[2]):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            found = build(loop(), 0.01, target=target)
            y = found.machine().run(3, {"r": 1.0})["y"].tolist()
            said[target] = [type(found).__name__, y, [str(w.message) for w in caught]]
        except CompileError as error:
            said[target] = ["CompileError", str(error), []]
print(json.dumps(said))
"""


def user(hidden: list[str], targets: list[str], folder: Path, **programs: str) -> dict[str, list[Any]]:
    """Return the result or error of `build` for each of `targets`, in another process."""
    for name, text in programs.items():
        file = folder / name.replace("_", "-")
        file.write_text(f"#!/bin/sh\n{text}\n")
        file.chmod(0o755)
    done = subprocess.run(
        [sys.executable, "-c", USER, json.dumps(hidden), json.dumps(targets)],
        cwd=PROJECT,
        env={"PATH": str(folder), "TWODOF_CACHE": str(folder / "cache"), "HOME": os.environ.get("HOME", "/")},
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    said: dict[str, list[Any]] = json.loads(done.stdout)
    return said


def test_without_anything_native_runs_slowly_and_the_others_name_their_packages(tmp_path: Path) -> None:
    said = user(["ziglang", "wasmtime"], ["native", "wasm", "cortex-m7"], tmp_path)
    kind, y, warned = said["native"]
    assert (kind, len(y)) == ("Reference", 3)
    assert len(warned) == 1
    assert "ziglang" in warned[0]
    assert "gcc" in warned[0]
    assert said["wasm"][0] == said["cortex-m7"][0] == "CompileError"
    assert "pip install wasmtime ziglang" in said["wasm"][1]
    assert "gcc-arm-none-eabi" in said["cortex-m7"][1]


@pytest.mark.long
def test_with_a_compiler_alone_the_engine_and_the_emulator_are_named(tmp_path: Path) -> None:
    said = user(["wasmtime"], ["native", "wasm", "cortex-m7"], tmp_path)
    assert said["native"][0] == "CompiledProgram"
    assert "pip install wasmtime" in said["wasm"][1]
    assert "apt-get install qemu-system-arm" in said["cortex-m7"][1]


@pytest.mark.parametrize("text", ["exit 1", "echo broken >&2; exit 127"])
def test_a_compiler_that_does_not_work_is_no_traceback(text: str, tmp_path: Path) -> None:
    said = user(["ziglang", "wasmtime"], ["native"], tmp_path, cc=text)
    assert said["native"][0] == "CompileError"
    assert "check that the compiler works" in said["native"][1]


@pytest.mark.long
def test_with_an_empty_path_the_required_wheels_compile(tmp_path: Path) -> None:
    said = user([], ["native", "wasm"], tmp_path)
    assert [said[target][0] for target in ("native", "wasm")] == ["CompiledProgram", "CompiledProgram"], said
    assert said["native"][1] == said["wasm"][1]


def test_a_wheel_has_the_page_and_requires_a_compiler(tmp_path: Path) -> None:
    """`pip install` of it needs no make, node or compiler."""
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(PROJECT / name, tmp_path)
    page = tmp_path / "src" / "twodof" / "lab" / "page"
    shutil.copytree(PROJECT / "src", tmp_path / "src", ignore=shutil.ignore_patterns("page", "__pycache__"))
    page.mkdir()
    (page / "index.html").write_text("the page")
    build = "from flit_core.buildapi import build_wheel; print(build_wheel('.'))"
    name = subprocess.run(
        [sys.executable, "-c", build], cwd=tmp_path, capture_output=True, text=True, check=True
    ).stdout
    with zipfile.ZipFile(tmp_path / name.strip()) as wheel:
        assert wheel.read("twodof/lab/page/index.html") == b"the page"
        (about,) = [name for name in wheel.namelist() if name.endswith("METADATA")]
        required = re.findall(r"^Requires-Dist: ([\w-]+)[^;\n]*$", wheel.read(about).decode(), flags=re.MULTILINE)
    assert {"wasmtime", "ziglang"} <= set(required)
