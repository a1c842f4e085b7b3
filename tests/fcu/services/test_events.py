"""Events: numbered without a gap, kept, and sent again on request."""

import struct
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from tests.fcu.services.world import World
from twodof.fcu.services.events import ACTION, ARMED, DISARMED, KEPT, MODE, MOST_AGAIN
from twodof.flight import failsafe_machine
from twodof.flight.failsafe_machine import OFF, REFUSED
from twodof.link.messages import message

US = {"target_system": 1, "target_component": 1}


def again(world: World, first: int, last: int) -> tuple[list[Any], list[Any]]:
    world.sent.clear()
    world.say(message("REQUEST_EVENT", first_sequence=first, last_sequence=last, **US), "asks")
    return world.taken("EVENT", "asks"), world.taken("RESPONSE_EVENT_ERROR", "asks")


def test_what_happens_is_told_in_order() -> None:
    world = World()
    world.run(3)
    world.run(1, armed=True)
    world.commander.custom_mode = 6 << 16
    world.run(2, armed=True, action=4, reason=512, state=OFF)
    world.run(1, armed=False, action=4, reason=512, state=OFF)
    events = world.taken("EVENT", None)
    assert [event.id for event in events] == [ARMED, ACTION, MODE, DISARMED]
    assert [event.sequence for event in events] == [1, 2, 3, 4]
    assert [event.event_time_boot_ms for event in events] == [12, 16, 16, 24]
    assert bytes(events[1].arguments[:5]) == struct.pack("<BI", 4, 512)
    assert bytes(events[2].arguments[:4]) == struct.pack("<I", 6 << 16)
    world.command(512, 411.0)
    assert world.taken("CURRENT_EVENT_SEQUENCE")[-1].sequence == 4


def test_motors_that_stand_because_nobody_armed_them_are_no_event() -> None:
    world = World()
    world.run(3, action=4, state=failsafe_machine.DISARMED)
    world.run(3, action=4, state=REFUSED)
    assert world.taken("EVENT") == []


def test_what_was_missed_is_sent_again() -> None:
    world = World()
    for armed in (True, False, True):
        world.run(1, armed=armed)
    first = world.taken("EVENT", None)
    events, errors = again(world, 2, 3)
    assert [(event.id, event.sequence) for event in events] == [(one.id, one.sequence) for one in first[1:]]
    assert errors == []


def test_what_is_gone_is_said_to_be_gone() -> None:
    world = World()
    for tick in range(KEPT + 10):
        world.run(1, armed=tick % 2 == 0)
    events, errors = again(world, 9, 12)
    assert [error.sequence for error in errors] == [9, 10]
    assert {error.sequence_oldest_available for error in errors} == {11}
    assert [event.sequence for event in events] == [11, 12]


@given(first=st.integers(0, 65535), last=st.integers(0, 65535))
def test_no_request_draws_more_than_a_handful(first: int, last: int) -> None:
    world = World()
    world.run(1, armed=True)
    events, errors = again(world, first, last)
    assert 1 <= len(events) + len(errors) <= MOST_AGAIN


def test_the_number_wraps() -> None:
    world = World(profile={})
    world.px4.events._sequence = 65534
    for armed in (True, False, True):
        world.run(1, armed=armed)
    assert [event.sequence for event in world.taken("EVENT")] == [65535, 0, 1]
    events, _ = again(world, 65535, 1)
    assert [event.sequence for event in events] == [65535, 0, 1]
