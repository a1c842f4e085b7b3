"""The slot: what was flashed is what flies, one of a kind, wholly or not at all."""

from pathlib import Path

import pytest

from twodof.blocks import Diagram
from twodof.blocks.schema.json_form import to_json
from twodof.errors import DiagramError
from twodof.flight.controller_store import STOCK, ControllerStore, data_folder, simulator_controllers
from twodof.flight.starters import starter
from twodof.flight.templates import TEMPLATES, kind_of


def test_without_flashing_the_stock_controllers_fly(tmp_path: Path) -> None:
    slot = ControllerStore(tmp_path / "none")
    assert slot.flashed() == {}
    assert set(STOCK) == set(TEMPLATES)
    for kind, name in STOCK.items():
        diagram, origin = slot.in_use(kind)
        assert kind_of(diagram) == kind
        assert origin == f"the stock controller ({name})"
    assert not slot.remove("attitude_control")
    assert not slot.folder.exists()


def test_what_was_flashed_flies_until_another_of_its_kind_is(tmp_path: Path) -> None:
    slot = ControllerStore(tmp_path / "a" / "b")
    slot.flash(starter("lqr-attitude"))
    slot.flash(starter("pid-position"))
    slot.flash(starter("notch-attitude"))
    assert {kind: d.name for kind, d in slot.flashed().items()} == {
        "attitude_control": "notch_attitude",
        "position_control": "pid_position",
    }
    diagram, origin = slot.in_use("attitude_control")
    assert to_json(diagram) == to_json(starter("notch-attitude"))
    assert origin == str(tmp_path / "a" / "b" / "attitude_control.json")
    assert slot.remove("attitude_control")
    assert slot.in_use("attitude_control")[1].startswith("the stock controller")


def test_what_fits_no_template_or_cannot_be_written_leaves_what_flew(tmp_path: Path) -> None:
    slot = ControllerStore(tmp_path)
    file = slot.flash(starter("lqr-attitude"))
    before = file.read_bytes()
    wrong = starter("pid-attitude")
    wrong.input("wind")
    with pytest.raises(DiagramError, match="the input wind is not of the template"):
        slot.flash(wrong)
    with pytest.raises(DiagramError, match="no template has its outputs"):
        slot.flash(Diagram("nothing"))
    assert file.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["attitude_control.json"]
    (tmp_path / "file").write_text("")
    with pytest.raises(DiagramError, match=r"cannot be made.*TWODOF_DATA"):
        ControllerStore(tmp_path / "file" / "sim").flash(starter("empty-motor"))
    with pytest.raises(DiagramError, match=r"no template named .yaw."):
        slot.in_use("yaw")


def test_a_damaged_file_is_said_and_can_be_flashed_over(tmp_path: Path) -> None:
    slot = ControllerStore(tmp_path)
    slot.flash(starter("lqr-attitude")).write_text("{")
    with pytest.raises(DiagramError, match="this is no JSON"):
        slot.flashed()
    assert "as what was flashed is damaged" in slot.in_use("attitude_control")[1]
    slot.flash(starter("lqr-attitude"))
    assert slot.flashed()["attitude_control"].name == "lqr_attitude"
    # A file of another template in the place of one would fly something else than it says.
    slot.file("position_control").write_text(to_json(starter("lqr-attitude")))
    with pytest.raises(DiagramError, match="does not fit the template position_control"):
        slot.flashed()


def test_where_it_is_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("TWODOF_DATA", str(tmp_path))
    assert simulator_controllers().folder == tmp_path / "flashed" / "sim"
    monkeypatch.delenv("TWODOF_DATA")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "xdg"))
    assert data_folder() == tmp_path / "xdg" / "twodof"
    monkeypatch.delenv("XDG_DATA_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert data_folder() == tmp_path / "home" / ".local" / "share" / "twodof"
