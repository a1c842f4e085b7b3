"""A plot of a flight: what it shows of a log, and that it is drawn into each kind of file."""

import re
from pathlib import Path

import numpy as np
import pytest

from twodof.errors import LogError
from twodof.experiment.flight import Laboratory
from twodof.flight.failsafe.causes_and_actions import ACTIONS, BIT, CAUSES
from twodof.flightlog.log import Channel, FlightLog
from twodof.report.plots.flight_plot import to_html, write_plot
from twodof.report.plots.flight_view import MOST_POINTS, SUFFIXES, Curve, FlightView, flight_view

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def log() -> FlightLog:
    return Laboratory("lab").fly("velocity-doublets").log


def curves(view: FlightView) -> dict[str, Curve]:
    return {curve.channel: curve for one in view.views for curve in one.curves}


def test_set_point_is_drawn_while_its_loop_is_closed(log: FlightLog) -> None:
    view = flight_view(log)
    assert [band.label for band in view.modes] == ["off", "position", "velocity", "off"]
    position, velocity = view.modes[1:3]
    drawn = curves(view)
    for channel, start, stop in (
        ("x0", position.start, position.stop),
        ("v0", position.start, velocity.stop),
        ("theta0", position.start, velocity.stop),
    ):
        known = drawn[channel].time[np.isfinite(drawn[channel].value)]
        # The mode is stamped up to 15 us after the set-points of its step, so that those of its first step are before.
        assert start <= known[0] < start + 0.004
        assert stop - 0.0041 < known[-1] < stop
    assert {"theta_true", "q_true", "x_true", "v_true", "M", "T"} <= drawn.keys()
    np.testing.assert_array_equal(drawn["theta"].value, np.degrees(log["theta"].value))
    assert [(band.label, band.start > velocity.start) for band in view.excitations] == [("doublet", True)]


def test_still_cart_is_left_out_with_a_note() -> None:
    view = flight_view(Laboratory("lab").fly("attitude-steps").log)
    assert [one.label.split()[0] for one in view.views] == ["pitch", "pitch", "motors"]
    assert view.notes == ("the cart stands still: position and velocity are left out",)


def test_topics_and_a_window_are_what_is_drawn(log: FlightLog) -> None:
    view = flight_view(log, ["theta", "setpoint.theta", "imu.gyro", "dist"], (19.0, 20.0))
    assert [one.label for one in view.views] == ["pitch θ [deg]", "imu.gyro [rad/s]", "tof.distance [m]"]
    assert [curve.label for curve in view.views[1].curves] == ["x", "y", "z"]
    assert view.span == (19.0, 20.0)
    # One sample beyond each end, so that a line reaches the edge.
    time = view.views[0].curves[0].time
    assert time[0] < 19.0 <= time[1]
    assert time[-2] <= 20.0 < time[-1]


def test_missing_signal_is_refused(log: FlightLog) -> None:
    with pytest.raises(LogError, match="does not have this signal") as refused:
        flight_view(log, ["gyro"])
    assert "gyr, theta" in refused.value.remedy
    with pytest.raises(LogError, match="nothing was logged from 100 to 101 s"):
        flight_view(log, (), (100.0, 101.0))


def test_a_line_is_interrupted_where_samples_were_lost() -> None:
    time = np.delete(np.arange(0.0, 4.0, 0.004), slice(300, 340))
    view = flight_view(FlightLog({"theta": Channel(time, np.ones_like(time), "rad")}))
    curve = curves(view)["theta"]
    (hole,) = np.flatnonzero(np.isnan(curve.value))
    assert curve.time[hole - 1] < curve.time[hole] < curve.time[hole + 1]
    assert curve.time[hole + 1] - curve.time[hole - 1] == pytest.approx(41 * 0.004)
    assert view.modes == ()
    assert "which mode flew is not known" in view.notes[0]


def test_decimated_line_keeps_its_extremes() -> None:
    time = np.arange(400_000) * 0.004
    value = np.sin(time / 100.0)
    value[123_456], value[301_000] = 9.0, -7.0
    drawn = curves(flight_view(FlightLog({"q": Channel(time, value, "rad/s")})))["q"]
    assert len(drawn.time) <= MOST_POINTS + 2
    assert np.degrees([9.0, -7.0]).tolist() == [drawn.value.max(), drawn.value.min()]
    assert (drawn.time[0], drawn.time[-1]) == (time[0], time[-1])


@pytest.mark.parametrize("by", ["place", "mask"])
def test_what_the_failsafe_did_is_named_with_its_cause(log: FlightLog, by: str) -> None:
    """As a recording has it (the place of the deciding cause) and as the log on board (a mask). Disarmed is none."""
    level, off = ACTIONS.index("level"), ACTIONS.index("off")
    lost = [cause.name for cause in CAUSES].index("setpoint_lost") if by == "place" else BIT["setpoint_lost"]
    none = -1 if by == "place" else 0
    rows = [(off, none, 0), (0, none, 0), (level, lost, 1), (level, lost, 3), (0, none, 0), (off, none, 0)]
    fields = ("action", "reason" if by == "place" else "reasons", "causes")
    told = Channel([10.0, 11.0, 20.0, 20.5, 21.0, 24.0], np.array(rows, dtype=np.float64), "", fields)
    (band,) = flight_view(FlightLog({**log.channels, "safety": told})).failsafe
    assert (band.start, band.stop, band.label) == (20.0, 21.0, "level: setpoint lost")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_it_is_drawn_into_each_kind_of_file(log: FlightLog, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"flight{suffix}"
    write_plot(flight_view(log, ["theta"], (19.0, 20.0), "<a> & b"), path)
    begun = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF", ".html": b"<!doctype html>"}[suffix]
    assert path.read_bytes().startswith(begun)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.long
def test_page_names_quantities_and_is_inert(log: FlightLog) -> None:
    page = to_html(flight_view(log, title="<script>alert(1)</script>"))
    for text in (
        "pitch θ [deg]",
        "velocity v [m/s]",
        "position",
        "velocity",
        "doublet",
        "estimated",
        "true",
        "set-point",
    ):
        assert f">{text}<" in page
    assert "<script" not in page
    assert not re.search(r"#0a0b0", page)  # each stand-in has become the page's colour
    short = flight_view(log, ["theta"], (19.0, 20.0))
    assert to_html(short) == to_html(short)


def test_impossible_place_is_refused_before_drawing(log: FlightLog, tmp_path: Path) -> None:
    view = flight_view(log)
    for path, what in ((tmp_path / "a.txt", "no picture has"), (tmp_path / "no" / "a.png", "not there")):
        with pytest.raises(LogError, match=what):
            write_plot(view, path)
