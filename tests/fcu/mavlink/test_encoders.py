"""Telemetry messages: each field against its step, for all numbers that a step may hold."""

import math
import struct
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fcu.mavlink.world import World, step
from twodof.fcu.control.flight_code import ControllerIdentity
from twodof.fcu.mavlink.encoders import FENCE, PREARM, PRESENT, deciding
from twodof.flight.failsafe.causes_and_actions import BIT, CAUSES
from twodof.link.mavlink.framing import Parser, decode, encode
from twodof.signals import MODES

pytestmark = pytest.mark.slow

NUMBERS = st.floats(allow_nan=True, allow_infinity=True)
SANE = st.floats(-100.0, 100.0)
SHARED = World()


def f32(value: float) -> float:
    """As the wire rounds it."""
    try:
        return struct.unpack("<f", struct.pack("<f", value))[0]
    except OverflowError:
        return math.copysign(math.inf, value)


def equal(got: float, value: float) -> bool:
    return got == f32(value) or (math.isnan(got) and math.isnan(value))


def told(number: int, world: World | None = None, **values: Any) -> Any:
    """The message `number` of a step with these values."""
    world = world or SHARED
    tick = values.pop("tick", 1000)
    world.px4.telemetry.observe(step(tick, **values))
    (frame,) = Parser().feed(encode(world.px4.telemetry.message(number), 1, 1, 0))
    return decode(frame)


@settings(max_examples=40)
@given(theta=NUMBERS, q=NUMBERS, tick=st.integers(0, 2**32))
def test_attitude(theta: float, q: float, tick: int) -> None:
    got = told(30, theta=theta, q=q, tick=tick)
    assert got.time_boot_ms == tick * 4 % 2**32
    assert equal(got.pitch, theta)
    assert equal(got.pitchspeed, q)
    assert (got.roll, got.yaw, got.rollspeed, got.yawspeed) == (0.0, 0.0, 0.0, 0.0)


@settings(max_examples=40)
@given(theta=st.floats(-0.9, 0.9), q=SANE)
def test_the_quaternion_turns_level_into_the_pitch(theta: float, q: float) -> None:
    got = told(31, theta=theta, q=q)
    w, x, y, z = got.q1, got.q2, got.q3, got.q4
    # Pitch of a rotation matrix, Diebel 2006, eq. 290; single precision.
    assert math.asin(2.0 * (w * y - z * x)) == pytest.approx(theta, abs=1e-6)
    assert w * w + x * x + y * y + z * z == pytest.approx(1.0, abs=1e-6)
    assert (x, z, got.rollspeed, got.yawspeed, got.repr_offset_q) == (0.0, 0.0, 0.0, 0.0, [0.0] * 4)
    assert equal(got.pitchspeed, q)


@settings(max_examples=40)
@given(theta=NUMBERS, theta0=NUMBERS)
def test_an_attitude_that_is_none_is_nan_and_never_an_error(theta: float, theta0: float) -> None:
    assert math.isfinite(told(31, theta=theta).q1) == math.isfinite(theta)
    assert math.isfinite(told(331, theta=theta).q[0]) == math.isfinite(theta)
    assert math.isfinite(told(83, theta0=theta0).q[0]) == math.isfinite(theta0)


@settings(max_examples=40)
@given(theta=st.floats(-0.9, 0.9), v=st.floats(-2.0, 2.0), x=SANE, q=SANE)
def test_odometrys_velocity_is_the_bodys(theta: float, v: float, x: float, q: float) -> None:
    got = told(331, theta=theta, v=v, x=x, q=q)
    assert (got.frame_id, got.child_frame_id, got.estimator_type) == (1, 12, 8)
    assert (got.reset_counter, got.quality, got.y, got.z, got.vy) == (0, 0, 0.0, 0.0, 0.0)
    assert got.time_usec == 4_000_000
    # Turned back into north-east-down it is v along north alone.
    assert got.vx * math.cos(theta) + got.vz * math.sin(theta) == pytest.approx(v, abs=1e-6)
    assert -got.vx * math.sin(theta) + got.vz * math.cos(theta) == pytest.approx(0.0, abs=1e-6)
    assert (got.rollspeed, got.yawspeed) == (0.0, 0.0)
    assert equal(got.pitchspeed, q)
    assert equal(got.x, x)
    assert math.isnan(got.pose_covariance[0])
    assert math.isnan(got.velocity_covariance[0])


@settings(max_examples=40)
@given(values=st.tuples(*[NUMBERS] * 6))
def test_imu(values: tuple[float, ...]) -> None:
    names = ("acc_x", "acc_y", "acc_z", "gyro_x", "gyro_y", "gyro_z")
    got = told(105, **dict(zip(names, values, strict=True)))
    fields = (got.xacc, got.yacc, got.zacc, got.xgyro, got.ygyro, got.zgyro)
    assert all(equal(one, value) for one, value in zip(fields, values, strict=True))
    assert got.time_usec == 4_000_000
    assert got.fields_updated == 0x3F
    absent = (got.xmag, got.ymag, got.zmag, got.abs_pressure, got.diff_pressure, got.pressure_alt, got.temperature)
    assert all(math.isnan(one) for one in absent)


@settings(max_examples=40)
@given(dist=NUMBERS, age=NUMBERS)
def test_range(dist: float, age: float) -> None:
    world = World()
    got = told(132, world, dist=dist, dist_age=age, dist_new=True)
    late = age if 0.0 <= age <= 10.0 else 0.0
    assert got.time_boot_ms == pytest.approx(max(0.0, 4000.0 - late * 1000.0), abs=1.0)
    if math.isfinite(dist) and 0.0 <= dist <= 655.0:
        assert got.current_distance == pytest.approx(dist * 100.0, abs=0.5)
    assert (got.min_distance, got.max_distance, got.covariance) == (2, 120, 255)
    exact = told(54204, world, dist=dist, dist_age=age, dist_new=True)
    assert equal(exact.distance, dist)
    assert exact.valid == math.isfinite(dist)
    assert exact.tick == 1000


def test_a_sample_keeps_its_own_time() -> None:
    world = World()
    told(132, world, tick=100, dist=0.4, dist_age=0.008, dist_new=True)
    later = told(132, world, tick=110, dist=0.9, dist_age=0.048)
    assert (later.time_boot_ms, later.current_distance) == (392, 40)
    assert told(105, world, tick=111, imu_new=False, acc_x=5.0).time_usec == 110 * 4000


@settings(max_examples=40)
@given(theta0=st.floats(-0.9, 0.9), q0=SANE, T=st.floats(-1.0, 1.0), mode=st.integers(0, len(MODES) - 1))
def test_set_points_in_use(theta0: float, q0: float, T: float, mode: int) -> None:
    got = told(83, theta0=theta0, q0=q0, T=T, mode=mode)
    assert 2.0 * math.atan2(got.q[2], got.q[0]) == pytest.approx(theta0, abs=1e-6)
    assert equal(got.body_pitch_rate, q0)
    assert equal(got.thrust, abs(T))
    # ATTITUDE_TARGET_TYPEMASK: attitude, pitch rate.
    assert got.type_mask == {"off": 128 | 2, "open-loop": 128 | 2, "rate": 128}.get(MODES[mode], 0)


@settings(max_examples=40)
@given(x0=SANE, v0=SANE, ax0=SANE, mode=st.integers(0, len(MODES) - 1))
def test_positions_in_use(x0: float, v0: float, ax0: float, mode: int) -> None:
    got = told(85, x0=x0, v0=v0, ax0=ax0, mode=mode)
    assert (equal(got.x, x0), equal(got.vx, v0), equal(got.afx, ax0)) == (True, True, True)
    assert got.coordinate_frame == 1
    # POSITION_TARGET_TYPEMASK: all that is ignored but for x, vx and ax.
    ignored = 0b110111111111 & ~(0b001001001 if MODES[mode] == "position" else 8 if MODES[mode] == "velocity" else 0)
    assert got.type_mask == ignored
    assert (got.y, got.z, got.vy, got.vz, got.afy, got.afz, got.yaw, got.yaw_rate) == (0.0,) * 8


@settings(max_examples=40)
@given(fore=NUMBERS, aft=NUMBERS, armed=st.booleans(), tick=st.integers(0, 2**32))
def test_motors(fore: float, aft: float, armed: bool, tick: int) -> None:
    got = told(36, fore=fore, aft=aft, armed=armed, tick=tick)
    assert got.time_usec == tick * 4000 % 2**32
    assert (got.servo1_raw, got.servo2_raw) == (got.servo3_raw, got.servo4_raw)
    for width, command in ((got.servo1_raw, fore), (got.servo2_raw, aft)):
        if not armed or not math.isfinite(command):
            assert width == 900
        else:
            assert width == pytest.approx(1000.0 + 1000.0 * min(max(command, 0.0), 1.0), abs=0.5)
    assert (got.servo5_raw, got.servo16_raw, got.port) == (0, 0, 0)


@settings(max_examples=40)
@given(M=NUMBERS, T=NUMBERS)
def test_moments(M: float, T: float) -> None:
    got = told(140, M=M, T=T)
    assert (equal(got.controls[1], M), equal(got.controls[3], T)) == (True, True)
    assert (got.group_mlx, got.time_usec) == (0, 4_000_000)
    assert [got.controls[place] for place in (0, 2, 4, 5, 6, 7)] == [0.0] * 6


@settings(max_examples=40)
@given(voltage=NUMBERS, charge=NUMBERS, causes=st.integers(0, 2 ** len(CAUSES) - 1))
def test_battery(voltage: float, charge: float, causes: int) -> None:
    got = told(147, voltage=voltage, charge=charge, causes=causes)
    status = told(1, voltage=voltage, charge=charge, causes=causes)
    assert got.voltages[0] == status.voltage_battery
    assert got.voltages[1:] == [0xFFFF] * 9
    assert got.battery_remaining == status.battery_remaining
    if math.isfinite(voltage) and 0.0 <= voltage <= 65.0:
        assert got.voltages[0] == pytest.approx(voltage * 1000.0, abs=0.5)
    elif not math.isfinite(voltage):
        assert got.voltages[0] == 0xFFFF
    if math.isfinite(charge):
        assert got.battery_remaining == pytest.approx(100.0 * min(max(charge, 0.0), 1.0), abs=0.5)
    else:
        assert got.battery_remaining == -1
    assert (got.temperature, got.current_battery, got.current_consumed, got.energy_consumed) == (0x7FFF, -1, -1, -1)
    assert (got.id, got.battery_function, got.type, got.mode, got.fault_bitmask) == (0, 1, 1, 0, 0)
    assert (got.time_remaining, got.voltages_ext) == (0, [0] * 4)
    assert (status.current_battery, status.drop_rate_comm, status.errors_comm) == (-1, 0, 0)
    counts = (status.errors_count1, status.errors_count2, status.errors_count3, status.errors_count4)
    more = (status.onboard_control_sensors_present_extended, status.onboard_control_sensors_enabled_extended)
    assert (*counts, *more, status.onboard_control_sensors_health_extended) == (0,) * 7
    worse = 3 if causes & BIT["battery_critical"] else 2 if causes & BIT["battery_low"] else 1
    assert got.charge_state == worse


@settings(max_examples=40)
@given(causes=st.integers(0, 2 ** len(CAUSES) - 1))
def test_health(causes: int) -> None:
    got = told(1, causes=causes)
    assert got.onboard_control_sensors_present == got.onboard_control_sensors_enabled == PRESENT
    assert got.onboard_control_sensors_health & ~PRESENT == FENCE  # which is not there
    assert bool(got.onboard_control_sensors_health & PREARM) == (causes == 0)
    assert bool(got.onboard_control_sensors_health & 1) == (not causes & BIT["imu_lost"])
    assert bool(got.onboard_control_sensors_health & 256) == (not causes & BIT["range_lost"])


def test_load_is_the_part_of_a_period_that_a_step_takes() -> None:
    world = World()
    world.controller.timing.step_mean = 1000.0
    assert told(1, world).load == 250  # in tenths of a percent
    world.controller.timing.step_mean = 9000.0
    assert told(1, world).load == 1000


def test_in_the_air_while_the_motors_turn() -> None:
    assert told(245, armed=True, fore=0.4, aft=0.4).landed_state == 2
    assert told(245, armed=True).landed_state == 1
    assert told(245, fore=0.4).landed_state == 1


def test_the_rig_says_what_it_is() -> None:
    world = World(lockstep=True, identity=lambda: ControllerIdentity("mine", 2**64 - 1))
    world.controller.hardware.name = "a name longer than sixteen characters"
    got = told(54206, world)
    assert (got.seed, got.diagram, got.tick_us, got.flags) == (7, 2**64 - 1, 4000, 2 | 4 | 8)
    assert (got.name, got.controller, got.noise) == ("a name longer th", "mine", 0.25)


def test_timing_is_the_controllers() -> None:
    world = World(lost=lambda: 17)
    timing = world.controller.timing
    timing.overruns, timing.missed, timing.step_mean, timing.step_worst, timing.late_worst = 1, 2, 3.0, 4.0, 5.0
    got = told(54211, world)
    fields = (got.overruns, got.missed, got.lost_out, got.step_mean, got.step_worst, got.late_worst)
    assert fields == (1, 2, 17, 3.0, 4.0, 5.0)


@pytest.mark.parametrize("number", [54204, 54205, 54206, 54210, 54211, 2])
def test_ticks_beyond_the_wires_range_wrap(number: int) -> None:
    world = World(truth=lambda: (0.0, 0.0, 0.0, 0.0))
    world.controller.tick = 2**32 + 5
    got = told(number, world, tick=2**32 + 5, dist_new=True)
    if number == 2:
        assert got.time_boot_ms == 20
    else:
        assert (got.step if number == 54205 else got.tick) == 5


def test_the_cause_that_decides_asks_for_the_strongest_action() -> None:
    assert deciding(0) == -1
    for place, cause in enumerate(CAUSES):
        assert deciding(1 << place) == place
        assert CAUSES[deciding((1 << len(CAUSES)) - 1)].action >= cause.action
    level, off = (next(p for p, c in enumerate(CAUSES) if c.name == name) for name in ("rings_wrong", "imu_lost"))
    assert deciding(1 << level | 1 << off) == off


def test_every_message_is_encoded_before_and_after_the_first_step() -> None:
    world = World(truth=lambda: (0.0, 0.0, 0.0, 0.0))
    telemetry = world.px4.telemetry
    before = {number for number in telemetry.messages if telemetry.message(number) is not None}
    world.run(1, dist_new=True)
    after = {number for number in telemetry.messages if telemetry.message(number) is not None}
    assert after == telemetry.messages
    assert {0, 2, 242, 54206, 54209} <= before
