"""`check`: a tree that fits has no findings, and each mismatch that PX4's build does not show is found."""

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.compile.px4.modules import PITCH_LOG, pitch
from tests.patience import PATIENCE_S
from twodof.compile.px4 import export
from twodof.compile.px4.tree import ERROR, MANIFEST, WARNING, check
from twodof.errors import CompileError

AIRFRAMES = "ROMFS/px4fmu_common/init.d-posix/airframes"


def put(root: Path, path: str, text: str = "\n") -> None:
    """Write a file with its folders."""
    (root / path).parent.mkdir(parents=True, exist_ok=True)
    (root / path).write_text(text)


def git(root: Path, *arguments: str) -> None:
    name = ("-c", "user.name=t", "-c", "user.email=t@t")
    subprocess.run(["git", "-C", str(root), *name, *arguments], check=True, capture_output=True, timeout=PATIENCE_S)


@pytest.fixture
def px4(tmp_path: Path) -> Path:
    """A tree with everything that is looked at, in a git repository with the tag v1.16.1."""
    root = tmp_path / "PX4"
    put(root, "CMakeLists.txt", "project(px4)\n")
    put(root, "src/modules/logger/messages.h", "struct s {\n    char format[1600];\n};\n")
    put(root, "src/modules/mc_rate_control/CMakeLists.txt")
    put(root, f"{AIRFRAMES}/4001_gz_x500")
    git(root, "init", "-q")
    git(root, "add", "-A")
    git(root, "commit", "-q", "-m", "all")
    git(root, "tag", "v1.16.1")
    return root


@pytest.fixture
def exported(tmp_path: Path) -> Path:
    folder = tmp_path / "out"
    export(pitch(), folder, PITCH_LOG)
    return folder


def findings(px4: Path, exported: Path, level: str) -> str:
    return "\n".join(f"{row.where}: {row.what}" for row in check(px4, exported).rows if row.level == level)


def test_tree_that_fits_has_no_findings(px4: Path, exported: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = check(px4, exported)
    assert found.rows == ()
    assert (found.fits, found.module, found.version) == (True, "twodof_pitch", "v1.16.1")
    monkeypatch.chdir(px4.parent)
    assert check("PX4", "out") == found


def retag(root: Path, tag: str) -> None:
    git(root, "tag", "-d", "v1.16.1")
    git(root, "tag", tag)


def within_another_repository(root: Path) -> None:
    (root / ".git").rename(root.parent / ".git")
    git(root.parent, "tag", "v0.3")


@pytest.mark.parametrize(
    ("change", "level", "what"),
    [
        (lambda p: put(p, "src/modules/logger/messages.h", "char format[300];"), ERROR, "room for 300 characters"),
        (lambda p: retag(p, "v1.13.3"), ERROR, "is PX4 v1.13.3; the module is for v1.14 to v1.17"),
        (lambda p: retag(p, "v1.18.0"), ERROR, "is PX4 v1.18.0; the module is for v1.14 to v1.17"),
        (lambda p: retag(p, "v1.15.4"), WARNING, "is PX4 v1.15.4: modules were flown with v1.16.1 only"),
        (lambda p: retag(p, "mine"), WARNING, "its version is unknown (git describe: mine)"),
        (lambda p: git(p, "tag", "-d", "v1.16.1"), WARNING, "its version is unknown (git describe: fatal: No names"),
        (within_another_repository, WARNING, "its version is unknown (git describe: fatal: not a git repository"),
        (lambda p: shutil.rmtree(p / "src/modules/mc_rate_control"), WARNING, "has no mc_rate_control, whose place"),
        (lambda p: shutil.rmtree(p / "src/modules"), ERROR, "is not a source tree of PX4"),
        (lambda p: shutil.rmtree(p), ERROR, "is not a source tree of PX4"),
        (lambda p: put(p.parent / "out", "msg/Mine.msg"), WARNING, "was changed since the export: msg/Mine.msg"),
        (lambda p: (p.parent / "out/README.md").unlink(), ERROR, "has lost files of the export: README.md"),
    ],
)
def test_mismatch_is_found(px4: Path, exported: Path, change: Callable[[Path], object], level: str, what: str) -> None:
    change(px4)
    assert what in findings(px4, exported, level)
    found = check(px4, exported)
    assert found.fits == (level == WARNING)
    assert all(row.remedy and row.where for row in found.rows)


def test_tag_far_away_says_no_version(px4: Path, exported: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    described = subprocess.CompletedProcess(["git"], 0, "v1.8.0-beta1-24731-gbb59c637cd\n", "")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: described)
    assert "its version is unknown" in findings(px4, exported, WARNING)


def test_airframe_of_the_same_number_is_a_warning(px4: Path, exported: Path) -> None:
    number = json.loads((exported / MANIFEST).read_text())["airframe"]
    put(px4, f"{AIRFRAMES}/{number}_twodof_pitch")
    put(px4, f"{AIRFRAMES}/{number}_twodof_pitch.post")
    assert check(px4, exported).rows == ()
    put(px4, f"{AIRFRAMES}/{number}_mine")
    assert f"has an airframe {number} already" in findings(px4, exported, WARNING)


def test_folder_without_an_export_raises(px4: Path, tmp_path: Path) -> None:
    put(tmp_path, "damaged/twodof-px4.json", '{"format": 1, "files": {}, "module": "m"}')
    for folder in (px4, tmp_path / "nothing", tmp_path / "damaged"):
        with pytest.raises(CompileError, match="holds no exported module"):
            check(px4, folder)
