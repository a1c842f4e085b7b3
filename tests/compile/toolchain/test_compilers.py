"""Compilers and the cache of what they made: two processes at once, damage, no right to write, other flags."""

import ctypes
import os
import select
import shlex
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.patience import PATIENCE_S
from twodof.compile import native as target
from twodof.compile.toolchain import cache as cache_module
from twodof.compile.toolchain import compilers
from twodof.errors import CompileError

pytestmark = pytest.mark.slow

SOURCE = "int twodof_answer(void) { return 42; }\n"


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TWODOF_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def answer(library: ctypes.CDLL) -> int:
    return int(library.twodof_answer())


def test_the_second_time_no_compiler_runs(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compiler = compilers.find_compiler()
    assert answer(target.load(SOURCE, compiler)) == 42
    assert len(list(cache.glob("*.so"))) == 1
    assert stat.S_IMODE(cache.stat().st_mode) == 0o700

    def never(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(compilers, "compile_c", never)
    start = time.process_time()
    assert answer(target.load(SOURCE, compiler)) == 42
    assert time.process_time() - start < 0.5  # milliseconds, by this process's own clock


def test_source_flags_and_compiler_are_in_the_key(cache: Path) -> None:
    gcc, zig = compilers.find_compiler(), compilers.find_compiler("zig")
    target.load(SOURCE, gcc)
    target.load(SOURCE, gcc, "-O0")
    target.load(SOURCE, gcc, native=False)
    target.load(SOURCE, gcc, flags=["-DX=1"])
    target.load(SOURCE.replace("42", "43"), gcc)
    target.load(SOURCE, zig)
    assert len(list(cache.glob("*.so"))) == 6
    assert [p for p in cache.iterdir() if p.suffix != ".so"] == []  # nothing is left over


def test_a_cache_that_cannot_be_written_is_done_without(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder", encoding="utf-8")
    monkeypatch.setenv("TWODOF_CACHE", str(blocked / "cache"))
    assert answer(target.load(SOURCE, compilers.find_compiler())) == 42
    if os.geteuid() != 0:  # root may write everywhere
        closed = tmp_path / "closed"
        closed.mkdir(mode=0o500)
        monkeypatch.setenv("TWODOF_CACHE", str(closed))
        assert answer(target.load(SOURCE, compilers.find_compiler())) == 42


@pytest.mark.long
def test_processes_that_build_the_same_at_once_all_get_it(cache: Path) -> None:
    code = (
        "from twodof.compile.native import load\n"
        "from twodof.compile.toolchain.compilers import find_compiler\n"
        f"print(load({SOURCE!r}, find_compiler()).twodof_answer())\n"
    )
    started = [subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) for _ in range(3)]
    assert [p.communicate(timeout=PATIENCE_S)[0].strip() for p in started] == ["42"] * 3
    assert len(list(cache.iterdir())) == 1


def test_what_a_compiler_says_is_passed_on(cache: Path) -> None:
    with pytest.raises(CompileError, match="refused"):
        target.load("int broken(", compilers.find_compiler())
    assert list(cache.iterdir()) == []


def test_a_compiler_that_is_missing_or_broken_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(CompileError, match="no C compiler"):
        compilers.find_compiler("no-such-compiler")
    broken = tmp_path / "cc"
    broken.write_text("#!/no/such/interpreter\n", encoding="utf-8")
    broken.chmod(0o755)
    with pytest.raises(CompileError, match="does not start"):
        target.load(SOURCE, compilers.find_compiler(str(broken)))


def test_a_compiler_that_hangs_ends_with_all_that_it_started(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As gcc's driver does, the script leaves the work to a process of its own, which holds the pipe's other end."""
    pipe, hanging = tmp_path / "pipe", tmp_path / "cc"
    os.mkfifo(pipe)
    hanging.write_text(f"#!/bin/sh\nexec 3> {pipe}\nprintf begun >&3\nsleep {10 * PATIENCE_S:.0f}\ntrue\n")
    hanging.chmod(0o755)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)

    class Begun(subprocess.Popen[bytes]):
        """One whose time begins once its script has, however long the machine takes to start that."""

        def communicate(self, input: bytes | None = None, timeout: float | None = None) -> tuple[bytes, bytes]:
            assert select.select([reader], [], [], PATIENCE_S)[0] == [reader]
            assert timeout == 1
            return super().communicate(input, timeout)

    monkeypatch.setattr(compilers, "BUILD_SECONDS", 1)
    monkeypatch.setattr(subprocess, "Popen", Begun)
    try:
        with pytest.raises(CompileError, match="did not end within 1 s"):
            target.load(SOURCE, compilers.find_compiler(str(hanging)))
        assert os.read(reader, 100) == b"begun"
        assert select.select([reader], [], [], PATIENCE_S)[0] == [reader]
        assert os.read(reader, 100) == b""  # nobody has the other end any more
    finally:
        os.close(reader)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux limits a process that runs")
def test_a_compiler_has_a_limit_of_processor_time_of_its_own(cache: Path, tmp_path: Path) -> None:
    """It ends even if the Python that waits for it is killed before. The limit comes after its start, however soon."""
    asked, wanted = tmp_path / "cc", compilers.BUILD_SECONDS
    wait = f'for k in $(seq {10 * PATIENCE_S:.0f}); do [ "$(ulimit -t)" = {wanted} ] && break; sleep 0.1; done'
    asked.write_text(f"#!/bin/sh\n{wait}\nulimit -t >&2\nexit 1\n", encoding="utf-8")
    asked.chmod(0o755)
    with pytest.raises(CompileError, match=f"{wanted}"):
        target.load(SOURCE, compilers.find_compiler(str(asked)))


@pytest.mark.parametrize(("bound", "most"), [("MOST_ENTRIES", 3), ("MOST_BYTES", 300)])
def test_the_cache_does_not_grow_for_ever(bound: str, most: int, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache_module, bound, most)
    for k in range(6):
        cache_module.cached([str(k)], ".x", lambda made: made.write_bytes(bytes(100)) and None, Path.read_bytes)
    assert len(list(cache.iterdir())) <= 4


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o702])
def test_folder_that_others_can_write_is_not_used(cache: Path, mode: int) -> None:
    compiler = compilers.find_compiler()
    target.load(SOURCE, compiler, "-O0")
    (entry,) = cache.iterdir()
    entry.unlink()  # the old file stays mapped in this process
    entry.write_bytes(b"put there by another user")
    cache.chmod(mode)
    with pytest.warns(RuntimeWarning, match="others may write into this cache") as said:
        assert answer(target.load(SOURCE, compiler, "-O0")) == 42
    assert entry.read_bytes() == b"put there by another user"
    remedy = str(said[0].message).partition("remove it (")[2].partition(")")[0]
    subprocess.run(shlex.split(remedy), check=True)
    assert answer(target.load(SOURCE, compiler, "-O0")) == 42
    assert stat.S_IMODE(cache.stat().st_mode) == 0o700
    assert len(list(cache.iterdir())) == 1


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give a folder to another user")
def test_folder_of_another_user_is_not_used(cache: Path) -> None:
    cache.mkdir(mode=0o755)
    os.chown(cache, 65534, 65534)
    with pytest.warns(RuntimeWarning, match="others may write into this cache"):
        assert answer(target.load(SOURCE, compilers.find_compiler(), "-O0")) == 42
    assert list(cache.iterdir()) == []


@pytest.mark.parametrize("damage", [Path.unlink, lambda entry: entry.write_bytes(b"torn")])
def test_entry_that_cannot_be_read_is_made_again(cache: Path, damage: Callable[[Path], object]) -> None:
    """Another process may remove an entry that has just been found."""

    def read(file: Path) -> bytes:
        if file.parent == cache:
            damage(file)
        if (data := file.read_bytes()) != b"made":
            raise ValueError(data)
        return data

    for _ in range(2):
        made = cache_module.cached(["a key"], ".x", lambda made: made.write_bytes(b"made") and None, read)
        assert made == b"made"
    (entry,) = cache.iterdir()
    assert entry.read_bytes() == b"made"


def test_folders_of_killed_builds_are_removed(cache: Path) -> None:
    target.load(SOURCE, compilers.find_compiler(), "-O0")
    old, new = cache / "making-old", cache / "making-new"
    for folder in (old, new):
        folder.mkdir()
    os.utime(old, (0, 0))
    target.load(SOURCE.replace("42", "43"), compilers.find_compiler(), "-O0")
    assert new.exists()
    assert not old.exists()


def test_without_a_home_a_folder_that_others_can_write_is_not_trusted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def homeless() -> Path:
        raise RuntimeError("no home")

    for name in ("TWODOF_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "home", homeless)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    own = cache_module.cache_folder()
    assert own.parent == tmp_path
    target.load(SOURCE, compilers.find_compiler(), "-O0")
    assert own.stat().st_mode & 0o077 == 0
    own.chmod(0o777)
    before = sorted(own.iterdir())
    with pytest.warns(RuntimeWarning, match="others may write into this cache"):
        assert target.load(SOURCE.replace("42", "44"), compilers.find_compiler(), "-O0") is not None
    assert sorted(own.iterdir()) == before


def test_a_process_that_flushes_subnormals_is_refused() -> None:
    code = (
        "import ctypes, sys\n"
        "from twodof.compile.native import load\n"
        "from twodof.compile.toolchain.compilers import find_compiler\n"
        "from twodof.errors import CompileError\n"
        "flush = load('#include <xmmintrin.h>\\nvoid flush(void) { _mm_setcsr(_mm_getcsr() | 0x8040); }',\n"
        "                    find_compiler())\n"
        "flush.flush()\n"
        "try:\n"
        f"    load({SOURCE!r}, find_compiler())\n"
        "except CompileError as error:\n"
        "    print(error.what)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    if "xmmintrin.h" in done.stderr:
        pytest.skip("not an x86 processor")
    assert "subnormal" in done.stdout, done.stderr
