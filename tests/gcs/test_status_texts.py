"""What a drone says in words, as it says it: in pieces, in other alphabets, and as PX4 counts its lines."""

import asyncio

import pytest

from tests.faults.virtual_time import run_virtual
from tests.gcs.peer import Peer
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.drone_state import PIECES_S
from twodof.link.mavlink.messages import statustext

LONG = "Arming denied: Resolve system health failures first"


def heard(*lines: tuple[int, list[bytes]], wait: float = 0.0) -> list[str]:
    """The lines that a client has after these were sent: their id, and their pieces."""

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
    """Its first line in pieces has the id 0, which by MAVLink says that it has one piece only."""
    raw = LONG.encode()
    assert heard((0, [raw[:50], raw[50:]]), (1, [b"Armed"])) == [LONG, "Armed"]


def test_a_line_that_fills_its_last_piece_is_not_lost() -> None:
    """Two of 50 bytes: the one is ended by the other, which is ended by a silence."""
    assert heard((3, [b"a" * 50]), (4, [b"b" * 50])) == ["a" * 50]
    assert heard((3, [b"a" * 50]), (4, [b"b" * 50]), wait=2.0 * PIECES_S) == ["a" * 50, "b" * 50]
    assert heard((0, [b"a" * 50]), (0, [b"b" * 50]), (0, [b"c"])) == ["a" * 50, "b" * 50, "c"]
