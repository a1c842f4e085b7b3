"""State of a drone in words: explanations of the failsafe, and lines of text in pieces."""

import asyncio

import pytest

from tests.faults.virtual_time import run_virtual
from tests.gcs.peer import Peer
from twodof.flight.failsafe.causes_and_actions import ACTIONS
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.drone_state import PIECES_S, SafetyState, explanation_of, names_of
from twodof.link.mavlink import dialect
from twodof.link.mavlink.messages import statustext

CAUSES = [
    name.removeprefix("TWODOF_CAUSE_").lower()
    for row in dialect.load().enums["TWODOF_CAUSE"].values()
    if not (name := str(row.name)).endswith("ENUM_END")
]


@pytest.mark.parametrize("cause", CAUSES)
def test_every_cause_is_explained(cause: str) -> None:
    words = SafetyState("descend", cause).in_words()
    assert words.startswith("descend (level, the thrust fades to 0, then off): ")
    assert len(words.partition("): ")[2]) > 15
    assert cause not in words


def test_every_cause_has_its_bit() -> None:
    assert names_of("TWODOF_CAUSE", (1 << len(CAUSES)) - 1) == tuple(CAUSES)


def test_every_action_is_explained() -> None:
    assert all(explanation_of("TWODOF_ACTION", action) for action in ACTIONS)


def test_no_reason_is_empty_and_unknown_words_stay() -> None:
    assert SafetyState("off", "").in_words() == ""
    assert SafetyState("none", "link_lost").in_words() == ""
    assert SafetyState("7", "bit 30").in_words() == "7: bit 30"


LONG = "Arming denied: Resolve system health failures first"


def heard(*lines: tuple[int, list[bytes]], wait: float = 0.0) -> list[str]:
    """Return a client's lines after these ids and pieces were sent."""

    async def talk() -> list[str]:
        async with Peer() as peer, await AsyncDrone.connect(peer.url) as drone:
            for number, pieces in lines:
                for place, piece in enumerate(pieces):
                    peer.send("STATUSTEXT", severity=2, text=piece, id=number, chunk_seq=place)
            await asyncio.sleep(wait or 0.02)
            assert all(line.severity == "critical" for line in drone.messages)
            return [line.text for line in drone.messages]

    return run_virtual(talk())


@pytest.mark.parametrize("text", ["short", LONG, "é" * 60 + " ende", "x" * 49 + "µm and so on", "y" * 120])
def test_a_line_is_heard_as_it_was_said(text: str) -> None:
    assert heard((7, [bytes(part._text_raw) for part in statustext(text)])) == [text]


def test_pieces_that_overtake_each_other_are_put_in_order() -> None:
    first, second, third = (bytes(part._text_raw) for part in statustext("x" * 50 + "y" * 50 + "z"))

    async def talk() -> list[str]:
        async with Peer() as peer, await AsyncDrone.connect(peer.url) as drone:
            for place, piece in ((0, first), (2, third), (1, second)):
                peer.send("STATUSTEXT", severity=2, text=piece, id=9, chunk_seq=place)
            await asyncio.sleep(0.02)
            return [line.text for line in drone.messages]

    assert run_virtual(talk()) == ["x" * 50 + "y" * 50 + "z"]


def test_px4_counts_its_lines_from_zero() -> None:
    """Id 0 would mean a line of one piece in MAVLink."""
    raw = LONG.encode()
    assert heard((0, [raw[:50], raw[50:]]), (1, [b"Armed"])) == [LONG, "Armed"]


def test_a_line_that_fills_its_last_piece_is_not_lost() -> None:
    assert heard((3, [b"a" * 50]), (4, [b"b" * 50])) == ["a" * 50]
    assert heard((3, [b"a" * 50]), (4, [b"b" * 50]), wait=2.0 * PIECES_S) == ["a" * 50, "b" * 50]
    assert heard((0, [b"a" * 50]), (0, [b"b" * 50]), (0, [b"c"])) == ["a" * 50, "b" * 50, "c"]
