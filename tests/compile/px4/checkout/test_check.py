"""check: a small tree that has what PX4 has is right, and each thing that is wrong with it is said."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.compile.px4.modules import PITCH_LOG, pitch
from tests.patience import PATIENCE_S
from twodof.compile.px4 import export
from twodof.compile.px4.checkout.check import ERROR, NEEDED, WARNING, CheckoutFindings, check
from twodof.compile.px4.checkout.source_tree import SourceTree
from twodof.compile.px4.checkout.versions import Px4Version, parse_version
from twodof.compile.px4.topics import FIELDS
from twodof.compile.px4.tree import MANIFEST
from twodof.errors import CompileError

pytestmark = pytest.mark.slow

SUBMODULES = (
    "src/modules/mavlink/mavlink",
    "src/lib/events/libevents",
    "src/lib/heatshrink/heatshrink",
    "platforms/nuttx/NuttX/nuttx",
    "platforms/nuttx/NuttX/apps",
    "Tools/simulation/jmavsim/jMAVSim",
)


def camel(topic: str) -> str:
    """A message's file name."""
    return "".join(word.capitalize() for word in topic.split("_"))


def put(root: Path, path: str, text: str = "// as in PX4\n") -> None:
    """A file with its folders."""
    (root / path).parent.mkdir(parents=True, exist_ok=True)
    (root / path).write_text(text)


def git(root: Path, *arguments: str) -> None:
    """A git command in `root`."""
    name = ("-c", "user.name=t", "-c", "user.email=t@t")
    subprocess.run(["git", "-C", str(root), *name, *arguments], check=True, capture_output=True, timeout=PATIENCE_S)


@pytest.fixture(scope="session")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tree with everything that is looked at in PX4, in a git repository with the tag v1.16.1."""
    root = tmp_path_factory.mktemp("source") / "PX4"
    for path in NEEDED:
        put(root, path)
    put(root, "CMakeLists.txt", 'project(px4)\nset(EXTERNAL_MODULES_LOCATION "" CACHE STRING "")\n')
    put(root, "Makefile")
    put(root, "msg/CMakeLists.txt", "foreach(f ${config_msg_list_external})\n")
    put(root, "cmake/px4_add_module.cmake", "MULTI_VALUE SRCS MODULE_CONFIG\nOPTIONS EXTERNAL\n")
    queue = "platforms/common/include/px4_platform_common/px4_work_queue/WorkQueueManager.hpp"
    put(root, queue, 'static constexpr wq_config_t rate_ctrl{"wq:rate_ctrl", 3150, 0};\n')
    put(root, "src/modules/logger/messages.h", "struct s {\n    char format[1600];\n};\n")
    units = "allowedUnits = set ([\n    'rad', 'rad/s', '1/s', 'm/s',\n    ''])\n"
    put(root, "src/lib/parameters/px4params/srcparser.py", units)
    for name in ("mc_rate_control", "mc_pos_control", "control_allocator"):
        put(
            root,
            f"src/modules/{name}/CMakeLists.txt",
            f"px4_add_module(\n    MODULE modules__{name}\n    MAIN {name}\n)\n",
        )
    put(root, "src/modules/mc_rate_control/mc_rate_control_params.c", "PARAM_DEFINE_FLOAT(MC_PITCHRATE_P, 0.15f);\n")
    put(
        root,
        "src/modules/x/module.yaml",
        "parameters:\n  - definitions:\n      X_GAIN:\n        type: float\n      X_${i}_B:\n",
    )
    put(root, "ROMFS/px4fmu_common/init.d-posix/airframes/4001_gz_x500")
    for topic, fields in FIELDS.items():
        folder = "msg/versioned" if topic == "vehicle_attitude" else "msg"
        text = "".join(f"{kind.partition(' or ')[0]} {name}  # what it is\n" for name, kind in fields.items())
        topics = f"# TOPICS {topic} {topic}_virtual\n" if topic.endswith("torque_setpoint") else ""
        put(root, f"{folder}/{camel(topic)}.msg", f"{text}uint8 A_CONSTANT = 3\n{topics}")
    put(root, ".gitmodules", "".join(f'[submodule "{p}"]\n\tpath = {p}\n\turl = x\n' for p in SUBMODULES))
    for path in SUBMODULES[:-1]:
        put(root, f"{path}/file")
    git(root, "init", "-q")
    git(root, "add", "-A")
    git(root, "commit", "-q", "-m", "all")
    git(root, "tag", "v1.16.1")
    return root


@pytest.fixture
def px4(source: Path, tmp_path: Path) -> Path:
    """A copy of it to spoil."""
    return Path(shutil.copytree(source, tmp_path / "PX4"))


@pytest.fixture(scope="session")
def fresh(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The module of `pitch`."""
    folder = tmp_path_factory.mktemp("fresh") / "out"
    export(pitch(), folder, PITCH_LOG)
    return folder


@pytest.fixture
def exported(fresh: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(fresh, tmp_path / "out"))


def said(found: CheckoutFindings, level: str) -> str:
    """All findings of a level."""
    return "\n".join(f"{row.where}: {row.what} ({row.remedy})" for row in found.rows if row.level == level)


def listing(root: Path) -> list[tuple[str, int]]:
    """All files with their times of change."""
    return sorted((str(p), p.stat().st_mtime_ns) for p in root.rglob("*") if p.is_file())


def test_a_px4_that_fits(px4: Path, exported: Path) -> None:
    before = listing(px4)
    found = check(px4, exported)
    assert found.rows == ()
    assert found.fits
    assert (found.module, found.version) == ("twodof_pitch", "v1.16.1")
    assert listing(px4) == before


def test_a_relative_path_is_the_same(px4: Path, exported: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(px4.parent)
    assert check("PX4", "out") == check(px4, exported)
    monkeypatch.chdir(px4)
    assert check(".", "../out") == check(px4, exported)


SPOILED: list[tuple[Callable[[Path], object], str]] = [
    (lambda p: shutil.rmtree(p / "src/lib/events/libevents"), "half checked out: src/lib/events/libevents empty"),
    (
        lambda p: (p / "src/modules/mavlink/mavlink/file").unlink(),
        "half checked out: src/modules/mavlink/mavlink empty",
    ),
    (lambda p: shutil.rmtree(p / "ROMFS"), "half checked out: ROMFS missing"),
    (lambda p: (p / "cmake/px4_add_module.cmake").unlink(), "cmake/px4_add_module.cmake missing"),
    (lambda p: (p / "msg/VehicleTorqueSetpoint.msg").unlink(), "has no topic vehicle_torque_setpoint"),
    (lambda p: put(p, "msg/ActuatorArmed.msg", "uint8 armed\n"), "actuator_armed.armed is uint8, where bool is used"),
    (lambda p: put(p, "msg/ActuatorArmed.msg", "bool ready\n"), "actuator_armed.armed is missing"),
    (lambda p: put(p, "msg/TwodofPitch.msg", "uint64 timestamp\n"), "has a message TwodofPitch already"),
    (
        lambda p: put(p, "msg/Other.msg", "uint64 timestamp\n# TOPICS twodof_pitch\n"),
        "has a topic twodof_pitch already",
    ),
    (
        lambda p: put(p, "src/a/CMakeLists.txt", "px4_add_module(MAIN twodof_pitch)"),
        "has a module twodof_pitch already",
    ),
    (lambda p: put(p, "src/a/a_params.c", "PARAM_DEFINE_INT32(TPI_LIVE, 1);"), "has a parameter TPI_LIVE already"),
    (lambda p: put(p, "src/a/module.yaml", "d:\n  TPI_LIVE:\n    type: int32\n"), "has a parameter TPI_LIVE already"),
    (
        lambda p: put(p, "src/a/module.yaml", "d:\n  TPI_DAMP_GAINS_${i}:\n"),
        "has parameters TPI_DAMP_GAINS_0, TPI_DAMP_GAINS_1",
    ),
    (
        lambda p: put(p, "src/a/module.yaml", "outputs:\n  - param_prefix: TPI\n"),
        "TPI_DAMPE_INTEGR and 4 more already",
    ),
    (lambda p: put(p, "CMakeLists.txt", "project(px4)\n"), "knows no external modules"),
    (lambda p: put(p, "msg/CMakeLists.txt", "set(msg_files)\n"), "knows no messages of external modules"),
    (lambda p: put(p, "src/modules/logger/messages.h", "char format[300];"), "room for 300 characters"),
    (lambda p: git(p, "tag", "-f", "v1.13.3"), "is PX4 v1.13.3; the module is for v1.14 to v1.17"),
    (lambda p: git(p, "tag", "-f", "v1.18.0"), "is PX4 v1.18.0; the module is for v1.14 to v1.17"),
]


@pytest.mark.parametrize(("spoil", "what"), SPOILED, ids=[what for _, what in SPOILED])
def test_what_does_not_fit_is_said(px4: Path, exported: Path, spoil: Callable[[Path], object], what: str) -> None:
    if "is PX4" in what:
        git(px4, "tag", "-d", "v1.16.1")
    spoil(px4)
    found = check(px4, exported)
    assert not found.fits
    assert what in said(found, ERROR)
    assert all(row.remedy and row.where for row in found.rows)


WARNED: list[tuple[Callable[[Path], object], str]] = [
    (lambda p: shutil.rmtree(p / "platforms/nuttx/NuttX/nuttx"), "builds for the simulator only"),
    (lambda p: shutil.rmtree(p / ".git"), "its version is unknown (there is no .git folder)"),
    (lambda p: git(p, "tag", "-d", "v1.16.1"), "its version is unknown (git describe says: fatal: No names found"),
    (
        lambda p: shutil.rmtree(p / "src/modules/mc_rate_control"),
        "has no mc_rate_control, whose place the module takes",
    ),
    (lambda p: put(p.parent / "out", "msg/Mine.msg"), "was changed since the export: msg/Mine.msg"),
]


@pytest.mark.parametrize(("spoil", "what"), WARNED, ids=[what for _, what in WARNED])
def test_what_may_not_fit_is_a_warning(px4: Path, exported: Path, spoil: Callable[[Path], object], what: str) -> None:
    spoil(px4)
    found = check(px4, exported)
    assert found.fits, said(found, ERROR)
    assert what in said(found, WARNING)


def test_another_version_is_a_warning(px4: Path, exported: Path) -> None:
    git(px4, "tag", "-d", "v1.16.1")
    git(px4, "tag", "v1.15.4")
    found = check(px4, exported)
    assert found.fits
    assert "is PX4 v1.15.4: what the module uses is there, but it was flown with" in said(found, WARNING)


def test_an_airframe_of_the_same_number_is_a_warning(px4: Path, exported: Path) -> None:
    number = json.loads((exported / MANIFEST).read_text())["airframe"]
    folder = "ROMFS/px4fmu_common/init.d-posix/airframes"
    put(px4, f"{folder}/{number}_twodof_pitch")
    assert check(px4, exported).rows == ()
    (px4 / folder / f"{number}_twodof_pitch").rename(px4 / folder / f"{number}_mine")
    assert f"has an airframe {number} already" in said(check(px4, exported), WARNING)


def another(folder: Path, name: str = "pile", prefix: str = "TPI") -> Path:
    """The export of another diagram, whose parameters begin like those of `pitch`."""
    diagram = pitch()
    diagram.name = name
    export(diagram, folder, prefix=prefix)
    return folder


def put_together(into: Path, other: Path) -> None:
    """What docs/how-to/export-to-px4.md says of two modules: the one's sources and message into the other's folders."""
    shutil.copytree(other / "src/modules", into / "src/modules", dirs_exist_ok=True)
    shutil.copytree(other / "etc", into / "etc", dirs_exist_ok=True)
    for message in (other / "msg").glob("*.msg"):
        shutil.copy(message, into / "msg")


def test_two_modules_in_one_folder_whose_parameters_are_called_alike_do_not_fit(
    px4: Path, exported: Path, tmp_path: Path
) -> None:
    put_together(exported, another(tmp_path / "other"))
    found = check(px4, exported)
    assert not found.fits
    errors = said(found, ERROR)
    assert "twodof_pile/module.yaml: has parameters TPI_DAMP_GAINS_0" in errors
    assert "export one of the two again with another --prefix" in errors


def test_two_modules_in_one_folder_with_prefixes_of_their_own_fit(px4: Path, exported: Path, tmp_path: Path) -> None:
    put_together(exported, another(tmp_path / "other", prefix="TQ"))
    found = check(px4, exported)
    assert found.fits, said(found, ERROR)


def test_a_module_that_was_copied_into_px4_is_seen(px4: Path, exported: Path, tmp_path: Path) -> None:
    put_together(px4, another(tmp_path / "other"))
    errors = said(check(px4, exported), ERROR)
    assert f"{px4}/src/modules/twodof_pile/module.yaml: has parameters TPI_DAMP_GAINS_0" in errors


def test_a_module_that_another_build_of_this_px4_has_taken_is_a_warning(
    px4: Path, exported: Path, tmp_path: Path
) -> None:
    other = another(tmp_path / "other")
    cache = "build/px4_sitl_default/CMakeCache.txt"
    put(px4, cache, f"CMAKE_AR:FILEPATH=/usr/bin/ar\nEXTERNAL_MODULES_LOCATION:STRING={other}\n")
    found = check(px4, exported)
    assert found.fits, said(found, ERROR)
    warnings = said(found, WARNING)
    assert f"{other}/src/modules/twodof_pile/module.yaml: has parameters TPI_DAMP_GAINS_0" in warnings
    assert "px4_sitl_default was built with it, and in one folder the two do not build" in warnings
    for mine in (exported, tmp_path / "gone"):
        put(px4, cache, f"EXTERNAL_MODULES_LOCATION:STRING={mine}\n")
        assert check(px4, exported).rows == ()


def test_an_airframe_of_the_same_number_in_one_folder_is_a_warning(px4: Path, exported: Path, tmp_path: Path) -> None:
    number = json.loads((exported / MANIFEST).read_text())["airframe"]
    put_together(exported, another(tmp_path / "other", prefix="TQ"))
    frames = exported / "etc/init.d-posix/airframes"
    next(frames.glob("*_twodof_pile")).rename(frames / f"{number}_twodof_pile")
    assert f"{number}_twodof_pile: has an airframe {number} already" in said(check(px4, exported), WARNING)


def test_a_read_only_px4_is_refused(px4: Path, exported: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # As root every folder can be written, so the answer of a read-only file system is put in.
    real = os.access
    monkeypatch.setattr(os, "access", lambda path, how: how != os.W_OK and real(path, how))
    assert "is read-only" in said(check(px4, exported), ERROR)


@pytest.mark.parametrize("name", ["nothing", "empty", "file", "cmake"])
def test_what_is_no_px4_is_refused(tmp_path: Path, exported: Path, name: str) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("")
    put(tmp_path, "cmake/CMakeLists.txt", "project(px4_msgs)\n")
    found = check(tmp_path / name, exported)
    assert not found.fits
    assert len(found.rows) == 1


@pytest.mark.parametrize("lost", ["src", "msg", "README.md", "src/CMakeLists.txt"])
def test_an_export_that_has_lost_files_does_not_fit(px4: Path, exported: Path, lost: str) -> None:
    place = exported / lost
    shutil.rmtree(place) if place.is_dir() else place.unlink()
    found = check(px4, exported)
    assert not found.fits
    assert "has lost files of the export" in said(found, ERROR)
    assert lost in said(found, ERROR)


def test_a_pipe_in_the_tree_does_not_hang(px4: Path, exported: Path) -> None:
    (px4 / "msg/CMakeLists.txt").unlink()
    os.mkfifo(px4 / "msg/CMakeLists.txt")
    os.mkfifo(px4 / "msg/Pipe.msg")
    os.mkfifo(exported / "pipe")
    assert "was changed since the export: pipe" in said(check(px4, exported), WARNING)


def test_a_folder_without_an_export_raises(px4: Path, tmp_path: Path) -> None:
    with pytest.raises(CompileError, match="holds no exported module"):
        check(px4, tmp_path)
    with pytest.raises(CompileError, match="holds no exported module"):
        check(px4, tmp_path / "nothing")


@pytest.mark.parametrize("key", ["module", "parameters", "airframe", "reads", "description"])
def test_a_damaged_manifest_raises(px4: Path, exported: Path, key: str) -> None:
    data = json.loads((exported / MANIFEST).read_text())
    for value in (None, 3.5, {"a": 1}, [1, 2]):
        (exported / MANIFEST).write_text(json.dumps(data | {key: value}))
        with pytest.raises(CompileError, match="manifest is damaged"):
            check(px4, exported)


@pytest.mark.parametrize(
    ("text", "version"),
    [
        ("v1.16.1", Px4Version(1, 16, 1)),
        ("v1.16.1-rc2\n", Px4Version(1, 16, 1, "rc2")),
        ("v1.17.0-alpha1-533-gabc1234", Px4Version(1, 17, 0, "alpha1-533-gabc1234")),
        ("1.14", Px4Version(1, 14, 0)),
        ("abc1234", None),
        ("v1", None),
        ("", None),
        ("v1.16.1; rm", None),
    ],
)
def test_versions_are_read(text: str, version: Px4Version | None) -> None:
    assert parse_version(text) == version


def test_far_from_a_tag_the_version_is_unknown(px4: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    describe = subprocess.CompletedProcess(["git"], 0, "v1.8.0-beta1-24731-gbb59c637cd\n", "")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: describe)
    version, reason = SourceTree(px4).version
    assert version is None
    assert "24731 commits" in reason
