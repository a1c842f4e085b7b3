"""A diagram as two files, `name`.h and `name`.c."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from twodof.blocks.declarations import check_name
from twodof.blocks.diagram import Diagram
from twodof.blocks.expressions import numbers
from twodof.compile.c.emitter import emit
from twodof.compile.c_files.header import header
from twodof.compile.program.lower import lower
from twodof.compile.target import EmittedProgram
from twodof.errors import DiagramError, LogError
from twodof.flightlog.atomic import atomic_write, make_folder
from twodof.flightlog.files import check_folder

_HEADERS = """
    assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg stdatomic
    stdbit stdbool stdckdint stddef stdint stdio stdlib stdnoreturn string strings tgmath threads time uchar wchar
    wctype
"""
STANDARD = frozenset(_HEADERS.split())
"""Headers of C: a file of that name would hide one."""


@dataclass(frozen=True)
class CFiles:
    """The texts of a program's header and C file, and the program that they were made from."""

    emitted: EmittedProgram
    header: str

    @property
    def name(self) -> str:
        """The prefix of all names, and the files' name."""
        return self.emitted.name

    @property
    def files(self) -> dict[str, str]:
        """The texts by the files' names."""
        return {f"{self.name}.h": self.header, f"{self.name}.c": self.emitted.source}

    def write(self, folder: str | Path, overwrite: bool = False) -> list[Path]:
        """Writes both files into `folder`, which it makes if it is not there, and gives their paths.

        Raises LogError if one is there already (unless `overwrite`), or the folder cannot be made or written.
        """
        paths = [Path(folder, file) for file in self.files]
        try:
            make_folder(Path(folder))
        except OSError as error:
            raise LogError(f"cannot be made: {error.strerror}", str(folder), "choose another folder") from error
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
    """`diagram` as C for a firmware; `dt` [s], `precision`, `log` and `integrator` as in `build`.

    All names begin with `name`, by default the diagram's; programs in one firmware need different ones. With `tables`
    there are `run` and the tables of parameters and signals as well. Raises DiagramError as `build`, and for a name
    that hides a header of C.
    """
    with numbers.precision(precision):  # refuses an unknown one
        program = lower(diagram, dt, log, integrator)
        program = replace(program, name=check_name(name or program.name, "name"))
        if program.name in STANDARD:
            raise DiagramError(f"{program.name}.h is a header of C", diagram.name, "give the program another `name`")
        (emitted,) = emit([program], precision, lean=not tables, header=f"{program.name}.h")
    return CFiles(emitted, header(program, emitted.layout, precision, tables))
