"""Writes drone.pyi, the synchronous drone as editors and mypy see it: run it where AsyncDrone changes."""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from typing import Any

from twodof.gcs import drone

STUB = Path(__file__).resolve().parents[1] / "src" / "twodof" / "gcs" / "drone.pyi"
DERIVED = (drone.DroneFiles, drone.DroneLogs, drone.Drone)
LONGEST = 110
HEAD = '"""{}\n\nWritten by tools/sync_stub.py: change the asynchronous classes, not this."""'
DRONE = """    logs: DroneLogs
    files: DroneFiles

    def __init__(self, there: AsyncDrone, runner: LoopThread) -> None: ..."""


def stub() -> str:
    """The text of the stub."""
    classes, needed = [], {"AsyncDrone": "twodof.gcs.async_drone", "LoopThread": "twodof.gcs.loop_thread"}
    for kind in DERIVED:
        base = kind.__bases__[0]
        needed[base.__name__] = base.__module__
        members = [
            _property(name, member, needed) if isinstance(member, property) else _method(name, member, needed)
            for name, member in vars(kind).items()
            if not name.startswith("_")
        ]
        head = f"class {kind.__name__}({base.__name__}):\n{_doc(kind, 4)}"
        classes.append("\n\n".join([head, *([DRONE] if kind is drone.Drone else []), *members]))
    imports = [f"from {module} import {name}" for name, module in sorted(needed.items(), key=lambda row: row[::-1])]
    return "\n\n".join([HEAD.format(drone.__doc__), "\n".join(imports), *classes]) + "\n"


def _property(name: str, member: property, needed: dict[str, str]) -> str:
    there = inspect.getattr_static(drone.AsyncDrone, name).fget
    returned = _named(inspect.signature(there).return_annotation, there, needed)
    return f"    @property\n    def {name}(self) -> {returned}:\n{_doc(member, 8)}"


def _method(name: str, member: Any, needed: dict[str, str]) -> str:
    signature = inspect.signature(member)
    arguments = []
    for row in signature.parameters.values():
        star = "*" if row.kind is row.VAR_POSITIONAL else ""
        kind = "" if row.name == "self" else f": {_named(row.annotation, member.__wrapped__, needed)}"
        default = "" if row.default is row.empty else f" = {row.default!r}"
        arguments.append(f"{star}{row.name}{kind}{default}")
    returned = _named(signature.return_annotation, member.__wrapped__, needed)
    line = f"    def {name}({', '.join(arguments)}) -> {returned}:"
    if len(line) > LONGEST:
        line = f"    def {name}(\n" + "".join(f"        {one},\n" for one in arguments) + f"    ) -> {returned}:"
    return f"{line}\n{_doc(member, 8)}"


def _named(annotation: str, there: Any, needed: dict[str, str]) -> str:
    """The annotation, with the modules of its names noted in `needed`."""
    known = there.__globals__ | {"AbstractContextManager": None}
    for name in re.findall(r"(?<![\w.\"])[A-Za-z_]\w*", annotation):
        if name == "AbstractContextManager":
            needed[name] = "contextlib"
        elif name in known:
            needed[name] = known[name].__module__
    return annotation


def _doc(member: Any, indent: int) -> str:
    lines = inspect.getdoc(member).splitlines()
    body = "\n".join(f"{' ' * indent}{line}".rstrip() for line in lines)
    end = "" if len(lines) == 1 else f"\n{' ' * indent}"
    return f'{" " * indent}"""{body.strip()}{end}"""'


if __name__ == "__main__":
    STUB.write_text(stub())
