"""A diagram as an argument: a starter's name, a file, or an error that lists the names."""

from pathlib import Path

import pytest

from twodof.cli.diagrams.argument import DIAGRAM_HELP, read_diagram
from twodof.errors import DiagramError
from twodof.flight.starters import STARTERS, new_diagram


def test_a_name_or_a_file(tmp_path: Path) -> None:
    assert read_diagram("lqr-attitude").name == "lqr_attitude"
    new_diagram("pid-position", tmp_path / "mine.json")
    assert read_diagram(str(tmp_path / "mine.json")).name == "pid_position"


def test_what_is_neither_is_answered_with_every_name() -> None:
    with pytest.raises(DiagramError) as caught:
        read_diagram("lqr")
    for name in STARTERS:
        assert name in caught.value.remedy
        assert name in DIAGRAM_HELP
