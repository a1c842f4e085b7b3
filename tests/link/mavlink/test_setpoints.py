"""Set-points over the wire: what a message carries is read back, at the time that was asked for."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from twodof.link.mavlink.messages import message
from twodof.link.mavlink.setpoints import SetPoint, pitch, quaternion, read_attitude, read_position, setpoint_message
from twodof.signals import ATTITUDE, OPEN_LOOP, POSITION, RATE, VELOCITY

TICK_MS = 4
NUMBERS = st.floats(-1.0, 1.0, width=32)


@given(value=NUMBERS, thrust=st.floats(0.0, 1.0, width=32), forward=NUMBERS, tick=st.integers(0, 1 << 40))
def test_a_set_point_is_read_back_at_its_time(value: float, thrust: float, forward: float, tick: int) -> None:
    for sent, read in (
        (SetPoint(ATTITUDE, theta0=value, thrust=thrust), read_attitude),
        (SetPoint(RATE, q0=value, thrust=thrust), read_attitude),
        (SetPoint(VELOCITY, v0=value, ax0=forward), read_position),
        (SetPoint(POSITION, x0=value, ax0=forward), read_position),
    ):
        carried = setpoint_message(sent, tick, target_system=1, target_component=1)
        got = read(carried)
        assert got is not None
        assert got.loop == sent.loop
        # theta0 goes as a quaternion, in double precision here.
        assert got[1:] == tuple(None if number is None else pytest.approx(number, abs=1e-12) for number in sent[1:])
        assert carried.time_boot_ms == tick * TICK_MS % (1 << 32)
    carried = setpoint_message(SetPoint(OPEN_LOOP, M_open=value, thrust=thrust), tick)
    assert (carried.M, carried.T, carried.tick) == (value, thrust, tick % (1 << 32))


@pytest.mark.parametrize(("loop", "moves"), [(ATTITUDE, False), (RATE, False), (VELOCITY, True), (POSITION, True)])
def test_velocity_and_position_move_the_cart(loop: int, moves: bool) -> None:
    assert SetPoint(loop).moves_cart == moves


THRUST, PITCH = {"thrust": 0.4}, {"theta0": 0.2}


@pytest.mark.parametrize(
    ("mask", "expected"),
    [
        (0, SetPoint(ATTITUDE, **PITCH, **THRUST)),  # an attitude goes before rates
        (7, SetPoint(ATTITUDE, **PITCH, **THRUST)),
        (64, SetPoint(ATTITUDE, **PITCH)),
        (32, SetPoint(ATTITUDE, **PITCH, thrust=0.3)),  # thrust_body goes before thrust
        (96, SetPoint(ATTITUDE, **PITCH, thrust=0.3)),
        (128, SetPoint(RATE, q0=0.5, **THRUST)),
        (128 | 4 | 64, SetPoint(RATE, q0=0.5)),  # a yaw rate is not flown
        (128 | 1, None),
        (128 | 2, SetPoint(None, **THRUST)),  # thrust alone
        (128 | 7, SetPoint(None, **THRUST)),
        (128 | 7 | 64, None),
        (128 | 7 | 32, None),
    ],
)
def test_an_attitude_target_is_read_as_its_mask_says(mask: int, expected: SetPoint | None) -> None:
    values = {"q": quaternion(0.2), "thrust": 0.4, "body_pitch_rate": 0.5, "thrust_body": [0.0, 0.0, -0.3]}
    found = read_attitude(message("SET_ATTITUDE_TARGET", type_mask=mask, **values))
    assert found == (expected and expected._replace(theta0=expected.theta0 and pytest.approx(expected.theta0)))


@pytest.mark.parametrize(
    ("frame", "mask", "changed", "expected"),
    [
        (1, 0, {}, SetPoint(POSITION, x0=0.1, ax0=0.3)),  # a position goes before a velocity
        (1, 64, {}, SetPoint(POSITION, x0=0.1, ax0=0.0)),
        (1, 1, {}, SetPoint(VELOCITY, v0=0.2, ax0=0.3)),
        (1, 0, {"x": math.nan, "afx": math.nan}, SetPoint(VELOCITY, v0=0.2, ax0=0.0)),  # NaN counts as ignored
        (8, 0, {}, SetPoint(VELOCITY, v0=0.2, ax0=0.3)),
        (8, 8, {}, None),
        (1, 1 | 8, {}, None),  # an acceleration alone
        (1, 512, {}, None),  # a force
        (1, 512 | 64, {}, SetPoint(POSITION, x0=0.1, ax0=0.0)),
        (7, 0, {}, None),
    ],
)
def test_a_position_target_is_read_as_its_mask_says(
    frame: int, mask: int, changed: dict[str, float], expected: SetPoint | None
) -> None:
    values = {"x": 0.1, "vx": 0.2, "afx": 0.3, **changed}
    sent = message("SET_POSITION_TARGET_LOCAL_NED", coordinate_frame=frame, type_mask=mask, **values)
    assert read_position(sent) == expected


@settings(max_examples=25)
@given(angles=st.tuples(*(st.floats(-1.5, 1.5) for _ in range(3))), length=st.floats(0.01, 100.0))
def test_the_pitch_is_that_of_any_attitude(angles: tuple[float, float, float], length: float) -> None:
    x, y, z, w = length * Rotation.from_euler("ZYX", angles).as_quat()
    assert pitch((w, x, y, z)) == pytest.approx(angles[1], abs=1e-6)
    assert pitch(quaternion(angles[1])) == pytest.approx(angles[1], abs=1e-9)


@pytest.mark.parametrize(
    "q", [(0.0, 0.0, 0.0, 0.0), (1e-4, 0.0, 0.0, 0.0), (2e3, 0.0, 0.0, 0.0), (math.nan, 0.0, 0.0, 0.0)]
)
def test_what_is_no_attitude_is_no_pitch(q: tuple[float, ...]) -> None:
    assert math.isnan(pitch(q))
    assert not SetPoint(ATTITUDE, theta0=pitch(q), thrust=0.4).sound


def test_a_set_point_has_a_loop_of_the_flight_code_and_keeps_what_it_leaves_open() -> None:
    assert [loop for loop in (None, *range(-1, 8)) if SetPoint(loop, thrust=0.4).sound] == [None, *range(1, 6)]
    before = SetPoint(RATE, q0=1.0, thrust=0.1)
    assert SetPoint(ATTITUDE, theta0=0.0, thrust=0.4).after(before) == SetPoint(
        ATTITUDE, theta0=0.0, q0=1.0, thrust=0.4
    )
    assert SetPoint(None).after(before) == before
