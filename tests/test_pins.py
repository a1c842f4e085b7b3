"""Every download is pinned with a hash."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]
PINS = sorted((PROJECT / "requirements").glob("*.txt"))
LOCK_FILE = PROJECT / "tests" / "interop" / "package-lock.json"
INSTALLERS = [PROJECT / "Makefile", PROJECT / ".ci" / "run", *sorted((PROJECT / "tools").glob("*.sh"))]
PINNED = re.compile(r"[a-z0-9.-]+==[\w.]+( ; [^\\]+)?( --hash=sha256:[0-9a-f]{64})+")
INDEX_HOST = re.compile(r"https?://|--(extra-)?index-url|--find-links|--trusted-host")


def requirements(text: str) -> list[str]:
    """The requirements of a file, each on one line, without comments."""
    joined = text.replace("\\\n", " ")
    lines = (re.sub(r"\s+", " ", line).strip() for line in joined.splitlines() if not line.startswith("#"))
    return [line for line in lines if line]


@pytest.mark.parametrize("path", PINS, ids=lambda path: path.name)
def test_every_requirement_is_one_version_with_hashes(path: Path) -> None:
    found = requirements(path.read_text())
    assert found
    assert [line for line in found if not PINNED.fullmatch(line)] == []


@pytest.mark.parametrize("line", ["rich", "rich>=15", "rich==15.0.0", "rich==15.* --hash=sha256:" + 64 * "0"])
def test_a_requirement_without_a_version_or_a_hash_is_found(line: str) -> None:
    assert not PINNED.fullmatch(line)


@pytest.mark.parametrize("path", PINS, ids=lambda path: path.name)
def test_no_file_of_pins_names_a_package_index(path: Path) -> None:
    assert not INDEX_HOST.search("\n".join(requirements(path.read_text())))


def test_the_files_of_pins_agree() -> None:
    versions: dict[str, set[str]] = {}
    for path in PINS:
        for line in requirements(path.read_text()):
            name, _, version = line.split()[0].partition("==")
            versions.setdefault(name, set()).add(version)
    # What maintains the pins has an environment of its own, and may be older or newer there.
    apart = {line.split("==")[0] for line in requirements((PROJECT / "requirements" / "maintain.txt").read_text())}
    assert {name: found for name, found in versions.items() if len(found) > 1 and name not in apart} == {}


def test_whatever_installs_a_python_package_asks_for_hashes_or_downloads_nothing() -> None:
    lines = [
        (path.name, line.strip())
        for path in INSTALLERS
        for line in path.read_text().splitlines()
        if re.search(r"pip install|\$\(INSTALL\) ", line) and not line.startswith(("#", "INSTALL :="))
    ]
    assert lines
    assert [line for line in lines if "--require-hashes" not in line[1] and "--no-deps -e ." not in line[1]] == []


def test_pip_builds_nothing_with_tools_that_are_not_pinned() -> None:
    (install,) = re.findall(r"^INSTALL := .*$", (PROJECT / "Makefile").read_text(), flags=re.MULTILINE)
    assert "--no-build-isolation" in install
    pinned = {line.split("==")[0] for line in requirements((PROJECT / "requirements" / "pip.txt").read_text())}
    assert pinned == {"pip", "setuptools"}


def test_every_node_package_has_a_hash_and_none_an_address() -> None:
    packages = json.loads(LOCK_FILE.read_text())["packages"]
    assert "node_modules/node-mavlink" in packages
    assert [name for name, row in packages.items() if name and not row.get("integrity", "").startswith("sha512-")] == []
    assert [name for name, row in packages.items() if "resolved" in row] == []
