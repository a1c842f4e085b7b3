"""Turns: people take turns, and the person with the most requests is refused first."""

import asyncio

import pytest

from tests.patience import PATIENCE_S
from twodof.errors import Rejected
from twodof.lab.turns import Turns, greediest


@pytest.mark.parametrize(
    ("people", "found"), [("", ""), ("a", "a"), ("aba", "a"), ("ab", "b"), ("ba", "a"), ("abbaa", "a")]
)
def test_the_greediest_person_is_found(people: str, found: str) -> None:
    assert greediest(people) == found


def test_people_take_turns_and_greed_is_refused() -> None:
    served: list[str] = []

    async def work(turns: Turns, name: str) -> None:
        async with turns.turn(name[0]):
            served.append(name)
            await asyncio.sleep(0)

    async def run() -> None:
        turns = Turns(1, 4, "test")
        names = ["a1", "a2", "a3", "a4", "b1", "a5", "c1"]
        done = await asyncio.gather(*(work(turns, name) for name in names), return_exceptions=True)
        refused = [name for name, error in zip(names, done, strict=True) if isinstance(error, Rejected)]
        assert served == ["a1", "b1", "c1", "a2", "a3"]
        assert refused == ["a4", "a5"]

    asyncio.run(run())


def test_a_cancelled_request_passes_its_turn_on() -> None:
    async def run() -> None:
        turns = Turns(1, 9, "test")
        await turns.take("a")
        waiting = [asyncio.create_task(turns.take(name)) for name in "abc"]
        await asyncio.sleep(0)
        waiting[0].cancel()
        turns.give_back()  # to b, who is cancelled before b runs on
        waiting[1].cancel()
        await asyncio.gather(*waiting[:2], return_exceptions=True)
        await asyncio.wait_for(waiting[2], PATIENCE_S)
        turns.give_back()
        await asyncio.wait_for(turns.take("d"), PATIENCE_S)

    asyncio.run(run())
