"""Timing on one core, the machine it was done on, and figures that know their targets."""

import importlib.metadata
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twodof.compile.toolchain.compilers import find_compiler
from twodof.errors import CompileError


@dataclass(frozen=True)
class Timing:
    """Repeated measurements of one thing [s of CPU time], and how much longer they took on the wall."""

    seconds: tuple[float, ...]
    stretch: float

    @property
    def best(self) -> float:
        """The shortest [s]."""
        return min(self.seconds)

    @property
    def median(self) -> float:
        """The median [s]."""
        return statistics.median(self.seconds)


def timed(functions: Sequence[Callable[[], object]], repeats: int) -> list[Timing]:
    """Times each of `functions` `repeats` times, taking turns, so that all meet the same disturbances.

    What counts is the CPU time of this thread. On a quiet machine it is the time on the wall; on a shared one it leaves
    out what others took. The first round warms caches and is not counted.
    """
    seconds: list[list[float]] = [[] for _ in functions]
    wall: list[float] = [0.0 for _ in functions]
    for round_ in range(repeats + 1):
        for i, function in enumerate(functions):
            clock, start = time.perf_counter(), time.thread_time()
            function()
            if round_:
                seconds[i].append(time.thread_time() - start)
                wall[i] += time.perf_counter() - clock
    return [Timing(tuple(s), w / max(sum(s), 1e-12)) for s, w in zip(seconds, wall, strict=True)]


@contextmanager
def one_core() -> Iterator[None]:
    """Keeps this process on one of its cores, where the system allows it."""
    allowed = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    if allowed:
        with suppress(OSError):
            os.sched_setaffinity(0, {max(allowed)})
    try:
        yield
    finally:
        if allowed:
            with suppress(OSError):
                os.sched_setaffinity(0, allowed)


@dataclass(frozen=True)
class Figure:
    """One result. `target` is what it has to reach: at least, or with `at_most` at most; None: it is a peer's."""

    name: str
    value: float
    unit: str
    target: float | None = None
    at_most: bool = False
    remark: str = ""

    @property
    def met(self) -> bool | None:
        """True if the target is reached; None without a target."""
        if self.target is None:
            return None
        return self.value <= self.target if self.at_most else self.value >= self.target

    def to_json(self) -> dict[str, Any]:
        """The figure as a JSON object, with `met`."""
        found: dict[str, Any] = {"name": self.name, "value": self.value, "unit": self.unit}
        if self.target is not None:
            found |= {"target": self.target, "at_most": self.at_most, "met": self.met}
        return found | ({"remark": self.remark} if self.remark else {})


def machine() -> dict[str, Any]:
    """Processor, cores, load, system, compilers and versions of what takes part."""
    packages = ("twodof", "numpy", "scipy", "control", "mujoco", "ziglang")
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "load": [round(x, 2) for x in os.getloadavg()] if hasattr(os, "getloadavg") else None,
        "system": " ".join((platform.system(), platform.machine(), *platform.libc_ver())),
        "python": platform.python_version(),
        "compilers": {name: version for name in ("cc", "clang", "zig") if (version := compiler_version(name))},
        "packages": {name: version for name in packages if (version := _package(name))},
    }


def compiler_version(name: str) -> str:
    """The first line of what the compiler says about itself; "" if it is not there."""
    try:
        command = find_compiler(name).command
    except CompileError:
        return ""
    done = subprocess.run([*command, "--version"], capture_output=True, text=True, timeout=60, check=False)
    return done.stdout.partition("\n")[0].strip()


def _processor() -> str:
    if sys.platform == "linux":
        with suppress(OSError):
            for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
                if line.startswith("model name"):
                    return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _package(name: str) -> str:
    with suppress(importlib.metadata.PackageNotFoundError):
        return importlib.metadata.version(name)
    return ""
