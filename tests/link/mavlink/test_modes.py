"""Modes and set-points: PX4's numbers, and what goes out comes back."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twodof.errors import LinkError
from twodof.link.mavlink import modes, setpoints
from twodof.link.mavlink.framing import Parser, decode, encode
from twodof.link.mavlink.messages import message
from twodof.link.mavlink.setpoints import SetPoint
from twodof.signals import ATTITUDE, POSITION, RATE, VELOCITY


def test_custom_modes_are_those_that_px4_publishes() -> None:
    """As PX4 v1.16 in software-in-the-loop sends them in HEARTBEAT (custom_mode of px4_custom_mode.h)."""
    published = {"manual": 65536, "rate": 327680, "attitude": 458752, "position": 196608, "hold": 50593792}
    assert {mode.name: mode.custom_mode for mode in modes.MODES} == published | {"offboard": 393216}


def test_the_base_mode_has_the_flags_of_the_mode() -> None:
    """MAV_MODE_FLAG: custom 1, auto 4, guided 8, stabilised 16, manual input 64, armed 128."""
    flags = {"manual": 65, "rate": 65, "attitude": 81, "position": 81, "hold": 29, "offboard": 17}
    assert {mode.name: modes.base_mode(mode.custom_mode, False) for mode in modes.MODES} == flags
    assert {modes.base_mode(one.custom_mode, True) - flags[one.name] for one in modes.MODES} == {128}


def test_names_and_numbers_go_both_ways() -> None:
    for mode in modes.MODES:
        assert modes.custom_mode(mode.name) == mode.custom_mode
        assert modes.mode_name(mode.custom_mode) == mode.name
    assert modes.mode_name(4 << 16 | 6 << 24) == "main 4, sub 6"
    with pytest.raises(LinkError, match="offboard"):
        modes.custom_mode("warp")


FLOAT = st.floats(-1.0, 1.0, width=32)


@given(value=FLOAT, thrust=st.floats(0.0, 1.0, width=32), forward=FLOAT)
def test_targets_say_what_they_were_made_of(value: float, thrust: float, forward: float) -> None:
    def sent(one: object) -> object:
        (frame,) = Parser().feed(encode(one, 250, 190, 0))
        return decode(frame)

    attitude = setpoints.read_attitude(sent(setpoints.attitude_target(value, thrust)))
    assert attitude is not None
    # float32 of the quaternion: 6e-8, over cos(1) at the largest pitch here, times the 2 of the double angle.
    assert attitude == SetPoint(ATTITUDE, theta0=pytest.approx(value, abs=3e-7), thrust=thrust)
    rate = setpoints.read_attitude(sent(setpoints.rate_target(value, thrust)))
    assert rate is not None
    assert rate == SetPoint(RATE, q0=value, thrust=thrust)
    alone = setpoints.read_attitude(
        sent(message("SET_ATTITUDE_TARGET", type_mask=0b10000111, q=[1, 0, 0, 0], thrust=thrust))
    )
    assert alone is not None
    assert alone == SetPoint(None, thrust=thrust)
    for make, loop, name in ((setpoints.position_target, POSITION, "x0"), (setpoints.velocity_target, VELOCITY, "v0")):
        plain = setpoints.read_position(sent(make(value)))
        assert plain == SetPoint(loop, ax0=0.0, **{name: value})
        assert setpoints.read_position(sent(make(value, forward))) == SetPoint(loop, ax0=forward, **{name: value})
        again = setpoints.setpoint_message(plain._replace(ax0=None), 0)
        assert setpoints.read_position(sent(again)) == plain
