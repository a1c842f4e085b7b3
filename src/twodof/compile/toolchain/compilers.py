"""C compilers and their cached products: libraries, WebAssembly modules, images."""

import functools
import hashlib
import importlib.util
import os
import platform
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from twodof.compile.toolchain.cache import Read, cached
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
BUILD_SECONDS = 600


@dataclass(frozen=True)
class Compiler:
    """A C compiler: its name, the beginning of its command line, and flags that only it needs."""

    name: str
    command: tuple[str, ...]
    flags: tuple[str, ...] = ()

    def identity(self) -> str:
        """Return a text that changes with the compiler: the resolved program, its size and its time."""
        path = Path(self.command[0]).resolve()
        stat = path.stat()
        return f"{self.name} {path} {stat.st_size} {stat.st_mtime_ns}"


def find_compiler(name: str | None = None) -> Compiler:
    """Return the compiler `name` ("cc", "gcc", "clang", "zig" or a path), by default the first that is installed.

    Raises CompileError if there is none.
    """
    for candidate in (name,) if name else ("cc", "gcc", "clang", "zig"):
        path = find_zig() if candidate == "zig" else shutil.which(candidate)
        if path and candidate == "zig":
            return Compiler("zig", (path, "cc"), ("-fno-sanitize=undefined",))
        if path:
            return Compiler(candidate, (path,))
    remedy = "install gcc (Debian: apt-get install gcc libc6-dev), or the wheel ziglang (pip install ziglang)"
    raise CompileError(f"no C compiler named {name!r} was found" if name else "no C compiler was found", "", remedy)


def find_zig() -> str | None:
    """Return the path of zig: in the wheel ziglang, or else on PATH."""
    wheel = importlib.util.find_spec("ziglang")
    folders = (wheel.submodule_search_locations or ()) if wheel is not None else ()
    # Not by way of `python -m ziglang`, which takes another tenth of a second.
    return next((path for path in (shutil.which("zig", path=f) for f in folders) if path), None) or shutil.which("zig")


@functools.cache
def processor() -> str:
    """Return a text that identifies everything on which `-march=native` depends."""
    try:
        first = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").partition("\n\n")[0]
    except OSError:
        first = platform.processor()
    volatile = ("processor", "cpu MHz", "bogomips", "apicid", "initial apicid", "core id", "physical id", "microcode")
    lines = [line for line in first.splitlines() if not line.lower().startswith(tuple(v.lower() for v in volatile))]
    return f"{platform.machine()} {platform.system()} {hashlib.sha256(chr(10).join(lines).encode()).hexdigest()}"


def compiled(
    source: str,
    compiler: Compiler,
    options: Sequence[str],
    suffix: str,
    read: Callable[[Path], Read],
    depends: str = "",
    files: Mapping[str, str] | None = None,
) -> Read:
    """Return `read(file)` of the file that `compiler` makes of the C `source` with `options`, cached by `cached`.

    `suffix` ends its name (".so", ".wasm", ".elf"). `depends` identifies anything else that decides its bytes (the
    processor, with `-march=native`). `files` (texts by name) are written beside the source, where the compiler runs, so
    that an option may name them (a linker script). Raises CompileError if the compiler refuses or hangs.
    """
    named = [part for item in sorted((files or {}).items()) for part in item]
    key = (source, compiler.identity(), *options, depends, *named)
    return cached(key, suffix, lambda made: compile_c(source, made, compiler, options, files), read)


def compile_c(
    source: str, target: Path, compiler: Compiler, options: Sequence[str], files: Mapping[str, str] | None = None
) -> None:
    """Compile `source` to `target`, whose folder is the working directory; see `compiled`."""
    file = target.with_suffix(".c")
    for path, text in {file: source, **{target.parent / n: t for n, t in (files or {}).items()}}.items():
        path.write_text(text, encoding="utf-8")
    done = run_compiler(compiler, (*options, "-o", str(target), str(file)), target.parent)
    if done.returncode or not target.is_file():
        said = done.stderr.decode("utf-8", "replace").strip()[-2000:]
        what = f"it refused the generated C: {said or f'exit status {done.returncode}'}"
        raise CompileError(what, compiler.name, "check that the compiler works; if it does, this is a fault of twodof")


def run_compiler(compiler: Compiler, arguments: Sequence[str], folder: Path) -> subprocess.CompletedProcess[bytes]:
    """Run `compiler` in `folder`, also for its temporary files, and return its status and standard error.

    Raises CompileError if it does not start, or if it does not end within BUILD_SECONDS; then the processes that it has
    started end too.
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
