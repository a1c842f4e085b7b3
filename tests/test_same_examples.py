"""hypothesis gives a test the same examples, after any other test in the same process: a failure is met again."""

import importlib.util
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

Drawn = list[tuple[float, int, str]]


def examples() -> Drawn:
    """Return the examples that hypothesis gives to a test."""
    found: Drawn = []

    @given(st.floats(allow_nan=False), st.integers(), st.text())
    def draw(x: float, n: int, text: str) -> None:
        found.append((x, n, text))

    draw()
    return found


def test_examples_do_not_depend_on_the_modules_that_are_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A module of our own that is full of numbers and words comes between two runs of one test."""
    before = examples()
    assert len(before) >= 100
    file = tmp_path / "own.py"
    file.write_text(f"MANY = {[(1000.5 + k, 10**6 + k, f'word {k}') for k in range(300)]!r}\n")
    made = importlib.util.spec_from_file_location("own", file)
    assert made is not None
    assert made.loader is not None
    own = importlib.util.module_from_spec(made)
    made.loader.exec_module(own)
    monkeypatch.setitem(sys.modules, "own", own)
    assert examples() == before
