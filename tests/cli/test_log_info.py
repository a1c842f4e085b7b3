"""`twodof log info` of logs whose makers noted something else than ours do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twodof.cli.app import run
from twodof.flightlog.files import write_log
from twodof.flightlog.log import Channel, FlightLog

NOTED: list[tuple[dict[str, Any], list[str]]] = [
    ({"texts": "hello"}, []),
    ({"texts": [1, ["a", "b", "c"], [2.5, "info", "fine"]]}, ["     2.500 s  info: fine"]),
    ({"texts": {"a": 1}, "flown": [1], "drone": 3}, []),
    ({"flown": "yes", "drone": {"controller": "mine"}}, ["controller: mine"]),
    ({"texts": [[1, 4, "\x1b[31mred"]], "flown": {"reason": "a\nb"}}, ["broken off: a b", "     1.000 s  4:  [31mred"]),
]


@pytest.mark.parametrize(("noted", "shown"), NOTED)
def test_what_others_noted_is_shown_where_it_is_laid_out_as_ours(
    noted: dict[str, Any], shown: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nor does it command the terminal."""
    path = tmp_path / "theirs.mcap"
    gyr = Channel(0.004 * np.arange(10), np.zeros((10, 3)), "rad/s", ("x", "y", "z"), "gyr")
    write_log(FlightLog({"gyr": gyr}, noted), path)
    assert run(["log", "info", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if line.startswith(("controller", "broken off", "     "))] == shown
