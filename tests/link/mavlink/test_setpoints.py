"""Set-points over the wire: what a message carries is read back, at the time that was asked for."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twodof.link.mavlink.setpoints import SetPoint, read_attitude, read_position, setpoint_message
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
        message = setpoint_message(sent, tick, target_system=1, target_component=1)
        got = read(message)
        assert got is not None
        assert got.loop == sent.loop
        # theta0 goes as a quaternion, in double precision here.
        assert got[1:] == tuple(None if number is None else pytest.approx(number, abs=1e-12) for number in sent[1:])
        assert message.time_boot_ms == tick * TICK_MS % (1 << 32)
    message = setpoint_message(SetPoint(OPEN_LOOP, M_open=value, thrust=thrust), tick)
    assert (message.M, message.T, message.tick) == (value, thrust, tick % (1 << 32))


@pytest.mark.parametrize(("loop", "moves"), [(ATTITUDE, False), (RATE, False), (VELOCITY, True), (POSITION, True)])
def test_velocity_and_position_move_the_cart(loop: int, moves: bool) -> None:
    assert SetPoint(loop).moves_cart == moves
