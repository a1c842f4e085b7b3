"""The exported tree: deterministic, complete, written wholly or not at all."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.compile.px4.golden import GOLDEN, MODULES
from tests.compile.px4.modules import PITCH_LOG, pitch, rail
from tests.patience import PATIENCE_S
from twodof.blocks.schema.json_form import from_json
from twodof.compile.px4 import export, make_module, tree
from twodof.compile.px4.tree import MANIFEST, strangers, write_tree
from twodof.errors import CompileError, LogError

pytestmark = pytest.mark.slow


def on_disk(folder: Path) -> dict[str, str]:
    """All files of a folder by relative path."""
    return {p.relative_to(folder).as_posix(): p.read_text() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.mark.parametrize("name", MODULES)
def test_golden_files(name: str) -> None:
    """`python -m tests.compile.px4.golden` writes new golden files after a wanted change."""
    made = dict(MODULES[name]().files)
    kept = on_disk(GOLDEN / name)
    assert sorted(made) == sorted(kept)
    for path, text in made.items():
        assert text == kept[path], path


def test_the_same_diagram_gives_the_same_bytes_in_another_process(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from tests.compile.px4.modules import *; "
        "from twodof.compile.px4 import export; export(pitch(), Path(sys.argv[1]), PITCH_LOG)"
    )
    folder = tmp_path / "out"
    subprocess.run(
        [sys.executable, "-c", code, str(folder)],
        check=True,
        timeout=PATIENCE_S,
        env={"PYTHONHASHSEED": "1", "PATH": "", "LANG": "C", "TZ": "Asia/Tokyo"},
        cwd=Path(__file__).parents[3],
    )
    assert on_disk(folder) == on_disk(GOLDEN / "pitch")


@pytest.mark.parametrize("name", MODULES)
def test_a_board_keeps_all_of_its_checks(name: str) -> None:
    assert "CBRK_" not in MODULES[name]().files["sdcard/etc/config.txt"]


def test_the_diagram_travels_with_the_module() -> None:
    again = make_module(from_json(make_module(pitch(), PITCH_LOG).files["diagram.json"]), PITCH_LOG)
    c = "src/modules/twodof_pitch/twodof_pitch.c"
    # what the block was called in Python is not in JSON
    plain = [f[c].replace("Damper", "").replace("TracedBlock", "") for f in (again.files, on_disk(GOLDEN / "pitch"))]
    assert plain[0] == plain[1]


def test_an_export_replaces_an_earlier_one_and_an_empty_folder(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "out"
    folder.mkdir(parents=True)
    export(pitch(), folder)
    export(rail(), folder)
    assert on_disk(folder) == dict(make_module(rail()).files)
    assert [p.name for p in folder.parent.iterdir()] == ["out"]


def test_other_files_and_folders_are_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    for force in (False, True):
        with pytest.raises(LogError, match="something else in it"):
            export(rail(), tmp_path, force=force)
        with pytest.raises(LogError, match="is a file"):
            export(rail(), tmp_path / "thesis.tex", force=force)
    assert on_disk(tmp_path) == {"thesis.tex": "years of work"}


@pytest.mark.parametrize(
    "manifest", ["", "[]", "{}", '{"format": 1, "files": 3}', '{"format": 2, "files": {}}', "[" * 5000]
)
def test_a_manifest_that_is_none_protects_the_folder(tmp_path: Path, manifest: str) -> None:
    (tmp_path / MANIFEST).write_text(manifest)
    with pytest.raises(LogError, match="something else in it"):
        export(rail(), tmp_path, force=True)


def test_changed_and_added_files_are_lost_only_by_force(tmp_path: Path) -> None:
    export(rail(), tmp_path)
    (tmp_path / "msg" / "Mine.msg").write_text("mine")
    (tmp_path / "README.md").write_text("mine")
    assert strangers(tmp_path) == ["README.md", "msg/Mine.msg"]
    before = on_disk(tmp_path)
    with pytest.raises(LogError, match=r"README\.md, msg/Mine\.msg"):
        export(rail(), tmp_path)
    assert on_disk(tmp_path) == before
    export(rail(), tmp_path, force=True)
    assert on_disk(tmp_path) == dict(make_module(rail()).files)


@pytest.mark.parametrize("fault", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize("at", [0, 7, 16])
def test_a_fault_while_writing_leaves_the_earlier_export(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: BaseException, at: int
) -> None:
    folder = tmp_path / "out"
    export(pitch(), folder)
    before = on_disk(folder)
    written = 0
    whole = tree.atomic_write

    def failing(place: Path, mode: str) -> object:
        nonlocal written
        written += 1
        if written > at:
            raise fault
        return whole(place, "w")

    monkeypatch.setattr(tree, "atomic_write", failing)
    with pytest.raises((CompileError, KeyboardInterrupt)):
        export(rail(), folder)
    assert on_disk(folder) == before
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_a_rename_that_fails_leaves_the_earlier_export(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "out"
    export(pitch(), folder)
    before = on_disk(folder)
    whole = Path.rename

    def failing(self: Path, target: Path) -> Path:
        if self.name.endswith(".new"):
            raise OSError(13, "Permission denied")
        return whole(self, target)

    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises(CompileError, match="Permission denied"):
        write_tree(folder, make_module(rail()).files)
    assert on_disk(folder) == before
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
