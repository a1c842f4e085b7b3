"""What flies on a drone is told, and kept with what is recorded of it."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from tests.gcs.virtual import on_board
from twodof.blocks.schema.json_form import to_json
from twodof.flight.starters import starter
from twodof.flightlog.files import attachments, read_log
from twodof.gcs.drone import Drone


def test_a_recording_keeps_the_tuned_parameters_and_the_diagram_that_flew(tmp_path: Path) -> None:
    mine = to_json(starter("pid-attitude")).encode()
    with (
        on_board(lockstep=True, controllers=["pid-attitude"], trusted=True) as there,
        Drone.connect(there.url) as drone,
    ):
        before = drone.active_controller()
        drone.parameters.update({"POS_KP": 0.7, "SDLOG_MODE": -1})
        flies = drone.active_controller()
        assert dict(flies.parameters) == {**before.parameters, "POS_KP": 0.7, "SDLOG_MODE": -1}
        assert list(flies.diagrams) == ["attitude_control"]
        with drone.record(tmp_path / "flight.mcap"):
            drone.run(0.1)
    (kept,) = attachments(tmp_path / "flight.mcap")
    assert kept.name == "attitude_control.json"
    assert kept.data == flies.diagrams["attitude_control"] == mine
    drone_said = read_log(tmp_path / "flight.mcap").provenance["drone"]
    assert drone_said["parameters"] == dict(flies.parameters)
    (controller,) = drone_said["controllers"].values()
    assert controller["name"] == "pid_attitude"
    assert controller["sha256"] == hashlib.sha256(mine).hexdigest()
    assert controller["diagram"] == json.loads(mine)
    assert controller["parameters"]["M_low"] == -1.0


def test_of_stock_controllers_at_their_defaults_there_is_nothing_to_keep(tmp_path: Path) -> None:
    with on_board(lockstep=True) as there, Drone.connect(there.url) as drone:
        flies = drone.active_controller()
        assert (dict(flies.parameters), dict(flies.diagrams), flies.known) == ({}, {}, True)
        with drone.record(tmp_path / "flight.mcap"):
            drone.run(0.1)
    assert attachments(tmp_path / "flight.mcap") == []
    assert read_log(tmp_path / "flight.mcap").provenance["drone"]["parameters"] == {}
