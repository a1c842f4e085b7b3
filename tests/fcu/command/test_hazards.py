"""Hazards that a commander alone can bring about: what was asked for before acts after, or nobody watches."""

import ast
from pathlib import Path

import pytest

from tests.fcu.assembled import ARM, TARGET, Assembled
from tests.fcu.command.cockpit import ME, OTHER, Cockpit, Rig, armed, offboard
from twodof import fcu
from twodof.errors import RefusalReason
from twodof.excitation import Impulse
from twodof.fcu.command.excitation_player import REFUSED, STOPPED, written_out
from twodof.fcu.command.setpoints import FRESH
from twodof.fcu.mavlink.parameter_service import BEGIN, COMMIT, INT32, REAL32
from twodof.fcu.parameters.table import VehicleParameter
from twodof.flight.failsafe.causes_and_actions import BIT
from twodof.flight.failsafe.state_machine import BRAKE, DESCEND, LEVEL
from twodof.link.mavlink import modes
from twodof.link.mavlink.dialect import MavCmd, MavResult
from twodof.link.mavlink.messages import float_of_int, message
from twodof.link.mavlink.setpoints import SetPoint
from twodof.parameters import FLIGHT_PARAMETERS
from twodof.signals import ATTITUDE, OFF, OPEN_LOOP, POSITION, VELOCITY

PULSE = written_out(Impulse(0.1, 0.02, settle=0.4))
PITCHED = SetPoint(ATTITUDE, theta0=0.3, thrust=0.5)

# What was sent ahead under a lease that has ended.


def test_what_waits_is_forgotten_with_the_lease_and_does_not_act_when_its_sender_has_it_again() -> None:
    """A restarted program with the same number does not know the set-points that the last run sent ahead."""
    cockpit = offboard()
    cockpit.commander.setpoint(ME, PITCHED, cockpit.tick + 10)
    assert cockpit.commander.lease.give_up(ME).accepted
    assert cockpit.commander.lease.request(ME).accepted
    assert cockpit.run(20).theta0 == 0.0
    assert cockpit.commander.refused[RefusalReason.LEASE] == 1


def test_an_excitation_that_waits_is_refused_when_its_starter_loses_the_lease_even_if_it_comes_back() -> None:
    cockpit = offboard()
    commander = cockpit.commander
    assert commander.excitation.define(ME, 7, PULSE).accepted
    assert commander.excitation.start(ME, 7, 0, 0.4, cockpit.tick + 10).accepted
    assert commander.lease.give_up(ME).accepted
    assert (commander.excitation.player.state, commander.excitation.player.reason) == (
        REFUSED,
        "who started it has lost the lease",
    )
    assert commander.lease.request(ME).accepted
    assert all(cockpit.run().M_open == 0.0 for _ in range(20))


@pytest.mark.parametrize("takes", [ME, OTHER])
def test_a_stream_of_before_is_no_reason_to_enter_offboard_after_the_lease_has_ended(takes: tuple[int, int]) -> None:
    cockpit = armed()
    commander = cockpit.commander
    commander.setpoint(ME, PITCHED)
    assert commander.lease.give_up(ME).accepted
    assert commander.set_mode(takes, modes.OFFBOARD).result == MavResult.TEMPORARILY_REJECTED
    assert cockpit.run(3).mode == OFF


def test_nor_does_it_fly_when_another_arms_in_offboard() -> None:
    cockpit = Cockpit()
    cockpit.run(2)
    commander = cockpit.commander
    commander.setpoint(ME, PITCHED)
    assert commander.set_mode(ME, modes.OFFBOARD).accepted
    assert commander.lease.give_up(ME).accepted
    assert cockpit.arm(OTHER).accepted
    assert cockpit.run(3).mode == OFF


def test_a_lease_that_is_given_up_before_the_drone_has_armed_ends_the_arming() -> None:
    """Else it would arm with no pilot, and any listener would keep its link alive."""
    cockpit = Cockpit()
    cockpit.run(2)
    assert cockpit.commander.arming.arm(ME).result == MavResult.IN_PROGRESS
    assert cockpit.commander.lease.give_up(ME).accepted
    assert cockpit.commander.arming.answer.result == MavResult.FAILED
    assert not any(cockpit.run().arm for _ in range(5))


# Arming with something held.


@pytest.mark.parametrize("before", [modes.MANUAL, modes.RATE, modes.ATTITUDE])
@pytest.mark.parametrize("after", [modes.MANUAL, modes.RATE, modes.ATTITUDE])
def test_a_stick_that_is_held_keeps_from_arming_in_whatever_mode_is_chosen_with_it(before: int, after: int) -> None:
    """A mode and an arming sent at once: the next stick message, some milliseconds later, would start the motors."""
    cockpit = Cockpit()
    cockpit.run(2)
    commander = cockpit.commander
    commander.set_mode(ME, before)
    commander.sticks(ME, 0.1, 0.4)
    commander.set_mode(ME, after)
    assert "not_idle" in commander.arming.arm(ME).text
    cockpit.run(FRESH + 1)  # let go of: no stick is heard any more
    assert cockpit.arm().accepted


@pytest.mark.parametrize("mode", [modes.MANUAL, modes.RATE, modes.ATTITUDE])
def test_a_stick_that_is_held_over_a_disarming_keeps_from_the_next_arming(mode: int) -> None:
    cockpit = armed()
    commander = cockpit.commander
    commander.set_mode(ME, mode)
    commander.sticks(ME, 0.1, 0.4)
    assert cockpit.run().mode != OFF
    commander.arming.disarm(ME)
    cockpit.run(2)
    assert "not_idle" in commander.arming.arm(ME).text
    commander.sticks(ME, 0.0, 0.0)
    assert cockpit.arm().accepted
    assert cockpit.run(3).mode in (OFF, OPEN_LOOP)
    assert (cockpit.steps[-1].asked.thrust, cockpit.steps[-1].asked.M_open) == (0.0, 0.0)


def test_a_stick_at_rest_in_one_mode_keeps_from_arming_in_one_in_which_it_is_not() -> None:
    """Pitch without thrust moves nothing in attitude mode, and the motors in manual mode."""
    cockpit = Cockpit()
    cockpit.run(2)
    cockpit.commander.set_mode(ME, modes.ATTITUDE)
    cockpit.commander.sticks(ME, 0.1, 0.0)
    cockpit.commander.set_mode(ME, modes.MANUAL)
    assert "not_idle" in cockpit.commander.arming.arm(ME).text
    cockpit.commander.set_mode(ME, modes.ATTITUDE)
    assert cockpit.arm().accepted


# Something that is left over.


@pytest.mark.parametrize(("stick", "loop"), [(1.0, VELOCITY), (0.0, POSITION)])
def test_a_feed_forward_of_before_does_not_push_the_cart_that_is_flown_by_sticks(stick: float, loop: int) -> None:
    cockpit = offboard(SetPoint(POSITION, x0=0.1, ax0=2.0))
    commander = cockpit.commander
    assert cockpit.steps[-1].asked.ax0 == 2.0
    commander.set_mode(ME, modes.POSITION)
    commander.sticks(ME, stick, 0.0)
    asked = cockpit.run()
    assert (asked.mode, asked.ax0) == (loop, 0.0)


@pytest.mark.parametrize(("loop", "name", "ax0"), [(3, "m/s", 0.0), (4, "m", 2.0)])
def test_nor_in_an_excitation_but_about_the_very_set_point_that_it_belongs_to(loop: int, name: str, ax0: float) -> None:
    cockpit = offboard(SetPoint(POSITION, x0=0.1, ax0=2.0))
    assert cockpit.commander.excitation.define(ME, 7, written_out(Impulse(0.1, 0.02, unit=name))).accepted
    assert cockpit.commander.excitation.start(ME, 7, loop).accepted
    assert cockpit.run().ax0 == ax0


@pytest.mark.parametrize("acts", [LEVEL, BRAKE, DESCEND])
def test_no_excitation_begins_while_the_failsafe_acts(acts: int) -> None:
    """It would go on, in its middle, when the failsafe lets go."""
    cockpit = offboard()
    commander = cockpit.commander
    assert commander.excitation.define(ME, 7, PULSE).accepted
    cockpit.failsafe.acts, cockpit.failsafe.causes = acts, BIT["setpoint_lost"]
    cockpit.run(2)
    verdict = commander.excitation.start(ME, 7, 0, 0.4)
    assert verdict.result == MavResult.TEMPORARILY_REJECTED
    assert "the failsafe acts" in verdict.text
    cockpit.failsafe.acts, cockpit.failsafe.causes = None, 0
    assert all(cockpit.run().mode == ATTITUDE for _ in range(5))


def test_one_whose_tick_comes_while_the_failsafe_acts_is_refused_then() -> None:
    cockpit = offboard()
    commander = cockpit.commander
    assert commander.excitation.define(ME, 7, PULSE).accepted
    assert commander.excitation.start(ME, 7, 0, 0.4, cockpit.tick + 5).accepted
    cockpit.failsafe.acts = LEVEL
    cockpit.run(8)
    assert commander.excitation.player.state == REFUSED
    assert "the failsafe acts" in commander.excitation.player.reason
    cockpit.failsafe.acts = None
    assert all(cockpit.run().mode == ATTITUDE for _ in range(5))


# The safety switch.


def test_the_safety_switch_set_in_flight_stops_the_motors_in_the_next_tick() -> None:
    """A person may stand at the rig: motors turn only while the switch allows it."""
    rig = Rig()
    cockpit = offboard(rig=rig)
    assert cockpit.commander.excitation.define(ME, 7, PULSE).accepted
    assert cockpit.commander.excitation.start(ME, 7, 0, 0.4).accepted
    cockpit.run()
    rig.safety_off = False
    asked = cockpit.run()
    assert (asked.arm, asked.mode) == (False, OFF)
    assert cockpit.commander.excitation.player.state == STOPPED
    assert (2, "safety switch: motors off") in cockpit.commander.remarks
    rig.safety_off = True
    assert not any(cockpit.run().arm for _ in range(5)), "nothing starts by itself"
    assert cockpit.arm().accepted
    assert cockpit.run(5).mode == OFF


def test_nor_does_it_arm_where_the_switch_is_set_in_the_very_tick() -> None:
    rig = Rig()
    cockpit = Cockpit(rig)
    cockpit.run(2)
    assert cockpit.commander.arming.arm(ME).result == MavResult.IN_PROGRESS
    rig.safety_off = False
    assert not any(cockpit.run().arm for _ in range(5))
    assert cockpit.commander.arming.answer.result == MavResult.FAILED


def test_a_switch_that_is_set_on_the_ground_is_no_event() -> None:
    rig = Rig(safety_off=False)
    cockpit = Cockpit(rig)
    assert cockpit.commander.excitation.define(ME, 7, PULSE).accepted
    assert cockpit.commander.excitation.start(ME, 7, 0, 0.4, 10).accepted
    cockpit.run(5)
    assert cockpit.commander.remarks == []
    assert cockpit.commander.excitation.player.waiting


def test_a_stick_that_another_held_keeps_nobody_from_arming() -> None:
    cockpit = Cockpit()
    cockpit.run(2)
    cockpit.commander.sticks(ME, 0.5, 0.5)
    assert cockpit.commander.lease.give_up(ME).accepted
    assert cockpit.arm(OTHER).accepted
    assert cockpit.run(3).mode == OFF


# The failsafe changed in flight.


def test_in_flight_no_message_changes_a_parameter_of_the_failsafe() -> None:
    """One by one, or several at once."""
    drone = Assembled()
    store, code = drone.drone.assembly.store, drone.drone.controller.code
    rows = [row for row in store.rows if row.disarmed and not row.fixed]
    failsafe = {row.name for row in FLIGHT_PARAMETERS if row.path.startswith("failsafe.")}
    assert failsafe <= {row.name for row in rows}
    first = rows[0]

    def put(row: VehicleParameter) -> None:
        now = store[row.name]
        other = row.low if now != row.low else row.high
        value, kind = (float_of_int(int(other)), INT32) if row.kind == "int32" else (other, REAL32)
        drone.say(message("PARAM_SET", param_id=row.name, param_value=value, param_type=kind, **TARGET))

    def transaction(action: int, count: int = 0) -> None:
        kind = "TWODOF_PARAM_TRANSACTION"
        drone.say(message(kind, action=action, transaction=1, count=count, **TARGET))

    before = dict(store)
    put(first)
    assert dict(store) != before, "on the ground it can be"
    drone.fly()
    before = dict(store)
    flown = {path: code.parameter(path) for path in code.machine.parameters if path.startswith("failsafe.")}
    for row in rows:
        put(row)
        transaction(BEGIN)
        put(row)
        put(store.row("RATE_KP"))
        transaction(COMMIT, 2)
    drone.command(MavCmd.PREFLIGHT_STORAGE, 2.0)
    drone.stream()
    drone.run(2)
    assert dict(store) == before
    assert "disarmed" in drone.texts()
    assert {path: code.parameter(path) for path in flown} == flown
    assert len(flown) > 30
    put(store.row("RATE_KP"))
    assert dict(store) != before, "gains can be, and what was said was understood"
    drone.command(ARM, 0.0)
    drone.run(2)
    transaction(BEGIN)
    put(first)
    transaction(COMMIT, 1)
    assert store[first.name] != before[first.name], "on the ground again"


# A clock that anybody may set.


def test_nothing_that_decides_looks_at_a_clock_but_the_ticks() -> None:
    """So no clock that is set, and no pause of any length, changes what is decided: only a tick that passes does."""
    for path in (Path(fcu.__file__).parent / "command").glob("*.py"):
        source = path.read_text(encoding="utf-8")
        imported = {
            alias.name.partition(".")[0]
            for node in ast.walk(ast.parse(source))
            if isinstance(node, ast.Import | ast.ImportFrom)
            for alias in (node.names if isinstance(node, ast.Import) else [ast.alias(node.module or "")])
        }
        assert not imported & {"time", "datetime", "asyncio", "threading", "signal", "socket", "random", "os"}, (
            path.name
        )
