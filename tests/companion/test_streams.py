"""Streams: the vehicle is asked for the union of all requests, and each client gets the messages that it wants."""

from math import isfinite

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.companion.ends import SYSTEM, Ends, names
from tests.link.batches import batch
from twodof.companion.client import EVERY, GROUPS, PROFILES, CompanionClient, profile, union
from twodof.gcs.full_rate import BatchRows
from twodof.link.mavlink import dialect
from twodof.link.mavlink.dialect import PROFILES as VEHICLE_PROFILES
from twodof.link.mavlink.framing import decode
from twodof.link.mavlink.messages import channel_mask

pytestmark = pytest.mark.slow

TO = {"target_system": SYSTEM, "target_component": 1}
ATTITUDE, BATCH = 30, 54203


def ask(ends: Ends, client: CompanionClient, number: int, interval: float, **more: float) -> None:
    """The client asks for a message."""
    ends.says(client, "COMMAND_LONG", 250, command=511, param1=number, param2=interval, **TO, **more)


def fly(ends: Ends, seconds: float, every_ms: int = 4) -> list[list[int]]:
    """The vehicle streams ATTITUDE for some time: what each client got, as times [ms]."""
    got: list[list[int]] = [[] for _ in ends.clients]
    start = int(ends.now * 1000) // every_ms * every_ms
    for time in range(start, start + round(seconds * 1000), every_ms):
        ends.vehicle("ATTITUDE", time_boot_ms=time)
        for times, client in zip(got, ends.clients, strict=True):
            times += [decode(one).time_boot_ms for one in ends.heard(client)]
    ends.now += seconds
    return got


@pytest.mark.parametrize("name", ["onboard", "ground"])
def test_defaults_are_those_of_the_flight_controller(name: str) -> None:
    """Except messages that come at each change too, which thinning would hold back."""
    theirs, ours = VEHICLE_PROFILES[name], profile(name)
    known = dialect.load().mavlink_map
    passed = {known[number].msgname for number in theirs.keys() - ours.keys()}
    assert passed == {"TWODOF_OPENLOOP", "CURRENT_MODE", "AVAILABLE_MODES_MONITOR"}
    for number, every in ours.items():
        if every > EVERY:
            assert 1e6 / every == pytest.approx(theirs[number], rel=1e-4)  # whole microseconds


def test_the_vehicle_is_asked_for_the_union() -> None:
    ends = Ends("ground", "none")
    assert ends.router.asked[ATTITUDE].interval == round(1e6 / 15)
    ends.join("onboard")
    assert (ATTITUDE, 10_000.0) in ends.answer()
    ask(ends, ends.clients[1], ATTITUDE, 4000)
    assert ends.answer() == [(ATTITUDE, 4000.0)]
    ask(ends, ends.clients[0], ATTITUDE, 40_000)
    assert ends.answer() == [(ATTITUDE, 4000.0)]  # a slower request does not slow the others down
    ask(ends, ends.clients[1], ATTITUDE, -1)
    assert ends.answer() == [(ATTITUDE, 10_000.0)]


def test_the_answer_to_a_wish_is_the_vehicles() -> None:
    ends = Ends("none", "none")
    for result in (0, 2):
        ask(ends, ends.clients[0], ATTITUDE, 4000)
        assert ends.heard(ends.clients[0]) == []  # not before the vehicle has answered
        ends.answer(result)
        (got,) = ends.heard(ends.clients[0])
        answer = decode(got)
        assert (got.system, got.component, answer.command, answer.result) == (SYSTEM, 1, 511, result)
        assert ends.heard(ends.clients[1]) == []


@pytest.mark.parametrize("interval", [4000, 8000, 10_000, 20_000, 33_333, 100_000, 1_000_000])
@pytest.mark.parametrize("start", [1, 7.36])
def test_a_slower_client_gets_its_own_rate(interval: int, start: float) -> None:
    ends = Ends("none", "none")
    ask(ends, ends.clients[0], ATTITUDE, 4000)
    ask(ends, ends.clients[1], ATTITUDE, interval)
    ends.settle()
    ends.now = 100.0 + start
    fast, slow = fly(ends, 4.0)
    assert len(fast) == 1000
    assert abs(len(slow) - 4e6 / interval) <= 1.0  # a first and a last interval that are not whole
    assert len({time * 1000 // interval for time in slow}) == len(slow)
    ends.now = 0.0  # the rig was reset
    assert len(fly(ends, 1.0)[0]) == 250


def test_the_fastest_client_is_not_thinned() -> None:
    ends = Ends("none", "none")
    ask(ends, ends.clients[0], ATTITUDE, 10_000)
    ask(ends, ends.clients[1], ATTITUDE, 100_000)
    ends.settle()
    # 100 Hz in ticks of 4 ms: 8 and 12 ms in turn, which no grid of ours must thin again.
    times = [4 * (tick * 5 // 2) for tick in range(100)]
    for time in times:
        ends.vehicle("ATTITUDE", time_boot_ms=time)
    assert [decode(one).time_boot_ms for one in ends.heard(ends.clients[0])] == times


def test_a_requested_message_comes_once() -> None:
    ends = Ends("none", "none")
    ends.settle()
    ends.says(ends.clients[0], "COMMAND_LONG", 250, command=512, param1=ATTITUDE, **TO)
    assert len(ends.up.sent) == 1
    for time in (4, 8):
        ends.vehicle("ATTITUDE", time_boot_ms=time)
    assert [names(ends.heard(client)) for client in ends.clients] == [["ATTITUDE"], []]


def test_a_restarted_vehicle_is_told_again() -> None:
    ends = Ends("onboard")
    ends.settle()
    for start in (7, 7, 0):
        ends.vehicle("TWODOF_RIG", start=start)
        assert ends.answer() == []
    ends.vehicle("TWODOF_RIG", start=8)
    assert (ATTITUDE, 10_000.0) in ends.answer()


def test_request_data_stream_sets_a_group() -> None:
    ends = Ends("onboard", "onboard")
    ends.settle()
    ends.says(ends.clients[0], "REQUEST_DATA_STREAM", 250, req_stream_id=10, req_message_rate=4, start_stop=1, **TO)
    assert {number: request.interval for number, request in ends.clients[0].requests.items()} == {
        dialect.message_id(name): 250_000 for name in GROUPS[10]
    }
    assert ends.clients[1].requests == {}
    assert ends.up.sent == []  # the other one still wants them faster


@given(st.lists(st.tuples(st.sets(st.integers(0, 9), min_size=1), st.integers(1, 5)), min_size=1, max_size=3))
def test_batches_hold_the_samples_of_each_client(wanted: list[tuple[set[int], int]]) -> None:
    """The vehicle sends all channels at the common divisor of the intervals, and all get these messages."""
    columns = ["imu.gyro_y", "imu.acc_x", "imu.acc_z", "estimate.theta", "estimate.q", "estimate.x", "estimate.v"]
    columns = [name for name in columns if name.replace(".", "_").upper() in _channels()]
    ends = Ends(*["none"] * len(wanted))
    rows = []
    for client, (places, every) in zip(ends.clients, wanted, strict=True):
        chosen = tuple(columns[place % len(columns)] for place in sorted(places))
        rows.append((BatchRows(tuple(dict.fromkeys(chosen))), every))
        mask = channel_mask(rows[-1][0].columns)
        ask(ends, client, BATCH, 4000 * every, param3=mask & 0xFFFF, param4=mask >> 16)
    got = union(ends.router.clients, BATCH)
    ends.settle()
    width, every = got.mask.bit_count(), got.interval // 4000
    values = np.arange(40 * width, dtype=np.float32).reshape(40, width)
    for sent in batch(every * 3, got.mask, values, every):
        fields = {name: getattr(sent, name) for name in sent.get_fieldnames()}
        ends.vehicle("TWODOF_BATCH", **fields)
    for client, (mine, own_every) in zip(ends.clients, rows, strict=True):
        for frame in ends.heard(client):
            mine.take(decode(frame))
        expected = {tick for tick in range(3 * every, 43 * every, every) if tick % own_every == 0}
        assert expected <= set(mine.ticks.tolist())
        assert mine.values.shape == (40, len(mine.columns))


def _channels() -> set[str]:
    return {entry.name.removeprefix("TWODOF_CHANNEL_") for entry in dialect.load().enums["TWODOF_CHANNEL"].values()}


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
        assert all(isfinite(request.interval) for request in client.requests.values())
