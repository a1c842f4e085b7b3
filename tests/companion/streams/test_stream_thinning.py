"""Streams: each client its own rates, the vehicle asked for the fastest, answers as the vehicle would give them."""

from collections import Counter
from math import isfinite

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.companion.ends import SYSTEM, Ends, names
from twodof.companion.client import CompanionClient
from twodof.companion.streams import rate_profiles
from twodof.companion.streams.rate_profiles import PROFILES, profile
from twodof.link.mavlink import dialect
from twodof.link.mavlink.framing import decode
from twodof.link.mavlink.rates import PROFILES as vehicle_profiles

pytestmark = pytest.mark.slow

TO = {"target_system": SYSTEM, "target_component": 1}
ATTITUDE = 30


def ask(ends: Ends, client: CompanionClient, number: int, interval: float, **more: float) -> None:
    """The client asks for a message."""
    ends.says(client, "COMMAND_LONG", 250, command=511, param1=number, param2=interval, **TO, **more)


def fly(ends: Ends, seconds: float, every_ms: int = 4, name: str = "ATTITUDE") -> dict[CompanionClient, list[int]]:
    """The vehicle streams for some time: what each client got, as times [ms]."""
    got: dict[CompanionClient, list[int]] = {client: [] for client in ends.clients}
    start = int(ends.now * 1000) // every_ms * every_ms
    for time in range(start, start + round(seconds * 1000), every_ms):
        ends.vehicle(name, time_boot_ms=time)
        for client in ends.clients:
            got[client] += [decode(one).time_boot_ms for one in ends.heard(client)]
    ends.now += seconds
    return got


@pytest.mark.parametrize("name", ["onboard", "ground"])
def test_who_asks_for_nothing_gets_what_the_flight_controller_would_send(name: str) -> None:
    """Of each message except those that come at each change too, which thinning would hold back."""
    theirs, ours = vehicle_profiles[name], profile(name)
    known = dialect.load().mavlink_map
    passed = {known[number].msgname for number in theirs.keys() - ours.keys()}
    assert passed == {"TWODOF_OPENLOOP", "CURRENT_MODE", "AVAILABLE_MODES_MONITOR", "CURRENT_EVENT_SEQUENCE"}
    assert ours.keys() <= theirs.keys()
    as_they_come = {
        dialect.load().mavlink_map[number].msgname for number, every in ours.items() if every == rate_profiles.EVERY
    }
    state = {"TWODOF_RIG", "TWODOF_LEASE", "TWODOF_SAFETY", "TWODOF_TIMING"}
    assert as_they_come == state | ({"TWODOF_TOF"} if name == "onboard" else set())
    for number, every in ours.items():
        if every > rate_profiles.EVERY:
            assert 1e6 / every == pytest.approx(theirs[number], rel=1e-4)  # whole microseconds


def test_the_vehicle_is_asked_for_the_fastest_that_anybody_wants() -> None:
    ends = Ends("ground", "none")
    at = {number: wish.interval for number, wish in ends.router.subscriptions.asking.granted.items()}
    assert at[ATTITUDE] == round(1e6 / 15)
    assert at[105] == 500_000
    ends.join("onboard")
    assert (ATTITUDE, 10_000.0) in ends.answer()
    ask(ends, ends.clients[1], ATTITUDE, 4000)
    assert ends.answer() == [(ATTITUDE, 4000.0)]
    ask(ends, ends.clients[0], ATTITUDE, 40_000)
    assert ends.answer() == []  # nothing changes for the vehicle
    ask(ends, ends.clients[1], ATTITUDE, -1)
    assert ends.answer() == [(ATTITUDE, 10_000.0)]


@pytest.mark.parametrize("interval", [4000, 8000, 10_000, 20_000, 33_333, 100_000, 1_000_000])
@pytest.mark.parametrize("start", [1, 2.004, 7.36])
def test_a_client_gets_its_rate_out_of_a_faster_stream(interval: int, start: float) -> None:
    ends = Ends("none", "none")
    slow, fast = ends.clients
    ask(ends, fast, ATTITUDE, 4000)
    ask(ends, slow, ATTITUDE, interval)
    ends.settle()
    ends.now = 100.0 + start
    got = fly(ends, 4.0)
    assert len(got[fast]) == 1000
    # One in each interval that has begun; a first and a last that are not whole.
    assert abs(len(got[slow]) - 4e6 / interval) <= 1.0
    assert len({time * 1000 // interval for time in got[slow]}) == len(got[slow])


def test_thinning_goes_by_the_messages_time_whenever_the_client_came() -> None:
    times = []
    for late in (0.0, 0.712):
        ends = Ends("none", "none")
        ask(ends, ends.clients[0], ATTITUDE, 4000)
        ends.settle()
        ends.now = 200.0
        fly(ends, late) if late else None
        ask(ends, ends.clients[1], ATTITUDE, 30_000)
        ends.settle()
        ends.now = 201.0
        times.append(fly(ends, 2.0)[ends.clients[1]])
    assert times[0] == times[1]


def test_who_wants_what_comes_anyway_gets_every_one() -> None:
    ends = Ends("none", "none")
    ask(ends, ends.clients[0], ATTITUDE, 10_000)
    ask(ends, ends.clients[1], ATTITUDE, 100_000)
    ends.settle()
    # 100 Hz in ticks of 4 ms: 8 and 12 ms in turn, which no grid of ours must thin again.
    times = [4 * (tick * 5 // 2) for tick in range(100)]
    for time in times:
        ends.vehicle("ATTITUDE", time_boot_ms=time)
    assert [decode(one).time_boot_ms for one in ends.heard(ends.clients[0])] == times


def test_a_message_without_a_time_is_thinned_by_counting() -> None:
    ends = Ends("onboard", "ground")
    ends.settle()
    for _ in range(50):
        ends.vehicle("SYS_STATUS")
    counts = [Counter(names(ends.heard(client)))["SYS_STATUS"] for client in ends.clients]
    assert counts == [50, 10]


def test_time_that_begins_anew_stops_no_stream() -> None:
    ends = Ends("none", "none")
    ask(ends, ends.clients[0], ATTITUDE, 4000)
    ask(ends, ends.clients[1], ATTITUDE, 100_000)
    ends.settle()
    fly(ends, 1.0)
    ends.now = 0.0  # the rig was reset
    assert len(fly(ends, 1.0)[ends.clients[1]]) == 10


def test_answers_are_the_vehicles_and_come_once_it_has_agreed() -> None:
    ends = Ends("none", "none")
    first, second = ends.clients
    ask(ends, first, ATTITUDE, 4000)
    assert ends.heard(first) == []  # not before the vehicle has said so
    ends.answer()
    (got,) = ends.heard(first)
    answer = decode(got)
    assert (got.system, got.component, answer.command, answer.result) == (SYSTEM, 1, 511, 0)
    assert (answer.target_system, answer.target_component) == (250, 190)
    assert ends.heard(second) == []
    ask(ends, second, ATTITUDE, 8000)  # it is there already: no need to ask
    assert names(ends.heard(second)) == ["COMMAND_ACK"]


def test_what_the_vehicle_refuses_is_refused_and_not_kept() -> None:
    ends = Ends("none", "none")
    ask(ends, ends.clients[0], 241, 4000)
    ends.answer(result=2)
    assert decode(ends.heard(ends.clients[0])[0]).result == 2
    assert ends.clients[0].wishes == {}


def test_the_interval_told_is_the_clients_own() -> None:
    ends = Ends("onboard", "none")
    ask(ends, ends.clients[0], ATTITUDE, 20_000)
    ends.settle()
    for client, expected in zip(ends.clients, (20_000, -1), strict=True):
        ends.says(client, "COMMAND_LONG", 250, command=510, param1=ATTITUDE, **TO)
        acknowledged, told = (decode(one) for one in ends.heard(client))
        assert (acknowledged.command, told.message_id, told.interval_us) == (510, ATTITUDE, expected)
    assert ends.up.sent == []
    ends.says(ends.clients[0], "COMMAND_LONG", 250, command=510, param1=54206, **TO)
    ends.answer()
    ends.says(ends.clients[0], "COMMAND_LONG", 250, command=510, param1=54206, **TO)
    assert len(ends.up.sent) == 1  # what passes as it comes the vehicle knows
    ends.vehicle("MESSAGE_INTERVAL", message_id=54206, interval_us=1_000_000)
    assert names(ends.heard(ends.clients[0])) == ["MESSAGE_INTERVAL"]
    assert ends.heard(ends.clients[1]) == []


def test_a_message_asked_for_once_comes_once() -> None:
    ends = Ends("none", "none")
    ends.settle()
    ends.says(ends.clients[0], "COMMAND_LONG", 250, command=512, param1=ATTITUDE, **TO)
    assert len(ends.up.sent) == 1
    for time in (4, 8):
        ends.vehicle("ATTITUDE", time_boot_ms=time)
    assert names(ends.heard(ends.clients[0])) == ["ATTITUDE"]
    assert ends.heard(ends.clients[1]) == []


def test_a_vehicle_that_does_not_answer_is_asked_again_and_then_later() -> None:
    ends = Ends("none")
    ask(ends, ends.clients[0], ATTITUDE, 4000)
    for _ in range(100):
        ends.now += 0.1
        ends.router.subscriptions.asking.poll(ends.now)
    asked = [decode(one) for one in ends.up.take()]
    assert 5 <= len(asked) <= 8  # four within 2 s, then again after 5 s
    assert ends.heard(ends.clients[0]) == []  # and nothing is said in its name
    for _ in range(50):
        ends.now += 0.1
        ends.router.subscriptions.asking.poll(ends.now)
        ends.answer()
    assert ends.router.subscriptions.asking.granted[ATTITUDE].interval == 4000


def test_a_vehicle_that_was_started_anew_is_told_again() -> None:
    ends = Ends("onboard")
    ends.settle()
    for tick in range(64):
        ends.vehicle("ATTITUDE", time_boot_ms=60_000 + tick)
    ends._sequence = 0
    ends.vehicle("HEARTBEAT")
    ends.vehicle("ATTITUDE", time_boot_ms=40)
    assert (ATTITUDE, 10_000.0) in ends.answer()
    assert ends.router.counts.restarts == 1


def test_a_frame_that_was_late_on_the_line_is_no_vehicle_that_was_started_anew() -> None:
    ends = Ends("onboard")
    ends.settle()
    for tick in (0, 4, 2, 3, 1, 5, 9, 6):  # in the order in which they come
        ends._sequence = tick
        ends.vehicle("ATTITUDE", time_boot_ms=60_000 + 50 * tick)
    assert ends.answer() == []
    assert ends.router.counts.restarts == 0


def test_a_group_of_streams_is_asked_for_as_ardupilots_clients_do() -> None:
    ends = Ends("onboard", "onboard")
    ends.settle()
    ends.says(ends.clients[0], "REQUEST_DATA_STREAM", 250, req_stream_id=10, req_message_rate=4, start_stop=1, **TO)
    assert {number: wish.interval for number, wish in ends.clients[0].wishes.items()} == {
        dialect.message_id(name): 250_000 for name in rate_profiles.GROUPS[10]
    }
    assert ends.clients[1].wishes == {}
    assert ends.up.sent == []  # the other one still wants them faster


@pytest.mark.parametrize("number", [77, 253, 22, 0])
def test_no_rate_can_be_asked_for_what_comes_when_it_must(number: int) -> None:
    ends = Ends("none")
    ask(ends, ends.clients[0], number, 1e6)
    assert decode(ends.heard(ends.clients[0])[0]).result == 2
    assert ends.up.sent == []


@settings(max_examples=30)
@given(st.lists(st.tuples(st.integers(0, 2), st.floats(width=32), st.floats(width=32)), max_size=20))
def test_no_numbers_in_a_command_do_harm(asked: list[tuple[int, float, float]]) -> None:
    ends = Ends(*PROFILES)
    for place, number, interval in asked:
        ask(ends, ends.clients[place], number, interval, param3=interval, param4=number)
        ends.answer(2)
    ends.settle()
    fly(ends, 0.1)
    for client in ends.clients:
        assert all(isfinite(wish.interval) for wish in client.wishes.values())


def test_wishes_are_bounded() -> None:
    ends = Ends("none")
    for number in range(1000, 3000):
        ask(ends, ends.clients[0], number, 1e6)
        ends.answer()
    assert len(ends.clients[0].wishes) <= 256
    assert decode(ends.heard(ends.clients[0])[-1]).result == 1
