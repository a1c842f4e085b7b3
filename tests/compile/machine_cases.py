"""Random state machines in a diagram, with random inputs."""

from __future__ import annotations

import random
from typing import Any

from tests.compile.differential import Case
from tests.compile.random_machines import MachineTable, machine_block, random_table
from twodof.blocks import Diagram


def random_rows(r: random.Random, steps: int) -> list[dict[str, Any]]:
    """Inputs of each tick."""
    rows: list[dict[str, Any]] = []
    flag = clear = False
    for _ in range(steps):
        flag = flag != (r.random() < 0.3)
        clear = r.random() < 0.04
        rows.append({"u": float(r.randint(-5, 5)), "b": r.randint(-5, 5), "flag": flag, "clear": clear})
    return rows


def machine_case(r: random.Random, name: str, steps: int) -> tuple[Case, MachineTable]:
    """A random machine in a sub-diagram that is reset now and then, with its inputs."""
    table = random_table(r)
    d = Diagram(name)
    inner = Diagram("inner")
    for diagram in (d, inner):
        diagram.input("u")
        diagram.input("b", "int32")
        diagram.input("flag", "bool")
    inner.add("machine", machine_block(table), u="u", b="b", flag="flag")
    d.input("clear", "bool")
    d.add("inner", inner, u="u", b="b", flag="flag", reset="clear")
    paths = [f"inner.machine.{port}" for port in ("y", "k", "w", "mode", "elapsed")]
    return Case(d, paths, random_rows(r, steps), {}), table
