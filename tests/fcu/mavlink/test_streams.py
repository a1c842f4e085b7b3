"""Streams: exact rates on ticks that depend on nothing else, per client, encoded once, with nothing sent twice."""

from collections import Counter
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fcu.mavlink.world import World
from twodof.fcu.mavlink.clients import SILENT_TICKS
from twodof.fcu.mavlink.streams import due_ticks
from twodof.link.mavlink import dialect
from twodof.link.mavlink.dialect import PROFILES
from twodof.link.mavlink.messages import message
from twodof.signals import TICK_NS

pytestmark = pytest.mark.slow

HELLO = message("HEARTBEAT", type=6, autopilot=8)
# A message of twodof's own: its sender knows them.
OURS = message("TWODOF_LEASE", target_system=9)
ATTITUDE, HIGHRES_IMU, DISTANCE_SENSOR, TOF, TRUTH, SAFETY = 30, 105, 132, 54204, 54205, 54210


def names(profile: dict[int, float]) -> dict[str, float]:
    return {dialect.load().mavlink_map[number].msgname: rate for number, rate in profile.items()}


@given(interval=st.integers(TICK_NS, 10**12), offset=st.integers(0, 249), tick=st.integers(0, 2**32))
def test_a_stream_is_due_where_the_number_of_intervals_has_risen(interval: int, offset: int, tick: int) -> None:
    def intervals(at: int) -> int:
        return (at + offset) * TICK_NS // interval

    last, due = due_ticks(tick, interval, offset)
    assert last <= tick < due
    assert intervals(last) == intervals(due - 1) == intervals(tick) == intervals(last - 1) + 1 == intervals(due) - 1


@pytest.mark.parametrize("profile", PROFILES)
def test_rates_are_those_of_the_profile(profile: str) -> None:
    world = World(profile=PROFILES[profile])
    world.say(OURS)
    world.run(250)  # the first second has what is new to begin with
    world.sent.clear()
    world.run(20 * 250, dist_new=True)
    got = Counter(one.get_type() for one, to in world.sent if to == "client")
    for name, rate in names(dict(PROFILES[profile])).items():
        if rate > 0.0 and name != "TWODOF_TOF":
            # Within one message of what the rate gives in 20 s: a stream may be due at either end.
            assert got[name] == pytest.approx(20 * rate, abs=1.0), name


def test_streams_of_one_rate_are_spread_over_the_ticks() -> None:
    world = World()
    world.say(OURS)
    world.run(500)
    busiest = 0
    for _ in range(500):
        world.sent.clear()
        world.run()
        busiest = max(busiest, len(world.sent))
    # All together would be 23 in one tick in which those of 10, 5, 1 and .5 Hz meet.
    assert busiest <= 8


def test_what_a_tick_carries_does_not_depend_on_when_the_client_came() -> None:
    def sent(before: int) -> list[tuple[int, str]]:
        world, found = World(), []
        world.run(before)
        world.say(OURS)
        world.run(1000 - before)
        world.sent.clear()
        for tick in range(1000, 1600):
            world.run()
            found += [(tick, one.get_type()) for one, to in world.sent if to == "client"]
            world.sent.clear()
        return found

    assert sent(0) == sent(1) == sent(617)


@settings(max_examples=10)
@given(micros=st.one_of(st.integers(1, 2_000_000), st.floats(1.0, 2e6, width=32)))
def test_an_interval_asked_for_is_kept_exactly(micros: float) -> None:
    world = World(profile={})
    assert world.command(511, ATTITUDE, micros) == 0
    ticks = []
    for tick in range(1100):
        world.run()
        if world.taken("ATTITUDE"):
            ticks.append(tick)
    asked = max(micros, 4000.0)  # not more than one a tick
    assert len(ticks) == pytest.approx(1100 * 4000.0 / asked, abs=1.0)
    gaps = {later - earlier for earlier, later in pairwise(ticks)}
    assert all(abs(gap * 4000.0 - asked) < 4000.0 for gap in gaps)


def test_intervals_are_a_clients_own() -> None:
    world = World()
    world.say(HELLO, "one")
    world.say(HELLO, "other")
    assert world.command(511, ATTITUDE, -1.0, peer="one") == 0
    world.sent.clear()
    world.run(250)
    assert world.taken("ATTITUDE", "one") == []
    assert len(world.taken("ATTITUDE", "other")) == 100
    assert world.command(511, ATTITUDE, 0.0, peer="one") == 0  # the default again
    world.run(250)
    assert len(world.taken("ATTITUDE", "one")) == 100


def test_the_interval_is_told() -> None:
    world = World()
    expected = {ATTITUDE: 10_000, 0: 1_000_000, TOF: -1, TRUTH: 0, 33: 0, 54203: -1}
    for number, micros in expected.items():
        assert world.command(510, number) == 0
        (got,) = world.taken("MESSAGE_INTERVAL")
        assert (got.message_id, got.interval_us) == (number, micros)
    world.command(511, ATTITUDE, 25_000.0)
    world.command(510, ATTITUDE)
    assert world.taken("MESSAGE_INTERVAL")[0].interval_us == 25_000


@pytest.mark.parametrize(
    ("params", "result"),
    [
        ((0, 1000.0), 4),  # HEARTBEAT stays, as in PX4
        ((33, 1000.0), 3),  # no such stream
        ((99999.0, 1000.0), 3),
        ((float("nan"), 1000.0), 3),
        ((float("inf"), 1000.0), 3),
        ((ATTITUDE, float("nan")), 2),
        ((ATTITUDE, float("inf")), 2),
        ((ATTITUDE, 1e30), 0),
        ((-5.0, 0.0), 3),
    ],
)
def test_intervals_that_make_no_sense(params: tuple[float, ...], result: int) -> None:
    world = World()
    assert world.command(511, *params) == result


def test_each_range_sample_is_sent_once() -> None:
    world = World()
    world.say(OURS)
    for tick in range(500):
        world.run(1, dist_new=tick % 13 == 0, dist=0.001 * tick)
    ticks = [got.tick for got in world.taken("TWODOF_TOF")]
    assert ticks == [tick for tick in range(500) if tick % 13 == 0]


def test_who_does_not_know_our_messages_gets_none_of_them() -> None:
    world = World()
    world.say(HELLO, "stranger")
    world.say(message("COMMAND_LONG", command=512, param1=54206.0, target_system=1, target_component=1), "asks")
    world.say(message("COMMAND_INT", command=511, param1=54210.0, param2=-1.0, target_system=1), "thins out")
    world.run(500, dist_new=True)
    got = {
        peer: {one.get_type() for one, to in world.sent if to == peer and one.get_type().startswith("TWODOF")}
        for peer in ("stranger", "asks", "thins out")
    }
    assert got["stranger"] == set()
    assert {"TWODOF_RIG", "TWODOF_TOF", "TWODOF_SAFETY"} <= got["asks"]
    assert got["asks"] - got["thins out"] == {"TWODOF_SAFETY"}


def test_truth_comes_on_request_only_and_from_the_rig() -> None:
    world = World(truth=lambda: (0.1, 0.2, 0.3, 0.4))
    world.say(OURS)
    world.run(250)
    assert world.taken("TWODOF_TRUTH") == []
    assert world.command(511, TRUTH, 4000.0) == 0
    world.run(10)
    got = world.taken("TWODOF_TRUTH")
    assert [(one.theta, one.q, one.x, one.v) for one in got] == [(0.1, 0.2, 0.3, 0.4)] * 10
    assert World().command(511, TRUTH, 4000.0) == 3  # a real rig has none


def test_the_failsafe_is_told_at_once_and_flapping_flags_ten_times_a_second() -> None:
    world = World()
    world.say(OURS)
    world.run(30)
    world.sent.clear()
    world.run(1, action=1, state=3, armed=True, reason=4, causes=4)
    (told,) = world.taken("TWODOF_SAFETY")
    assert (told.action, told.reason, told.since, told.flags) == (1, 2, 30, 4)
    for tick in range(250):
        world.run(1, action=1, state=3, armed=True, reason=4, causes=4 | (tick & 1) << 5)
    assert 10 <= len(world.taken("TWODOF_SAFETY")) <= 12


@pytest.mark.parametrize("which", ["rig", "lease", "open loop"])
def test_one_change_is_told_by_one_message(which: str) -> None:
    world = World()
    world.say(OURS)
    world.run(2)
    world.sent.clear()
    if which == "rig":
        world.controller.hardware.safety_off = False
    elif which == "lease":
        world.commander.lease.holder = (250, 1)
    else:
        world.commander.openloop = world.commander.openloop._replace(revision=1)
    world.run()
    told = {one.get_type() for one, _ in world.sent if one.get_type().startswith("TWODOF")}
    assert told == {"rig": {"TWODOF_RIG"}, "lease": {"TWODOF_LEASE"}, "open loop": {"TWODOF_OPENLOOP"}}[which]


def test_a_silent_client_is_forgotten_and_a_closed_one_at_once() -> None:
    world = World()
    world.say(HELLO, "silent")
    world.say(HELLO, "closed")
    world.run(1)
    world.services[0].gone("closed")
    world.sent.clear()
    world.run(250)
    assert {to for _, to in world.sent} == {"silent", None}
    world.controller.tick += SILENT_TICKS
    world.run(250)
    world.sent.clear()
    world.run(250)
    assert {to for _, to in world.sent} == {None}  # HEARTBEAT alone
    world.say(HELLO, "silent")
    world.run(250)
    assert len(world.taken("ATTITUDE", "silent")) == 100


def test_in_lockstep_a_bystander_may_be_silent_for_as_long_as_time_runs_fast() -> None:
    world = World(lockstep=True)
    world.say(HELLO)
    world.run(1)
    world.controller.tick = 10 * SILENT_TICKS
    world.run(250)
    world.sent.clear()
    world.run(250)
    assert len(world.taken("ATTITUDE", "client")) == 100


def test_time_that_begins_anew_keeps_the_streams() -> None:
    world = World()
    world.say(OURS)
    world.command(511, ATTITUDE, 20_000.0)
    world.run(1234)
    for service in world.services:
        service.restart()
    world.controller.tick = 0
    world.sent.clear()
    world.run(500)
    stamps = [one.time_boot_ms for one in world.taken("ATTITUDE")]
    assert len(stamps) == 100
    assert stamps[0] < 20


def test_request_data_stream_is_taken_and_changes_nothing() -> None:
    world = World()
    world.say(OURS)
    target = {"target_system": 1, "target_component": 1}
    assert world.say(message("REQUEST_DATA_STREAM", req_stream_id=1, req_message_rate=50, start_stop=1, **target))
    world.run(250)
    assert len(world.taken("SYS_STATUS")) == 5
