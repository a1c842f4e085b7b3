"""MAVSDK, which knows nothing of us, goes through a flight from discovery to the log.

Before it the script for pymavlink on the page about clients flies the same drone behind its companion.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyulog import ULog

from bench.stack.programs import port
from tests.patience import PATIENCE_S
from twodof.fcu.parameters.parameter_store import ParameterStore
from twodof.rig.parameters import lab
from twodof.sim.closed_loop import mounting

pytestmark = pytest.mark.slow

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "connect-clients.md"
CLIENT = Path(__file__).with_name("mavsdk_client.py")
SET_TO = 0.09
STILL = 0.02  # rad, m; the estimator's noise at rest is far below
REACHED = 0.03  # rad; the set-point is 0.1


def flight(url: str, log: Path, first: str) -> dict[str, list[dict[str, Any]]]:
    """Return the client's output by step; fail with all of it if the client does not end."""
    command = [sys.executable, "-W", "error", str(CLIENT), url, "RATE_KP", str(SET_TO), str(log), first]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    except subprocess.TimeoutExpired as error:
        pytest.fail(f"no end after {PATIENCE_S} s: {error.stdout!r} {error.stderr!r}")
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    saw: dict[str, list[dict[str, Any]]] = {}
    for line in done.stdout.splitlines():
        if line.startswith("{"):
            step = json.loads(line)
            saw.setdefault(step.pop("step"), []).append(step)
    return saw


@pytest.mark.long
def test_the_script_for_pymavlink_on_the_page_flies(companion_port: int, tmp_path: Path) -> None:
    """It arms, follows a pitch of .1 rad within .02 for a second, disarms; mavutil gives itself the component 0."""
    text = PAGE.read_text(encoding="utf-8").split("## pymavlink")[1].split("## node-mavlink")[0]
    (block,) = re.findall(r"```py\n(.*?)```", text, flags=re.DOTALL)
    script = tmp_path / "fly.py"
    script.write_text(block.replace(":14540", f":{companion_port}"))
    command = [sys.executable, str(script)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    pitch = re.search(r"pitch ([+-][\d.]+) rad", done.stdout)
    assert pitch is not None
    assert abs(float(pitch[1]) - 0.1) < 0.02
    assert "disarmed True" in done.stdout


@pytest.mark.soak
def test_mavsdk_flies_by_tcp_in_the_order_of_its_own_examples(fcu_url: str, tmp_path: Path) -> None:
    log = tmp_path / "fetched.ulg"
    check(flight(f"tcpout://127.0.0.1:{port(fcu_url)}", log, "arm"), log)


@pytest.mark.long
def test_mavsdk_flies_by_udp_through_the_companion_and_arms_in_offboard(companion_port: int, tmp_path: Path) -> None:
    log = tmp_path / "fetched.ulg"
    check(flight(f"udpin://127.0.0.1:{companion_port}", log, "offboard"), log)


def check(saw: dict[str, list[dict[str, Any]]], log: Path) -> None:
    """Check the client's output against this drone."""
    assert saw["discovered"] == [{"system": 1, "autopilot": "PX4"}]
    (version,) = saw["version"]
    assert version["software"] >= [1, 16, 0]  # what clients take as PX4's

    ours = {row.name: row for row in ParameterStore(defaults=mounting(lab().snapshot())).rows}
    (parameters,) = saw["parameters"]
    assert set(parameters["values"]) == set(ours)  # nothing missing, nothing else
    assert parameters["integers"] == sum(row.kind == "int32" for row in ours.values())
    for name, value in parameters["values"].items():
        if "RATE_KP" not in (name, ours[name].of):  # what is set below, under both its names
            assert value == pytest.approx(np.float32(ours[name].default), rel=1e-6), name  # seven digits of a float32
    assert saw["set"] == [{"name": "RATE_KP", "value": pytest.approx(SET_TO, rel=1e-6)}]

    (telemetry,) = saw["telemetry"]
    assert np.ptp(telemetry["pitch"]) < STILL  # at rest, at whatever angle friction has held it
    assert np.all(np.diff(telemetry["stamps"]) > 0)
    assert np.abs(telemetry["x"]).max() < STILL
    assert 9.0 < telemetry["voltage"] < 12.7  # three cells
    assert not telemetry["armed"]

    assert saw["offboard"] == [{"active": True, "mode": "OFFBOARD"}]
    # Of each the client says that it was reached, and stayed for ten messages.
    assert [np.sign(reached["wanted"]) for reached in saw["attitude"]] == [1.0, -1.0]
    for reached in saw["attitude"]:
        assert np.mean(reached["pitch"]) == pytest.approx(reached["wanted"], abs=REACHED)
    assert saw["armed"] == saw["disarmed"] == [{}]

    (downloaded,) = saw["downloaded"]
    assert downloaded["size"] == saw["logs"][0]["sizes"][-1]
    read = ULog(str(log))
    assert read.data_list
