"""The log streamed while it is written: acknowledged where it must arrive, whole where nothing is lost, found again."""

import asyncio
import random
from pathlib import Path
from typing import Any

import pytest

from tests.faults.virtual_time import on_virtual_time
from tests.fcu.mavlink.test_log_download import US, settled
from tests.fcu.mavlink.world import World
from tests.fcu.steps import plain_step
from twodof.fcu.mavlink.log_transfer import LogStreamService
from twodof.fcu.onboard_log.logger import OnboardLogger
from twodof.flightlog.ulog_file import scan_ulog
from twodof.link.mavlink.messages import message

pytestmark = pytest.mark.slow

START, STOP = 2510, 2511

ACCEPTED, TEMPORARILY_REJECTED, DENIED = 0, 1, 2
ACKED = "LOGGING_DATA_ACKED"


def world_of(folder: Path) -> tuple[World, OnboardLogger]:
    world = World(lockstep=True)
    log = OnboardLogger(folder, world.store, lockstep=True)
    # Before those that take what they know: it is to hear every frame.
    world.services.insert(1, LogStreamService(world.px4.vehicle, world.px4.commands, log))
    return world, log


async def received(world: World, log: OnboardLogger, steps: int, loss: float = 0.0) -> list[Any]:
    """Return the messages of a client that acknowledges, while `steps` steps are flown and some are lost."""
    rng, got = random.Random(4), []
    sequences: set[int] = set()
    for tick in range(steps):
        log.step(plain_step(tick))
    log.flush()
    quiet = 0
    while quiet < 100:  # .2 s without anything
        await asyncio.sleep(0.002)
        news = [one for one, _ in world.sent if one.get_type().startswith("LOGGING_DATA")]
        quiet = 0 if news else quiet + 1
        world.sent.clear()
        for one in news:
            if one.get_type() == ACKED:
                if rng.random() < loss:
                    continue
                world.say(message("LOGGING_ACK", sequence=one.sequence, **US))
                if one.sequence in sequences:
                    continue
                sequences.add(one.sequence)
            got.append(one)
    return got


def whole(got: list[Any]) -> bytes:
    return b"".join(bytes(one.data[: one.length]) for one in got)


@pytest.mark.parametrize("loss", [0.0, 0.3])
@on_virtual_time
async def test_the_stream_is_the_file(tmp_path: Path, loss: float) -> None:
    world, log = world_of(tmp_path)
    assert world.command(START, 0.0) == ACCEPTED
    got = await received(world, log, 400, loss)
    (stored,) = log.logs()
    assert whole(got) == stored.path.read_bytes()
    assert [one.sequence for one in got] == [*range(len(got))]
    # What describes the log must arrive, records need not.
    described = [one.get_type() == ACKED for one in got]
    assert described == sorted(described, reverse=True)
    head = scan_ulog(whole(got[: sum(described)]), "head")
    assert head.formats == scan_ulog(whole(got), "all").formats
    assert not head.topics
    assert world.command(STOP) == ACCEPTED
    log.close()


@on_virtual_time
async def test_a_client_that_does_not_answer_is_given_up(tmp_path: Path) -> None:
    world, log = world_of(tmp_path)
    world.command(START, 0.0)
    for tick in range(10):
        log.step(plain_step(tick))
    log.flush()
    await settled(
        world,
        lambda: "not streamed any more" in "".join(one.text for one, _ in world.sent if one.get_type() == "STATUSTEXT"),
    )
    sent = world.taken(ACKED)
    assert {one.sequence for one in sent} == {0}
    assert len(sent) == 51  # once, and again 50 times
    assert "no LOGGING_ACK" in world.texts()
    assert world.command(START, 0.0) == ACCEPTED
    log.close()


@on_virtual_time
async def test_a_stream_to_a_client_that_is_gone_ends(tmp_path: Path) -> None:
    world, log = world_of(tmp_path)

    def texts() -> str:
        return "".join(one.text for one, _ in world.sent if one.get_type() == "STATUSTEXT")

    assert world.command(START, 0.0) == ACCEPTED
    await received(world, log, 100)  # all that is to be answered was
    for _ in range(3):  # a heartbeat each 4 s keeps it, whatever others say
        await asyncio.sleep(4.0)
        world.say(message("HEARTBEAT", type=6, autopilot=8))
    assert world.command(START, 0.0, source=(245, 190)) == TEMPORARILY_REJECTED, "it is streamed still"
    begin = asyncio.get_running_loop().time()
    while "is silent" not in texts():
        await asyncio.sleep(0.1)
        world.say(message("HEARTBEAT", type=6, autopilot=8), source=(245, 190))
    assert asyncio.get_running_loop().time() - begin == pytest.approx(5.0, abs=0.2)
    assert world.command(START, 0.0, source=(245, 190)) == ACCEPTED
    log.close()


@on_virtual_time
async def test_it_begins_with_a_new_log_and_serves_one_client(tmp_path: Path) -> None:
    world, log = world_of(tmp_path)
    for tick in range(100):
        log.step(plain_step(tick, armed=True))
    log.flush()
    assert world.command(START, 3.0) == DENIED
    assert world.command(START, 0.0) == ACCEPTED
    assert world.command(START, 0.0, peer="other", source=(7, 1)) == TEMPORARILY_REJECTED
    assert world.command(STOP, peer="other", source=(7, 1)) == ACCEPTED  # it has none to stop
    for tick in range(100, 150):
        log.step(plain_step(tick, armed=True))
    got = await received(world, log, 0)
    first, second = log.logs()
    assert whole(got) == second.path.read_bytes()
    assert first.size > 0
    log.close()
