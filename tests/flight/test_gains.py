"""Gains: the file's form, its round trip, and what is refused."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twodof.blocks.reference.interpreter import Reference
from twodof.errors import ParameterError
from twodof.flight.core import core
from twodof.flight.gains import DEFAULT, STUDENT, Gains, load_gains
from twodof.parameters import PARAMETERS, ParameterSet
from twodof.signals import PERIOD


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
        ('{"rate": [1, 2, 3], "attitude": 1, "velocity": [1, 2]}', "gains.json"),
        ('{"rate": [1, 2, true], "attitude": 1, "velocity": [1, 2], "position": 1}', "rate"),
        ('{"rate": [0, 0, 0], "attitude": "1", "velocity": [1, 2], "position": 1}', "attitude"),
        ('{"rate": [0, 0, 0], "attitude": 1, "velocity": [1, -2], "position": 1}', "gains.json: VEL_KI: -2 is"),
        ('{"rate": [0, 0, 0], "attitude": 1, "velocity": [1, 2], "position": NaN}', "gains.json: POS_KP: nan is"),
        ('{"rate": [0, 0, 0], "attitude": 1, "velocity": [1, 2], "position": 1%s}' % ("0" * 400), "POS_KP: inf is"),
    ],
)
def test_what_is_no_set_of_gains_is_refused(tmp_path: Path, text: str, where: str) -> None:
    path = tmp_path / "gains.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ParameterError) as caught:
        load_gains(path)
    assert where in str(caught.value)
    assert caught.value.remedy


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"nowhere\.json"):
        load_gains(tmp_path / "nowhere.json")


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({"rate": (1.0, 2.0)}, "rate"),
        ({"velocity": (1.0, 2.0, 3.0)}, "velocity"),
        ({"attitude": "11"}, "ATT_KP"),
        ({"position": True}, "POS_KP"),
        ({"position": float("inf")}, "POS_KP"),
        ({"position": 10**400}, "POS_KP"),
    ],
)
def test_gains_of_another_shape_are_refused(changes: dict[str, Any], where: str) -> None:
    with pytest.raises(ParameterError) as caught:
        replace(DEFAULT, **changes)
    assert where in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "value"), [({"rate": (0.2, 0.2, 0.001)}, {"RATE_KP": 0.2}), ({"attitude": 16.0}, {"ATT_KP": 16.0})]
)
def test_what_the_drone_refuses_the_simulator_refuses_with_the_same_words(
    changes: dict[str, Any], value: dict[str, float]
) -> None:
    """Before, RATE_KP could be 0.12 on the drone and 1.0 in the simulator, ATT_KP 15 and 50."""
    with pytest.raises(ParameterError) as drone:
        ParameterSet().update(value)
    with pytest.raises(ParameterError) as simulator:
        replace(DEFAULT, **changes)
    assert simulator.value.what == drone.value.what
    ((name, number),) = value.items()
    (row,) = (row for row in PARAMETERS if row.name == name)
    code = Reference(core(), PERIOD).machine()
    with pytest.raises(ParameterError) as program:
        code.set(row.path, number)
    assert f"{name}: {program.value.what}" == drone.value.what


def test_what_a_log_says_of_its_gains_is_read_back() -> None:
    """Read gains of a flight, of a recording, and of a log on board, whose float32 are the shortest decimals."""
    tuned = STUDENT.tuned()
    assert tuned["POS_KP"] == STUDENT.position
    assert Gains.from_provenance({"parameters": tuned}) == STUDENT
    assert Gains.from_provenance({"drone": {"parameters": tuned}}) == STUDENT
    assert Gains.from_provenance({"parameters": DEFAULT.tuned()}) == DEFAULT
    open_rate = dict.fromkeys(("RATE_KP", "RATE_KI", "RATE_KD"), 0.0)
    on_board = {
        name: float(np.float32(value))
        for name, value in ({row.name: row.default for row in PARAMETERS} | tuned).items()
    }
    assert Gains.from_provenance({"parameters": on_board, "ulog": {}}) == STUDENT
    assert Gains.from_provenance({"parameters": open_rate}) == replace(DEFAULT, rate=(0.0, 0.0, 0.0))


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
    assert Gains.from_provenance(provenance) is None
