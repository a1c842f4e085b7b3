"""Rows of telemetry for programs without a web socket: a request takes the samples of the next moment."""

import json
import urllib.error
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.lab.served import served_lab
from tests.web.lab_server import LabServer, served
from twodof.signals import TICK_S

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabServer]:
    with served(tmp_path_factory.mktemp("data")) as found:
        yield found


def rows(server: LabServer, asked: str) -> dict[str, list[float | None]]:
    found: dict[str, list[float | None]] = server.call("GET", f"drones/{server.drone}/telemetry?{asked}")
    return found


@pytest.mark.long
def test_rows_are_those_of_the_time_asked_for(server: LabServer) -> None:
    told = rows(server, "column=estimate.theta&column=imu.gyro_y&seconds=1")
    assert set(told) == {"time", "estimate.theta", "imu.gyro_y"}
    assert len(told["time"]) == len(told["estimate.theta"]) == len(told["imu.gyro_y"]) >= 10
    steps = np.diff(np.array(told["time"], float)) / TICK_S
    assert np.allclose(steps, np.round(steps))
    assert np.median(steps) == pytest.approx(1.0)
    again = rows(server, "column=estimate.theta&seconds=0.5")["time"]
    assert again[0] > told["time"][-1]  # type: ignore[operator]


@pytest.mark.long
@pytest.mark.parametrize(
    ("asked", "where"), [("column=estimate.thata", "TWODOF_BATCH"), ("column=estimate.q&seconds=9", "seconds")]
)
def test_what_could_never_come_is_refused(server: LabServer, asked: str, where: str) -> None:
    with pytest.raises(urllib.error.HTTPError) as refused:
        rows(server, asked)
    assert refused.value.code == 422
    assert where in json.loads(refused.value.read())["where"]


def test_a_drone_in_lockstep_is_refused(tmp_path: Path) -> None:
    with served_lab(tmp_path) as lab:
        status, told = lab.call("GET", "drones/1/telemetry?column=estimate.q")
    assert (status, told["what"]) == (409, "its time passes in lockstep")
