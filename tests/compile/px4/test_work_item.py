"""The work item, built with PX4's warning flags against stand-ins for its headers, flown step by step."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.compile.differential import same
from tests.compile.px4.build import Bench
from tests.compile.px4.host import from_words, to_words
from tests.compile.px4.modules import PITCH_LOG, pitch, rail
from twodof.blocks import Diagram
from twodof.blocks import library as lib
from twodof.compile import build
from twodof.compile.px4.controller import DT
from twodof.compile.px4.export import make_module
from twodof.flight.starters import starter

PERIOD = 4000
STALE, NOT_FINITE, REFUSED, NO_SETPOINT = 1, 2, 4, 8
SQRT2 = np.float32(math.sqrt(2.0))


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """The module of `pitch`."""
    return Bench(make_module(pitch(), PITCH_LOG), tmp_path_factory.mktemp("pitch"))


@pytest.fixture
def bench(built: Bench) -> Bench:
    """A fresh process, in which the module has been started."""
    built.fresh()
    built.command("start")
    return built


def quaternion(theta: float) -> list[float]:
    """Pitch alone."""
    return [math.cos(theta / 2), 0.0, math.sin(theta / 2), 0.0]


def mode(bench: Bench, armed: bool = True, rates: bool = True, attitude: bool = True, rail: bool = False) -> None:
    """What the commander says."""
    bench.publish("actuator_armed", armed=armed)
    bench.publish(
        "vehicle_control_mode",
        flag_control_rates_enabled=rates,
        flag_control_attitude_enabled=attitude,
        flag_control_velocity_enabled=rail,
        flag_control_position_enabled=rail,
    )


def measure(bench: Bench, theta: float, q: float, stamp: int | None = None) -> None:
    """Attitude and gyro, as the estimator and the sensors give them; the gyro makes the module run."""
    bench.publish("vehicle_attitude", q=quaternion(theta))
    bench.publish("vehicle_angular_velocity", xyz=[0.0, q, 0.0], timestamp_sample=stamp or bench.now)


def fly(bench: Bench, steps: int, theta_0: float = 0.1, thrust: float = 0.4, every: int = PERIOD) -> None:
    """Samples of a swinging drone under a held set-point."""
    for k in range(steps):
        bench.at(bench.now + every)
        bench.publish("vehicle_attitude_setpoint", q_d=quaternion(theta_0), thrust_body=[0.0, 0.0, -thrust])
        measure(bench, 0.05 * math.sin(0.3 * k), 0.2 * math.cos(0.3 * k))


def replayed(diagram: Diagram, log: tuple[str, ...], rows: Any) -> dict[str, Any]:
    """What the host computes of the inputs in the module's messages."""
    machine = build(diagram, DT, "float32", log).machine()
    inputs = {name: np.ascontiguousarray(rows[f"in_{name.lower()}"]) for name in diagram.inputs}
    return machine.run(len(rows), inputs)


def test_a_flight_gives_the_hosts_outputs_bit_for_bit(bench: Bench) -> None:
    mode(bench)
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
    mode(bench)
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


def test_pitch_is_read_from_the_quaternion(bench: Bench) -> None:
    mode(bench)
    fly(bench, 40, theta_0=0.3)
    rows = bench.run().topic("twodof_pitch")
    assert np.allclose(rows["in_theta_0"], 0.3, atol=1e-6)  # a few units in the last place of float32
    assert np.allclose(rows["in_theta"], [0.05 * math.sin(0.3 * k) for k in range(40)], atol=1e-6)
    assert np.allclose(rows["in_q"], [0.2 * math.cos(0.3 * k) for k in range(40)], atol=1e-6)


def test_a_faster_gyro_still_gives_a_step_each_period(bench: Bench) -> None:
    mode(bench)
    fly(bench, 400, every=1000)
    rows = bench.run().topic("twodof_pitch")
    assert len(rows) == 100
    assert set(np.diff(rows["timestamp_sample"].astype(np.int64))) == {PERIOD}
    assert rows["missed"][-1] == 0


@pytest.mark.parametrize("every", [1250, 2500, 3003, 4001])
def test_a_gyro_of_any_rate_gives_250_steps_a_second(bench: Bench, every: int) -> None:
    mode(bench)
    fly(bench, 2_000_000 // every, every=every)
    rows = bench.run().topic("twodof_pitch")
    span = int(rows["timestamp_sample"][-1] - rows["timestamp_sample"][0])
    assert abs(len(rows) + rows["missed"][-1] - (1 + span / PERIOD)) <= 1
    assert rows["missed"][-1] <= (0 if every < PERIOD else 1)


def test_periods_without_a_sample_are_counted(bench: Bench) -> None:
    mode(bench)
    fly(bench, 10)
    bench.at(bench.now + 2 * PERIOD)  # two samples are lost
    fly(bench, 10)
    rows = bench.run().topic("twodof_pitch")
    assert list(rows["missed"]) == [0] * 10 + [2] * 10
    assert list(rows["tick"]) == list(range(20))


def test_disarmed_it_computes_and_commands_nothing(bench: Bench) -> None:
    mode(bench, armed=False)
    fly(bench, 20)
    mode(bench, armed=True)
    fly(bench, 20)
    events = bench.run()
    rows, torque = events.topic("twodof_pitch"), events.topic("vehicle_torque_setpoint")
    assert not rows["active"][:20].any()
    assert rows["active"][20:].all()
    assert not torque["xyz"][:20].any()
    assert not events.topic("vehicle_thrust_setpoint")["xyz"][:20].any()
    assert torque["xyz"][20:, 1].all()
    assert rows["in_flag_reset_int"][:20].all()
    assert not rows["in_flag_reset_int"][20:].any()


def test_it_leaves_the_field_to_others_when_rates_are_not_controlled(bench: Bench) -> None:
    mode(bench, rates=False)
    fly(bench, 5)
    events = bench.run()
    assert len(events.topic("vehicle_torque_setpoint")) == 0
    assert len(events.topic("vehicle_thrust_setpoint")) == 0
    assert not events.topic("twodof_pitch")["active"].any()


def test_a_stale_attitude_stops_the_motors_and_the_controller_starts_again(bench: Bench) -> None:
    mode(bench)
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
    mode(bench)
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


def test_a_silent_gyro_stops_the_motors(bench: Bench) -> None:
    mode(bench)
    fly(bench, 5)
    for _ in range(10):
        bench.at(bench.now + 5 * PERIOD)
        mode(bench)
    events = bench.run()
    rows, torque = events.topic("twodof_pitch"), events.topic("vehicle_torque_setpoint")
    assert len(rows) == 15  # one each 20 ms, the first of them 20 ms after the last sample
    assert (rows["faults"][5:] == STALE).all()
    assert not torque["xyz"][5:].any()
    assert not rows["active"][5:].any()


def test_a_missing_set_point_is_replaced_and_said(bench: Bench) -> None:
    mode(bench)
    fly(bench, 5)
    fly(bench, 5, theta_0=math.nan)
    rows = bench.run().topic("twodof_pitch")
    assert list(rows["faults"]) == [0] * 5 + [NO_SETPOINT] * 5
    assert not rows["in_theta_0"][5:].any()
    assert rows["active"].all()


def test_in_rate_mode_the_rate_set_point_is_read(bench: Bench) -> None:
    mode(bench, attitude=False)
    bench.publish("vehicle_rates_setpoint", pitch=0.7, thrust_body=[0.0, 0.0, -0.5])
    fly(bench, 5)
    events = bench.run()
    rows = events.topic("twodof_pitch")
    assert np.array_equal(rows["in_q_0"], np.full(5, np.float32(0.7)))
    assert not rows["in_flag_attitude_enabled"].any()
    assert np.array_equal(events.topic("vehicle_thrust_setpoint")["xyz"][:, 2], np.full(5, np.float32(-0.5)))


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


@pytest.mark.parametrize("queued", [False, True], ids=["alone", "with a run asked for before"])
def test_a_stop_in_flight_leaves_no_command_behind(bench: Bench, queued: bool) -> None:
    mode(bench)
    fly(bench, 5)
    if queued:
        bench.publish("vehicle_angular_velocity", at_once=False)
    bench.command("stop")
    fly(bench, 5)
    events = bench.run()
    torque, thrust = (events.topic(f"vehicle_{what}_setpoint")["xyz"] for what in ("torque", "thrust"))
    assert len(torque) == len(thrust) == 6
    assert torque[4].any()
    assert thrust[4].any()
    assert not torque[5].any()
    assert not thrust[5].any()
    # PX4's allocator runs after the module on the same queue, and reads nothing of a topic without a publication.
    for topic in ("vehicle_torque_setpoint", "vehicle_thrust_setpoint"):
        assert events.withdrawn()[topic] >= events.topic(topic)["timestamp"][5] + 5 * PERIOD
    assert events.returned() == [0, 0]


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


def test_a_command_that_is_not_finite_stops_the_motors_and_the_controller_starts_again(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    bench = Bench(make_module(overflowing()), tmp_path_factory.mktemp("module"))
    bench.command("start")
    mode(bench)
    fly(bench, 12)
    events = bench.run()
    rows, torque = events.topic("twodof_overflow"), events.topic("vehicle_torque_setpoint")
    lost = ~np.isfinite(rows["out_m"])
    assert list(rows["tick"]) == [0, 1, 2, 3] * 3
    assert list(np.flatnonzero(lost)) == [3, 7, 11]
    assert (((rows["faults"] & NOT_FINITE) != 0) == lost).all()
    assert not torque["xyz"][lost].any()
    assert not events.topic("vehicle_thrust_setpoint")["xyz"][lost].any()
    assert torque["xyz"][~lost, 1].all()
    assert (np.abs(torque["xyz"][:, 1]) <= SQRT2).all()


def overflowing() -> Diagram:
    """M grows by 1e12 at each step, and so is infinite at the fourth."""
    d = Diagram("overflow")
    d.input("q", unit="rad/s")
    d.add("grow", lib.UnitDelay(1.0))
    d.add("gain", lib.Gain(1e12), u="grow")
    d.add("zero", lib.Gain(0.0), u="q")
    d.add("sum", lib.Sum("++"), a="gain", b="zero")
    d.connect("sum", "grow.u")
    d.output("M", "sum")
    return d


def test_a_position_module_commands_attitude_and_thrust_only_along_the_rail(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    bench = Bench(make_module(rail()), tmp_path_factory.mktemp("module"))
    bench.command("start")
    yaw = 0.4
    for along in (False, True):
        mode(bench, rail=along)
        for k in range(10):
            bench.at(bench.now + PERIOD)
            bench.publish("trajectory_setpoint", position=[0.2, math.nan, math.nan], velocity=[math.nan] * 3)
            bench.publish("vehicle_local_position", x=0.01 * k, vx=0.1, xy_valid=True, v_xy_valid=True)
            bench.publish("vehicle_attitude", q=[math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)])
            bench.publish("vehicle_angular_velocity")
    events = bench.run()
    rows, attitude = events.topic("twodof_rail"), events.topic("vehicle_attitude_setpoint")
    assert len(attitude) == 10
    assert list(rows["active"]) == [False] * 10 + [True] * 10
    assert set(rows["faults"]) == {0}
    assert rows["in_flag_position_enabled"][10:].all()
    assert np.all(same(rows["out_theta_0"], replayed(rail(), (), rows)["theta_0"]))
    w, x, y, z = (attitude["q_d"][:, i].astype(float) for i in range(4))
    pitch = np.arcsin(2 * (w * y - z * x))
    heading = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    assert np.allclose(pitch, rows["out_theta_0"][10:], atol=1e-6)  # float32, a few units in the last place
    assert np.allclose(heading, yaw, atol=1e-6)
    assert np.array_equal(attitude["thrust_body"], np.tile(np.float32([0.0, 0.0, -0.4]), (10, 1)))


def test_without_a_valid_position_there_is_no_thrust(tmp_path_factory: pytest.TempPathFactory) -> None:
    bench = Bench(make_module(rail()), tmp_path_factory.mktemp("module"))
    bench.command("start")
    mode(bench, rail=True)
    for k in range(6):
        bench.at(bench.now + PERIOD)
        bench.publish("trajectory_setpoint", position=[0.2, 0.0, 0.0])
        bench.publish("vehicle_local_position", xy_valid=k < 3, v_xy_valid=True)
        bench.publish("vehicle_attitude", q=quaternion(0.0))
        bench.publish("vehicle_angular_velocity")
    events = bench.run()
    assert list(events.topic("twodof_rail")["faults"]) == [0] * 3 + [STALE] * 3
    thrust = events.topic("vehicle_attitude_setpoint")["thrust_body"][:, 2]
    assert list(thrust) == [np.float32(-0.4)] * 3 + [0.0] * 3
    assert np.array_equal(events.topic("vehicle_attitude_setpoint")["q_d"][3:, 2], np.zeros(3))


def both() -> Diagram:
    """The stock position controller above the stock attitude controller, in one diagram."""
    d = Diagram("both")
    above, below = starter("stock-position"), starter("stock-attitude")
    for part in (above, below):
        for name, port in part.inputs.items():
            if name != "theta_0":
                d.input(name, port.kind, port.width, port.unit)
    d.add("above", above, inputs={name: name for name in above.inputs})
    d.add("below", below, inputs={n: "above.theta_0" if n == "theta_0" else n for n in below.inputs})
    d.output("M", "below.M")
    d.output("thrust", "above.thrust")
    d.output("theta_0", "above.theta_0")
    return d


def test_position_and_attitude_in_one_module(tmp_path_factory: pytest.TempPathFactory) -> None:
    bench = Bench(make_module(both()), tmp_path_factory.mktemp("both"))
    bench.command("start")
    for along in (True, False):
        mode(bench, rail=along)
        for k in range(50):
            bench.at(bench.now + PERIOD)
            bench.publish("trajectory_setpoint", position=[0.1, 0.0, 0.0])
            bench.publish("vehicle_local_position", x=0.001 * k, vx=0.05, xy_valid=True, v_xy_valid=True)
            bench.publish("vehicle_attitude_setpoint", q_d=quaternion(0.0), thrust_body=[0.0, 0.0, -0.3])
            measure(bench, 0.02 * math.sin(0.2 * k), 0.1)
    events = bench.run()
    rows = events.topic("twodof_both")
    expected = replayed(both(), (), rows)
    for path, field in (("M", "out_m"), ("thrust", "out_thrust"), ("theta_0", "out_theta_0")):
        assert np.all(same(rows[field], expected[path])), path
    thrust = -events.topic("vehicle_thrust_setpoint")["xyz"][:, 2]
    assert np.array_equal(thrust[:50], rows["out_thrust"][:50])  # along the rail its own
    assert np.array_equal(thrust[50:], np.full(50, np.float32(0.3)))  # else that of the set-point
    assert len(events.topic("vehicle_attitude_setpoint")) == 100  # those of this test only
    assert set(rows["faults"]) == {0}


def motors() -> Diagram:
    """fore = thrust_0 + M_0, aft = thrust_0 - M_0."""
    d = Diagram("mixer")
    for name, unit in (("M_0", ""), ("thrust_0", ""), ("acc_z", "m/s2"), ("gyro_y", "rad/s")):
        d.input(name, unit=unit)
    d.add("fore", lib.Sum("++"), a="thrust_0", b="M_0")
    d.add("aft", lib.Sum("+-"), a="thrust_0", b="M_0")
    for n, source in enumerate(("fore", "aft", "fore", "aft"), 1):
        d.output(f"motor_{n}", source)
    return d


def test_a_motor_module_commands_the_four_motors_and_stops_them_by_nan(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    bench = Bench(make_module(motors()), tmp_path_factory.mktemp("module"))
    bench.command("start")
    for armed in (False, True):
        mode(bench, armed=armed)
        bench.at(bench.now + PERIOD)
        bench.publish("vehicle_attitude_setpoint", thrust_body=[0.0, 0.0, -0.4], q_d=quaternion(0.0))
        bench.publish("vehicle_torque_setpoint", xyz=[0.0, 0.1, 0.0])
        bench.publish("sensor_combined", gyro_rad=[0.0, 0.3, 0.0], accelerometer_m_s2=[0.0, 0.0, -9.8])
        bench.publish("vehicle_angular_velocity")
    events = bench.run()
    control = events.topic("actuator_motors")["control"]
    assert np.isnan(control[0]).all()
    assert np.allclose(control[1, :4], [0.5, 0.3, 0.5, 0.3], atol=1e-7)  # the sums round once in float32
    assert np.isnan(control[1, 4:]).all()
    rows = events.topic("twodof_mixer")
    assert np.allclose(rows["in_acc_z"], -9.8)
    assert np.allclose(rows["in_gyro_y"], 0.3)
