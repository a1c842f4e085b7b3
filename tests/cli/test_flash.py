"""`twodof flash`: sizes, what changes, one stored slot, and refusals that change nothing."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.program import Shell
from tests.experiment.drones import drone_thread
from tests.fcu.program import twodof_fcu
from tests.toolchains import need
from twodof.blocks.schema.json_form import to_json
from twodof.cli.app import run
from twodof.compile.cortex_m7 import processor
from twodof.errors import CompileError, Rejected
from twodof.flight.controller_store import simulator_controllers
from twodof.flight.starters import load_diagram, new_diagram, save_diagram, starter
from twodof.flightlog.files import read_log
from twodof.gcs.drone import Drone

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A data folder of the test's own, and no emulator, which test_costs_of_the_processor brings back."""
    monkeypatch.setenv("TWODOF_DATA", str(tmp_path / "data"))

    def none() -> str:
        raise CompileError("an emulator is missing", "qemu-system-arm", "install the package qemu-system-arm")

    monkeypatch.setattr(processor, "find_emulator", none)
    return tmp_path


def answer(shell: Shell, *arguments: str, status: int = 0) -> Any:
    return shell([*arguments, "--json"], status).json


@pytest.mark.long
def test_a_flashed_controller_flies_on_request_alone(folder: Path, shell: Shell) -> None:
    first = answer(shell, "flash", "lqr-attitude", "--to", "sim")
    assert first["template"] == "attitude_control"
    assert first["against"] == "the stock controller (stock-attitude)"
    assert first["flashed"] is True
    assert first["trial"]["fault"] is None
    assert first["trial"]["margins"]["motors"]["stable"] is True
    assert {row["kind"] for row in first["changes"]} == {"added", "removed", "changed"}
    assert answer(shell, "flash", "pid-position", "--to", "sim")["template"] == "position_control"

    def moments(*more: str) -> tuple[Any, np.ndarray]:
        file = folder / "flight.parquet"
        found = answer(shell, "simulate", "velocity-doublets", "--out", str(file), "--force", *more)
        return found["controllers"], read_log(file)["M"].value

    stock, flown = moments()
    assert stock == {}
    both, flashed = moments("--controller", "flashed")
    assert {kind: row["name"] for kind, row in both.items()} == {
        "attitude_control": "lqr_attitude",
        "position_control": "pid_position",
    }
    _, named = moments("--controller", "lqr-attitude", "--controller", "pid-position")
    assert flashed.tobytes() == named.tobytes()
    assert flashed.tobytes() != flown.tobytes()


@pytest.mark.long
def test_a_changed_gain_is_the_one_change(folder: Path, shell: Shell) -> None:
    file = folder / "mine.json"
    new_diagram("notch-attitude", file)
    answer(shell, "flash", str(file), "--to", "sim")
    text = file.read_text()
    assert text.count('"value": 0.068') == 1
    file.write_text(text.replace('"value": 0.068', '"value": 0.07'))
    tried = answer(shell, "flash", str(file), "--to", "sim", "--dry-run")
    assert tried["flashed"] is False
    assert tried["changes"] == [
        {
            "what": "parameter",
            "kind": "changed",
            "path": "q_kp",
            "before": "0.068 s/rad, 0 to 1",
            "after": "0.07 s/rad, 0 to 1",
        }
    ]
    assert answer(shell, "flash", str(file), "--to", "sim")["changes"] == tried["changes"]
    assert answer(shell, "flash", str(file), "--to", "sim")["changes"] == []
    assert to_json(simulator_controllers().flashed()["attitude_control"]) == file.read_text()


@pytest.mark.long
def test_people_read_sizes_and_changes(shell: Shell) -> None:
    out = shell(["flash", "notch-attitude", "--to", "sim"]).out
    assert "notch_attitude fits attitude_control; float32, 250 Hz" in out
    assert "code: not measured for the Cortex-M7" in out
    assert "install the package qemu-system-arm" in out
    assert "+ block notch: notch" in out
    assert "fly it: twodof simulate EXPERIMENT --controller flashed" in out
    assert "nothing changes against" in shell(["flash", "notch-attitude", "--to", "sim"]).out


@pytest.mark.long
def test_costs_of_the_processor(monkeypatch: pytest.MonkeyPatch, shell: Shell) -> None:
    monkeypatch.undo()
    monkeypatch.setenv("TWODOF_DATA", "/nowhere")
    need("qemu-system-arm")
    costs = answer(shell, "flash", "notch-attitude", "--to", "sim", "--dry-run")["costs"]
    m7 = costs["cortex_m7"]
    # 11 given and 14 derived parameters of 4 bytes; the integral, the filter, two of the notch, and the tick.
    assert (costs["parameter_bytes"], costs["state_bytes"]) == (4 * 25, 4 * 5)
    assert m7["struct_bytes"] == {"P": 100, "S": 20, "U": 20, "Y": 4}
    assert 0 < m7["flash_bytes"] < 8192
    assert 0 < m7["instructions_max"] < 1000
    wide = answer(shell, "flash", "notch-attitude", "--to", "sim", "--dry-run", "--precision", "float64")["costs"]
    assert wide["parameter_bytes"] == 8 * 25


@pytest.mark.long
def test_a_px4_module_lists_its_changes(folder: Path, shell: Shell) -> None:
    out = folder / "module"
    first = answer(shell, "flash", "pid-attitude", "--to", "px4-dir", "--out", str(out))
    assert first["against"] == "the stock controller (stock-attitude)"
    assert to_json(load_diagram(out / "diagram.json")) == to_json(starter("pid-attitude"))
    second = answer(shell, "flash", "notch-attitude", "--to", "px4-dir", "--out", str(out))
    assert second["against"] == str(out / "diagram.json")
    assert "+ block notch" in "".join(f"+ {c['what']} {c['path']}" for c in second["changes"] if c["kind"] == "added")
    assert not simulator_controllers().folder.exists()


@pytest.mark.long
def test_an_unfit_px4_changes_nothing(folder: Path, shell: Shell) -> None:
    (folder / "px4").mkdir()
    arguments = ["--to", "px4-dir", "--out", str(folder / "module"), "--px4", str(folder / "px4")]
    found = answer(shell, "flash", "pid-attitude", *arguments, status=1)
    assert found["error"]["kind"] == "CompileError"
    assert "does not fit this PX4" in found["error"]["what"]
    assert not (folder / "module").exists()


@pytest.mark.long
def test_a_drone_keeps_a_flashed_controller_over_restarts(folder: Path, shell: Shell) -> None:
    """A controller is sent to a running drone, flies there, and flies again in a program that is started afterwards."""
    state = folder / "drone"
    with drone_thread(conditions={"rings": True}, state=state) as url:
        found = answer(shell, "flash", "lqr-attitude", "--to", url)
        assert found["flashed"]
        assert found["against"].startswith("the stock controller")
        assert "drone 1" in found["place"]
        again = answer(shell, "flash", "lqr-attitude", "--to", url)
        assert again["changes"] == []
        assert again["against"] == "lqr_attitude, which flies on drone 1"
        assert "nothing was flashed" in shell(["flash", "stock-attitude", "--to", url, "--dry-run"]).out
    with twodof_fcu("--lockstep", "--rings", "--state", str(state)) as url, Drone.connect(url) as drone:
        assert drone.state.rig.controller == "lqr_attitude"
        for _ in range(4):
            drone.run(0.25)
        drone.arm()
        found = answer(shell, "flash", "stock-attitude", "--to", url, status=2)
        assert found["error"]["kind"] == "Rejected"
        assert "lease" in found["error"]["what"]
        assert "take_lease" not in found["error"]["remedy"]
        assert f"twodof kill --url {url}" in found["error"]["remedy"]
        assert drone.state.armed, "a refusal does not disarm"
        with pytest.raises(Rejected, match="armed"):
            drone.fly_controller("attitude_control", to_json(starter("stock-attitude")))
        drone.disarm()
        with pytest.raises(Rejected, match="no JSON"):
            drone.fly_controller("attitude_control", "{")
        flies = drone.files.read("/etc/extras/attitude_control.json")
        assert flies == to_json(starter("lqr-attitude")).encode()
        assert drone.files.read("/controllers/attitude_control.json") == flies, "what was not built is not kept"
        drone.fly_controller("attitude_control", to_json(starter("stock-attitude")))
        drone.run(0.1)
        drone.command("REQUEST_MESSAGE", 54206)
        drone.run(0.1)
        assert drone.state.rig.controller == "stock"


@pytest.mark.long
def test_what_is_wrong_changes_nothing(folder: Path, shell: Shell) -> None:
    answer(shell, "flash", "lqr-attitude", "--to", "sim")
    before = (folder / "data/flashed/sim/attitude_control.json").read_bytes()
    wrong = starter("pid-attitude")
    wrong.input("wind")
    save_diagram(wrong, folder / "wrong.json")
    found = answer(shell, "flash", str(folder / "wrong.json"), "--to", "sim", status=2)
    assert "the input wind is not of the template" in found["error"]["what"]
    found = answer(shell, "flash", "lqr", "--to", "sim", status=2)
    assert "lqr-attitude" in found["error"]["remedy"]
    found = answer(shell, "flash", "pid-attitude", "--to", "fc", status=2)
    assert found["error"]["what"] == "'fc' is not sim, px4-dir, fcu or a URL"
    for arguments in (["--to", "px4-dir"], ["--to", "sim", "--out", "x"], ["--to", "sim", "--px4", "x"], ["--to", "x"]):
        assert run(["flash", "pid-attitude", *arguments]) == 2
    assert (folder / "data/flashed/sim/attitude_control.json").read_bytes() == before


@pytest.mark.long
@pytest.mark.parametrize("name", ["empty-attitude", "stock-attitude"])
def test_remarks_of_check_appear_before_a_flash(name: str, shell: Shell) -> None:
    remarks = answer(shell, "flash", name, "--to", "sim", "--dry-run")["remarks"]
    found = answer(shell, "diagram", "check", name)["remarks"]
    assert found
    assert remarks == [f"{row['where']}: {row['what']} ({row['remedy']})" for row in found]
