"""Rows that a page sends become the log that they are, or are refused."""

import numpy as np
import pytest

from twodof.errors import LogError
from twodof.flightlog.log import log_of_rows


def test_each_column_is_the_channel_of_its_mat_name_without_its_gaps() -> None:
    time = np.arange(4) * 0.004
    theta, x = np.array([1, 2, 3, 4], "<f4"), np.array([np.nan, 5, np.nan, 6], "<f4")
    data = time.astype("<f8").tobytes() + theta.tobytes() + x.tobytes()
    log = log_of_rows(data, ["estimate.theta", "estimate.x"], {"seed": 1})
    assert log["theta"].value.tolist() == [1, 2, 3, 4]
    assert log["theta"].unit == "rad"
    assert log["x"].time.tolist() == [0.004, 0.012]
    assert log["x"].value.tolist() == [5, 6]


@pytest.mark.parametrize(
    ("data", "columns", "what"),
    [
        (b"", ["estimate.theta"], "whole rows"),
        (b"\0" * 13, ["estimate.theta"], "whole rows"),
        (b"\0" * 12, [], "give one"),
        (b"\0" * 16, ["estimate.theta", "estimate.theta"], "each once"),
        (b"\0" * 12, ["estimate.thrust"], "no column"),
        (b"\0" * 12, ["imu.gyro_y"], "no column"),
        (b"\0" * 24, ["estimate.theta"], "does not rise"),
        (b"\xff" * 12, ["estimate.theta"], "not finite"),
    ],
)
def test_what_is_not_a_log_is_refused(data: bytes, columns: list[str], what: str) -> None:
    with pytest.raises(LogError, match=what):
        log_of_rows(data, columns, {})
