"""MAVSDK fetches what the vehicle keeps: files, descriptions, and a log while it is written."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.stack.programs import port
from tests.patience import PATIENCE_S
from twodof.fcu.mavlink.file_tree import metadata_files
from twodof.fcu.onboard_log.log_topics import STEP_TOPIC
from twodof.fcu.parameters.parameter_store import ParameterStore
from twodof.flightlog.ulog_file import scan_ulog
from twodof.rig.parameters import lab
from twodof.sim.closed_loop import mounting

pytestmark = pytest.mark.slow

CLIENT = Path(__file__).with_name("mavsdk_files_client.py")
ROWS = ParameterStore(defaults=mounting(lab().snapshot())).rows
"""The parameters of the virtual drone, whose defaults say where its IMU is."""


@pytest.fixture(scope="module")
def saw(fcu_url: str, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Any]]:
    """Return the client's output by step, and the folder of the files that it fetched."""
    folder = tmp_path_factory.mktemp("mavsdk")
    command = [sys.executable, "-W", "error", str(CLIENT), f"tcpout://127.0.0.1:{port(fcu_url)}", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    found: dict[str, list[Any]] = {"folder": [folder]}
    for line in done.stdout.splitlines():
        if line.startswith("{"):
            step = json.loads(line)
            found.setdefault(step.pop("step"), []).append(step)
    return found


def test_it_lists_the_tree(saw: dict[str, list[Any]]) -> None:
    files = metadata_files(ROWS)
    root, extras = saw["list"]
    assert root["entries"] == [["DIRECTORY", name, 0] for name in ("controllers", "etc")]
    assert extras["entries"] == [["FILE", name, len(content)] for name, content in sorted(files.items())]


def test_it_fetches_in_bursts_and_without_and_finds_the_same_checksum(saw: dict[str, list[Any]]) -> None:
    text = metadata_files(ROWS)["parameters.json"].decode()
    assert saw["fetched"] == [{"burst": burst, "text": text} for burst in (False, True)]
    assert saw["identical"] == [{"same": True}]


def test_it_sends_a_diagram_and_removes_it(saw: dict[str, list[Any]]) -> None:
    assert saw["sent"] == [{"entries": [["attitude_control.json", 5000]]}]
    assert ["FILE_DOES_NOT_EXIST" in one["why"] for one in saw["refused"]] == [True, True]


@pytest.mark.long
def test_it_finds_the_descriptions_by_component_metadata(saw: dict[str, list[Any]]) -> None:
    found = {update["type"]: update["text"].encode() for update in saw["metadata"]}
    files = metadata_files(ROWS)
    assert found == {"PARAMETER": files["parameters.json"]}


@pytest.mark.long
def test_it_is_told_why_arming_is_refused(saw: dict[str, list[Any]]) -> None:
    # MAVSDK hands texts over on several threads, in any order.
    killed, denied = sorted(saw["text"], key=lambda one: one["text"])
    assert killed == {"text": "killed by system 245, component 190", "level": "CRITICAL"}
    assert denied["text"].startswith("not armed: killed by system 245")
    assert denied["level"] == "CRITICAL"
    assert len(saw["not armed"]) == 1


@pytest.mark.long
def test_the_log_that_is_streamed_to_it_is_a_log(saw: dict[str, list[Any]]) -> None:
    data = (saw["folder"][0] / "streamed.ulg").read_bytes()
    # MAVSDK hands on what came, in order; on loopback nothing is lost.
    steps = scan_ulog(data, "streamed", salvage=True).topic(STEP_TOPIC)
    assert steps is not None
    assert len(steps["tick"]) > 0
    assert set(np.diff(steps["tick"].astype(np.int64)).tolist()) <= {1}
