"""The work item, built with PX4's warning flags against stand-ins for its headers, flown step by step."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.compile.differential import same
from tests.compile.px4.build import Bench
from tests.compile.px4.flown import NO_SETPOINT, PERIOD, SQRT2, STALE, fly, mode, quaternion, replayed
from tests.compile.px4.host import from_words, to_words
from tests.compile.px4.modules import PITCH_LOG, pitch
from twodof.compile import build
from twodof.compile.px4.controller import DT

pytestmark = pytest.mark.slow


@pytest.mark.long
def test_a_flight_gives_the_hosts_outputs_bit_for_bit(bench: Bench) -> None:
    fly(bench, 500)
    rows = bench.run().topic("twodof_pitch")
    assert len(rows) == 500
    assert list(rows["tick"]) == list(range(500))
    assert set(rows["faults"]) == {0}
    assert rows["active"].all()
    expected = replayed(pitch(), PITCH_LOG, rows)
    for path, field in (("M", "out_m"), ("damper.error", "log_damper_error"), ("damper.count", "log_damper_count")):
        assert np.all(same(rows[field], expected[path])), path
    assert np.ptp(rows["out_m"]) > 0.05


def test_thrust_is_published_before_the_torque_which_is_scaled_for_the_allocator(bench: Bench) -> None:
    fly(bench, 3)
    events = bench.run()
    order = [what for what, _ in events.rows if what in ("vehicle_thrust_setpoint", "vehicle_torque_setpoint")]
    assert order == ["vehicle_thrust_setpoint", "vehicle_torque_setpoint"] * 3
    rows = events.topic("twodof_pitch")
    torque, thrust = events.topic("vehicle_torque_setpoint"), events.topic("vehicle_thrust_setpoint")
    assert np.array_equal(torque["xyz"][:, 1], SQRT2 * rows["out_m"])
    assert np.array_equal(torque["xyz"][:, [0, 2]], np.zeros((3, 2)))
    assert np.array_equal(thrust["xyz"], np.tile(np.float32([0.0, 0.0, -0.4]), (3, 1)))
    assert np.array_equal(torque["timestamp_sample"], rows["timestamp_sample"])


@pytest.mark.parametrize("every", [1000, 1250, 2500, 3003, 4001])
def test_a_gyro_of_any_rate_gives_250_steps_a_second(bench: Bench, every: int) -> None:
    fly(bench, 2_000_000 // every, every=every)
    rows = bench.run().topic("twodof_pitch")
    span = int(rows["timestamp_sample"][-1] - rows["timestamp_sample"][0])
    assert abs(len(rows) + rows["missed"][-1] - (1 + span / PERIOD)) <= 1
    assert rows["missed"][-1] <= (0 if every < PERIOD else 1)


def test_periods_without_a_sample_are_counted(bench: Bench) -> None:
    fly(bench, 10)
    bench.at(bench.now + 2 * PERIOD)  # two samples are lost
    fly(bench, 10)
    rows = bench.run().topic("twodof_pitch")
    assert list(rows["missed"]) == [0] * 10 + [2] * 10
    assert list(rows["tick"]) == list(range(20))


def test_disarmed_or_without_rate_control_it_commands_nothing(started: Bench) -> None:
    mode(started, armed=False)
    fly(started, 20)
    mode(started, armed=True)
    fly(started, 20)
    mode(started, rates=False)  # the field is another's
    fly(started, 5)
    events = started.run()
    rows, torque = events.topic("twodof_pitch"), events.topic("vehicle_torque_setpoint")
    assert not rows["active"][:20].any()
    assert rows["active"][20:40].all()
    assert not rows["active"][40:].any()
    assert len(torque) == len(events.topic("vehicle_thrust_setpoint")) == 40
    assert not torque["xyz"][:20].any()
    assert not events.topic("vehicle_thrust_setpoint")["xyz"][:20].any()
    assert torque["xyz"][20:, 1].all()
    assert rows["in_flag_reset_int"][:20].all()
    assert not rows["in_flag_reset_int"][20:40].any()


def test_a_stale_attitude_stops_the_motors_and_the_controller_starts_again(bench: Bench) -> None:
    fly(bench, 10)
    for _ in range(20):  # 80 ms without an attitude, of which 50 are forgiven
        bench.at(bench.now + PERIOD)
        bench.publish("vehicle_angular_velocity", xyz=[0.0, 0.1, 0.0])
    fly(bench, 10)
    events = bench.run()
    rows, torque = events.topic("twodof_pitch"), events.topic("vehicle_torque_setpoint")
    stale = (rows["faults"] & STALE) != 0
    assert list(np.flatnonzero(stale)) == list(range(22, 30))  # the last attitude came at step 9: 13 steps are 52 ms
    assert not torque["xyz"][stale].any()
    assert not events.topic("vehicle_thrust_setpoint")["xyz"][stale].any()
    assert list(rows["tick"][30:]) == list(range(10))
    expected = replayed(pitch(), PITCH_LOG, rows[30:])
    assert np.all(same(rows["out_m"][30:], expected["M"]))


@pytest.mark.parametrize("what", ["gyro", "attitude"])
def test_a_measurement_that_is_not_finite_stops_the_motors(bench: Bench, what: str) -> None:
    fly(bench, 5)
    bench.at(bench.now + PERIOD)
    bench.publish("vehicle_attitude", q=[math.nan] * 4 if what == "attitude" else quaternion(0.0))
    bench.publish("vehicle_angular_velocity", xyz=[0.0, math.inf if what == "gyro" else 0.0, 0.0])
    fly(bench, 5)
    events = bench.run()
    rows = events.topic("twodof_pitch")
    assert list(rows["faults"]) == [0] * 5 + [STALE] + [0] * 5
    assert list(rows["tick"][6:]) == list(range(5))
    assert not events.topic("vehicle_torque_setpoint")["xyz"][5].any()


def test_a_missing_set_point_is_replaced_and_said(bench: Bench) -> None:
    fly(bench, 5)
    fly(bench, 5, theta_0=math.nan)
    rows = bench.run().topic("twodof_pitch")
    assert list(rows["faults"]) == [0] * 5 + [NO_SETPOINT] * 5
    assert not rows["in_theta_0"][5:].any()
    assert rows["active"].all()


def test_one_that_has_no_loops_along_the_rail_misses_its_set_points_there_too(started: Bench) -> None:
    mode(started, rail=True)
    fly(started, 5)
    fly(started, 5, theta_0=math.nan)
    fly(started, 5, thrust=math.nan)
    mode(started, armed=False)
    fly(started, 5, theta_0=math.nan, thrust=math.nan)
    rows = started.run().topic("twodof_pitch")
    assert list(rows["faults"]) == [0] * 5 + [NO_SETPOINT] * 10 + [0] * 5


def test_in_rate_mode_the_rate_set_point_is_read(started: Bench) -> None:
    mode(started, attitude=False)
    started.publish("vehicle_rates_setpoint", pitch=0.7, thrust_body=[0.0, 0.0, -0.5])
    fly(started, 5)
    events = started.run()
    rows = events.topic("twodof_pitch")
    assert np.array_equal(rows["in_q_0"], np.full(5, np.float32(0.7)))
    assert not rows["in_flag_attitude_enabled"].any()
    assert np.array_equal(events.topic("vehicle_thrust_setpoint")["xyz"][:, 2], np.full(5, np.float32(-0.5)))


def test_the_command_starts_once_and_stops(built: Bench) -> None:
    built.fresh()
    for words in (["status"], ["start"], ["start"], ["status"], ["stop"], ["status"], ["stop"], ["dance"], []):
        built.command(*words)
    built.publish("vehicle_angular_velocity")
    events = built.run()
    assert events.returned() == [-1, 0, -1, 0, 0, -1, 0, -1, -1]
    assert len(events.topic("twodof_pitch")) == 0
    said = " ".join(events.said())
    assert "already running" in said
    assert "usage: twodof_pitch" in said


def test_it_does_not_start_without_a_gyro(built: Bench) -> None:
    built.fresh()
    built.script.append("deaf")
    built.command("start")
    built.command("status")
    events = built.run()
    assert events.returned() == [-1, -1]


def test_a_recorded_sequence_is_replayed_bit_for_bit(built: Bench, tmp_path: Path) -> None:
    random = np.random.default_rng(3)
    steps = 3000
    columns: dict[str, Any] = {}
    for field in built.module.fields.inputs:
        if field.kind == "bool":
            columns[field.path] = random.random(steps) < 0.3
        else:
            columns[field.path] = random.normal(0, 1, steps).astype(np.float32)
            for value in (math.nan, math.inf, -math.inf, -0.0, 1e-42):
                columns[field.path][random.integers(0, steps, 3)] = value
    words = np.column_stack([to_words(f, columns[f.path]) for f in built.module.fields.inputs])
    (tmp_path / "in").write_bytes(words.tobytes())
    built.fresh()
    built.parameter("TPI_DAMPER_KI", 0.7)
    built.command("replay", str(tmp_path / "in"), str(tmp_path / "out"))
    built.command("replay", str(tmp_path / "nothing"), str(tmp_path / "out2"))
    built.command("replay", str(tmp_path / "in"), str(tmp_path / "no" / "out"))
    events = built.run()
    assert events.returned() == [0, -1, -1]
    data = np.frombuffer((tmp_path / "out").read_bytes(), np.uint32).reshape(steps, -1)
    given = from_words(built.module.fields.outputs, data)
    machine = build(pitch(), DT, "float32", PITCH_LOG).machine()
    machine.set("damper.ki", 0.7)
    machine.reset()
    for path, expected in machine.run(steps, columns).items():
        assert np.all(same(given[path], expected)), path
