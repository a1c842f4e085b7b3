"""The commander: modes, set-points, and what is asked of the flight code for each of them."""

from math import inf, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fcu.command.cockpit import LEVEL_FLIGHT, ME, OTHER, Cockpit, armed, offboard
from twodof.errors import RefusalReason
from twodof.fcu.command.command_lease import MOST_REMARKS
from twodof.fcu.command.setpoints import (
    CAPACITY,
    FRESH,
    HORIZON,
    PITCH_AT_FULL,
    RATE_AT_FULL,
    VELOCITY_AT_FULL,
    SetPoint,
)
from twodof.fcu.control.hardware import ControlInput
from twodof.flight.failsafe.causes_and_actions import BIT
from twodof.flight.failsafe.state_machine import BRAKE, DESCEND, FLYING, LEVEL
from twodof.flight.failsafe.state_machine import OFF as STOPPED_BY_FAILSAFE
from twodof.link.mavlink import modes
from twodof.link.mavlink.dialect import MavResult
from twodof.signals import ATTITUDE, OFF, OPEN_LOOP, POSITION, RATE, VELOCITY

# Set-points and offboard.


def test_offboard_flies_the_last_set_point_and_keeps_what_it_leaves_open() -> None:
    cockpit = offboard()
    assert cockpit.steps[-1].asked.setpoint_new
    assert not cockpit.run().setpoint_new
    for setpoint, mode in (
        (SetPoint(RATE, q0=0.5), RATE),
        (SetPoint(VELOCITY, v0=0.1, ax0=0.2), VELOCITY),
        (SetPoint(POSITION, x0=-0.2), POSITION),
        (SetPoint(ATTITUDE, theta0=0.1), ATTITUDE),
        (SetPoint(None, thrust=0.5), ATTITUDE),
    ):
        cockpit.commander.setpoint(ME, setpoint)
        asked = cockpit.run()
        assert asked.mode == mode
        assert asked.setpoint_new
    assert asked == ControlInput(ATTITUDE, True, -0.2, 0.1, 0.2, 0.1, 0.5, 0.5, link_new=True, setpoint_new=True)


@given(
    name=st.sampled_from(["x0", "v0", "ax0", "theta0", "q0", "thrust", "M_open"]),
    value=st.sampled_from([nan, inf, -inf]),
)
def test_a_number_that_is_none_changes_nothing_and_is_counted(name: str, value: float) -> None:
    cockpit = offboard()
    before = cockpit.run()
    verdict = cockpit.commander.setpoint(ME, LEVEL_FLIGHT._replace(**{name: value}))
    assert verdict.result == MavResult.DENIED
    assert cockpit.run() == before
    assert cockpit.commander.refused == {RefusalReason.INVALID: 1}


def test_offboard_wants_a_stream_above_2_hz() -> None:
    cockpit = armed()
    commander = cockpit.commander
    assert commander.set_mode(ME, modes.OFFBOARD).result == MavResult.TEMPORARILY_REJECTED
    commander.setpoint(ME, LEVEL_FLIGHT)
    cockpit.run(FRESH + 1)
    assert commander.set_mode(ME, modes.OFFBOARD).result == MavResult.TEMPORARILY_REJECTED
    commander.setpoint(ME, LEVEL_FLIGHT)
    cockpit.run(FRESH)
    assert commander.set_mode(ME, modes.OFFBOARD).accepted


def test_from_a_hold_into_offboard_what_is_left_open_stays_as_it_flies() -> None:
    cockpit = offboard(LEVEL_FLIGHT._replace(thrust=0.5))
    commander = cockpit.commander
    commander.set_mode(ME, modes.HOLD)
    assert cockpit.run().thrust == 0.375
    commander.open_loop(ME, 0.1, 0.0, True, True, False)  # "the thrust stays"
    assert commander.set_mode(ME, modes.OFFBOARD).accepted
    asked = cockpit.run()
    assert (asked.mode, asked.M_open, asked.thrust) == (OPEN_LOOP, 0.1, 0.375)


def test_offboard_entered_again_before_a_new_set_point_flies_on_what_flew() -> None:
    cockpit = offboard(LEVEL_FLIGHT._replace(theta0=0.3))
    cockpit.commander.set_mode(ME, modes.HOLD)
    cockpit.run()
    assert cockpit.commander.set_mode(ME, modes.OFFBOARD).accepted
    asked = cockpit.run(2)
    assert (asked.mode, asked.theta0, asked.thrust, asked.setpoint_new) == (ATTITUDE, 0.0, 0.375, False)


def test_a_stream_that_ends_leaves_the_mode_and_goes_on_when_it_comes_back() -> None:
    cockpit = offboard()
    quiet = cockpit.run(400)
    assert quiet.mode == ATTITUDE
    assert not quiet.setpoint_new  # the failsafe counts, and levels
    assert cockpit.commander.custom_mode == modes.OFFBOARD
    cockpit.commander.setpoint(ME, SetPoint(ATTITUDE, theta0=0.2))
    assert cockpit.run().theta0 == 0.2


@pytest.mark.parametrize("mode", [modes.MANUAL, modes.RATE, modes.ATTITUDE, modes.POSITION, modes.HOLD])
def test_targets_act_in_offboard_only(mode: int) -> None:
    cockpit = armed()
    cockpit.commander.set_mode(ME, mode)
    before = cockpit.run(2)
    assert cockpit.commander.setpoint(ME, SetPoint(RATE, q0=1.0, thrust=0.7)).accepted
    assert cockpit.run() == before


def test_set_points_act_at_their_tick_in_the_order_in_which_they_came() -> None:
    cockpit = offboard()
    base = cockpit.tick
    for ahead, theta0 in ((30, 0.3), (10, 0.1), (30, 0.35), (20, 0.2)):
        assert cockpit.commander.setpoint(ME, SetPoint(ATTITUDE, theta0=theta0), base + ahead).accepted
    seen = [cockpit.run().theta0 for _ in range(40)]
    assert seen == [0.0] * 10 + [0.1] * 10 + [0.2] * 10 + [0.35] * 10
    assert sum(step.asked.setpoint_new for step in cockpit.steps[-40:]) == 3


def test_what_waits_is_bounded_in_number_and_time() -> None:
    cockpit = offboard()
    for place in range(CAPACITY):
        assert cockpit.commander.setpoint(ME, LEVEL_FLIGHT, cockpit.tick + 1 + place).accepted
    assert not cockpit.commander.setpoint(ME, LEVEL_FLIGHT, cockpit.tick + 5).accepted
    cockpit.run(10)
    assert not cockpit.commander.setpoint(ME, LEVEL_FLIGHT, cockpit.tick + HORIZON + 1).accepted
    assert cockpit.commander.refused[RefusalReason.QUEUE] == 2
    cockpit.commander.arming.disarm(ME)
    cockpit.run(CAPACITY)
    assert cockpit.arm().accepted
    assert cockpit.run(CAPACITY).mode == OFF


# Modes.


def test_level_hold_flies_on_board_with_the_thrust_of_the_parameter() -> None:
    cockpit = armed()
    assert cockpit.commander.set_mode(ME, modes.HOLD).accepted
    for _ in range(3):
        asked = cockpit.run()
        assert (asked.mode, asked.theta0, asked.thrust, asked.setpoint_new) == (ATTITUDE, 0.0, 0.375, True)
    assert cockpit.commander.set_mode(ME, modes.MANUAL).accepted
    assert not cockpit.run().setpoint_new


def test_a_hold_chosen_before_arming_starts_nothing() -> None:
    cockpit = Cockpit()
    cockpit.run(2)
    assert cockpit.commander.set_mode(ME, modes.HOLD).accepted
    assert cockpit.arm().accepted
    assert cockpit.run(5).mode == OFF
    assert cockpit.commander.set_mode(ME, modes.HOLD).accepted
    assert cockpit.run().mode == ATTITUDE


@given(number=st.integers(0, 2**32 - 1).filter(lambda number: number not in modes.BY_NUMBER))
def test_a_mode_that_is_none_is_refused(number: int) -> None:
    cockpit = armed()
    assert cockpit.commander.set_mode(ME, number).result == MavResult.UNSUPPORTED
    assert cockpit.commander.custom_mode == modes.MANUAL


@pytest.mark.parametrize(
    ("mode", "flown", "name", "value"),
    [
        (modes.MANUAL, OPEN_LOOP, "M_open", -0.5),
        (modes.RATE, RATE, "q0", -0.5 * RATE_AT_FULL),
        (modes.ATTITUDE, ATTITUDE, "theta0", -0.5 * PITCH_AT_FULL),
        (modes.POSITION, VELOCITY, "v0", 0.5 * VELOCITY_AT_FULL),
    ],
)
def test_a_stick_forward_lowers_the_nose_and_goes_to_plus_x(mode: int, flown: int, name: str, value: float) -> None:
    cockpit = armed()
    cockpit.commander.set_mode(ME, mode)
    assert cockpit.commander.sticks(ME, 0.5, 0.4).accepted
    asked = cockpit.run()
    assert asked.mode == flown
    assert getattr(asked, name) == value
    assert not cockpit.commander.sticks(ME, 1.5, 0.4).accepted
    assert not cockpit.commander.sticks(ME, nan, 0.4).accepted
    assert not cockpit.commander.sticks(ME, 0.0, -0.1).accepted


def test_a_centred_stick_holds_the_position_where_it_was_let_go() -> None:
    cockpit = armed()
    cockpit.commander.set_mode(ME, modes.POSITION)
    cockpit.commander.sticks(ME, 1.0, 0.0)
    cockpit.run()
    cockpit.steps[-1].x = 0.12  # the estimate, in the step that the commander has seen
    cockpit.commander.sticks(ME, 0.0, 0.0)
    assert cockpit.run()[:2] == (POSITION, True)
    assert cockpit.steps[-1].asked.x0 == 0.12
    cockpit.commander.sticks(ME, 0.0, 0.0)
    assert cockpit.run().x0 == 0.12


def test_an_open_loop_message_flies_its_moment_about_the_trim() -> None:
    cockpit = armed()
    commander = cockpit.commander
    assert commander.open_loop(ME, 0.1, 0.4, True, True, True).accepted
    asked = cockpit.run()
    assert (asked.mode, asked.M_open, asked.thrust, asked.use_trim) == (OPEN_LOOP, 0.1, 0.4, True)
    assert commander.openloop == (cockpit.tick - 1, 0.1, 0.4, True, True, True, 1)
    commander.open_loop(ME, 0.2, 0.9, True, False, False)  # the trim alone, the thrust stays
    asked = cockpit.run()
    assert (asked.M_open, asked.thrust) == (0.0, 0.4)
    commander.open_loop(ME, 0.2, 0.0, True, True, True)
    asked = cockpit.run()
    assert (asked.M_open, asked.thrust, asked.use_trim) == (0.2, 0.0, False)


def test_the_end_of_an_open_loop_is_a_level_attitude_but_in_manual_mode() -> None:
    cockpit = armed()
    cockpit.commander.open_loop(ME, 0.1, 0.4, True, True, True)
    cockpit.commander.open_loop(ME, 0.1, 0.4, False, True, False)
    asked = cockpit.run()
    assert (asked.mode, asked.M_open, asked.thrust) == (OPEN_LOOP, 0.0, 0.4)
    assert cockpit.commander.set_mode(ME, modes.OFFBOARD).accepted
    cockpit.commander.open_loop(ME, 0.1, 0.4, True, True, True)
    assert cockpit.run().mode == OPEN_LOOP
    cockpit.commander.open_loop(ME, 0.1, 0.4, False, True, False)
    asked = cockpit.run()
    assert (asked.mode, asked.theta0, asked.thrust) == (ATTITUDE, 0.0, 0.4)


def test_an_open_loop_that_ends_levels_what_was_pitched_with_the_thrust_that_it_names() -> None:
    cockpit = offboard(LEVEL_FLIGHT._replace(theta0=0.3))
    assert cockpit.commander.open_loop(ME, 0.1, 0.5, False, False, True).accepted
    asked = cockpit.run()
    assert (asked.mode, asked.theta0, asked.thrust) == (ATTITUDE, 0.0, 0.5)


def test_an_open_loop_that_is_streamed_while_it_arms_is_told_when_it_flies() -> None:
    cockpit = Cockpit()
    cockpit.run(2)
    commander = cockpit.commander
    commander.open_loop(ME, 0.1, 0.4, True, True, True)
    commander.set_mode(ME, modes.OFFBOARD)
    commander.open_loop(ME, 0.1, 0.4, True, True, True)
    assert cockpit.arm().accepted
    assert not cockpit.steps[-1].asked.mode
    assert commander.openloop == (cockpit.tick, 0.1, 0.4, True, True, True, 1)
    assert cockpit.run().mode == OPEN_LOOP
    commander.set_mode(ME, modes.HOLD)
    commander.open_loop(ME, 0.2, 0.4, True, True, True)
    assert not commander.openloop.openloop
    commander.set_mode(ME, modes.OFFBOARD)
    assert commander.openloop.M == 0.2


def test_what_is_streamed_before_offboard_is_kept_in_one() -> None:
    cockpit = armed()
    commander = cockpit.commander
    commander.set_mode(ME, modes.ATTITUDE)
    commander.setpoint(ME, SetPoint(ATTITUDE, theta0=0.3, thrust=0.4))
    commander.setpoint(ME, SetPoint(None, thrust=0.5))
    assert cockpit.run().mode == OFF
    assert commander.set_mode(ME, modes.OFFBOARD).accepted
    asked = cockpit.run()
    assert (asked.mode, asked.theta0, asked.thrust) == (ATTITUDE, 0.3, 0.5)


def test_sticks_are_no_stream_for_offboard() -> None:
    cockpit = armed()
    cockpit.commander.set_mode(ME, modes.RATE)
    cockpit.commander.sticks(ME, 0.0, 0.4)
    assert cockpit.commander.set_mode(ME, modes.OFFBOARD).result == MavResult.TEMPORARILY_REJECTED


def test_the_open_loop_message_in_use_is_told_until_something_else_flies() -> None:
    cockpit = armed()
    commander = cockpit.commander

    def open_loop() -> None:
        assert commander.open_loop(ME, 0.1, 0.4, True, True, True).accepted

    assert commander.open_loop(ME, 0.1, 0.9, True, True, False).accepted
    assert commander.openloop[1:6] == (0.1, 0.0, True, True, False), "what is not enabled is told as 0"
    open_loop()
    revision = commander.openloop.revision
    open_loop()  # the same again changes nothing
    assert commander.open_loop(ME, nan, 0.4, True, False, True).accepted  # what does not count is not told
    assert commander.openloop[1:6] == (0.0, 0.4, True, False, True)
    open_loop()
    revision += 2
    assert commander.openloop.revision == revision
    for number, close in enumerate(
        (
            lambda: commander.sticks(ME, 0.0, 0.1),
            lambda: commander.open_loop(ME, 0.1, 0.4, False, True, True),
            lambda: commander.set_mode(ME, modes.HOLD),
            lambda: commander.arming.disarm(ME),
        )
    ):
        commander.set_mode(ME, modes.MANUAL)
        open_loop()
        assert commander.openloop.openloop
        assert close().accepted
        cockpit.run()
        assert commander.openloop[1:6] == (0.0, 0.0, False, False, False)
        assert commander.openloop.revision == revision + 2 * number + 1


# What it says of itself.


def test_what_nobody_drains_is_bounded() -> None:
    cockpit = Cockpit()
    for _ in range(2 * MOST_REMARKS):
        cockpit.commander.arming.kill(ME)
    assert len(cockpit.commander.remarks) == MOST_REMARKS == 64


def test_heartbeats_numbers_follow_the_failsafe() -> None:
    cockpit = Cockpit()
    commander = cockpit.commander
    assert commander.system_status == modes.UNREADY
    cockpit.run()
    assert (commander.system_status, commander.base_mode) == (modes.STANDBY, 65)
    cockpit.failsafe.causes = BIT["tilted"]
    cockpit.run()
    assert commander.system_status == modes.UNREADY
    cockpit.failsafe.causes = 0
    cockpit.run()
    cockpit.arm()
    commander.setpoint(ME, LEVEL_FLIGHT)
    commander.set_mode(ME, modes.OFFBOARD)
    cockpit.run()
    assert (commander.system_status, commander.base_mode) == (modes.ACTIVE, 128 + 16 + 1)
    cockpit.failsafe.acts = LEVEL
    cockpit.run()
    assert commander.system_status == modes.CRITICAL


def test_a_restart_forgets_all_but_the_lease() -> None:
    cockpit = offboard(talking=())
    commander = cockpit.commander
    commander.lease.request(ME, 20_000)
    commander.open_loop(ME, 0.1, 0.1, True, True, True)
    revision = commander.openloop.revision
    commander.arming.disarm(ME)
    cockpit.run()
    left = commander.lease.left
    commander.restart()
    assert (commander.openloop.openloop, commander.openloop.revision > revision) == (False, True)
    assert commander.lease.holder == ME
    assert commander.lease.left == left
    assert (commander.custom_mode, commander.armed) == (modes.MANUAL, False)
    assert commander.system_status == modes.UNREADY
    assert commander.control_input(0) == ControlInput()
    assert commander.open_loop(OTHER, 0.1, 0.1, True, True, True).result == MavResult.TEMPORARILY_REJECTED


def test_the_same_tuple_is_given_while_nothing_changes() -> None:
    """So 250 calls a second make no new object."""
    cockpit = offboard(talking=())
    cockpit.run(2)
    quiet = cockpit.commander.control_input(cockpit.tick)
    assert all(cockpit.commander.control_input(cockpit.tick + 1 + later) is quiet for later in range(50))


def test_what_the_failsafe_does_is_said_in_words() -> None:
    cockpit = offboard()
    said = cockpit.commander.remarks
    said.clear()
    cockpit.failsafe.acts, cockpit.failsafe.causes = LEVEL, BIT["setpoint_lost"]
    cockpit.run(3)
    assert said == [(4, "failsafe: level (setpoint_lost)")]
    cockpit.failsafe.acts, cockpit.failsafe.causes = None, 0
    cockpit.run(3)
    assert said[1:] == [(6, "failsafe: over, it flies what is asked again")]
    cockpit.failsafe.acts, cockpit.failsafe.causes = STOPPED_BY_FAILSAFE, BIT["imu_lost"]
    cockpit.run(3)
    assert said[2:] == [(2, "failsafe: motors off (imu_lost)")]


@pytest.mark.parametrize("state", [FLYING, LEVEL, BRAKE, DESCEND])
def test_arming_and_disarming_are_no_words_of_the_failsafe(state: int) -> None:
    cockpit = offboard()
    assert cockpit.commander.remarks == []
    cockpit.failsafe.acts = state
    cockpit.run(2)
    cockpit.commander.remarks.clear()
    cockpit.commander.arming.disarm(ME)
    cockpit.run(3)
    assert cockpit.commander.remarks == []


def test_an_action_brings_no_set_point_of_before_back() -> None:
    cockpit = offboard()
    cockpit.run(10)
    cockpit.failsafe.acts = LEVEL
    assert not any(cockpit.run().setpoint_new for _ in range(4))


def test_a_link_that_is_lost_speaks_against_arming_until_somebody_is_heard() -> None:
    cockpit = Cockpit(talking=())
    cockpit.failsafe.causes = BIT["link_lost"]
    cockpit.run(3)
    assert cockpit.commander.system_status == modes.UNREADY
    cockpit.commander.lease.note_frame(ME, True)
    assert cockpit.commander.system_status == modes.STANDBY
    cockpit.run()
    assert cockpit.commander.arming.arm(ME).result == MavResult.IN_PROGRESS
