"""The two named rigs: published numbers, origins, bounds, files."""

import json
from pathlib import Path

import pytest

from twodof.errors import ParameterError
from twodof.parameters import ParameterSet
from twodof.rig.parameters import CALIBRATED, CONDITIONS, LAB_FILE, TABLE, lab, load_rig, origins, paper, save_rig
from twodof.rig.rig import rig, rig_params
from twodof.signals import Q_AGE


def test_the_paper_rig_has_the_papers_numbers() -> None:
    p = paper()
    inertia, mass = p["inertia"], p["mass_drone"] + p["mass_cart"]
    assert (p["spring"] / inertia) ** 0.5 == pytest.approx(3.437, rel=1e-12)  # w_n
    assert p["viscous_run"] / inertia / (2.0 * 3.437) == pytest.approx(0.0836, rel=1e-12)  # xi
    assert p["viscous_idle"] == p["viscous_run"]
    assert p["delay"] == 0.020 + Q_AGE
    assert p["lag"] == 0.0
    assert p["rail_viscous"] / mass == pytest.approx(1.168, rel=1e-12)  # p_v
    for name in ("coulomb_idle", "coulomb_run", "rail_coulomb", "softening", "hardening", "offset", "gust"):
        assert p[name] == 0.0


def test_the_lab_rig_is_calibrated_in_what_it_says() -> None:
    values = lab()
    default = ParameterSet(table=TABLE)
    for name in CALIBRATED:
        assert values[name] != default[name], name
    stored = json.loads(LAB_FILE.read_text(encoding="utf-8"))
    assert values.snapshot() == stored["parameters"]
    # Plausible for a drone of .374 kg and 20 cm.
    assert 1e-3 < values["inertia"] < 6e-3
    assert 0.0 < values["offset"] < 0.02
    assert values["viscous_run"] + values["coulomb_run"] < values["viscous_idle"] + values["coulomb_idle"]


@pytest.mark.parametrize("name", ["paper", "lab"])
def test_every_number_has_an_origin(name: str) -> None:
    told = origins(name)
    assert set(told) == {row.name for row in TABLE}
    assert all(told.values())


def test_the_table_is_that_of_the_diagram() -> None:
    assert {row.name for row in TABLE} == set(rig_params()) - CONDITIONS
    assert set(rig().params) == set(rig_params())
    assert set(rig_params()) >= CONDITIONS
    for row in TABLE:
        assert row.text


def test_a_file_reads_back_to_the_same_bits(tmp_path: Path) -> None:
    values = lab()
    values.update({"inertia": 0.1 + 0.2, "gust": 1e-300})
    save_rig(values, tmp_path / "rig.json")
    assert load_rig(tmp_path / "rig.json").snapshot() == values.snapshot()
    (tmp_path / "notepad.json").write_text((tmp_path / "rig.json").read_text(), encoding="utf-8-sig")
    assert load_rig(tmp_path / "notepad.json").snapshot() == values.snapshot()
    assert load_rig("paper").snapshot() == paper().snapshot()
    assert load_rig("lab").snapshot() == lab().snapshot()


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("{", "is not JSON"),
        ("[]", "has no .version."),
        ('{"version": 2, "parameters": {}}', "has no .version."),
        ('{"version": 1}', "has no table"),
        ('{"version": 1, "parameters": {"wheels": 4}}', "no such parameter"),
        ('{"version": 1, "parameters": {"mass_drone": -1}}', "outside"),
        ('{"version": 1, "parameters": {"mass_drone": NaN}}', "outside"),
        ('{"version": 1, "parameters": {"mass_drone": "heavy"}}', "is not a number"),
    ],
)
def test_a_bad_file_is_refused_and_named(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "rig.json"
    path.write_text(text)
    with pytest.raises(ParameterError, match=complaint) as raised:
        load_rig(path)
    assert raised.value.where == str(path)


def test_a_missing_file_or_name_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="cannot be read"):
        load_rig(tmp_path / "none.json")
    with pytest.raises(ParameterError, match="no rig called"):
        origins("mars")
