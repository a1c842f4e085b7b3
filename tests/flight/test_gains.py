"""Gains: the file's form, its round trip, and what is refused."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twodof.errors import ParameterError
from twodof.flight.gains import DEFAULT, STUDENT, Gains, load_gains
from twodof.parameters import PARAMETERS


def test_default_gains_are_the_drones_own() -> None:
    # The numbers of the drone's parameter list.
    assert Gains((0.0854, 0.251, 0.00054), 11.0, (2.4, 2.81), 1.5) == DEFAULT
    assert load_gains("default") is DEFAULT
    assert load_gains("student") is STUDENT
    assert STUDENT.rate == (0.0651, 0.35, 0.000896)
    by_name = {row.name: row.default for row in PARAMETERS}
    assert DEFAULT.attitude == by_name["ATT_KP"]


def test_a_file_of_gains_is_read_back(tmp_path: Path) -> None:
    gains = Gains((0.1, 0.2, 0.003), 4.0, (2.0, 1.0), 0.5)
    path = tmp_path / "gains.json"
    path.write_text(json.dumps(gains.to_json()), encoding="utf-8")
    assert load_gains(path) == gains


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("{", "gains.json"),
        ("[1, 2]", "gains.json"),
        ('{"rate": [1, 2, 3], "attitude": 1, "velocity": [1, 2]}', "gains.json"),
        ('{"rate": [1, 2], "attitude": 1, "velocity": [1, 2], "position": 1}', "rate"),
        ('{"rate": [1, 2, true], "attitude": 1, "velocity": [1, 2], "position": 1}', "rate"),
        ('{"rate": [1, 2, 3], "attitude": "1", "velocity": [1, 2], "position": 1}', "attitude"),
        ('{"rate": [1, 2, 3], "attitude": 1, "velocity": [1, -2], "position": 1}', "velocity.ki"),
        ('{"rate": [1, 2, 3], "attitude": 1, "velocity": [1, 2], "position": NaN}', "position"),
        ('{"rate": [1, 2, 3], "attitude": 1, "velocity": [1, 2], "position": 1%s}' % ("0" * 400), "position"),
    ],
)
def test_what_is_no_set_of_gains_is_refused(tmp_path: Path, text: str, where: str) -> None:
    path = tmp_path / "gains.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ParameterError) as caught:
        load_gains(path)
    assert where in caught.value.where
    assert caught.value.remedy


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"nowhere\.json"):
        load_gains(tmp_path / "nowhere.json")


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({"rate": (1.0, 2.0)}, "rate"),
        ({"rate": 1.0}, "rate"),
        ({"velocity": (1.0, 2.0, 3.0)}, "velocity"),
        ({"attitude": "11"}, "attitude.kp"),
        ({"attitude": None}, "attitude.kp"),
        ({"position": True}, "position.kp"),
        ({"position": float("inf")}, "position.kp"),
        ({"position": 10**400}, "position.kp"),
    ],
)
def test_gains_of_another_shape_are_refused(changes: dict[str, Any], where: str) -> None:
    with pytest.raises(ParameterError) as caught:
        replace(DEFAULT, **changes)
    assert caught.value.where == where


def test_what_a_log_says_of_its_gains_is_read_back() -> None:
    """Of a flight, a recording, and a log on board in float32, of which what was set is the shortest decimal."""
    tuned = STUDENT.tuned()
    assert tuned["POS_KP"] == STUDENT.position
    assert Gains.flown({"parameters": tuned}) == STUDENT
    assert Gains.flown({"drone": {"parameters": tuned}}) == STUDENT
    assert Gains.flown({"parameters": DEFAULT.tuned()}) == DEFAULT
    open_rate = dict.fromkeys(("RATE_KP", "RATE_KI", "RATE_KD"), 0.0)
    on_board = {
        name: float(np.float32(value))
        for name, value in ({row.name: row.default for row in PARAMETERS} | tuned).items()
    }
    assert Gains.flown({"parameters": on_board, "ulog": {}}) == STUDENT
    assert Gains.flown({"parameters": open_rate}) == replace(DEFAULT, rate=(0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    "provenance",
    [
        {},
        {"parameters": []},
        {"drone": 3},
        *({"parameters": {"RATE_KP": value}} for value in ("much", True, None, -1.0, 1e300, 10**400, float("nan"))),
        {"ulog": {}, "parameters": {"MC_PITCH_P": 6.5}},
    ],
)
def test_a_log_that_does_not_say_its_gains_has_none(provenance: dict[str, Any]) -> None:
    assert Gains.flown(provenance) is None
