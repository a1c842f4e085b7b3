"""Cutting an experiment out of a log: the right stretch, or a word about what is there instead."""

from pathlib import Path

import numpy as np
import pytest

from twodof.errors import IdentificationError, LogError
from twodof.excitation import Prbs
from twodof.experiment.experiments import Experiment, script
from twodof.experiment.flight import Laboratory
from twodof.flightlog.files import read_log
from twodof.identify.experiments import KINDS, around, cut, kind_of


def test_the_impulse_ends_at_rest(flight_data: Path) -> None:
    """flight-data's table: pulse at 188.456, free until about 197; later somebody touches the drone."""
    record = cut(read_log(flight_data / "free-response-impulse.mat"), KINDS["impulse"])
    assert 188.0 < record.start < 188.456
    assert 197.0 < record.time[-1] < 200.0


def test_the_doublet_lies_between_start_and_end_stop(flight_data: Path) -> None:
    """flight-data's table: rotors on at 244.67, first edge at 244.808, the stop is hit after 245.8 s."""
    log = read_log(flight_data / "doublet-0.03.mat")
    record = cut(log, KINDS["doublet"])
    assert 244.67 < record.start < 244.75
    assert 245.7 < record.time[-1] < 245.8
    theta = log["theta"].slice(record.start, record.time[-1]).value
    assert np.abs(theta).max() <= 0.84


def test_a_missing_excitation_is_named(flight_data: Path) -> None:
    log = read_log(flight_data / "doublet-0.03.mat")
    with pytest.raises(LogError, match="open-loop-doublet"):
        cut(log, KINDS["impulse"])


def test_a_kind_is_named() -> None:
    log = Laboratory("paper").fly("doublet").log
    named, own = cut(log, "doublet"), cut(log, KINDS["doublet"])
    assert (named.start, named.steps) == (own.start, own.steps)
    with pytest.raises(IdentificationError, match=r"called 'dublet'.*there are: impulse, doublet, velocity"):
        cut(log, "dublet")


def test_a_picture_shows_what_came_before_and_after() -> None:
    log = Laboratory("paper").fly("doublet").log
    record = cut(log, "doublet")
    shown = around(log, record, before=0.5, after=1.0)
    end = min(float(record.time[-1]) + 1.0, float(log["M"].time[-1]))
    assert (shown.start, shown.time[-1]) == pytest.approx((record.start - 0.5, end), abs=0.005)  # of a period of 4 ms


@pytest.mark.parametrize(
    ("log", "kind"),
    [
        ("free-response-impulse", "impulse"),
        ("doublet-0.03", "doublet"),
        ("velocity-doublets-0.25", "velocity"),
        ("position-sweep-default", "velocity"),
        ("attitude-steps-10deg-default", "attitude"),
        ("rate-doublets-30dps-student", "attitude"),
    ],
)
def test_the_experiment_of_a_log_is_found(flight_data: Path, log: str, kind: str) -> None:
    assert kind_of(read_log(flight_data / f"{log}.mat")) is KINDS[kind]


@pytest.mark.parametrize(
    ("mode", "unit", "size", "clock"), [("rate", "rad/s", 0.5, 0.1), ("attitude", "rad", 0.07, 0.03)]
)
def test_the_default_window_holds_a_random_signal(mode: str, unit: str, size: float, clock: float) -> None:
    flown = Experiment("own", mode, Prbs(size, clock, 6, unit=unit, lead=0.5), rings=True)
    flight = Laboratory("lab").fly(flown, 1)
    plan, stamps = script(flown, flight.x_start), flight.log["M"].time
    record = cut(flight.log, kind_of(flight.log))
    # The first half second of the plan is its lead.
    assert stamps[plan.begin] <= record.start < stamps[plan.begin] + 0.5
    assert record.time[-1] > stamps[min(plan.end, stamps.size - 1)] - 0.5
