"""Parameters of a work item that flies: changed between two steps, in batches, within their bounds."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.compile.differential import same
from tests.compile.px4.build import Bench
from tests.compile.px4.flown import (
    REFUSED,
    SQRT2,
    fly,
    mode,
    replayed,
)
from tests.compile.px4.modules import PITCH_LOG, pitch
from twodof.compile import build
from twodof.compile.px4.controller import DT


def test_parameters_change_between_two_steps(bench: Bench) -> None:
    mode(bench)
    fly(bench, 10)
    bench.parameter("TPI_DAMP_GAINS_0", 1.5)
    bench.parameter("TPI_DAMPER_SHARE", 2)
    bench.parameter("TPI_DAMPE_INTEGR", 0)
    bench.publish("parameter_update")
    fly(bench, 10)
    rows = bench.run().topic("twodof_pitch")
    assert list(rows["parameter_revision"]) == [1] * 10 + [2] * 10
    machine = build(pitch(), DT, "float32", PITCH_LOG).machine()
    columns = {n: np.ascontiguousarray(rows[f"in_{n.lower()}"]) for n in pitch().inputs}
    first = machine.run(10, {n: c[:10] for n, c in columns.items()})
    machine.set_many({"damper.gains": [1.5, 0.08], "damper.share": 2, "damper.integrating": False})
    second = machine.run(10, {n: c[10:] for n, c in columns.items()})
    assert np.all(same(rows["out_m"], np.concatenate([first["M"], second["M"]])))


def test_one_value_out_of_bounds_refuses_the_whole_batch_and_is_said_once(bench: Bench) -> None:
    mode(bench)
    fly(bench, 5)
    bench.parameter("TPI_DAMP_GAINS_0", 1.5)
    bench.parameter("TPI_DAMPER_KI", 5.1)
    for _ in range(3):
        bench.publish("parameter_update")
        fly(bench, 5)
    bench.parameter("TPI_DAMPER_KI", 5.0)
    bench.publish("parameter_update")
    fly(bench, 5)
    events = bench.run()
    rows = events.topic("twodof_pitch")
    place = [row.name for row in bench.module.parameters].index("TPI_DAMPER_KI")
    assert list(rows["refused_parameter"]) == [-1] * 5 + [place] * 15 + [-1] * 5
    assert list(rows["faults"]) == [0] * 5 + [REFUSED] * 15 + [0] * 5
    assert rows["active"].all()
    assert list(rows["parameter_revision"]) == [1] * 20 + [2] * 5
    warnings = [text for text in events.said() if "TPI_DAMPER_KI" in text]
    assert len(warnings) == 1
    machine = build(pitch(), DT, "float32", PITCH_LOG).machine()
    expected = machine.run(20, {n: np.ascontiguousarray(rows[f"in_{n.lower()}"][:20]) for n in pitch().inputs})
    assert np.all(same(rows["out_m"][:20], expected["M"]))  # the good change beside it was not taken either


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 4.000001, -1e-9])
def test_no_value_outside_its_bounds_is_ever_taken(bench: Bench, value: float) -> None:
    mode(bench)
    bench.parameter("TPI_DAMP_GAINS_0", value)
    bench.publish("parameter_update")
    fly(bench, 2)
    assert list(bench.run().topic("twodof_pitch")["faults"]) == [REFUSED] * 2


def test_changes_wait_while_live_is_0_and_act_together(bench: Bench) -> None:
    mode(bench)
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
    machine = build(pitch(), DT, "float32", PITCH_LOG).machine()
    columns = {n: np.ascontiguousarray(rows[f"in_{n.lower()}"]) for n in pitch().inputs}
    machine.run(20, {n: c[:20] for n, c in columns.items()})
    machine.set("damper.gains", [1.5, 0.2])
    assert np.all(same(rows["out_m"][20:], machine.run(5, {n: c[20:] for n, c in columns.items()})["M"]))


def test_a_fixed_parameter_is_read_at_the_start_only(built: Bench) -> None:
    built.fresh()
    built.parameter("TPI_DAMPER_SUM_0", 0.5)
    built.command("start")
    mode(built)
    fly(built, 5)
    built.parameter("TPI_DAMPER_SUM_0", 7.0)  # out of bounds, but not asked for any more
    built.publish("parameter_update")
    fly(built, 5)
    rows = built.run().topic("twodof_pitch")
    assert set(rows["faults"]) == {0}
    machine = build(pitch(), DT, "float32", PITCH_LOG).machine()
    machine.set("damper.sum_0", 0.5)
    machine.reset()
    expected = machine.run(10, {n: np.ascontiguousarray(rows[f"in_{n.lower()}"]) for n in pitch().inputs})
    assert np.all(same(rows["out_m"], expected["M"]))


def test_a_start_with_a_value_out_of_bounds_flies_the_defaults(built: Bench) -> None:
    built.fresh()
    built.parameter("TPI_DAMPER_KI", -1.0)
    built.command("start")
    mode(built)
    fly(built, 5)
    events = built.run()
    rows = events.topic("twodof_pitch")
    assert set(rows["faults"]) == {REFUSED}
    assert np.all(same(rows["out_m"], replayed(pitch(), PITCH_LOG, rows)["M"]))
    torque = events.topic("vehicle_torque_setpoint")["xyz"][:, 1]
    assert np.array_equal(torque, SQRT2 * rows["out_m"])


def test_all_parameters_show_up_once_it_has_started(bench: Bench) -> None:
    assert bench.run().used() == {row.name for row in bench.module.parameters}
