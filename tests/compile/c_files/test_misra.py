"""Exported C keeps the rules of MISRA C:2012, but those that docs/explanation/targets.md lists, as cppcheck sees it."""

import random
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.compile import examples
from tests.compile.differential import random_cases
from tests.compile.machine_cases import machine_case
from tests.toolchains import need
from twodof.blocks import Diagram
from twodof.compile.c_files.c_files import c_files
from twodof.flight.core import core
from twodof.flight.starters import STARTERS, starter

PAGE = Path(__file__).parents[3] / "docs" / "explanation" / "targets.md"


def listed() -> set[str]:
    """The rules that the page says are not kept."""
    table = PAGE.read_text(encoding="utf-8").partition("## MISRA C:2012")[2].partition("## How to read")[0]
    heads = re.findall(r"^\| ([\d., ]+) \|", table, re.MULTILINE)
    return {rule.strip() for head in heads for rule in head.split(",")}


def broken(diagrams: Sequence[Diagram], precision: str, folder: Path) -> dict[str, str]:
    """Rule -> the first line that breaks it, in the exported C of the diagrams."""
    need("cppcheck")
    for diagram in diagrams:
        c_files(diagram, 0.01, precision).write(folder)
    command = ["cppcheck", "--addon=misra", "--std=c99", "--enable=style", "--quiet"]
    command += ["--template={id} {file}:{line} {code}", "-I", str(folder), *map(str, sorted(folder.glob("*.c")))]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found: dict[str, str] = {}
    for rule, line in re.findall(r"^misra-c2012-([\d.]+) (.*)", done.stderr, re.MULTILINE):
        found.setdefault(rule, line)
    return found


@pytest.mark.soak
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_the_flight_core_all_starters_random_diagrams_and_machines(precision: str, tmp_path: Path) -> None:
    drawn = [case.diagram for case in random_cases(range(300, 312), 1)]
    machines = [machine_case(random.Random(seed), f"machine{seed}", 1)[0].diagram for seed in range(8)]
    diagrams = [core(), *(starter(name) for name in STARTERS), examples.edge(), *drawn, *machines]
    found = broken(diagrams, precision, tmp_path)
    assert {rule: line for rule, line in found.items() if rule not in listed()} == {}
    assert {"12.1", "14.1"} <= set(found)  # it looks, and finds what the page says
