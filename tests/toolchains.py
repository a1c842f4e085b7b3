"""Programs that no wheel brings: a test without one is skipped with the reason, or fails in CI."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import NoReturn

import pytest

PACKAGES = {
    "arm-none-eabi-gcc": "gcc-arm-none-eabi libnewlib-arm-none-eabi",
    "chromium": "chromium",
    "cppcheck": "cppcheck",
    "curl": "curl",
    "g++": "g++",
    "gcc": "gcc libc6-dev",
    "node": "nodejs",
    "npm": "npm",
    "octave-cli": "octave",
    "qemu-system-arm": "qemu-system-arm",
}
"""The Debian packages that bring each program; tools/toolchains.sh installs them."""


def required() -> bool:
    """Return True in continuous integration, where a missing program is a failure."""
    return os.environ.get("TWODOF_REQUIRE_TOOLS") == "1" or os.environ.get("CI") == "true"


def missing(*programs: str) -> list[str]:
    """Return the `programs` that are missing."""
    return [program for program in programs if shutil.which(program) is None]


def need(*programs: str) -> None:
    """Skip the present test, naming the package, if one of `programs` is missing; fail it instead if `required`."""
    for program in missing(*programs):
        lacking(f"{program} is missing: `make tools` as root, or install {PACKAGES[program]}")


def need_node_package(name: str) -> Path:
    """The folder for NODE_PATH in which tools/node_packages.sh has put `name`; skip or fail as `need` does."""
    need("node")
    folder = Path(sys.prefix) / "node" / "node_modules"
    if not (folder / name).is_dir():
        lacking(f"{name} is missing: `make tools`, or tools/node_packages.sh {folder.parent}")
    return folder


def lacking(reason: str) -> NoReturn:
    """Skip the present test for `reason`; fail it instead if `required`."""
    if required():
        pytest.fail(reason)
    pytest.skip(reason)
