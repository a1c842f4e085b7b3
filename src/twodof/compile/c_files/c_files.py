"""A diagram as two files, `name`.h and `name`.c, and the map from the lines of the C to the blocks."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from twodof.blocks.declarations import check_name
from twodof.blocks.diagram import Diagram
from twodof.blocks.expressions import numbers
from twodof.compile.c.emitter import emit
from twodof.compile.c.operators import C_TYPES
from twodof.compile.c_files.interface import CInterface, comment
from twodof.compile.program.check import compiled
from twodof.compile.program.flat_program import FlatProgram
from twodof.compile.program.layout import Member, MemoryLayout
from twodof.compile.program.lower import lower
from twodof.compile.target import EmittedProgram
from twodof.errors import DiagramError, LogError
from twodof.flightlog.atomic import atomic_write, make_folder
from twodof.flightlog.files import check_folder

SHOWN = 6  # inputs and outputs in the example
_HEADERS = """
    assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg stdatomic
    stdbit stdbool stdckdint stddef stdint stdio stdlib stdnoreturn string strings tgmath threads time uchar wchar
    wctype
"""
STANDARD = frozenset(_HEADERS.split())
"""Standard headers of C, which a file of the same name would hide."""


@dataclass(frozen=True)
class CFiles:
    """Texts of a program's header and C file, and the emitted program that they contain."""

    emitted: EmittedProgram
    header: str

    @property
    def name(self) -> str:
        """Prefix of all names in the C, and name of the files."""
        return self.emitted.name

    @property
    def files(self) -> dict[str, str]:
        """Texts by file name."""
        return {f"{self.name}.h": self.header, f"{self.name}.c": self.emitted.source}

    def write(self, folder: str | Path, overwrite: bool = False) -> list[Path]:
        """Write both files into `folder`, which is made if it does not exist, and return their paths.

        Raises LogError if a file exists already (unless `overwrite`), or the folder cannot be made or written.
        """
        paths = [Path(folder, file) for file in self.files]
        try:
            make_folder(Path(folder))
        except OSError as error:
            raise LogError(
                f"the folder cannot be made: {error.strerror}", str(folder), "choose another folder"
            ) from error
        for path in paths:
            check_folder(path, overwrite)
        for path, text in zip(paths, self.files.values(), strict=True):
            with atomic_write(path, "w") as file:
                file.write(text)
        return paths


def c_files(
    diagram: Diagram,
    dt: float,
    precision: str = "float64",
    log: Iterable[str] = (),
    integrator: str = "rk4",
    name: str = "",
    tables: bool = False,
) -> CFiles:
    """Return `diagram` as C for a firmware; `dt` [s], `precision`, `log` and `integrator` as in `build`.

    All names begin with `name`, by default the diagram's; programs in one firmware need different ones. With `tables`
    there are `run` and the tables of parameters and signals as well. Raises DiagramError as `build`, and for a name
    that hides a header of C.
    """
    with numbers.precision(precision):  # refuses an unknown one
        program = lower(diagram, dt, log, integrator)
        program = replace(program, name=check_name(name or program.name, "name"))
        if program.name in STANDARD:
            raise DiagramError(
                f"{program.name}.h is a standard header of C", diagram.name, "give the program another `name`"
            )
        (emitted,) = emit([program], precision, lean=not tables, header=f"{program.name}.h")
    return CFiles(emitted, header(program, emitted.layout, precision, tables))


def header(program: FlatProgram, layout: MemoryLayout, precision: str, tables: bool) -> str:
    """Return the text of `program.name`.h: `layout`'s structs with units and paths, and the functions' prototypes.

    `real` is written as the C type of `precision`, so that programs of both can be included together. With `tables`
    it declares `run`, the tables of parameters and signals, and the sizes as well.
    """
    name, single = program.name, precision == "float32"
    interface = CInterface(program, layout, tables, {**C_TYPES, "real": "float" if single else "double"})
    return f"""/* {name}{f": {comment(program.text)}" if program.text else ""}

   One step is {program.dt:.9g} s; numbers are {precision}. twodof made this file and {name}.c of a diagram.
   Change the diagram and export again. The loop of a program that uses them:

{"".join(f"       {line}".rstrip() + chr(10) for line in _example(program, layout))}
   Each instance has structs of its own; nothing else changes. Compile {name}.c as C99 or later, with
   -ffp-contract=off -fno-math-errno and without -ffast-math, to have the bits of all other targets.
   Sizes [bytes]{_sizes(layout, precision)}. */
#ifndef {name}_INCLUDED
#define {name}_INCLUDED

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {{
#endif

{interface.text()}#ifdef __cplusplus
}}
#endif

#endif
"""


def _sizes(layout: MemoryLayout, precision: str) -> str:
    sizes = ", ".join(f"{name} {dtype.itemsize}" for name, dtype in layout.dtypes(precision).items())
    return f" where a double is aligned to 8: {sizes}" if precision == "float64" else f": {sizes}"


def _example(program: FlatProgram, layout: MemoryLayout) -> Iterator[str]:
    p = program.name
    for struct in "PSUY":
        yield f"static {p}_{struct} {struct.lower()};"
    yield ""
    for call in ("defaults(&p)", "prepare(&p)", "init(&p, &s)"):
        yield f"{p}_{call};"
    yield "for (;;) {"
    yield from _carried(layout.u.members, "u.{0} = read_{0}();", "read_{0}(u.{0});")
    yield f"    {p}_step(&p, &s, &u, &y);"
    yield from _carried(layout.y.members, "write_{0}(y.{0});", "write_{0}(y.{0});")
    yield "}"


def _carried(members: Sequence[Member], scalar: str, array: str) -> Iterator[str]:
    """Yield lines that give or take the values of a struct's members."""
    for member in members[:SHOWN]:
        yield "    " + (scalar if member.width is None else array).format(member.name)
    if len(members) > SHOWN:
        yield f"    ...  and {len(members) - SHOWN} more"


@dataclass(frozen=True)
class SourceLine:
    """A line of C: its number (from 1), the function or struct it stands in, and its block.

    `block` is a path, or "" for a line that belongs to no single block; `role` then tells its purpose ("" if unknown).
    """

    number: int
    text: str
    part: str
    block: str
    role: str

    @property
    def executable(self) -> bool:
        """True if the line is more than braces and comments."""
        return bool(self.text.strip(" {}")) and not self.text.lstrip().startswith("/*")


@dataclass
class SourceMap:
    """Map from the lines of one program's C to its blocks."""

    lines: list[SourceLine]
    blocks: dict[str, str]  # path -> type
    left_out: tuple[str, ...] = ()  # blocks of which nothing runs
    _by_block: dict[str, list[SourceLine]] = field(default_factory=dict)

    def of(self, path: str) -> dict[str, list[tuple[int, int]]]:
        """Return the ranges of line numbers (first, last) that a block became, by function or struct."""
        if not self._by_block:
            for line in self.lines:
                self._by_block.setdefault(line.block, []).append(line)
        found: dict[str, list[tuple[int, int]]] = {}
        for line in self._by_block.get(path, []):
            ranges = found.setdefault(line.part, [])
            if ranges and ranges[-1][1] == line.number - 1:
                ranges[-1] = ranges[-1][0], line.number
            else:
                ranges.append((line.number, line.number))
        return found


def source_map(emitted: EmittedProgram) -> SourceMap:
    """Return the map of the C file of `emitted`."""
    text = emitted.source.splitlines()
    lines = [
        SourceLine(number, line, mark.part, mark.block, mark.role)
        for number, (line, mark) in enumerate(zip(text, emitted.marks, strict=True), 1)
    ]
    nodes = emitted.flat.nodes
    needed = compiled(emitted.flat)
    kinds = {n.path: n.block.type_name or type(n.block).__name__ for n in nodes}
    return SourceMap(lines, kinds, tuple(path for path in kinds if path not in needed))
