"""Builds an exported module against stand-ins for PX4's headers, with PX4's warning flags."""

from __future__ import annotations

import subprocess
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.toolchains import PACKAGES, need
from twodof.compile.px4.controller import EXACT
from twodof.compile.px4.export import Px4Module
from twodof.compile.px4.work_item import TOPICS

STAND_IN = Path(__file__).parent / "stand_in"
DEADLINE = 120.0

# PX4 v1.16's flags for gcc, in its order: cmake/px4_add_common_flags.cmake and what platforms/posix adds.
PX4_FLAGS = """
    -g -fdata-sections -ffunction-sections -fomit-frame-pointer -fmerge-all-constants -fno-signed-zeros
    -fno-trapping-math -freciprocal-math -fno-math-errno -fno-strict-aliasing -fvisibility=hidden
    -Wall -Wextra -Werror -Warray-bounds -Wcast-align -Wdisabled-optimization -Wdouble-promotion -Wfatal-errors
    -Wfloat-equal -Wformat-security -Winit-self -Wlogical-op -Wpointer-arith -Wshadow -Wuninitialized
    -Wunknown-pragmas -Wunused-variable -Wno-missing-field-initializers -Wno-missing-include-dirs
    -Wno-unused-parameter -fno-builtin-printf -fno-strength-reduce -Wformat=1 -Wunused-but-set-variable
    -Wno-format-truncation
"""
C_FLAGS = ["-std=gnu11", "-fno-common", "-Wnested-externs", "-Wstrict-prototypes", "-Wbad-function-cast"]
CPP_FLAGS = ["-std=gnu++14", "-fcheck-new", "-Wreorder", "-Wno-overloaded-virtual", "-fno-rtti"]

_TYPES = {
    "uint64": "uint64_t",
    "uint32": "uint32_t",
    "int32": "int32_t",
    "uint16": "uint16_t",
    "uint8": "uint8_t",
    "float32": "float",
    "bool": "bool",
}

FIELDS = {topic: row["fields"] for topic, row in TOPICS.items()}


_CONSTANTS = {"vehicle_command": {"VEHICLE_CMD_COMPONENT_ARM_DISARM": 400}}


def topic_header(topic: str, rows: list[tuple[str, str]], constants: dict[str, int]) -> str:
    """uORB/topics/TOPIC.h, as PX4's generator would make it of a message with these fields."""
    members = ""
    for kind, name in rows:
        base, _, width = kind.partition(" or ")[0].partition("[")
        members += f"\t{_TYPES[base]} {name}{'[' + width if width else ''};\n"
    values = ""
    for name, value in constants.items():
        values += f"\tstatic constexpr {'uint8_t' if value < 256 else 'uint32_t'} {name} = {value};\n"
    return (
        f"#pragma once\n#include <stdint.h>\n#include <uORB/uORB.h>\nstruct {topic}_s {{\n{members}{values}}};\n"
        f'static const orb_metadata orb_{topic}{{"{topic}"}};\n'
    )


def parse_message(text: str) -> tuple[list[tuple[str, str]], dict[str, int]]:
    """The fields (type, name) and the constants of a .msg file."""
    fields, constants = [], {}
    for line in text.splitlines():
        words = line.partition("#")[0].replace("=", " = ").split()
        if len(words) == 4:
            constants[words[1]] = int(words[3])
        elif words:
            kind, name = words
            fields.append((kind, name))
    return fields, constants


def lay_out(module: Px4Module, folder: Path) -> Path:
    """The module's tree and the headers of all topics in `folder`; returns the folder of the module's sources."""
    module.write(folder / "export")
    topics = folder / "include" / "uORB" / "topics"
    topics.mkdir(parents=True)
    for topic, rows in FIELDS.items():
        (topics / f"{topic}.h").write_text(
            topic_header(topic, [(k, n) for n, k in rows.items()], _CONSTANTS.get(topic, {}))
        )
    text = module.files[f"msg/{module.names.class_name}.msg"]
    (topics / f"{module.names.module}.h").write_text(topic_header(module.names.module, *parse_message(text)))
    return folder / "export" / "src" / "modules" / module.names.module


def compile_module(module: Px4Module, folder: Path, optimise: str = "-O2", more: tuple[str, ...] = ()) -> list[Path]:
    """The module's two objects, built with PX4's flags and the module's own. Fails the test on any warning."""
    sources = lay_out(module, folder)
    names = module.names
    includes = [f"-I{folder / 'include'}", f"-I{STAND_IN}", f"-I{sources}"]
    own = [f'-DMODULE_NAME="{names.module}"', *EXACT, *includes, *more]
    made = []
    for compiler, flags, source in (
        ("gcc", C_FLAGS, sources / f"{names.module}.c"),
        ("g++", CPP_FLAGS, sources / f"{names.class_name}.cpp"),
    ):
        target = folder / f"{source.name}.o"
        run([compiler, *flags, optimise, *PX4_FLAGS.split(), *own, "-c", str(source), "-o", str(target)])
        made.append(target)
    return made


def run(command: list[str]) -> str:
    """The output of a command, which must succeed; the test is skipped, saying so, where a compiler is missing."""
    if command[0] in PACKAGES:
        need(command[0])
    done = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE)
    assert done.returncode == 0, f"{' '.join(command[:1])}: {done.stdout[-4000:]}{done.stderr[-4000:]}"
    return done.stdout


def dtype_of(rows: Iterable[tuple[str, str]]) -> np.dtype[Any]:
    """The numpy type of a topic's struct with these fields (type, name)."""
    formats: list[tuple[str, Any]] = []
    for kind, name in rows:
        base, _, width = kind.partition(" or ")[0].partition("[")
        formats.append((name, np.dtype((base, (int(width[:-1]),))) if width else np.dtype(base)))
    return np.dtype(formats, align=True)


def driver(folder: Path) -> list[str]:
    """The object of what drives a module, built once in `folder`, of one source: its headers take most of the time."""
    target = folder / "driver.o"
    if not target.exists():
        source = folder / "driver.cpp"
        source.write_text('#include "stand_in.cpp"\n#include "bench.cpp"\n')
        run(["g++", "-O0", f"-I{STAND_IN}", "-c", str(source), "-o", str(target)])
    return [str(target)]


class Bench:
    """A module in a process of its own, driven by a script that is run at the end, and what came of it.

    `at` sets the clock [us], `publish` a topic's fields, `parameter` a value, `command` runs the module's command.
    """

    def __init__(self, module: Px4Module, folder: Path, optimise: str = "-O2") -> None:
        objects = compile_module(module, folder, optimise)
        n = module.names.module
        self.module, self.program = module, folder / "bench"
        link = ["g++", *driver(folder.parent), *map(str, objects), f"-Wl,--defsym=module_main={n}_main"]
        run([*link, "-o", str(self.program)])
        self.dtypes = {t: dtype_of([(k, f) for f, k in rows.items()]) for t, rows in FIELDS.items()}
        self.dtypes[n] = dtype_of(parse_message(module.files[f"msg/{module.names.class_name}.msg"])[0])
        self.fresh()

    def fresh(self) -> None:
        """A new process, with the parameters at their defaults."""
        self.script: list[str] = []
        self.now = 0
        self.at(1_000_000)
        for row in self.module.parameters:
            self.parameter(row.name, row.default)

    def at(self, now: int) -> None:
        """The clock [us]; what is late by then runs."""
        self.now = now
        self.script.append(f"time {now}")

    def parameter(self, name: str, value: float) -> None:
        """A parameter's value, without telling the module."""
        kind = {row.name: "f" if row.kind == "real" else "i" for row in self.module.parameters}[name]
        self.script.append(f"parameter {name} {kind} {float(value)!r}")

    def publish(self, topic: str, at_once: bool = True, **values: Any) -> None:
        """A topic's fields; those not named are 0, `timestamp` and `timestamp_sample` the present.

        Its listeners run now or (`at_once` false) before what the next line of the script wants to run.
        """
        row = np.zeros(1, self.dtypes[topic])
        for name in row.dtype.names or ():
            row[name] = values.get(name, self.now if name.startswith("timestamp") else 0)
        assert set(values) <= set(row.dtype.names or ())
        self.script.append(f"{'publish' if at_once else 'queue'} {topic} {row.tobytes().hex()}")

    def advertise(self, topic: str) -> None:
        """Another's publication of a topic begins."""
        self.script.append(f"advertise {topic}")

    def end(self, topic: str) -> None:
        """Another's publication of a topic ends."""
        self.script.append(f"end {topic}")

    def read(self, name: str) -> None:
        """The ground reads a parameter; `Events.read` says what."""
        self.script.append(f"read {name}")

    def obey(self) -> None:
        """From now on PX4 disarms when it is asked to."""
        self.script.append("obey")

    def command(self, *words: str) -> None:
        """The module's command."""
        self.script.append(f"command {' '.join(words)}")

    def run(self) -> Events:
        """All that the module published and said, in order."""
        done = subprocess.run(
            [self.program],
            input="\n".join([*self.script, "used", ""]),
            capture_output=True,
            text=True,
            timeout=DEADLINE,
        )
        assert done.returncode == 0, done.stderr[-2000:]
        return Events([line.partition(" ")[::2] for line in done.stdout.splitlines()], self.dtypes)


@dataclass
class Events:
    """Lines of a bench's run: (topic or word, rest)."""

    rows: list[tuple[str, str]]
    dtypes: dict[str, np.dtype[Any]]

    def topic(self, name: str) -> NDArray[Any]:
        """All that was published of a topic, as an array of structs."""
        data = b"".join(bytes.fromhex(rest) for what, rest in self.rows if what == name)
        return np.frombuffer(data, self.dtypes[name])

    def lost(self) -> list[str]:
        """The topics of what was published and could be read by nobody."""
        return [rest.split()[0] for what, rest in self.rows if what == "lost"]

    def read(self) -> list[tuple[str, float]]:
        """Return the parameters that the ground read."""
        return [(rest.split()[0], float(rest.split()[1])) for what, rest in self.rows if what == "read"]

    def told(self) -> list[str]:
        """Return the critical messages to the pilot."""
        return [text.removeprefix("critical ") for text in self.said() if text.startswith("critical ")]

    def said(self) -> list[str]:
        """Return the module's printed lines."""
        return [rest for what, rest in self.rows if what == "said"]

    def returned(self) -> list[int]:
        """Return the results of its commands."""
        return [int(rest) for what, rest in self.rows if what == "returned"]

    def withdrawn(self) -> dict[str, int]:
        """When [us] the module's publications ended, by topic: what nobody has read by then nobody ever reads."""
        ends = [rest.split() for what, rest in self.rows if what == "withdrawn"]
        return {topic: int(now) for topic, now in ends}

    def used(self) -> set[str]:
        """The parameters it asked for."""
        return {rest for what, rest in self.rows if what == "used"}
