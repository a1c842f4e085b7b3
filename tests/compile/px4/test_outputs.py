"""Modules with other outputs: commands that overflow, a place along the rail, both loops, the four motors."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from tests.compile.differential import same
from tests.compile.px4.build import Bench
from tests.compile.px4.flown import NOT_FINITE, PERIOD, SQRT2, STALE, fly, measure, mode, quaternion, replayed
from tests.compile.px4.modules import both, rail

pytestmark = pytest.mark.slow


def test_a_command_that_is_not_finite_stops_the_motors_and_the_controller_starts_again(
    benches: Callable[[str], Bench],
) -> None:
    bench = benches("overflow")
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


def test_a_controller_without_a_reset_starts_afresh_each_time_that_it_may_command(
    benches: Callable[[str], Bench],
) -> None:
    """This one grows by 1e12 at each step: it would be infinite on the ground."""
    bench = benches("overflow")
    bench.command("start")
    for armed, steps in ((False, 10), (True, 3), (False, 5), (True, 2)):
        mode(bench, armed)
        fly(bench, steps)
    rows = bench.run().topic("twodof_overflow")
    assert list(rows["tick"]) == [0] * 10 + [0, 1, 2] + [3, 0, 0, 0, 0] + [0, 1]
    assert not (rows["faults"][:13] & NOT_FINITE).any()


def test_a_controller_of_attitude_alone_commands_nothing_in_acro(benches: Callable[[str], Bench]) -> None:
    """There PX4 has no attitude set-point, so it would hold a pitch that nobody asked for."""
    bench = benches("alone")
    bench.command("start")
    for attitude in (True, False, True):
        mode(bench, attitude=attitude)
        fly(bench, 4)
    rows = bench.run().topic("twodof_alone")
    assert list(rows["active"]) == [True] * 4 + [False] * 4 + [True] * 4


def test_a_position_module_commands_attitude_and_thrust_only_along_the_rail(benches: Callable[[str], Bench]) -> None:
    bench = benches("rail")
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


def test_without_a_valid_position_there_is_no_thrust(benches: Callable[[str], Bench]) -> None:
    bench = benches("rail")
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


@pytest.mark.long
def test_position_and_attitude_in_one_module(benches: Callable[[str], Bench]) -> None:
    bench = benches("both")
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


@pytest.mark.long
def test_a_motor_module_commands_the_four_motors_and_stops_them_by_nan(benches: Callable[[str], Bench]) -> None:
    bench = benches("mixer")
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
