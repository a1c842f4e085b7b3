"""No test has a limit of its own for what only ends a hang: such limits are too tight on some machine, some day."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

TESTS = Path(__file__).parent
# What waits for another process, thread or task: their first argument, or the second, or `timeout`, is a limit [s].
WAITING = {"communicate": 0, "wait": 0, "join": 0, "result": 0, "wait_for": 1, "run": None, "check_output": None}
LONGEST_PAUSE_S = 0.5
"""What is shorter is no limit, but a look every so often."""


SUSPECT = re.compile(r"timeout=[\d.]|\b(?:communicate|wait|join|result|wait_for)\([^\n]*\d")


def limits(name: str, tree: ast.AST) -> Iterator[str]:
    """Calls that wait with a number for their limit."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute) or node.func.attr not in WAITING:
            continue
        place = WAITING[node.func.attr]
        given = [word.value for word in node.keywords if word.arg == "timeout"]
        given += node.args[place : place + 1] if place is not None else []
        for limit in given:
            if (
                isinstance(limit, ast.Constant)
                and isinstance(limit.value, int | float)
                and limit.value > LONGEST_PAUSE_S
            ):
                yield f"{name}:{node.lineno} {node.func.attr}({limit.value}): say PATIENCE_S"


@pytest.mark.long
def test_waits_that_state_nothing_have_one_patience() -> None:
    texts = {path: path.read_text() for path in sorted(TESTS.rglob("*.py"))}
    found = [
        line
        for path, text in texts.items()
        if SUSPECT.search(text)  # to parse them all takes seconds
        for line in limits(str(path.relative_to(TESTS)), ast.parse(text))
    ]
    assert found == []


def test_a_limit_of_its_own_is_found() -> None:
    wrong = ["child.wait(timeout=10)", "thread.join(5.0)", "asyncio.wait_for(work, 20.0)"]
    text = "\n".join([*wrong, "child.wait(PATIENCE_S)", "end.wait(0.05)"])
    assert all(SUSPECT.search(line) for line in wrong)
    assert [line.split()[0] for line in limits("t.py", ast.parse(text))] == ["t.py:1", "t.py:2", "t.py:3"]
