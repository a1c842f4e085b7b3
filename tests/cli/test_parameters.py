"""`twodof parameters`: what can be tuned on a drone is seen, found by path, set together or not at all."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from tests.cli.program import Shell
from tests.experiment.drones import drone_thread
from twodof.cli import output
from twodof.gcs.drone import Drone

pytestmark = pytest.mark.slow

PATH, NAME = "attitude_control.k_q", "TLA_K_Q"


@pytest.mark.long
def test_a_controller_is_tuned_from_the_shell(shell: Shell, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def said(*arguments: str, status: int = 0) -> Any:
        told = shell(["parameters", "--url", url, *arguments], status)
        return told.err if status else json.loads(told.out) if "--json" in arguments else told.out

    with drone_thread(controllers=["lqr-attitude"]) as url:
        assert len(said().splitlines()) == 1 + len(said("--json")["parameters"])
        assert said("--changed", "--json")["parameters"] == []
        assert said("--changed") == "all are at their defaults\n"
        assert "…" not in said()
        monkeypatch.setattr(output, "table_console", lambda: Console(width=70))
        assert re.search(rf"{NAME} +0.108704\d+ +0.108704\d+ +0 +1  s/rad", said())  # in a narrow terminal too
        monkeypatch.undo()
        assert f"{NAME}    0.2  0.10870461     0     1  s/rad  {PATH}: " in said(f"{PATH}=0.2", "RATE_KP=0.07")
        assert {row["name"] for row in said("--changed", "--json")["parameters"]} == {NAME, "RATE_KP", "FC_PARAM_4"}
        (row,) = said(PATH, "--json")["parameters"]
        assert (row["name"], row["path"], row["value"], row["high"], row["unit"]) == (NAME, PATH, 0.2, 1.0, "s/rad")

        kept = tmp_path / "mine.params"
        assert "ATT_KP" not in said("--save", str(kept)), "the file has them all"
        assert "is there already" in said("--save", str(kept), status=2)
        assert re.search(r"^1\t1\tRATE_KP\t0\.07\d*\t9$", kept.read_text(), re.MULTILINE)  # as QGroundControl has it
        said("RATE_KP=0.06")
        kept.write_text(kept.read_text() + "1\t1\tMC_ROLL_P\t6.5\t9\n")
        assert [row["name"] for row in said("--load", str(kept), "--json")["parameters"]] == ["RATE_KP"]
        assert said("--load", str(kept)) == ""
        assert said("RATE_KP", "--json")["parameters"][0]["value"] == pytest.approx(0.07)
        kept.write_text("2\t1\tRATE_KP\t0.07\t9\n")
        assert shell(["parameters", "--url", url, "--load", str(kept)]).err.endswith(
            "note: the file is of vehicle 2, this is vehicle 1\n"
        )
        assert "is not a parameter" in said("--load", __file__, status=2)

        assert "2 is outside 0 to 1 s/rad" in said("RATE_KP=0.05", f"{PATH}=2", status=2)
        assert "no such parameter" in said("RATE_KP=0.05", "attitude_control.kq=0.1", status=2)
        assert "'much' is not a number" in said("RATE_KP=0.05", f"{PATH}=much", status=2)
        with Drone.connect(url) as pilot:
            said("RATE_KP=0.08")
            assert pilot.parameters["RATE_KP"] == pytest.approx(0.08)
            said("RATE_KP=0.07")
            pilot.withhold_tuning()
            assert "holds the lease and withholds tuning" in said(f"{PATH}=0.3", status=2)
            assert (pilot.parameters[PATH], pilot.parameters["RATE_KP"]) == (0.2, 0.07)
            pilot.parameters[PATH] = 0.3
            assert said(PATH, "--json")["parameters"][0]["value"] == 0.3
