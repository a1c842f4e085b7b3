"""pymavlink's own mavutil, with its own dialect, sees and tunes a controller that a user flies."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.experiment.drones import drone_thread
from tests.patience import PATIENCE_S
from twodof.fcu.parameters.parameter_store import ParameterStore
from twodof.fcu.parameters.table import user_parameters
from twodof.flight.starters import starter
from twodof.sim.virtual_drone import VirtualDrone

pytestmark = pytest.mark.slow

CLIENT = Path(__file__).with_name("mavutil_parameters_client.py")
OWN, NAME, PATH = "lqr-attitude", "TLA_K_Q", "attitude_control.k_q"


def test_a_controllers_gain_is_listed_and_set() -> None:
    drones: list[VirtualDrone] = []
    with drone_thread(drones.append, controllers=[OWN], lockstep=False, conditions={"rings": True}) as url:
        command = [sys.executable, str(CLIENT), url.replace("tcp://", "tcp:"), NAME, "0.2"]
        environment = {**os.environ, "MAVLINK20": "1", "MAVLINK_DIALECT": "common"}
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False, env=environment)
        assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
        saw = json.loads(done.stdout)
        flying = drones[0].controller.code.parameter(PATH)
    store = ParameterStore()
    store.carry(user_parameters([starter(OWN)]))
    assert saw["names"] == [row.name for row in store.rows]
    assert saw["before"] == pytest.approx(starter(OWN).params["k_q"].value, rel=1e-7)
    assert saw["told"] == saw["read"] == np.float32(0.2)
    assert flying == 0.2
