"""Parameters of a work item that flies: changed between two steps, in batches, within their bounds."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from tests.compile.differential import same
from tests.compile.px4.build import Bench
from tests.compile.px4.flown import REFUSED, SQRT2, fly, mode, replayed
from tests.compile.px4.modules import PITCH_LOG, pitch


def assert_flown(rows: Any, changes: Mapping[int, Mapping[str, Any]] | None = None) -> None:
    """Assert that the module commanded the host's moments, with parameters that change at some rows."""
    assert np.all(same(rows["out_m"], replayed(pitch(), PITCH_LOG, rows, changes)["M"]))


def test_parameters_change_between_two_steps(bench: Bench) -> None:
    fly(bench, 10)
    bench.parameter("TPI_DAMP_GAINS_0", 1.5)
    bench.parameter("TPI_DAMPER_SHARE", 2)
    bench.parameter("TPI_DAMPE_INTEGR", 0)
    bench.publish("parameter_update")
    fly(bench, 10)
    rows = bench.run().topic("twodof_pitch")
    assert list(rows["parameter_revision"]) == [1] * 10 + [2] * 10
    assert_flown(rows, {10: {"damper.gains": [1.5, 0.08], "damper.share": 2, "damper.integrating": False}})


def test_a_value_out_of_bounds_is_put_back_and_stands_in_nobodys_way(bench: Bench) -> None:
    fly(bench, 5)
    bench.parameter("TPI_DAMP_GAINS_0", 1.5)
    bench.parameter("TPI_DAMPER_KI", 5.1)
    bench.publish("parameter_update")
    fly(bench, 5)
    bench.read("TPI_DAMPER_KI")
    bench.parameter("TPI_DAMP_GAINS_1", 0.2)
    bench.publish("parameter_update")
    fly(bench, 5)
    bench.read("TPI_DAMP_GAINS_0")
    bench.read("TPI_DAMP_GAINS_1")
    events = bench.run()
    ki, first, second = (value for _, value in events.read())
    assert (ki, first, second) == pytest.approx((0.3, 1.5, 0.2), rel=1e-5)  # printed with 6 digits
    rows = events.topic("twodof_pitch")
    place = [row.name for row in bench.module.parameters].index("TPI_DAMPER_KI")
    assert list(rows["refused_parameter"]) == [-1] * 5 + [place] * 10
    assert list(rows["faults"]) == [0] * 5 + [REFUSED] + [0] * 9
    assert rows["active"].all()
    assert events.told() == ["TPI_DAMPER_KI was out of bounds and is put back"]
    assert_flown(rows, {5: {"damper.gains": [1.5, 0.08]}, 10: {"damper.gains": [1.5, 0.2]}})


def test_several_values_out_of_bounds_are_put_back_with_one_notification(bench: Bench) -> None:
    fly(bench, 5)
    for name, value in (("TPI_DAMPER_KI", -1.0), ("TPI_DAMPER_SHARE", 0), ("TPI_DAMPE_INTEGR", 7), ("TPI_LIVE", 2)):
        bench.parameter(name, value)
    bench.publish("parameter_update")
    fly(bench, 5)
    for name in ("TPI_DAMPER_KI", "TPI_DAMPER_SHARE", "TPI_DAMPE_INTEGR", "TPI_LIVE"):
        bench.read(name)
    events = bench.run()
    assert [value for _, value in events.read()] == pytest.approx([0.3, 4, 1, 1])
    assert len(events.told()) == 4
    assert len(events.topic("parameter_update")) == 2  # that of this test, and one in answer


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 4.000001, -1e-9])
def test_no_value_outside_its_bounds_is_ever_taken(bench: Bench, value: float) -> None:
    fly(bench, 1)
    bench.parameter("TPI_DAMP_GAINS_0", value)
    bench.publish("parameter_update")
    fly(bench, 2)
    bench.read("TPI_DAMP_GAINS_0")
    events = bench.run()
    assert events.read() == [("TPI_DAMP_GAINS_0", 0.5)]
    rows = events.topic("twodof_pitch")
    assert list(rows["faults"]) == [0, REFUSED, 0]
    assert_flown(rows)


def test_changes_wait_while_live_is_0_and_act_together(bench: Bench) -> None:
    fly(bench, 5)
    for name, value in (("TPI_LIVE", 0), ("TPI_DAMP_GAINS_0", 1.5), ("TPI_DAMP_GAINS_1", 0.2)):
        bench.parameter(name, value)
        bench.publish("parameter_update")
        fly(bench, 5)
    bench.parameter("TPI_LIVE", 1)
    bench.publish("parameter_update")
    fly(bench, 5)
    rows = bench.run().topic("twodof_pitch")
    assert list(rows["parameter_revision"]) == [1] * 20 + [2] * 5
    assert_flown(rows, {20: {"damper.gains": [1.5, 0.2]}})


def test_a_fixed_parameter_is_read_at_the_start_only(built: Bench) -> None:
    built.fresh()
    built.parameter("TPI_DAMPER_SUM_0", 0.5)
    built.command("start")
    mode(built)
    fly(built, 5)
    built.parameter("TPI_DAMPER_SUM_0", 0.25)  # for the next start
    built.publish("parameter_update")
    fly(built, 5)
    built.read("TPI_DAMPER_SUM_0")
    built.parameter("TPI_DAMPER_SUM_0", 7.0)  # for none
    built.publish("parameter_update")
    fly(built, 5)
    built.read("TPI_DAMPER_SUM_0")
    events = built.run()
    rows = events.topic("twodof_pitch")
    assert [value for _, value in events.read()] == [0.25, 0.5]
    assert list(rows["faults"]) == [0] * 10 + [REFUSED] + [0] * 4
    assert_flown(rows, {0: {"damper.sum_0": 0.5}})


def test_a_start_with_a_value_out_of_bounds_flies_its_default_and_the_other_values(built: Bench) -> None:
    built.fresh()
    built.parameter("TPI_DAMPER_KI", -1.0)
    built.parameter("TPI_DAMP_GAINS_0", 1.5)
    built.command("start")
    built.read("TPI_DAMPER_KI")
    mode(built)
    fly(built, 5)
    events = built.run()
    assert [value for _, value in events.read()] == pytest.approx([0.3])
    rows = events.topic("twodof_pitch")
    assert list(rows["faults"]) == [REFUSED] + [0] * 4
    assert_flown(rows, {0: {"damper.gains": [1.5, 0.08]}})
    torque = events.topic("vehicle_torque_setpoint")["xyz"][:, 1]
    assert np.array_equal(torque, SQRT2 * rows["out_m"])


def test_a_parameter_that_px4_does_not_know_keeps_its_default_and_is_said(started: Bench) -> None:
    started.script.insert(-1, "forget TPI_DAMPER_KI")
    mode(started)
    started.parameter("TPI_DAMP_GAINS_0", 1.5)
    started.publish("parameter_update")
    fly(started, 5)
    events = started.run()
    assert "TPI_DAMPER_KI is missing in PX4" in events.told()
    rows = events.topic("twodof_pitch")
    assert_flown(rows, {0: {"damper.gains": [1.5, 0.08]}})


def test_all_parameters_show_up_once_it_has_started(started: Bench) -> None:
    assert started.run().used() == {row.name for row in started.module.parameters}
