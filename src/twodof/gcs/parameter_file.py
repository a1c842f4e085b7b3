"""Parameter files (.params) as QGroundControl saves and loads them; those of Mission Planner (.param) are read too.

A line has five fields with tabs between them: vehicle id, component id, name, value and MAV_PARAM_TYPE. What follows #
is a remark. Source: QGroundControl's developer guide, "Parameters File Format". A line of Mission Planner or MAVProxy
has name and value, with a comma or spaces between them; in a script of PX4 `param set` stands before them.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import isfinite
from typing import Self

from twodof.errors import ParameterError, printable, shown
from twodof.flightlog.provenance import text_of
from twodof.gcs.parameters import INT32, MOST, REAL32, ParameterEntry, same_as

MAX_BYTES = 1 << 20
"""Largest file: a PX4 with a thousand parameters makes 40 KB."""

_HEAD = "Vehicle-Id Component-Id Name Value Type"
_WHOLE = range(1, 9)  # MAV_PARAM_TYPE_UINT8 to INT64
_TYPES = range(1, 11)


@dataclass(frozen=True)
class ParameterFile:
    """Parameters of one component: `values` and MAV_PARAM_TYPE `kinds` by name, `about` the remarks "Name: text".

    `system` is 0 for a file that does not name its vehicle.
    """

    values: Mapping[str, float]
    kinds: Mapping[str, int]
    system: int = 1
    component: int = 1
    about: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(
        cls, entries: Iterable[ParameterEntry], system: int, component: int = 1, about: Mapping[str, str] | None = None
    ) -> Self:
        """Make a file of a drone's parameters."""
        rows = list(entries)
        values, kinds = {row.name: row.value for row in rows}, {row.name: row.kind for row in rows}
        return cls(values, kinds, system, component, about or {})

    @classmethod
    def read(cls, content: str | bytes, where: str = "parameter file", component: int | None = None) -> Self:
        """Read the parameters of one component, by default the first in the file.

        Raises ParameterError with the number of a wrong line. Lines of other components are left out.
        """
        if len(content) > MAX_BYTES:
            raise ParameterError(f"the file has more than {MAX_BYTES >> 10} KiB", where, "give a .params file")
        try:
            text = content if isinstance(content, str) else text_of(content)
        except UnicodeDecodeError:
            text = "\0"
        if "\0" in text:
            remedy = "save the parameters in QGroundControl; `param save` of PX4 writes a binary file"
            raise ParameterError("the file is not text", where, remedy)
        values: dict[str, float] = {}
        kinds: dict[str, int] = {}
        about: dict[str, str] = {}
        system = 0
        for number, line in enumerate(text.splitlines(), 1):
            if line.startswith("#"):
                name, colon, said = line.lstrip("# ").partition(":")
                if colon and not values and len(about) < 20:
                    about[name.strip()[:40]] = said.strip()[:200]
            elif line.partition("#")[0].strip():
                vehicle, own, name, value, kind = _row(line, f"{where}, line {number}")
                if component in (None, own):
                    component, system = own, system or vehicle
                    if name in values:
                        raise ParameterError(f"{name} is given twice", f"{where}, line {number}", "leave one out")
                    values[name], kinds[name] = value, kind
                if len(values) > MOST:
                    raise ParameterError(f"the file has more than {MOST} parameters", where, "give one drone's file")
        if not values:
            raise ParameterError("the file has no parameter", where, "give a .params file of QGroundControl")
        return cls(values, kinds, system, component or 1, about)

    def text(self) -> str:
        """Return the file's text; numbers have the shortest form that reads back to the same float32."""
        remarks = [f"# {printable(name)}: {' '.join(printable(said).split())}" for name, said in self.about.items()]
        lines = [f"# Onboard parameters for Vehicle {self.system}", "#", *remarks, *["#"] * bool(remarks), f"# {_HEAD}"]
        for name, value in self.values.items():
            kind = self.kinds.get(name, REAL32)
            number = str(int(value)) if kind in _WHOLE else repr(float(value))
            lines.append(f"{self.system}\t{self.component}\t{name}\t{number}\t{kind}")
        return "\n".join(lines) + "\n"

    def against(self, known: Mapping[str, ParameterEntry]) -> tuple[dict[str, float], tuple[str, ...]]:
        """Compare with a drone's parameters `known`; return the file's differing values, and names the drone lacks.

        A parameter that the drone has under two names, twodof's and the real drone's, is returned once, under twodof's.
        """
        missing = tuple(name for name in self.values if name not in known)
        changes = {
            name: value
            for name, value in self.values.items()
            if name in known and not _same(value, known[name]) and same_as(name) not in {*self.values} & known.keys()
        }
        return changes, missing


def _same(value: float, entry: ParameterEntry) -> bool:
    """Compare two values to six figures, as other programs write a float32; integers exactly."""
    return value == entry.value if entry.kind == INT32 else f"{value:.6g}" == f"{entry.value:.6g}"


def _row(line: str, where: str) -> tuple[int, int, str, float, int]:
    fields = line.partition("#")[0].replace(",", " ").split()
    if fields[:1] == ["param"] and fields[1:2] in (["set"], ["set-default"]):
        fields = fields[2:]
    try:
        vehicle, component, name, text, kind = ["0", "1", *fields, f"{REAL32}"] if len(fields) == 2 else fields
        value, numbers = float(text), (int(vehicle), int(component), int(kind))
    except ValueError as reason:
        raise ParameterError(
            f"{shown(line)} is not a parameter", where, f"a line has: {_HEAD}, or name and value"
        ) from reason
    if not (0 <= numbers[0] <= 255 and 0 <= numbers[1] <= 255 and numbers[2] in _TYPES):
        raise ParameterError(f"{shown(line)} has an id or a type out of range", where, f"a line has: {_HEAD}")
    if not (name.isascii() and name.isprintable() and 1 <= len(name) <= 16 and isfinite(value)):
        remedy = "give a name of 1 to 16 ASCII characters, and a finite value"
        raise ParameterError(f"{shown(line)} has an invalid name or value", where, remedy)
    return numbers[0], numbers[1], name, value, numbers[2]
