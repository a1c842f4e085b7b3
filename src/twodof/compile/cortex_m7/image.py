"""Image for the Cortex-M7: programs, start-up and server, cross-compiled and linked to one ELF file."""

import io
import re
import shutil
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from twodof.compile.c.operators import FREESTANDING_FILES, FREESTANDING_MEMORY
from twodof.compile.toolchain import cache, compilers
from twodof.compile.toolchain.compilers import Compiler
from twodof.errors import CompileError

FIRMWARE = Path(__file__).parent / "firmware"
OWN = ("boot.c", "server.c", "aeabi.c")
HEADERS = ("program.h", "semihosting.h", "server.h")
SCRIPT = "image.ld"
CALLED = ("program", "aeabi", "memory")  # what a step may call
MODULES = (*CALLED, "boot", "server", "dispatch")
FIRMWARE_MODULES = ("aeabi", "memory", "boot", "server")  # the same in each image
MEMORY = f"#include <stddef.h>\n#include <stdint.h>\n{FREESTANDING_MEMORY}"

FLAGS = (*compilers.FLAGS, "-ffreestanding", "-fomit-frame-pointer", "-g0", "-ffunction-sections", "-fdata-sections")
# FPv5 with 16 double registers, the larger of the processor's two floating-point units; values in its registers.
GCC = ("-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard", "-fstack-usage")
ZIG = (
    *("-target", "thumb-freestanding-eabihf", "-mcpu=cortex_m7+fp_armv8d16"),
    *("-fno-sanitize=undefined", "-fstack-size-section"),
)
LINK = ("-nostdlib", "-static", "-Wl,--gc-sections", "-T", SCRIPT)
OPTIMISE = "-O2"


def find_cross_compiler(name: str | None = None) -> Compiler:
    """Return the cross compiler `name` ("gcc" or "zig"), or else the first that is installed.

    Raises CompileError, which names the package to install, if there is none.
    """
    if name not in (None, "gcc", "arm-none-eabi-gcc", "zig"):
        raise CompileError(f"{name!r:.80} is not a cross compiler for the Cortex-M7", "", "name gcc or zig")
    if name != "zig" and (path := shutil.which("arm-none-eabi-gcc")):
        return Compiler("arm-none-eabi-gcc", (path,), GCC)
    if name in (None, "zig") and (path := compilers.find_zig()):
        return Compiler("zig", (path, "cc"), ZIG)
    raise CompileError(
        "no C compiler for the Cortex-M7 was found"
        if name is None
        else f"{name}, a compiler for the Cortex-M7, was not found",
        "",
        "install arm-none-eabi-gcc (Debian: apt-get install gcc-arm-none-eabi) or the wheel ziglang",
    )


@dataclass(frozen=True)
class Image:
    """An image for the processor, with its parts.

    `elf` is the whole image; `objects` are the object files of `CALLED`, first that of the programs' own C.
    `stack_usage` is gcc's report on the stack frames of their functions (clang's is in the objects). `names` and
    `sizes` [bytes] are those of the programs, in the image's order.
    """

    elf: bytes
    objects: tuple[bytes, ...]
    stack_usage: str
    names: tuple[str, ...]
    sizes: tuple[tuple[int, ...], ...]
    compiler: str
    optimise: str


def build_image(
    source: str,
    programs: Sequence[tuple[str, Sequence[int]]],
    compiler: Compiler,
    optimise: str = OPTIMISE,
    flags: Sequence[str] = (),
    libraries: Sequence[str] = (),
) -> Image:
    """Build the image of the C `source`; each program is (prefix of its names, sizes of real, P, S, U and Y [bytes]).

    `flags` are further options for the source, `libraries` for the linker. Raises CompileError if the compiler refuses
    the C or hangs, or if code and constants do not fit into 4 MB.
    """
    names = tuple(name for name, _ in programs)
    table = "".join(f"DECLARE_PROGRAM({n})\n" for n in names)
    rows = "".join(f"    PROGRAM({n})\n" for n in names)
    dispatch = (
        f'#include "program.h"\n\n{table}\nconst Program programs[] = {{\n{rows}}};\n'
        f"const uint32_t program_count = {len(names)};\n"
    )
    firmware = {name: (FIRMWARE / name).read_text(encoding="utf-8") for name in (*OWN, *HEADERS, SCRIPT)}
    firmware |= {**FREESTANDING_FILES, "memory.c": MEMORY}
    files = {**firmware, "program.c": source, "dispatch.c": dispatch}
    options = (*FLAGS, *compiler.flags)

    def key(sources: Mapping[str, str]) -> tuple[str, ...]:
        texts = (part for item in sorted(sources.items()) for part in item)
        return *texts, compiler.identity(), *options, OPTIMISE

    def compile_(name: str, folder: Path, more: Sequence[str] = (OPTIMISE,)) -> None:
        _command(compiler, (*options, *more, "-I.", "-c", f"{name}.c", "-o", f"{name}.o"), folder)

    def make_firmware(target: Path) -> None:
        _write(firmware, target.parent)
        for name in FIRMWARE_MODULES:
            compile_(name, target.parent)
        _pack(target, FIRMWARE_MODULES)

    def make(target: Path) -> None:
        folder = target.parent
        _write(files, folder)
        with zipfile.ZipFile(
            io.BytesIO(cache.cached(key(firmware), ".m7o", make_firmware, Path.read_bytes))
        ) as archive:
            archive.extractall(folder)
        compile_("program", folder, (optimise, *flags))
        compile_("dispatch", folder)
        objects = [f"{name}.o" for name in MODULES]
        libgcc = () if compiler.name == "zig" else ("-lgcc",)
        _command(compiler, (*options, *LINK, *objects, *libraries, *libgcc, "-o", "image.elf"), folder)
        _pack(target, CALLED, "image.elf")

    wanted = (*key(files), optimise, *flags, *libraries)
    with zipfile.ZipFile(io.BytesIO(cache.cached(wanted, ".m7", make, Path.read_bytes))) as archive:
        usage = "".join(archive.read(n).decode() for n in archive.namelist() if n.endswith(".su"))
        elf, *objects = (archive.read(n) for n in ("image.elf", *(f"{m}.o" for m in CALLED)))
    sizes = tuple(tuple(s) for _, s in programs)
    return Image(elf, tuple(objects), usage, names, sizes, compiler.name, optimise)


def _write(files: Mapping[str, str], folder: Path) -> None:
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")


def _pack(target: Path, modules: Sequence[str], *more: str) -> None:
    """Archive the objects of `modules`, with gcc's reports on their stacks, and files named in `more`."""
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in (*more, *(f"{m}.{kind}" for m in modules for kind in ("o", "su"))):
            if (target.parent / name).exists():  # clang writes no .su, but a section
                archive.write(target.parent / name, name)


def _command(compiler: Compiler, arguments: Sequence[str], folder: Path) -> None:
    """Run the compiler in `folder`, within bounds of time."""
    done = compilers.run_compiler(compiler, arguments, folder)
    if done.returncode:
        said = done.stderr.decode("utf-8", "replace").strip()[-2000:]
        if re.search(r"overflowed by|will not fit in region", said):
            what = f"code and constants do not fit into the board's 4 MB: {said[-300:]}"
            raise CompileError(what, compiler.name, "build fewer diagrams at once, or with -Os")
        what = f"it refused the generated C: {said or f'exit status {done.returncode}'}"
        remedy = "check that the compiler works; if it does, this is a fault of twodof"
        raise CompileError(what, compiler.name, remedy)
