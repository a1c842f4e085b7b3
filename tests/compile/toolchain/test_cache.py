"""The cache of compiled code is run as it lies there: what others could have put into it is not."""

from __future__ import annotations

import ctypes
import hashlib
import os
import shlex
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.patience import PATIENCE_S, patiently
from tests.processes import started
from twodof.compile.native import target
from twodof.compile.toolchain import compilers

pytestmark = pytest.mark.slow

GOOD, EVIL = 42, 666
SOURCE = "int twodof_cache_answer(void) {{ return {}; }}\n"
NOBODY = 65534
as_root = pytest.mark.skipif(os.getuid() != 0, reason="only root can give a file to another user")


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TWODOF_CACHE", str(tmp_path / "home" / "cache"))
    return tmp_path / "home" / "cache"


def answer(value: int = GOOD) -> int:
    """What the library says that is compiled, or found, for a source that answers `value`.

    A process has one library for each path, so a copy of what would be loaded is asked.
    """
    with compilers.compiled(SOURCE.format(value), compilers.find_compiler(), target.FLAGS, ".so") as file:
        copy = Path(tempfile.mkstemp(suffix=".so")[1])
        shutil.copyfile(file, copy)
    try:
        return int(ctypes.CDLL(str(copy)).twodof_cache_answer())
    finally:
        copy.unlink()


def answer_of_a_program() -> int:
    """The same with what is really loaded, in a process of its own."""
    code = (
        "from twodof.compile.native.target import load\n"
        "from twodof.compile.toolchain.compilers import find_compiler\n"
        f"print(load({SOURCE.format(GOOD)!r}, find_compiler()).twodof_cache_answer())\n"
    )
    return int(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, timeout=PATIENCE_S).stdout)


def forged(cache: Path, folder: Path) -> bytes:
    """A library that answers something else, sealed as its forger can, who has read how, for the entry in `cache`."""
    (entry,) = cache.glob("*.so")
    folder.mkdir()
    (folder / "evil.c").write_text(SOURCE.format(EVIL))
    made = folder / "evil.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-o", str(made), str(folder / "evil.c")], check=True)
    data = made.read_bytes()
    for name in (entry.stem.encode(), b""):
        if entry.read_bytes()[-32:] == hashlib.sha256(name + entry.read_bytes()[:-32]).digest():
            return data + hashlib.sha256(name + data).digest()
    raise AssertionError("the seal is another one by now")


def exchanged(cache: Path, data: bytes) -> Path:
    """The entry, with `data` in its place; the file that is mapped here stays as it is."""
    (entry,) = cache.glob("*.so")
    entry.unlink()
    entry.write_bytes(data)
    entry.chmod(0o644)
    return entry


@as_root
def test_a_library_of_another_user_is_not_loaded_from_a_folder_of_ours(cache: Path, tmp_path: Path) -> None:
    """As it is after `chmod go-w` of a folder into which he could write before."""
    assert target.load(SOURCE.format(GOOD), compilers.find_compiler()).twodof_cache_answer() == GOOD
    entry = exchanged(cache, forged(cache, tmp_path / "his"))
    os.chown(entry, NOBODY, NOBODY)
    assert answer_of_a_program() == GOOD
    assert [file.stat().st_uid for file in cache.iterdir()] == [os.getuid()]


@pytest.mark.parametrize("mode", [0o666, 0o664, 0o646])
def test_a_library_that_others_can_write_is_not_loaded(cache: Path, tmp_path: Path, mode: int) -> None:
    assert answer() == GOOD
    exchanged(cache, forged(cache, tmp_path / "his")).chmod(mode)
    assert answer() == GOOD


def test_a_link_is_not_followed(cache: Path, tmp_path: Path) -> None:
    assert answer() == GOOD
    elsewhere = tmp_path / "elsewhere.so"
    elsewhere.write_bytes(forged(cache, tmp_path / "his"))
    entry = exchanged(cache, b"")
    entry.unlink()
    entry.symlink_to(elsewhere)
    assert answer() == GOOD
    assert not entry.is_symlink()


def test_a_pipe_does_not_hang(cache: Path) -> None:
    assert target.load(SOURCE.format(GOOD), compilers.find_compiler()).twodof_cache_answer() == GOOD
    (entry,) = cache.glob("*.so")
    entry.unlink()
    os.mkfifo(entry)
    assert answer_of_a_program() == GOOD
    assert entry.is_file()


def test_an_entry_under_the_name_of_another_is_not_loaded(cache: Path) -> None:
    """Nobody has to write a file for that: to rename one of ours is enough."""
    assert answer(7) == 7
    (other,) = cache.glob("*.so")
    kept = other.read_bytes()
    assert answer(8) == 8
    (entry,) = [file for file in cache.glob("*.so") if file != other]
    entry.unlink()
    entry.write_bytes(kept)
    entry.chmod(0o644)
    assert answer(8) == 8


@pytest.mark.parametrize("mode", [0o777, 0o770])
def test_a_folder_that_others_can_exchange_is_not_used(cache: Path, mode: int) -> None:
    assert answer() == GOOD
    before = sorted(cache.iterdir())
    cache.parent.chmod(mode)
    with pytest.warns(RuntimeWarning, match="name another folder in TWODOF_CACHE") as said:
        assert answer(9) == 9
    assert str(cache.parent) in str(said[0].message)
    assert sorted(cache.iterdir()) == before
    cache.parent.chmod(0o1777)  # as /tmp is: others cannot rename what is ours
    assert answer(9) == 9
    assert len(list(cache.iterdir())) == 2


@as_root
@pytest.mark.parametrize("which", ["cache", "parent"])
def test_a_folder_of_another_user_is_not_used(cache: Path, which: str) -> None:
    assert answer() == GOOD
    os.chown(cache if which == "cache" else cache.parent, NOBODY, NOBODY)
    with pytest.warns(RuntimeWarning, match="name another folder in TWODOF_CACHE"):
        assert answer(9) == 9
    assert len(list(cache.iterdir())) == 1


def test_the_remedy_that_is_given_leads_to_a_cache_that_is_safe_and_used(cache: Path, tmp_path: Path) -> None:
    assert answer() == GOOD
    exchanged(cache, forged(cache, tmp_path / "his"))
    cache.chmod(0o777)
    with pytest.warns(RuntimeWarning, match="others may write into this cache") as said:
        assert answer() == GOOD
    remedy = str(said[0].message).partition("remove it (")[2].partition(")")[0]
    subprocess.run(shlex.split(remedy), check=True)
    assert answer() == GOOD
    assert stat.S_IMODE(cache.stat().st_mode) == 0o700
    assert len(list(cache.iterdir())) == 1


@pytest.fixture
def lax() -> Iterator[None]:
    """A user whose new files anybody may write."""
    before = os.umask(0)
    yield
    os.umask(before)


@pytest.mark.usefixtures("lax")
def test_what_we_put_there_nobody_else_can_write(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache.parent.mkdir(mode=0o755)
    assert answer() == GOOD
    assert all(not file.stat().st_mode & 0o022 for file in (cache, *cache.iterdir()))

    def never(*_: object) -> None:
        raise AssertionError("it is there and not taken")

    monkeypatch.setattr(compilers, "compile_c", never)
    assert answer() == GOOD


BUILD = (
    "from pathlib import Path\n"
    "from twodof.compile.native.target import load\n"
    "from twodof.compile.toolchain.compilers import find_compiler\n"
    "load('int x;', find_compiler({compiler!r}))\n"
)


@pytest.mark.long
def test_what_an_interrupted_build_left_is_gone_at_the_next_use_and_a_running_build_stays(
    cache: Path, tmp_path: Path
) -> None:
    assert answer() == GOOD
    slow = tmp_path / "cc"
    slow.write_text(f"#!/bin/sh\necho $$ >> {tmp_path}/compilers\nexec sleep {10 * PATIENCE_S:.0f}\n")
    slow.chmod(0o755)
    command = [sys.executable, "-c", BUILD.format(compiler=str(slow))]
    compilers = tmp_path / "compilers"
    compilers.touch()
    with started(command) as killed, started(command) as runs:
        for _ in patiently():
            if len(compilers.read_text().splitlines()) == 2:
                break
        killed.send_signal(signal.SIGKILL)
        killed.wait(PATIENCE_S)
        subprocess.run([sys.executable, "-c", BUILD.format(compiler=None)], check=True, timeout=PATIENCE_S)
        assert len(list(cache.glob("build-*"))) == 1, "one is left of a program that was killed"
        assert runs.poll() is None
        runs.send_signal(signal.SIGKILL)
        runs.wait(PATIENCE_S)
        # Nothing is compiled now: what is needed is there.
        subprocess.run([sys.executable, "-c", BUILD.format(compiler=None)], check=True, timeout=PATIENCE_S)
        assert sorted(file.suffix for file in cache.iterdir()) == [".so", ".so"]
    for compiler in compilers.read_text().split():  # who waits for them is not there any more
        os.kill(int(compiler), signal.SIGKILL)
