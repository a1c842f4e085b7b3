"""Lease, grants and resets over MAVLink: who may, how far time runs, and what every refusal answers."""

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fcu.command.cockpit import ME, OTHER
from tests.fcu.mavlink.desk import TARGET, Desk
from twodof.errors import RefusalReason
from twodof.link.mavlink.messages import message


def grant(until: int, number: int = 1) -> Any:
    return message("TWODOF_GRANT", until=until, number=number, **TARGET)


def ask(action: int = 1, duration_ms: int = 8000) -> Any:
    return message("TWODOF_LEASE", action=action, duration_ms=duration_ms, **TARGET)


def reset(**fields: Any) -> Any:
    return message("TWODOF_RIG_RESET", **({"noise": 1.0} | fields), **TARGET)


# Lease.


def test_the_lease_is_asked_for_and_given_up() -> None:
    desk = Desk()
    desk.say(ask())
    (told,) = desk.taken("TWODOF_LEASE")
    assert (told.holder_system, told.holder_component, told.duration_ms) == (*ME, 8000)
    desk.say(ask(), OTHER, "other")
    (told,) = desk.taken("TWODOF_LEASE")
    assert (told.holder_system, told.holder_component) == ME
    assert "system 250" in desk.told[0]
    desk.say(ask(2), OTHER, "other")
    assert desk.taken("TWODOF_LEASE")[0].holder_system == ME[0]
    desk.say(ask(2))
    assert desk.taken("TWODOF_LEASE")[0].holder_system == 0


def test_in_lockstep_one_who_thinks_for_long_loses_nothing_if_nobody_else_asks() -> None:
    desk = Desk(lockstep=True)
    desk.arm()
    desk.say(message("TWODOF_OPENLOOP", M=0.1, T=0.4, openloop=1, enableM=1, enableT=1, tick=40, **TARGET))
    lease = desk.services[0]
    for _ in range(100):
        lease.idle()
    assert desk.commander.lease.holder == ME
    desk.say(message("HEARTBEAT", type=6, autopilot=8))
    assert desk.commander.lease.left > 0
    desk.say(ask(), OTHER, "other")
    assert desk.commander.lease.holder == ME
    desk.say(grant(50))
    desk.run_granted()
    assert abs(desk.commander.openloop.M - 0.1) < 1e-7, "a float32 on the wire"


def test_any_frame_of_its_holder_keeps_the_link_alive_and_no_vehicles() -> None:
    desk = Desk()
    desk.run(2)
    desk.say(message("HEARTBEAT", type=2, autopilot=12), (7, 1))  # another drone
    assert not desk.run().link_new
    desk.say(message("HEARTBEAT", type=6, autopilot=8))
    assert desk.run().link_new
    desk.say(message("SYSTEM_TIME"))
    assert desk.run().link_new
    desk.say(ask())
    desk.run()
    desk.say(message("SYSTEM_TIME"), OTHER)
    assert not desk.run().link_new
    desk.say(message("SYSTEM_TIME"))
    assert desk.run().link_new


def test_our_own_frames_come_round_are_nobody() -> None:
    desk = Desk()
    desk.run(2)
    desk.say(ask(), (1, 1))
    assert desk.commander.lease.holder is None
    assert not desk.run().link_new


# Grants.


def test_a_grant_is_answered_once_its_ticks_have_run() -> None:
    desk = Desk(lockstep=True)
    desk.say(grant(10, 5))
    assert desk.controller.granted == 10
    assert not desk.taken("TWODOF_TICK")
    desk.run(9)
    assert not desk.taken("TWODOF_TICK")
    desk.run()
    (told,) = desk.taken("TWODOF_TICK")
    assert (told.tick, told.until, told.number) == (10, 10, 5)


def test_grants_that_overlap_are_answered_in_order() -> None:
    desk = Desk(lockstep=True)
    for number, until in enumerate((10, 5, 8)):
        desk.say(grant(until, number))
    desk.run_granted()
    assert [one.number for one in desk.taken("TWODOF_TICK")] == [1, 2, 0]


def test_in_real_time_nothing_is_granted() -> None:
    desk = Desk(lockstep=False)
    desk.say(grant(10))
    assert desk.controller.granted == 0
    assert "by itself" in desk.told[0]


# Resets.


def test_a_reset_begins_again_at_tick_0_and_keeps_the_lease() -> None:
    desk = Desk(lockstep=True)
    desk.say(ask())
    desk.run(100)
    left = desk.commander.lease.left
    desk.say(reset(seed=12, x=0.1, noise=0.5, rings=1))
    (told,) = desk.taken("TWODOF_RIG")
    assert (told.tick, told.seed, told.noise, told.flags & 17) == (0, 12, 0.5, 1)
    lease = desk.commander.lease
    assert (lease.holder, lease.left, lease.revision) == (ME, left, 1)
    desk.arm()


@pytest.mark.parametrize(
    "fields",
    [
        {"x": 0.5},
        {"x": math.nan},
        {"x": math.inf},
        {"noise": -1.0},
        {"noise": math.nan},
        {"noise": math.inf},
        {"seed": 2**32},
        {"seed": 2**64 - 1},
    ],
)
def test_an_impossible_reset_is_refused_and_changes_nothing(fields: dict[str, Any]) -> None:
    desk = Desk(lockstep=True)
    desk.run(10)
    desk.say(reset(**fields))
    (told,) = desk.taken("TWODOF_RIG")
    assert told.flags & 16
    assert (told.tick, told.seed) == (10, 7)
    assert desk.told[0].startswith("reset refused")


def test_no_reset_while_armed_on_a_real_rig_or_by_one_without_the_lease() -> None:
    desk = Desk(lockstep=True)
    desk.arm()
    desk.say(reset())
    assert desk.taken("TWODOF_RIG")[0].flags & 16
    assert "armed" in desk.told[-1]
    assert desk.reasons[-1] is RefusalReason.ARMED
    desk.commander.arming.disarm(ME)
    desk.run()
    desk.say(reset(), OTHER, "other")
    assert desk.taken("TWODOF_RIG")[0].flags & 16
    assert "system 250" in desk.told[-1]
    desk.bench.virtual = False
    desk.say(reset())
    assert desk.taken("TWODOF_RIG")[0].flags & 16
    assert "real" in desk.told[-1]


def test_a_reset_answers_what_was_granted() -> None:
    desk = Desk(lockstep=True)
    desk.say(grant(10, 1))
    desk.run(2)
    desk.say(reset())
    (told,) = desk.taken("TWODOF_TICK")
    assert (told.tick, told.until) == (0, 0)


LONG = st.integers(0, 2**32 - 1)
DOUBLES = st.floats()
ANY = st.one_of(
    st.builds(
        lambda **f: message("TWODOF_GRANT", **f), until=st.integers(0, 40), number=LONG, target_system=st.just(1)
    ),
    st.builds(
        lambda **f: message("TWODOF_RIG_RESET", **f),
        seed=st.integers(0, 2**64 - 1),
        x=DOUBLES,
        noise=DOUBLES,
        target_system=st.sampled_from([0, 1, 2]),
        rings=st.integers(0, 255),
    ),
    st.builds(
        lambda **f: message("TWODOF_LEASE", **f),
        duration_ms=LONG,
        target_system=st.sampled_from([0, 1, 2]),
        action=st.integers(0, 255),
        holder_system=st.integers(0, 255),
    ),
)


@settings(max_examples=40)
@given(sent=st.lists(st.tuples(ANY, st.sampled_from([ME, OTHER, (0, 0), (1, 1)])), max_size=12))
def test_whatever_they_hold_nothing_arms_and_time_runs_as_granted(sent: list[tuple[Any, tuple[int, int]]]) -> None:
    desk = Desk(lockstep=True)
    for one, source in sent:
        desk.say(one, source)
        assert desk.controller.granted <= max(40, desk.controller.tick)
        if desk.controller.granted > desk.controller.tick:
            desk.run_granted()
    assert not desk.run().arm
