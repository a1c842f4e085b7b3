"""Arming, disarming and the kill: what the commander lets through, and what the failsafe answers."""

import pytest

from tests.fcu.command.cockpit import COMPANION, LEVEL_FLIGHT, ME, OTHER, Cockpit, armed, offboard
from twodof.errors import RefusalReason
from twodof.fcu.command.arming import ArmingControl
from twodof.fcu.command.command_lease import failed, rejected
from twodof.fcu.command.setpoints import FRESH, OPENLOOP, STICKS
from twodof.fcu.control.hardware import ControlInput
from twodof.flight.failsafe.causes_and_actions import BIT
from twodof.flight.failsafe.state_machine import DISARMED, FLYING, LEVEL
from twodof.flight.failsafe.state_machine import OFF as STOPPED_BY_FAILSAFE
from twodof.flight.failsafe.state_machine import REFUSED as REFUSED_BY_FAILSAFE
from twodof.link.mavlink import modes
from twodof.link.mavlink.dialect import MavResult
from twodof.link.mavlink.setpoints import SetPoint
from twodof.signals import ATTITUDE, OFF, OPEN_LOOP

# Arming.


def streaming(thrust: float = 0.4) -> Cockpit:
    """Return one in offboard with a level set-point, not armed."""
    cockpit = Cockpit()
    cockpit.run(2)
    assert cockpit.commander.setpoint(ME, LEVEL_FLIGHT._replace(thrust=thrust)).accepted
    assert cockpit.commander.set_mode(ME, modes.OFFBOARD).accepted
    return cockpit


def test_arming_is_an_edge_that_the_failsafe_answers_in_its_tick() -> None:
    cockpit = Cockpit()
    cockpit.run(3)
    assert cockpit.commander.arming.arm(ME).result == MavResult.IN_PROGRESS
    assert not cockpit.commander.armed
    assert cockpit.run().arm
    assert cockpit.commander.arming.answer.accepted
    assert cockpit.commander.armed
    assert cockpit.commander.arming.arm(ME).accepted
    assert cockpit.run(10) == ControlInput(arm=True, link_new=True)  # nothing is asked: the motors are off


@pytest.mark.parametrize("cause", sorted(BIT))
def test_every_cause_that_the_failsafe_has_refuses_arming_by_its_name(cause: str) -> None:
    cockpit = Cockpit()
    cockpit.failsafe.causes = BIT[cause]
    cockpit.run(3)
    cured = cause == "link_lost"  # the command itself is heard over the link
    if not cured:
        verdict = cockpit.commander.arming.arm(ME)
        assert verdict.result == MavResult.TEMPORARILY_REJECTED
        assert cause in verdict.text
    cockpit.failsafe.causes = 0
    cockpit.run()
    assert cockpit.commander.arming.arm(ME).result == MavResult.IN_PROGRESS
    cockpit.failsafe.causes = BIT[cause]  # it comes in the very tick
    cockpit.run()
    assert cockpit.commander.arming.answer.result == MavResult.TEMPORARILY_REJECTED
    assert cause in cockpit.commander.arming.answer.text
    assert not cockpit.run().arm
    assert cockpit.failsafe.state == DISARMED


@pytest.mark.parametrize("mode", [modes.MANUAL, modes.RATE, modes.ATTITUDE, modes.POSITION])
def test_arming_is_refused_while_sticks_ask_for_something(mode: int) -> None:
    cockpit = Cockpit()
    cockpit.run(2)
    commander = cockpit.commander
    commander.set_mode(ME, mode)
    for pitch, thrust in ((0.1, 0.4), (0.0, 0.1)):
        commander.sticks(ME, pitch, thrust)
        assert "not_idle" in commander.arming.arm(ME).text
    commander.sticks(ME, 0.0, 0.0)
    assert cockpit.arm().accepted == (mode != modes.POSITION)  # which holds it even with the stick centred


@pytest.mark.parametrize(("ago", "arms"), [(FRESH, False), (FRESH + 1, True)])
def test_sticks_count_for_half_a_second(ago: int, arms: bool) -> None:
    cockpit = Cockpit()
    cockpit.run(2)
    cockpit.commander.sticks(ME, 0.1, 0.4)
    cockpit.run(ago)
    assert cockpit.arm().accepted == arms


@pytest.mark.parametrize("kind", [OPENLOOP, STICKS])
def test_what_was_asked_for_in_another_mode_does_not_keep_from_arming_in_one_that_does_not_hear_it(kind: str) -> None:
    """A stick that is held is heard in the next mode too: tests/fcu/command/test_hazards.py."""
    cockpit = Cockpit()
    cockpit.run(2)
    if kind == STICKS:
        cockpit.commander.sticks(ME, 0.1, 0.4)
    else:
        cockpit.commander.open_loop(ME, 0.1, 0.4, True, True, True)
    cockpit.commander.set_mode(ME, modes.HOLD if kind == STICKS else modes.ATTITUDE)
    assert cockpit.arm().accepted


def test_in_offboard_what_is_streamed_flies_from_the_tick_after_it_has_armed() -> None:
    """The order that PX4 documents: stream, offboard, arm. In the tick in which it arms nothing is asked for yet."""
    cockpit = streaming()
    assert cockpit.commander.arming.arm(ME).result == MavResult.IN_PROGRESS
    assert cockpit.run().mode == OFF
    assert cockpit.commander.arming.answer.accepted
    asked = cockpit.run()
    assert (asked.mode, asked.thrust, asked.setpoint_new) == (ATTITUDE, 0.4, True)


def test_in_offboard_a_stream_without_thrust_arms_and_stands() -> None:
    cockpit = streaming(thrust=0.0)
    commander = cockpit.commander
    assert cockpit.arm().accepted
    commander.setpoint(ME, LEVEL_FLIGHT._replace(thrust=0.0))
    assert cockpit.run().mode == OFF
    commander.setpoint(ME, LEVEL_FLIGHT)
    assert cockpit.run().mode == ATTITUDE


@pytest.mark.parametrize(("mode", "ago"), [(modes.OFFBOARD, FRESH + 1), (modes.MANUAL, 0)])
def test_an_old_stream_and_one_in_another_mode_do_not_fly_after_arming(mode: int, ago: int) -> None:
    cockpit = streaming()
    cockpit.commander.set_mode(ME, mode)
    cockpit.run(ago)
    assert cockpit.arm().accepted
    assert cockpit.run(20).mode == OFF


def test_asking_again_and_again_does_not_wait_for_longer() -> None:
    cockpit = Cockpit()
    cockpit.run(2)
    for tick in range(2, 60):
        if cockpit.commander.arming.arm(ME).result == MavResult.IN_PROGRESS:
            cockpit.commander.control_input(tick)
            cockpit.commander.after_step(cockpit.failsafe.step(tick, ControlInput()))  # deaf
        if cockpit.commander.arming.answer.result == MavResult.FAILED:
            break
    assert tick < 30


def test_a_set_point_for_the_very_tick_in_which_it_arms_flies_from_the_next_on() -> None:
    cockpit = streaming()
    cockpit.commander.setpoint(ME, LEVEL_FLIGHT._replace(theta0=0.1), cockpit.tick + 1)
    cockpit.run()
    assert cockpit.commander.arming.arm(ME).result == MavResult.IN_PROGRESS
    cockpit.commander.setpoint(ME, LEVEL_FLIGHT._replace(theta0=0.2), cockpit.tick)
    cockpit.commander.setpoint(ME, LEVEL_FLIGHT._replace(theta0=0.3), cockpit.tick + 1)
    assert cockpit.run().mode == OFF
    assert cockpit.commander.arming.answer.accepted
    assert cockpit.run().theta0 == 0.3


def alone() -> ArmingControl:
    """Before a flight code that the test speaks for."""
    return Cockpit(lockstep=True).commander.arming


class Said:
    """A step of the flight code, as far as arming looks at it."""

    def __init__(self, tick: int, state: int = DISARMED, reason: int = 0, causes: int = 0) -> None:
        self.tick, self.state, self.reason, self.causes = tick, state, reason, causes


def test_what_the_failsafe_says_before_it_was_asked_is_no_answer() -> None:
    arming = alone()
    assert arming.request(10).result == MavResult.IN_PROGRESS
    for state in (FLYING, LEVEL, REFUSED_BY_FAILSAFE):
        arming.update_input(9)
        assert not arming.arm_input
        arming.read_answer(Said(9, state))
        assert arming.pending
    arming.update_input(10)
    assert arming.arm_input
    arming.read_answer(Said(10, FLYING))
    assert arming.answer.accepted


@pytest.mark.parametrize(
    ("reason", "causes", "words"),
    [
        (BIT["tilted"] | BIT["not_idle"], 0, "not armed: not_idle, tilted"),
        (BIT["tilted"], BIT["not_idle"], "not armed: tilted"),
        (0, BIT["not_idle"], "not armed: not_idle"),
        (0, 0, "not armed: it levelled or braked a moment ago"),
    ],
)
def test_its_refusal_is_told_in_its_words(reason: int, causes: int, words: str) -> None:
    arming = alone()
    arming.request(0)
    arming.update_input(0)
    arming.read_answer(Said(0, REFUSED_BY_FAILSAFE, reason, causes))
    assert (arming.answer, arming.arm_input) == (rejected(words), False)


def test_it_is_waited_for_a_tenth_of_a_second() -> None:
    arming = alone()
    arming.request(100)
    for tick in range(100, 125):
        arming.update_input(tick)
        arming.read_answer(Said(tick))
        assert (arming.pending, arming.arm_input) == (True, True)
    arming.read_answer(Said(125))
    assert (arming.answer, arming.arm_input) == (failed("not armed: the flight code did not answer"), False)


# Disarming and the kill.


@pytest.mark.parametrize("source", [ME, OTHER, COMPANION])
def test_disarming_and_a_kill_are_obeyed_whoever_asks_and_a_kill_holds(source: tuple[int, int]) -> None:
    cockpit = offboard()
    assert cockpit.commander.arming.disarm(source).accepted
    assert cockpit.run() == ControlInput(link_new=True)
    assert not cockpit.commander.armed
    cockpit = offboard()
    assert cockpit.commander.arming.kill(source).accepted
    assert cockpit.run() == ControlInput(link_new=True)
    assert "killed" in cockpit.commander.arming.arm(ME).text
    assert not cockpit.run(5).arm
    assert cockpit.commander.system_status == modes.TERMINATED
    assert (2, f"killed by system {source[0]}, component {source[1]}") in cockpit.commander.remarks
    assert cockpit.commander.arming.kill(COMPANION).accepted  # a kill again
    assert cockpit.commander.arming.killed_by == COMPANION
    assert "killed by system 1, component 191" in cockpit.commander.arming.arm(ME).text
    assert cockpit.commander.arming.disarm(ME).accepted
    assert "killed" in cockpit.commander.arming.arm(ME).text
    assert cockpit.commander.arming.release(ME).accepted
    assert cockpit.commander.remarks[-1] == (4, "released by system 250, component 190")
    assert cockpit.commander.arming.killed_by is None
    assert not cockpit.run(5).arm, "nothing arms by it"
    assert cockpit.arm().accepted
    assert cockpit.run(5).mode == OFF


@pytest.mark.parametrize("killer", [ME, OTHER])
def test_a_program_that_cleans_up_behind_itself_does_not_undo_the_kill_that_ended_it(killer: tuple[int, int]) -> None:
    """Its block ends by a disarming; then it is started again, disarms, resets and arms."""
    cockpit = offboard()
    commander = cockpit.commander

    def started_again() -> None:
        assert commander.arming.disarm(ME).accepted
        commander.restart()
        cockpit.failsafe.state, cockpit.tick = DISARMED, 0
        cockpit.run(2)

    commander.arming.kill(killer)
    cockpit.run()
    for _ in range(2):
        started_again()
        assert "killed by" in commander.arming.arm(ME).text
        assert not cockpit.run(5).arm
        assert commander.system_status == modes.TERMINATED
    assert commander.arming.release(ME).accepted
    assert cockpit.arm().accepted
    started_again()
    assert not commander.arming.killed_by, "nor does a reset kill"


def test_who_may_not_command_may_not_release_and_what_was_not_killed_needs_none() -> None:
    cockpit = armed()
    said = len(cockpit.commander.remarks)
    assert cockpit.commander.arming.release(ME).accepted
    assert cockpit.run().arm, "a release stops nothing"
    cockpit.commander.arming.kill(OTHER)
    verdict = cockpit.commander.arming.release(OTHER)
    assert verdict == rejected("release refused: system 250, component 190 holds the lease", RefusalReason.LEASE)
    assert cockpit.commander.arming.killed_by is not None
    assert len(cockpit.commander.remarks) == said + 1


def test_arming_acknowledges_a_stop_by_the_failsafe() -> None:
    cockpit = offboard()
    cockpit.failsafe.acts = STOPPED_BY_FAILSAFE
    cockpit.run(2)
    assert not cockpit.commander.armed
    cockpit.failsafe.causes = BIT["tilted"]
    assert cockpit.arm().text == "not armed: tilted", "the cause is not gone"
    assert not cockpit.run().arm
    cockpit.failsafe.acts, cockpit.failsafe.causes = None, 0
    cockpit.run()
    assert cockpit.arm().accepted
    assert cockpit.run().mode == OFF


def test_a_repeated_request_does_not_arm_after_a_stop() -> None:
    """Its first copy has armed the drone, and its acknowledgement got lost: nobody asks for a second flight."""
    cockpit = offboard()
    cockpit.failsafe.acts = STOPPED_BY_FAILSAFE
    cockpit.run(2)
    cockpit.failsafe.acts = None
    assert "stopped the motors" in cockpit.commander.arming.arm(ME, repeated=True).text
    assert cockpit.commander.arming.arm(ME).result == MavResult.IN_PROGRESS
    assert [cockpit.run().arm for _ in range(2)] == [False, True], "the failsafe sees a disarming first"
    assert cockpit.commander.arming.answer.accepted


@pytest.mark.parametrize("lockstep", [False, True])
def test_disarmed_and_armed_again_between_two_ticks_the_failsafe_sees_both(lockstep: bool) -> None:
    cockpit = offboard(lockstep=lockstep)
    assert cockpit.commander.arming.disarm(ME).accepted
    assert cockpit.commander.arming.arm(ME).result == MavResult.IN_PROGRESS
    asked = [cockpit.run() for _ in range(2)]
    assert [one.arm for one in asked] == [False, True]
    assert cockpit.commander.arming.answer.accepted
    assert cockpit.run(5).mode == OFF  # nothing of before flies


def test_disarming_before_it_was_armed_answers_the_arming() -> None:
    cockpit = Cockpit()
    cockpit.run(2)
    cockpit.commander.arming.arm(ME)
    cockpit.commander.arming.disarm(OTHER)
    assert cockpit.commander.arming.answer.result == MavResult.FAILED
    assert not cockpit.run(3).arm


def test_an_open_loop_set_point_at_rest_does_not_keep_from_arming() -> None:
    cockpit = Cockpit()
    cockpit.run(2)
    cockpit.commander.setpoint(ME, SetPoint(OPEN_LOOP, M_open=0.0, thrust=0.0), kind=OPENLOOP)
    assert cockpit.arm().accepted
    cockpit.commander.arming.disarm(ME)
    cockpit.run(2)
    cockpit.commander.setpoint(ME, SetPoint(OPEN_LOOP, M_open=0.1, thrust=0.0), kind=OPENLOOP)
    assert "not_idle" in cockpit.commander.arming.arm(ME).text
