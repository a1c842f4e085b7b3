"""C that MathWorks' coder generated, built as a shared library and driven through its own structures.

`built` compiles the files with GCC. Structures are found in the preprocessed text, and reached in memory by ctypes.
Elementary functions are those of the block language, by callbacks: what is left to compare is the translation.
"""

import ctypes
import re
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twodof.blocks import Diagram
from twodof.blocks.library import Atan2, Power, Trigonometry
from twodof.compile import build

TYPES: dict[str, Any] = {
    "real32_T": ctypes.c_float, "real_T": ctypes.c_double, "boolean_T": ctypes.c_bool, "int8_T": ctypes.c_int8,
    "uint8_T": ctypes.c_uint8, "int16_T": ctypes.c_int16, "uint16_T": ctypes.c_uint16, "int32_T": ctypes.c_int32,
    "uint32_T": ctypes.c_uint32,
}  # fmt: skip
REAL = (ctypes.c_float, ctypes.c_double)
PLACES = {"sin": 1, "cos": 1, "tan": 1, "asin": 1, "acos": 1, "atan": 1, "atan2": 2, "pow": 2}
"""Elementary functions, with the number of their arguments."""
FLAGS = ("-std=gnu11", "-O1", "-ffp-contract=off", "-fno-builtin", "-w", "-shared", "-fPIC")
HEAD = (
    "#include <math.h>", "#define arm_sin_f32 ours_sin", "#define arm_cos_f32 ours_cos", "#include <limits.h>",
    "#undef LONG_MAX", "#undef ULONG_MAX", "#define LONG_MAX INT_MAX", "#define ULONG_MAX UINT_MAX",
)  # fmt: skip
"""Lines before the C: two functions of CMSIS, and a long as short as on the boards, which the C checks."""


@dataclass
class GeneratedCode:
    """A shared library, its structures by name, and the text of its headers."""

    library: ctypes.CDLL
    structures: dict[str, type[ctypes.Structure]]
    headers: str
    functions: list[Any]

    def at(self, structure: str, name: str) -> ctypes.Structure:
        """Return a global variable."""
        return self.structures[structure].in_dll(self.library, name)

    def states(self, structure: str, known: Mapping[str, int]) -> dict[str, str]:
        """Return the members of a structure that are states, with the path among `known` that each stands for.

        A comment behind the member names the block, `<S78>/Delay`, and another one each system. `known` has the widths.
        """
        systems = dict(re.findall(r"'<(\w+)>'\s*:\s*'[^'/\n]*/?([^'\n]*)'", self.headers))
        found = re.search(r"typedef struct \{((?:(?!typedef struct).)*?)\} " + structure + ";", self.headers, re.DOTALL)
        assert found is not None
        pairs: dict[str, str] = {}
        for name, size, system, block in re.findall(
            r"(\w+_(?:D|DS|DST|DSTA|DSTAT|DSTATE)(?:_\w+)?)(\[\d+\])?;\s*/\* '<(\w+)>/([^']*)'", found[1]
        ):
            path = ".".join(map(plain, [*filter(None, systems.get(system, "").split("/")), block]))
            wanted = int(size[1:-1]) if size else 1
            alike = [one for one, width in known.items() if width == wanted and plain(one).startswith(f"{path}.")]
            pairs |= {name: one for one in alike if one.endswith((".x", ".buffer"))}  # noqa: B035
        return pairs


def plain(name: str) -> str:
    return re.sub(r"[^\w.]+", "_", name).lower()


def built(folder: Path, files: Sequence[str], made: Path, single: bool) -> GeneratedCode:
    """Compile files of a folder; elementary functions take the precision `single`, or double."""
    real, end = ("float", "f") if single else ("double", "")
    head, body = [*HEAD], list[str]()
    for name, places in PLACES.items():
        declared = f"{real} (*ours_{name})({', '.join([real] * places)});"
        head += [f"extern {declared}", f"#define {name}{end} ours_{name}"]
        body.append(declared)
    for name, lines in (("ours.h", head), ("ours.c", body), ("arm_math.h", [])):
        (made / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    parts = [f"-I{folder}", f"-I{made}"]
    sources = [*(str(folder / one) for one in files), str(made / "ours.c")]
    library = made / "generated.so"
    command = ["gcc", *FLAGS, *parts, "-include", str(made / "ours.h"), *sources, "-o", str(library), "-lm"]
    subprocess.run(command, check=True)
    seen = subprocess.run(
        ["gcc", "-E", "-P", *parts, "-include", str(made / "ours.h"), sources[0]], stdout=subprocess.PIPE, check=True
    )
    headers = "\n".join(one.read_text(encoding="utf-8", errors="replace") for one in sorted(folder.glob("*.h")))
    code = GeneratedCode(ctypes.CDLL(str(library)), _structures(seen.stdout.decode(errors="replace")), headers, [])
    for name, places in PLACES.items():
        kind = ctypes.c_float if single else ctypes.c_double
        call = ctypes.CFUNCTYPE(kind, *[kind] * places)(ours(name, places, single))
        code.functions.append(call)  # it must outlive the library
        ctypes.c_void_p.in_dll(code.library, f"ours_{name}").value = ctypes.cast(call, ctypes.c_void_p).value
    return code


def ours(name: str, places: int, single: bool) -> Any:
    """Return an elementary function of the block language for numbers of one precision."""
    d, block = Diagram(name), {"atan2": Atan2, "pow": Power}[name]() if places == 2 else Trigonometry(name)
    for port in block.inputs:
        d.input(port.name)
    d.add("f", block, inputs={port.name: port.name for port in block.inputs})
    d.output("y", "f")
    machine = build(d, dt=1.0, precision="float32" if single else "float64").machine()
    return lambda *u: machine.step(dict(zip(d.inputs, u, strict=True)))["y"]


def _structures(text: str) -> dict[str, type[ctypes.Structure]]:
    found: dict[str, type[ctypes.Structure]] = {}
    for body, name in re.findall(r"typedef\s+struct\s*\w*\s*\{([^{}]*)\}\s*(\w+);", text):
        members = re.findall(r"(\w+)\s+(\w+)((?:\[\d+\])*)\s*;", body)
        if len(members) == body.count(";") and all(kind in {*TYPES, *found} for kind, _, _ in members):
            fields = []
            for kind, member, sizes in members:
                made = {**TYPES, **found}[kind]
                for size in reversed(re.findall(r"\d+", sizes)):
                    made = made * int(size)
                fields.append((member, made))
            found[name] = type(name, (ctypes.Structure,), {"_fields_": fields})
    return found


def leaves(structure: ctypes.Structure, prefix: str = "") -> Iterator[tuple[str, ctypes.Structure, str, Any, int]]:
    """Yield each number in a structure: its path, what holds it and its name there, the C type and how many."""
    for name, kind in structure._fields_:
        if issubclass(kind, ctypes.Structure):
            yield from leaves(getattr(structure, name), f"{prefix}{name}.")
        else:
            count = getattr(kind, "_length_", 1)
            yield f"{prefix}{name}", structure, name, getattr(kind, "_type_", kind) if count > 1 else kind, count


def value(structure: ctypes.Structure, name: str) -> np.ndarray:
    """Return a member as an array of float64, which holds all its numbers."""
    return np.ravel(np.array(getattr(structure, name), dtype=float))


def drawn(kind: Any, count: int, steps: int, limits: tuple[int, int], draw: np.random.Generator) -> np.ndarray:
    """Return seeded sums of sines, or whole numbers in `limits`, each held for 20 steps on the average."""
    if kind in REAL:
        t = np.arange(steps)[:, None] * 0.005
        parts = [np.sin(t * draw.uniform(0.5, 20.0, count) + draw.uniform(0.0, 6.0, count)) for _ in range(3)]
        return np.sum(parts, axis=0).astype(kind)
    drawn = draw.integers(*limits, (steps, count))
    last = np.maximum.accumulate(np.where(draw.random((steps, count)) < 0.05, np.arange(steps)[:, None], 0))
    return np.take_along_axis(drawn, last, axis=0)
