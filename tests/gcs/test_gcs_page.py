"""The user's page: its code runs as it stands there, and its tables name what there is."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.gcs.virtual import on_board
from twodof import fleet
from twodof.gcs.drone import Drone

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "fly-from-python.md"


@contextmanager
def virtual_drone(rig: str = "lab", rings: bool = False) -> Iterator[str]:
    """As that of `fleet`, which tests/fleet holds, without a process of its own."""
    with on_board(rig=rig, lockstep=True, conditions={"rings": rings, "seed": 1}) as there:
        yield there.url


def test_the_code_on_the_page_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert len(blocks) == 6
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(fleet, "virtual_drone", virtual_drone)
    exec(compile("\n".join(blocks), str(PAGE), "exec"), {"__name__": "__main__"})
    assert "done" in capsys.readouterr().out
    assert (tmp_path / "flight.mat").is_file()


def test_every_verb_in_the_table_is_one_of_the_drones() -> None:
    table = PAGE.read_text(encoding="utf-8").split("| verb | is |")[1].split("\n\n")[0]
    verbs = re.findall(r"`(\w+)\(", table)
    assert len(verbs) > 15
    assert [verb for verb in verbs if not callable(getattr(Drone, verb, None))] == []
