"""Events: numbered without a gap, kept, and sent again on request; in words as libevents' own parser reads them."""

from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fcu.mavlink.world import World
from tests.fcu.px4_compat.event_reader import Reader
from twodof.fcu.command.result import rejected
from twodof.fcu.px4_compat.event_definitions import definitions
from twodof.fcu.px4_compat.events import KEPT, LOOK_TICKS, MOST_AGAIN, REPORT_TICKS, EventService
from twodof.flight.failsafe import state_machine
from twodof.flight.failsafe.causes_and_actions import BIT, CAUSES, DESCEND, LEVEL, OFF
from twodof.link.mavlink.enums import MavResult
from twodof.link.mavlink.messages import message

TEXTS = {cause.name: cause.text for cause in CAUSES}
US = {"target_system": 1, "target_component": 1}
PILOT = (250, 1)
ARM, KILL, RUN_CHECKS = 400, 185, 401


def again(world: World, first: int, last: int) -> tuple[list[Any], list[Any]]:
    world.sent.clear()
    world.say(message("REQUEST_EVENT", first_sequence=first, last_sequence=last, **US), "asks")
    return world.taken("EVENT", "asks"), world.taken("RESPONSE_EVENT_ERROR", "asks")


def reported(world: World) -> list[Any]:
    """What was told, without the reports of checks."""
    return [event for event in world.taken("EVENT", None) if event.id & 0xFFFFFF < 100]


def test_what_happens_is_told_in_order_and_in_words() -> None:
    world = World()
    world.commander.lease.holder = PILOT
    world.run(3)
    world.run(1, armed=True, state=state_machine.FLYING)
    world.commander.custom_mode = 6 << 16
    world.run(2, armed=True, action=LEVEL, reason=BIT["setpoint_lost"], state=state_machine.LEVEL)
    world.run(1, armed=True, state=state_machine.FLYING)
    world.run(1, armed=True, action=DESCEND, reason=BIT["link_lost"], state=state_machine.DESCEND)
    reason = BIT["imu_lost"] | BIT["estimate_lost"]
    world.run(1, armed=False, action=OFF, reason=reason, state=state_machine.OFF)
    world.run(1, armed=False, action=OFF, state=state_machine.DISARMED)
    events = reported(world)
    reader = Reader(definitions())
    assert [one.name for one in reader.read(events)] == [
        *("armed", "failsafe_action", "mode", "failsafe_over"),
        *("failsafe_action", "failsafe_off", "disarmed"),
    ]
    assert [event.event_time_boot_ms for event in events] == [12, 16, 16, 24, 28, 32, 32]
    assert reader.shown(events) == [
        "Armed by system 250, component 1",
        "Failsafe: level (no set-point came for a while, in a mode that flies one)",
        # QGroundControl tells of a mode by itself; here is no line of it.
        "Failsafe: over, it flies what is asked again",
        "Failsafe: descend (nothing came over the link for a while)",
        f"Failsafe: motors off ({TEXTS['imu_lost']}; {TEXTS['estimate_lost']})",
        "Disarmed by the failsafe",
    ]


def test_what_keeps_from_arming_is_reported_when_it_changes_and_every_two_seconds_at_most() -> None:
    world = World()
    reader = Reader(definitions())
    world.run(1, causes=BIT["range_lost"] | BIT["battery_low"])
    assert {one.name for one in reader.read(world.taken("EVENT", None))} == {
        *("arming_check_summary", "check_range_lost", "check_battery_low", "health_summary")
    }
    assert reader.failing() == {
        "The cart is free and its range sensor silent, stuck or far from the estimate": "distance_sensor",
        TEXTS["battery_low"].capitalize(): "battery",
    }
    assert not any(group.can_arm for group in reader.checks._mode_groups)
    parts = reader.checks.health_components
    assert [name for name, part in parts.items() if part.health.error] == ["distance_sensor"]
    assert [name for name, part in parts.items() if part.arming_check.error] == ["battery"]
    world.run(REPORT_TICKS - 1)
    assert world.taken("EVENT", None) == []  # it has changed, but a moment ago only
    world.run(LOOK_TICKS)
    reader.read(world.taken("EVENT", None))
    assert reader.failing() == {}
    assert all(group.can_arm and group.can_run for group in reader.checks._mode_groups)
    world.run(3 * REPORT_TICKS)
    assert world.taken("EVENT", None) == []  # nothing new


def test_whoever_asks_for_the_checks_gets_the_report_in_flight_too() -> None:
    world = World()
    world.run(3)
    world.taken("EVENT")
    assert world.command(RUN_CHECKS) == 0
    assert len(world.taken("EVENT", None)) == 2
    world.commander.armed = True
    world.run(1, armed=True, state=state_machine.FLYING, causes=BIT["not_idle"] | BIT["tilted"])
    reader = Reader(definitions())
    world.taken("EVENT")
    assert world.command(RUN_CHECKS) == 0
    reader.read(world.taken("EVENT", None))
    assert reader.failing() == {}  # thrust and pitch are what flying is


def test_the_rings_forbid_the_mode_that_moves_the_cart_and_no_other() -> None:
    world = World()
    world.controller.hardware.rings = True
    world.run(1)
    reader = Reader(definitions())
    reader.read(world.taken("EVENT", None))
    assert [group.name for group in reader.checks._mode_groups if not group.can_arm] == ["position"]


def test_a_refusal_to_arm_says_all_that_is_in_the_way() -> None:
    world = World()
    reader = Reader(definitions())
    world.controller.hardware.safety_off = False
    world.commander.killed_by = PILOT
    world.commander.unfit = lambda: "a controller is being built"
    world.run(1, causes=BIT["tilted"])
    world.taken("EVENT")
    world.commander.verdict = rejected("not armed: killed by system 250, component 1")
    assert world.command(ARM, 1.0) == MavResult.TEMPORARILY_REJECTED
    (line,) = reader.shown(world.taken("EVENT", None))
    assert line.removeprefix("Arming denied: ").split("; ") == [
        "the pitch is far from level",
        "it was killed, release it first",
        "safety switch, press it",
        "the controller has stopped, or is being built",
    ]
    world.commander.lease.holder = (1, 1)
    assert world.command(ARM, 1.0) == MavResult.TEMPORARILY_REJECTED
    assert reader.shown(world.taken("EVENT", None)) == ["Arming denied: somebody else commands"]


def test_a_flood_of_refusals_is_told_once_in_a_while() -> None:
    world = World()
    world.run(1)
    world.taken("EVENT")
    world.commander.verdict = rejected("not armed: imu_lost")
    for _ in range(100):
        world.command(ARM, 1.0)
    assert len(world.taken("EVENT", None)) == 1
    world.run(LOOK_TICKS)
    world.command(ARM, 1.0)
    assert len(world.taken("EVENT", None)) == 1


def test_a_kill_is_told_with_who_did_it() -> None:
    world = World()
    world.run(1, armed=True, state=state_machine.FLYING)
    world.taken("EVENT")
    world.commander.killed_by = PILOT
    world.command(KILL, 1.0)
    world.run(1)
    events = reported(world)
    assert Reader(definitions()).shown(events) == ["Killed by system 250, component 1", "Disarmed by a kill"]
    world.commander.killed_by, world.commander.lease.holder = None, PILOT
    world.run(1)
    assert Reader(definitions()).shown(reported(world)) == ["Released by system 250, component 1"]


def test_a_text_that_an_event_says_too_is_marked_as_px4_marks_it() -> None:
    world = World()
    world.commander.remarks += [(4, "failsafe: level (setpoint_lost)"), (4, "parameters are not stored")]
    world.run(1)
    assert [one.text for one in world.taken("STATUSTEXT")] == [
        "failsafe: level (setpoint_lost)\t",
        "parameters are not stored",
    ]
    world.commander.verdict = rejected("not armed: imu_lost")
    world.command(ARM, 1.0)
    assert [one.text for one in world.taken("STATUSTEXT")] == ["not armed: imu_lost\t"]


def test_who_comes_is_told_where_the_numbers_stand() -> None:
    world = World()
    world.run(1, armed=True)
    last = world.taken("EVENT")[-1].sequence
    world.say(message("HEARTBEAT", type=6, autopilot=8), "new")
    (told,) = world.taken("CURRENT_EVENT_SEQUENCE", "new")
    assert (told.sequence, told.flags) == (last, 1)  # reset: numbers of a program that ran before count no more


def test_motors_that_stand_because_nobody_armed_them_are_no_event() -> None:
    world = World()
    world.run(3, action=OFF, state=state_machine.DISARMED)
    world.run(3, action=OFF, state=state_machine.REFUSED)
    assert reported(world) == []


def test_what_was_missed_is_sent_again() -> None:
    world = World()
    for armed in (True, False, True):
        world.run(1, armed=armed)
    first = world.taken("EVENT", None)
    events, errors = again(world, 2, 4)
    assert [(event.id, event.sequence) for event in events] == [(one.id, one.sequence) for one in first[1:4]]
    assert errors == []


def test_what_is_gone_is_said_to_be_gone() -> None:
    world = World()
    for tick in range(KEPT + 10):
        world.run(1, armed=tick % 2 == 0)
    last = world.taken("EVENT", None)[-1].sequence
    oldest = last - KEPT + 1
    events, errors = again(world, oldest - 2, oldest + 1)
    assert [error.sequence for error in errors] == [oldest - 2, oldest - 1]
    assert {error.sequence_oldest_available for error in errors} == {oldest}
    assert [event.sequence for event in events] == [oldest, oldest + 1]


@settings(max_examples=30)
@given(first=st.integers(0, 65535), last=st.integers(0, 65535))
def test_no_request_draws_more_than_a_handful(first: int, last: int) -> None:
    world = World()
    world.run(1, armed=True)
    events, errors = again(world, first, last)
    assert 1 <= len(events) + len(errors) <= MOST_AGAIN


def test_the_number_wraps() -> None:
    world = World(profile={})
    (events,) = (service for service in world.services if isinstance(service, EventService))
    events.sequence = 65534
    for armed in (True, False, True):
        world.run(1, armed=armed)
    assert [event.sequence for event in world.taken("EVENT")] == [65535, 0, 1, 2, 3]
    repeated, _ = again(world, 65535, 3)
    assert [event.sequence for event in repeated] == [65535, 0, 1, 2, 3]
