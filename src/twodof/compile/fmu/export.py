"""Export of a diagram as a Functional Mock-up Unit (FMU) for co-simulation, by FMI 3.0 or 2.0."""

import platform
import uuid
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from importlib import resources
from pathlib import Path
from string import Template
from types import MappingProxyType

from twodof.blocks.diagram import Diagram
from twodof.blocks.schema.json_form import to_json
from twodof.compile.builder import emit_program
from twodof.compile.fmu.variables import FmuVariable, build_description, fmu_variables, model_description
from twodof.compile.target import EmittedProgram
from twodof.compile.toolchain import compilers
from twodof.errors import CompileError, DiagramError
from twodof.flightlog.atomic import atomic_write
from twodof.flightlog.files import check_folder

VERSIONS = ("3.0", "2.0")
FLAGS = (*compilers.FLAGS, "-fPIC", "-shared", "-fvisibility=hidden")
"""Those of the native target without this processor's own instructions: the same bits, on any of its kind."""

BINARIES: Mapping[tuple[str, str], tuple[str, str, str]] = MappingProxyType(
    {
        ("Linux", "x86_64"): ("x86_64-linux", "linux64", ".so"),
        ("Linux", "aarch64"): ("aarch64-linux", "aarch64-linux", ".so"),
        ("Darwin", "arm64"): ("aarch64-darwin", "aarch64-darwin", ".dylib"),
        ("Darwin", "x86_64"): ("x86_64-darwin", "darwin64", ".dylib"),
    }
)
"""Folder of the binary by FMI 3.0 and 2.0 and its ending, by system and processor."""

_THEN = (1980, 1, 1, 0, 0, 0)  # the earliest time in a ZIP: equal diagrams give equal files


@dataclass(frozen=True)
class Fmu:
    """FMU of a program: its variables in the order of their value references, and its C file."""

    diagram: Diagram
    emitted: EmittedProgram
    version: str
    variables: tuple[FmuVariable, ...]

    @property
    def name(self) -> str:
        """Model identifier: the name of the binary and of the C file."""
        return self.emitted.name

    @cached_property
    def token(self) -> str:
        """Instantiation token (GUID), which changes with the program and its variables."""
        rows = "".join(v.row for v in self.variables)
        digest = sha256(f"{self.version}\n{self.emitted.source}\n{rows}".encode()).digest()
        return f"{{{uuid.UUID(bytes=digest[:16])}}}"

    @cached_property
    def source(self) -> str:
        """C of the program, and the functions of FMI around it."""
        newer = self.version == "3.0"
        folder = resources.files(__package__).joinpath("templates")
        fmi = "fmi3" if newer else "fmi2"
        text = "".join(folder.joinpath(file).read_text(encoding="utf-8") for file in ("fmu.c", f"{fmi}.c"))
        return self.emitted.source + Template(text).substitute(
            name=self.name,
            version=self.version,
            fmi=fmi,
            bool="bool" if newer else "int",
            S="S" if newer else "s",  # FMI 2.0 writes FMUstate and DeSerialize
            D="Des" if newer else "DeS",
            period=self.emitted.flat.dt.hex(),
            token=self.token,
            rows="".join(f"    {v.row}\n" for v in self.variables),
        )

    def files(self) -> dict[str, bytes]:
        """Return all files of the FMU by path, with the binary of this computer.

        Raises CompileError without a compiler, if it fails, and where FMI has no name for this computer.
        """
        here = platform.system(), platform.machine()
        if here not in BINARIES:
            known = ", ".join(" ".join(pair) for pair in BINARIES)
            raise CompileError(f"FMI has no name for the platform {' '.join(here)}", "", f"use one of: {known}")
        newer, older, ending = BINARIES[here]
        compiler = compilers.find_compiler()
        file = f"{self.name}.c"
        found = {
            "modelDescription.xml": model_description(
                self.emitted.flat, self.variables, self.version, self.token, file
            ),
            f"binaries/{newer if self.version == '3.0' else older}/{self.name}{ending}": compilers.compiled(
                self.source, compiler, (*FLAGS, self.emitted.optimise, *compiler.flags), ending, Path.read_bytes
            ),
            f"sources/{file}": self.source.encode(),
            "resources/diagram.json": to_json(self.diagram).encode(),
        }
        if self.version == "3.0":
            found["sources/buildDescription.xml"] = build_description(self.name, file, compilers.FLAGS)
        return found

    def write(self, path: str | Path, overwrite: bool = False) -> None:
        """Write the FMU, a ZIP, whole or not at all.

        Raises LogError if the file exists already (unless `overwrite`) or cannot be written, CompileError as `files`.
        """
        check_folder(path, overwrite)
        files = self.files()
        with atomic_write(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in files.items():
                archive.writestr(zipfile.ZipInfo(name, _THEN), data, zipfile.ZIP_DEFLATED)


def make_fmu(
    diagram: Diagram, dt: float, precision: str = "float64", version: str = "3.0", log: Iterable[str] = ()
) -> Fmu:
    """Return the FMU of `diagram` for FMI `version`, "3.0" or "2.0"; the other arguments are those of `build`.

    The signals at the paths `log` are outputs too. Raises DiagramError for a faulty diagram, an unknown version, two
    variables of one name, and in FMI 2.0 for a uint32 and for too large arrays.
    """
    if version not in VERSIONS:
        raise DiagramError(f"FMI {version!r:.40} is not supported", diagram.name, f"use {' or '.join(VERSIONS)}")
    emitted = emit_program(diagram, dt, precision, log)
    return Fmu(diagram, emitted, version, tuple(fmu_variables(emitted, version)))
