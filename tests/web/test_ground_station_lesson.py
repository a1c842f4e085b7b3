"""The lesson of the ground station can be followed from its first line to its last."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.web.conftest import OpenPage, picture
from tests.web.ground_station_lesson import run
from tests.web.lab_server import LabServer

pytestmark = pytest.mark.slow

PROJECT = Path(__file__).resolve().parents[2]


@pytest.mark.long
def test_the_lesson_can_be_followed(lab_server: LabServer, open_page: OpenPage) -> None:
    """Each click and text of the lesson exists on the page, and so does each of its pictures."""
    lab_server.warm()
    page = open_page(lab_server.link)
    taken: list[str] = []

    def take(name: str) -> None:
        taken.append(f"ground-station-{name}.png")
        picture(page, f"lesson-{name}")

    run(page, take)
    lesson = (PROJECT / "docs" / "tutorials" / "ground-station.md").read_text(encoding="utf-8")
    assert [name for name in taken if name not in lesson or not (PROJECT / "docs" / "pictures" / name).is_file()] == []
    (flight,) = (lab_server.folder / "flights").glob("*.notes.txt")
    assert flight.read_text(encoding="utf-8") == "My first flight from the page."
