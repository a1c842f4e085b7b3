"""Set-points over MAVLink: masks as PX4 reads them, scheduled in lockstep, refused with words, and never by rubbish."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fcu.command.cockpit import ME, OTHER
from tests.fcu.mavlink.desk import SYSTEM, TARGET, Desk
from twodof.errors import RefusalReason
from twodof.fcu.mavlink.setpoint_service import MOST_TOLD
from twodof.link.mavlink import modes
from twodof.link.mavlink.messages import message
from twodof.link.mavlink.setpoints import SetPoint, setpoint_message
from twodof.signals import ATTITUDE, OPEN_LOOP, POSITION, RATE, VELOCITY

pytestmark = pytest.mark.slow

LEVEL = setpoint_message(SetPoint(ATTITUDE, theta0=0.0, thrust=0.4), 0, **TARGET)


def flying(lockstep: bool = False) -> Desk:
    desk = Desk(lockstep)
    desk.arm()
    desk.say(LEVEL)
    assert desk.commander.set_mode(ME, modes.OFFBOARD).accepted
    desk.run()
    return desk


def float32(value: float) -> float:
    return float(np.float32(value))


@pytest.mark.parametrize(
    ("sent", "mode", "name", "value"),
    [
        (setpoint_message(SetPoint(ATTITUDE, theta0=0.17, thrust=0.5), 0, **TARGET), ATTITUDE, "theta0", 0.17),
        (setpoint_message(SetPoint(RATE, q0=-0.5, thrust=0.5), 0, **TARGET), RATE, "q0", -0.5),
        (setpoint_message(SetPoint(VELOCITY, v0=0.2), 0, **TARGET), VELOCITY, "v0", 0.2),
        (setpoint_message(SetPoint(VELOCITY, v0=0.2, ax0=0.7), 0, **TARGET), VELOCITY, "ax0", 0.7),
        (setpoint_message(SetPoint(POSITION, x0=-0.1), 0, **TARGET), POSITION, "x0", -0.1),
        (setpoint_message(SetPoint(POSITION, x0=-0.1, ax0=0.7), 0, **TARGET), POSITION, "ax0", 0.7),
        (
            message("SET_ATTITUDE_TARGET", type_mask=0b10000111, q=[1, 0, 0, 0], thrust=0.6, **TARGET),
            ATTITUDE,
            "thrust",
            0.6,
        ),
        (
            message("TWODOF_OPENLOOP", M=0.1, T=0.5, openloop=1, enableM=1, enableT=1, **TARGET),
            OPEN_LOOP,
            "M_open",
            0.1,
        ),
    ],
)
def test_each_message_flies_its_loop_in_the_next_tick(sent: Any, mode: int, name: str, value: float) -> None:
    desk = flying()
    assert desk.say(sent)
    asked = desk.run()
    assert asked.mode == mode
    assert asked.setpoint_new
    # A pitch goes through a quaternion of float32, whose rounding of 6e-8 the arc sine at most doubles.
    assert getattr(asked, name) == pytest.approx(float32(value), abs=2e-7 if name == "theta0" else 0.0)


def test_what_is_not_flown_is_refused_in_words() -> None:
    desk = flying()
    before = desk.run()
    desk.say(message("SET_POSITION_TARGET_LOCAL_NED", coordinate_frame=1, type_mask=63, afx=1.0, **TARGET))
    assert desk.run()._replace(link_new=False) == before
    assert "asks for nothing" in desk.told[0]
    assert desk.commander.refused[RefusalReason.NOTHING] == 1


@pytest.mark.parametrize("number", [math.nan, math.inf])
@pytest.mark.parametrize(
    ("type_mask", "wrong"),
    [
        (7, lambda number: {"thrust": number}),
        (7 | 32, lambda number: {"thrust_body": [0, 0, number]}),
        (7, lambda number: {"q": [1, 0, number, 0]}),
        (128, lambda number: {"body_pitch_rate": number}),
    ],
)
def test_an_attitude_target_with_what_is_no_number_is_refused(type_mask: int, wrong: Any, number: float) -> None:
    desk = flying()
    before = desk.run()
    fields = {"type_mask": type_mask, "q": [1, 0, 0, 0], "thrust": 0.4} | wrong(number)
    desk.say(message("SET_ATTITUDE_TARGET", **fields, **TARGET))
    assert desk.run()._replace(link_new=False) == before
    assert desk.commander.refused == {RefusalReason.INVALID: 1}


@pytest.mark.parametrize(
    ("mode", "name", "value"), [(modes.MANUAL, "M_open", -0.25), (modes.ATTITUDE, "theta0", -0.25 * 0.35)]
)
def test_manual_control(mode: int, name: str, value: float) -> None:
    desk = Desk()
    desk.arm()
    desk.commander.set_mode(ME, mode)
    desk.say(message("MANUAL_CONTROL", target=SYSTEM, x=250, z=400))
    asked = desk.run()
    assert getattr(asked, name) == pytest.approx(value)
    assert asked.thrust == 0.4
    desk.say(message("MANUAL_CONTROL", target=SYSTEM, x=32767, z=400))
    assert desk.commander.refused[RefusalReason.INVALID] == 1


def test_in_lockstep_the_time_stamp_names_the_tick_and_in_real_time_it_does_not() -> None:
    desk = flying(lockstep=True)
    at = desk.controller.tick + 10
    desk.say(setpoint_message(SetPoint(ATTITUDE, theta0=0.0, thrust=0.45), at, **TARGET))
    assert [desk.run().thrust for _ in range(12)] == [float32(0.4)] * 10 + [float32(0.45)] * 2
    desk = flying(lockstep=False)
    desk.say(setpoint_message(SetPoint(ATTITUDE, theta0=0.0, thrust=0.45), desk.controller.tick + 10, **TARGET))
    assert desk.run().thrust == float32(0.45)


def test_one_refusal_a_second_is_told_and_all_are_counted() -> None:
    desk = flying()
    for _ in range(50):
        desk.say(LEVEL, OTHER, "other")
    assert desk.commander.refused[RefusalReason.LEASE] == 50
    assert len(desk.told) == 1
    assert "system 250" in desk.told[0]
    desk.run(250)
    desk.say(LEVEL, OTHER, "other")
    assert len(desk.told) == 2


def test_a_flood_of_refused_setpoints_mutes_nobody_else() -> None:
    desk = flying()
    for _ in range(50):
        desk.say(LEVEL, OTHER, "other")
        desk.say(LEVEL, (251, 190), "third")
    assert len(desk.told) == 2
    for system in range(1, 101):  # one that takes ever new numbers
        desk.say(LEVEL, (system, 77), "other")
    assert len(desk.told) == MOST_TOLD


@pytest.mark.parametrize(("system", "component", "acts"), [(1, 1, True), (0, 0, True), (1, 0, True), (2, 1, False)])
def test_only_what_is_addressed_to_it_acts(system: int, component: int, acts: bool) -> None:
    desk = flying()
    sent = setpoint_message(
        SetPoint(ATTITUDE, theta0=0.0, thrust=0.45), 0, target_system=system, target_component=component
    )
    assert desk.say(sent)
    assert (desk.run().thrust == float32(0.45)) == acts


FLOATS = st.floats(width=32) | st.sampled_from([math.nan, math.inf, -math.inf, 0.0, -0.0, 1e38])
BYTE, WORD, LONG = st.integers(0, 255), st.integers(0, 65535), st.integers(0, 2**32 - 1)
SHORT = st.integers(-32768, 32767)
ANY = st.one_of(
    st.builds(
        lambda **fields: message("SET_ATTITUDE_TARGET", **fields),
        time_boot_ms=LONG,
        target_system=BYTE,
        target_component=BYTE,
        type_mask=BYTE,
        q=st.lists(FLOATS, min_size=4, max_size=4),
        body_pitch_rate=FLOATS,
        thrust=FLOATS,
        thrust_body=st.lists(FLOATS, min_size=3, max_size=3),
    ),
    st.builds(
        lambda **fields: message("SET_POSITION_TARGET_LOCAL_NED", **fields),
        time_boot_ms=LONG,
        target_system=st.sampled_from([0, 1, 2]),
        coordinate_frame=st.sampled_from([1, 8, 7, 255]),
        type_mask=WORD,
        x=FLOATS,
        vx=FLOATS,
        afx=FLOATS,
    ),
    st.builds(lambda **fields: message("MANUAL_CONTROL", **fields), target=BYTE, x=SHORT, z=SHORT, r=SHORT),
    st.builds(
        lambda **fields: message("TWODOF_OPENLOOP", **fields),
        tick=LONG,
        M=FLOATS,
        T=FLOATS,
        target_system=st.sampled_from([0, 1, 2]),
        openloop=BYTE,
        enableM=BYTE,
        enableT=BYTE,
    ),
)


@settings(max_examples=40)
@given(sent=st.lists(ANY, max_size=12), lockstep=st.booleans(), mode=st.sampled_from([*modes.BY_NUMBER]))
def test_no_set_point_whatever_it_holds_arms_or_asks_for_what_is_no_number(
    sent: list[Any], lockstep: bool, mode: int
) -> None:
    desk = Desk(lockstep)
    desk.run(3)
    for one in sent:
        desk.say(one)
        assert not desk.run().arm
    assert not desk.commander.armed
    desk = flying(lockstep)
    desk.commander.set_mode(ME, mode)
    for one in sent:
        desk.say(one)
        asked = desk.run()
        assert all(math.isfinite(value) for value in asked)
        assert 0 <= asked.mode <= POSITION
