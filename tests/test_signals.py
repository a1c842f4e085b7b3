"""TOPICS: unambiguous, and the drone's own channels with the units that its logs have."""

import re
from pathlib import Path

import numpy as np
import pytest

from twodof.errors import LogError
from twodof.flightlog.files import read_log
from twodof.signals import BY_MAT, BY_NAME, MODES, TOPICS, topic, unit_of


def test_every_name_means_one_signal() -> None:
    assert len(BY_NAME) == len(BY_MAT) == len(TOPICS)
    columns = [column for row in TOPICS for column in row.columns]
    assert len(set(columns)) == len(columns)
    assert set(BY_NAME).isdisjoint(BY_MAT)


def test_names_fit_where_they_go() -> None:
    for row in TOPICS:
        assert re.fullmatch(r"[A-Za-z]\w{0,62}", row.mat), "a MATLAB variable"
        assert re.fullmatch(r"(/[a-z]\w*)+", row.ros), "a ROS 2 name"
        assert re.fullmatch(r"[A-Z][A-Z0-9_]*", row.mavlink), "a MAVLink message"
        assert row.unit
        assert row.rate_hz >= 0.0


def test_gyro_column_and_lookup() -> None:
    assert topic("gyr") is topic("imu.gyro")
    assert topic("gyr").columns == ("imu.gyro_x", "imu.gyro_y", "imu.gyro_z")
    assert (topic("q").columns, topic("q").width, topic("lmnf").width) == (("estimate.q",), 1, 5)
    assert (unit_of("theta"), unit_of("unheard")) == ("rad", "")
    with pytest.raises(LogError, match=r"no such signal .use one of imu.acc"):
        topic("unheard")


def test_nothing_on_board_sees_the_truth() -> None:
    assert {row.name for row in TOPICS if not row.onboard} == {
        row.name for row in TOPICS if row.name.startswith("truth.")
    }
    assert MODES[0] == "off"


def test_real_logs_have_these_channels_at_these_rates(flight_data: Path) -> None:
    log = read_log(flight_data / "velocity-doublets-0.25.mat")
    assert set(log) <= set(BY_MAT)
    for name in log:
        row = BY_MAT[name]
        assert log[name].value.shape[1:] == ((row.width,) if row.width > 1 else ())
        if row.rate_hz:
            # In the seven logs 249.70 to 249.90 Hz, and 18.29 to 18.35 Hz by the TOF sensor's own clock.
            assert 1.0 / log[name].period() == pytest.approx(row.rate_hz, rel=4e-3), name
    # dist is x + 0.50, up to the estimator's filter: 5 cm while the cart moves at .25 m/s.
    x = log.resample("x", log["dist"].time[5:])
    assert np.abs(log["dist"].value[5:] - 0.5 - x).max() < 0.05
