"""Compilers, and the cache of what they made: libraries, WebAssembly modules, images, by content."""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import os
import platform
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from twodof.errors import CompileError

if sys.platform == "linux":
    import resource

# Every target gives the same bits only under these; see the rules at the head of the emitted file.
FLAGS = (
    "-std=c99",
    "-ffp-contract=off",
    "-fno-math-errno",
    # No branch around what is cheaper computed for nothing; changes no result, as no IEEE exception is looked at.
    "-fno-trapping-math",
    # Packed stores of neighbouring states that are loaded one by one right after, or the other way, wait for memory.
    "-fno-tree-slp-vectorize",
    "-w",
)
CACHE_VERSION = "twodof-cache-2"
BUILD_SECONDS = 600
MOST_ENTRIES = 2000
MOST_BYTES = 2 * 1024**3
_SEAL = hashlib.sha256().digest_size


@dataclass(frozen=True)
class Compiler:
    """A C compiler: its command line's beginning, and the flags only it needs."""

    name: str
    command: tuple[str, ...]
    flags: tuple[str, ...] = ()

    def identity(self) -> str:
        """What changes when the compiler does: the resolved program, its size and its time."""
        path = Path(self.command[0]).resolve()
        stat = path.stat()
        return f"{self.name} {path} {stat.st_size} {stat.st_mtime_ns}"


def find_compiler(name: str | None = None) -> Compiler:
    """The compiler called `name` ("cc", "gcc", "clang", "zig" or a path), or else the first there is.

    Raises CompileError if it is not there.
    """
    for candidate in (name,) if name else ("cc", "gcc", "clang", "zig"):
        path = find_zig() if candidate == "zig" else shutil.which(candidate)
        if path and candidate == "zig":
            return Compiler("zig", (path, "cc"), ("-fno-sanitize=undefined",))
        if path:
            return Compiler(candidate, (path,))
    raise CompileError(
        f"there is no C compiler {name!r}" if name else "there is no C compiler",
        "",
        "install gcc (Debian: apt-get install gcc libc6-dev), or the wheel ziglang (pip install ziglang)",
    )


def find_zig() -> str | None:
    """The path of zig: in the wheel ziglang, or else where PATH says."""
    wheel = importlib.util.find_spec("ziglang")
    folders = (wheel.submodule_search_locations or ()) if wheel is not None else ()
    # Not by way of `python -m ziglang`, which takes another tenth of a second.
    return next((path for path in (shutil.which("zig", path=f) for f in folders) if path), None) or shutil.which("zig")


@functools.cache
def processor() -> str:
    """What `-march=native` depends on."""
    try:
        first = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").partition("\n\n")[0]
    except OSError:
        first = platform.processor()
    volatile = ("processor", "cpu MHz", "bogomips", "apicid", "initial apicid", "core id", "physical id", "microcode")
    lines = [line for line in first.splitlines() if not line.lower().startswith(tuple(v.lower() for v in volatile))]
    return f"{platform.machine()} {platform.system()} {hashlib.sha256(chr(10).join(lines).encode()).hexdigest()}"


def cache_folder() -> Path:
    """The user's folder of what was compiled: TWODOF_CACHE, or XDG_CACHE_HOME/twodof, or ~/.cache/twodof."""
    named = os.environ.get("TWODOF_CACHE")
    if named:
        return Path(named)
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(base) if base else Path.home() / ".cache") / "twodof"
    except RuntimeError:  # no home
        return _private_folder(Path(tempfile.gettempdir()) / f"twodof-{os.getuid()}")


def _private_folder(folder: Path) -> Path:
    """`folder`, made if it is not there; a fresh one instead if others could have put a library into it."""
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return Path(tempfile.mkdtemp(prefix="twodof-"))
    return folder if stat.S_ISDIR(found.st_mode) and _ours(found) else Path(tempfile.mkdtemp(prefix="twodof-"))


@contextmanager
def compiled(
    source: str,
    compiler: Compiler,
    options: Sequence[str],
    suffix: str,
    depends: str = "",
    files: Mapping[str, str] | None = None,
    afresh: bool = False,
) -> Iterator[Path]:
    """The file that `compiler` makes of the C `source` with `options`, from the cache if it is there.

    `suffix` ends its name (".so", ".wasm", ".elf"). `depends` is what else decides its bytes (the processor, with
    `-march=native`). `files` (name -> text) are written beside the source, where the compiler runs, so that an option
    may name them (a linker script). The file ends with a seal, which loaders of shared objects and ELF ignore;
    `compiled_bytes` gives the bytes without it. It may be gone after the `with`, and before where another process makes
    room. `afresh` makes it even if it is there. Raises CompileError if the compiler refuses or hangs.
    """
    key = _key(source, compiler, options, depends, files)
    with cached(key, suffix, lambda made: compile_c(source, made, compiler, options, files), afresh) as file:
        yield file


def compiled_bytes(
    source: str, compiler: Compiler, options: Sequence[str], suffix: str, files: Mapping[str, str] | None = None
) -> bytes:
    """The bytes of the file that `compiled` gives, without its seal. Raises CompileError as that does."""
    key = _key(source, compiler, options, "", files)
    return cached_bytes(key, suffix, lambda made: compile_c(source, made, compiler, options, files))


def _key(
    source: str, compiler: Compiler, options: Sequence[str], depends: str, files: Mapping[str, str] | None
) -> tuple[str, ...]:
    named = [part for item in sorted((files or {}).items()) for part in item]
    return (source, compiler.identity(), *options, depends, *named)


@contextmanager
def cached(key: Sequence[str], suffix: str, make: Callable[[Path], None], afresh: bool = False) -> Iterator[Path]:
    """The sealed file that `make(path)` writes for what `key` says, from the cache if it is there.

    It appears in the cache at once or not at all, so that several processes may make the same. `make` may leave other
    files in the folder of its path. Where the cache cannot be written it is done without.
    """
    digest = hashlib.sha256("\0".join((CACHE_VERSION, *key)).encode()).hexdigest()
    folder = cache_folder()
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    trusted = _trusted(folder)
    entry = folder / f"{digest}{suffix}"
    if trusted and not afresh and whole(entry):
        yield entry
        return
    try:
        work = tempfile.TemporaryDirectory(dir=folder if trusted else None, prefix="build-")
    except OSError:  # a cache that cannot be written is no reason not to run
        work = tempfile.TemporaryDirectory(prefix="twodof-")
    with work as name:
        made = Path(name) / f"program{suffix}"
        make(made)
        _seal(made)
        if trusted and made.parent.parent == folder:
            made.replace(entry)  # atomic: another process sees the old file, none, or the whole new one
            _prune(folder)
            made = entry
        yield made


def cached_bytes(key: Sequence[str], suffix: str, make: Callable[[Path], None], afresh: bool = False) -> bytes:
    """The bytes of the file that `cached` gives, without its seal.

    They come also where another process makes room in the cache between our look at the file and our reading it.
    """
    with suppress(FileNotFoundError), cached(key, suffix, make, afresh) as file:
        return _contents(file)
    with cached(key, suffix, make, afresh=True) as file:
        return _contents(file)


def _contents(file: Path) -> bytes:
    return file.read_bytes()[:-_SEAL]


def compile_c(
    source: str, target: Path, compiler: Compiler, options: Sequence[str], files: Mapping[str, str] | None = None
) -> None:
    """Write what `compiler` makes of `source` to `target`, whose folder is its working directory; see `compiled`."""
    file = target.with_suffix(".c")
    for path, text in {file: source, **{target.parent / n: t for n, t in (files or {}).items()}}.items():
        path.write_text(text, encoding="utf-8")
    done = run_compiler(compiler, (*options, "-o", str(target), str(file)), target.parent)
    if done.returncode or not target.is_file():
        said = done.stderr.decode("utf-8", "replace").strip()[-2000:]
        raise CompileError(
            f"it refused the C that was generated: {said or f'exit status {done.returncode}'}",
            compiler.name,
            "check that the compiler works; if it does, this is a fault of twodof",
        )


def run_compiler(compiler: Compiler, arguments: Sequence[str], folder: Path) -> subprocess.CompletedProcess[bytes]:
    """Run `compiler` in `folder`, where its temporary files are too; the result has what it said, but no output.

    Raises CompileError if it does not start, or does not end within BUILD_SECONDS: then the processes it has started
    end with it.
    """
    command = [*compiler.command, *arguments]
    try:
        with subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            cwd=folder,
            env=os.environ | {"TMPDIR": str(folder)},
            start_new_session=True,
        ) as process:
            if sys.platform == "linux":
                with suppress(OSError):  # it may have ended; a limit of its own, for when this process is killed
                    resource.prlimit(process.pid, resource.RLIMIT_CPU, (BUILD_SECONDS, BUILD_SECONDS))
            try:
                _, said = process.communicate(timeout=BUILD_SECONDS)
            except BaseException:
                with suppress(OSError):  # the driver is only the parent of what computes
                    os.killpg(process.pid, signal.SIGKILL)
                raise
    except subprocess.TimeoutExpired as error:
        raise CompileError(
            f"it did not end within {BUILD_SECONDS} s", compiler.name, "make the diagram smaller"
        ) from error
    except OSError as error:
        raise CompileError(f"it does not start: {error}", compiler.name, "install a working C compiler") from error
    return subprocess.CompletedProcess(command, process.returncode, None, said)


def whole(file: Path) -> bool:
    """Whether `file` is there and its seal is that of its bytes."""
    try:
        data = file.read_bytes()
    except OSError:
        return False
    return len(data) > _SEAL and hashlib.sha256(data[:-_SEAL]).digest() == data[-_SEAL:]


def _seal(file: Path) -> None:
    """Append the digest of its bytes."""
    data = file.read_bytes()
    with file.open("ab") as stream:
        stream.write(hashlib.sha256(data).digest())
        stream.flush()
        os.fsync(stream.fileno())


def _ours(found: os.stat_result) -> bool:
    """Whether only this user, or root, can write."""
    return found.st_uid in (0, os.getuid()) and not found.st_mode & 0o022


def _trusted(folder: Path) -> bool:
    """Whether nobody else can put a file into `folder`, which this process would run: a seal is no signature.

    Warns of a folder that is there and is not.
    """
    try:
        found = folder.stat()
    except OSError:
        return False
    if _ours(found):
        return True
    warnings.warn(
        f"{folder}: others may write into this cache of compiled code, so it is not used; "
        "make it yours alone (chmod go-w), or name another folder in TWODOF_CACHE",
        RuntimeWarning,
        stacklevel=2,
    )
    return False


def _prune(folder: Path) -> None:
    """Forget the oldest entries of a cache that has grown too large, and what ended builds have left."""
    ages: list[tuple[int, int, Path]] = []
    with suppress(OSError):
        for item in folder.iterdir():
            found = item.lstat()
            if stat.S_ISREG(found.st_mode):
                ages.append((found.st_mtime_ns, found.st_size, item))
            elif item.name.startswith("build-") and time.time() - found.st_mtime > 2 * BUILD_SECONDS:
                shutil.rmtree(item, ignore_errors=True)
        if len(ages) <= MOST_ENTRIES and sum(size for _, size, _ in ages) <= MOST_BYTES:
            return
        for _, _, old in sorted(ages)[: max(1, len(ages) // 2)]:
            old.unlink(missing_ok=True)
