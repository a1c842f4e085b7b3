"""A hostile diagram file is refused with a reason, in bounded time and memory (docs/reference/diagram-files.md)."""

import re
from pathlib import Path

import pytest

from tests.blocks.schema.door import MEMORY, SECONDS, judge, judge_many
from tests.blocks.schema.hostile import MALFORMED, NAMES, endless, large, named, too_large
from tests.blocks.schema.hostile_machines import hostile_machines, large_machines

pytestmark = pytest.mark.slow

each_day = pytest.mark.parametrize("share", [10, pytest.param(1, marks=pytest.mark.soak)])
"""A tenth of the size where a file's time is in proportion to it; the soak takes all of it."""


@pytest.mark.long
@each_day
def test_a_hostile_file_is_refused_with_a_reason_in_two_seconds_and_a_gigabyte(share: int, tmp_path: Path) -> None:
    """The largest takes half of it. A busy machine adds to processor time too: what is over is measured again."""
    refused = {**too_large(share), **endless(share), **hostile_machines(), **MALFORMED}
    found = judge({name: data for name, (data, _) in refused.items()}, tmp_path)
    wrong = []
    for name, row in found.items():
        good = row["error"] == "DiagramError" and re.search(refused[name][1], row["text"]) and row["long"] < 1000
        seconds = least_seconds(refused[name][0], row["seconds"], tmp_path / "again")
        if not good or seconds > SECONDS or row["bytes"] > MEMORY:
            wrong.append((name, row))
    assert not wrong


def least_seconds(data: bytes, first: float, folder: Path) -> float:
    """Return the least processor time [s] of judging a file: `first`, or one of five more tries."""
    least = first
    folder.mkdir(exist_ok=True)
    for _ in range(5):
        if least <= SECONDS:
            break
        least = min(least, judge({"again": data}, folder)["again"]["seconds"])
    return least


@pytest.mark.long
@pytest.mark.parametrize("share", [20, pytest.param(1, marks=pytest.mark.soak)])
def test_what_is_large_and_allowed_stays_bounded(share: int, tmp_path: Path) -> None:
    found = judge({**large(share), **large_machines()}, tmp_path)
    assert not [(name, row) for name, row in found.items() if row["stage"] != "compiled" or row["bytes"] > MEMORY]


def test_no_name_but_an_identifier_comes_in_anywhere(tmp_path: Path) -> None:
    files = {f"{name} as {place}": data for name, text in NAMES.items() for place, data in named(text).items()}
    found = judge_many([data.decode() for data in files.values()], tmp_path / "files", 300)
    rows = dict(zip(files, found, strict=True))
    fields = {"a dot as input", "a dot as custom state"}  # those of a bus
    assert {rows.pop(name)["stage"] for name in fields} == {"compiled"}
    assert not [(name, row) for name, row in rows.items() if row["error"] != "DiagramError" or row["long"] > 1000]
