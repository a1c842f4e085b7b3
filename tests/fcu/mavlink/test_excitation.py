"""Excitations over MAVLink: pieces in any order, a start at a tick, the state told at each change, rubbish refused."""

import json
import random
import zlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fcu.command.cockpit import ME
from tests.fcu.mavlink.desk import TARGET, Desk
from tests.patience import patiently
from twodof.excitation import Multisine
from twodof.fcu.command.excitation_player import DONE, PLAYING, READY, RECEIVING, REFUSED, STOPPED
from twodof.link.mavlink.messages import excite, message
from twodof.signals import PERIOD

pytestmark = pytest.mark.slow

LONG = Multisine.schroeder(0.1, 1.0, range(1, 30))  # some pieces
VALUES = LONG.at(np.arange(250) * PERIOD)
"""What it plays."""


def pieces(excitation: Any = LONG, transfer: int = 7) -> list[Any]:
    return list(excite(excitation, 0, transfer, 1, 1))


def start(transfer: int = 7, loop: int = 0, tick: int = 0, thrust: float = 0.4) -> Any:
    return message("TWODOF_EXCITE", action=1, transfer=transfer, loop=loop, tick=tick, thrust=thrust, **TARGET)


def states(desk: Desk) -> list[int]:
    return [one.state for one in desk.taken("TWODOF_EXCITE_STATUS")]


def ready(lockstep: bool = True) -> Desk:
    desk = Desk(lockstep)
    desk.arm()
    for piece in pieces():
        desk.say(piece)
    assert states(desk)[-1] == READY
    return desk


def test_pieces_that_come_reordered_and_twice_make_one_definition() -> None:
    desk = Desk(lockstep=True)
    desk.arm()
    sent = pieces() * 2
    assert len(sent) >= 8
    random.Random(3).shuffle(sent)
    for piece in sent:
        desk.say(piece)
    told = desk.taken("TWODOF_EXCITE_STATUS")
    assert told[-1].state == READY
    assert told[-1].transfer == 7
    assert told[-1].received == len(LONG.to_json())
    assert {one.state for one in told} == {RECEIVING, READY}


def test_it_plays_its_bits_from_the_tick_of_its_start_and_tells_each_change() -> None:
    desk = ready()
    begin = desk.controller.tick + 20
    desk.say(start(tick=begin))
    (told,) = desk.taken("TWODOF_EXCITE_STATUS")
    assert (told.state, told.start_tick, told.end_tick) == (READY, begin, begin + 250)
    asked = [desk.run() for _ in range(300)]
    assert [one.M_open for one in asked] == [0.0] * 20 + list(VALUES) + [0.0] * 30
    assert asked[20].thrust == float(np.float32(0.4))
    told = desk.taken("TWODOF_EXCITE_STATUS")
    assert [one.state for one in told] == [PLAYING, DONE]
    assert [one.tick for one in told] == [begin, begin + 250]


def test_in_real_time_it_is_written_out_beside_the_loop() -> None:
    desk = Desk(lockstep=False)
    desk.arm()
    for piece in pieces():
        desk.say(piece)

    for _ in patiently():  # it takes a millisecond
        if READY in states(desk):
            break
        desk.commander.lease.note_frame(ME, True)
        desk.run()
    desk.say(start())
    assert [desk.run().M_open for _ in range(250)] == list(VALUES)


def test_nan_thrust_is_that_in_use() -> None:
    desk = ready()
    desk.say(start(thrust=float("nan")))
    assert desk.run().thrust == 0.375


def test_a_refused_start_says_why_to_all_who_must_know() -> None:
    desk = ready()
    desk.say(start(loop=2))
    told = desk.taken("TWODOF_EXCITE_STATUS")
    assert {one.state for one in told} == {REFUSED}
    assert all("rad" in one.reason for one in told)
    assert "rad" in desk.told[0]
    assert desk.run().mode == 0


def test_stop_stops_and_forgets() -> None:
    desk = ready()
    desk.say(start())
    desk.run(10)
    desk.say(message("TWODOF_EXCITE", action=2, **TARGET))
    assert states(desk)[-1] == STOPPED
    assert desk.run().M_open == 0.0
    desk.say(start())
    assert states(desk) == [REFUSED]
    assert desk.run().M_open == 0.0
    desk.say(pieces()[0])  # a late piece of it brings nothing back
    assert states(desk)[-1] == STOPPED


@pytest.mark.parametrize(
    "text", ["{", "[]", '{"kind": "impulse", "version": 1}', json.dumps({"kind": "no", "version": 1}), "\x00"]
)
def test_a_definition_that_is_none_is_refused_with_the_reason(text: str) -> None:
    desk = Desk(lockstep=True)
    desk.arm()
    data = text.encode()
    sent = {"crc": zlib.crc32(data), "transfer": 9, "total": len(data), "length": len(data), "data": data}
    desk.say(message("TWODOF_EXCITE", **sent, **TARGET))
    told = desk.taken("TWODOF_EXCITE_STATUS")
    assert told[-1].state == REFUSED
    assert told[-1].transfer == 9
    assert told[-1].reason
    desk.say(message("TWODOF_EXCITE", **sent, **TARGET))  # asked again, it says so again
    assert states(desk) == [REFUSED]
    desk.say(start(transfer=9))
    assert desk.run().mode == 0


FLOATS = st.floats(width=32) | st.sampled_from([float("nan"), float("inf"), 0.4])
WORD, BYTE = st.integers(0, 65535), st.integers(0, 255)
ANY = st.builds(
    lambda **fields: message("TWODOF_EXCITE", **fields),
    tick=st.integers(0, 2**32 - 1) | st.integers(0, 50),
    crc=st.integers(0, 2**32 - 1),
    transfer=st.integers(6, 8),
    offset=WORD | st.sampled_from([0, 200]),
    total=WORD | st.sampled_from([0, 1, 136]),
    target_system=st.sampled_from([1, 1, 0, 2]),
    target_component=st.sampled_from([1, 0]),
    action=st.integers(0, 3) | BYTE,
    loop=st.integers(0, 5) | BYTE,
    length=BYTE,
    data=st.binary(max_size=200),
    thrust=FLOATS,
)


@settings(max_examples=30)
@given(sent=st.lists(ANY, max_size=15))
def test_nothing_that_is_sent_plays_what_was_not_defined_or_arms(sent: list[Any]) -> None:
    desk = Desk(lockstep=True)
    desk.run(3)
    for one in sent:
        assert desk.say(one)
        assert desk.run().arm is False
    assert desk.commander.excitation.player.state in (0, REFUSED)
    desk = ready()
    for one in sent:
        desk.say(one)
        asked = desk.run()
        assert asked.M_open in (0.0, *VALUES)
        assert 0.0 <= asked.thrust <= 1.0


def test_a_start_whose_answer_was_lost_is_answered_after_the_end_and_not_played_again() -> None:
    desk = ready()
    desk.say(start())
    for _ in range(300):
        desk.run()
    ended = desk.taken("TWODOF_EXCITE_STATUS")[-1]
    assert ended.state == DONE
    desk.say(start())
    (again,) = desk.taken("TWODOF_EXCITE_STATUS")
    assert (again.state, again.start_tick, again.end_tick) == (DONE, ended.start_tick, ended.end_tick)
    assert [desk.run().M_open for _ in range(50)] == [0.0] * 50
