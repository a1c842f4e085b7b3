"""Log download as MAVSDK and MAVProxy do it: in pieces, with losses, for several clients, refused where it must be."""

import asyncio
import random
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.faults.virtual_time import on_virtual_time
from tests.fcu.mavlink.world import CLIENT, World
from tests.fcu.steps import plain_step
from tests.patience import patiently
from twodof.fcu.command.command_lease import CommandResult, rejected
from twodof.fcu.mavlink.log_transfer import ENTRIES_A_TICK_ARMED, MOST_READERS, PART, LogDownload
from twodof.fcu.onboard_log.logger import OnboardLogger
from twodof.link.mavlink.messages import message

pytestmark = pytest.mark.slow

US = {"target_system": 1, "target_component": 1}
MAVSDK_CHUNK = 512 * PART
"""What MAVSDK asks for at once."""


def world_of(log: OnboardLogger, lockstep: bool = True) -> World:
    world = World(lockstep=lockstep)
    world.services.append(LogDownload(world.px4.vehicle, log))
    return world


def written(folder: Path, counts: tuple[int, ...] = (40, 300)) -> OnboardLogger:
    """Logs of so many armed steps."""
    log = OnboardLogger(folder, World().store, lockstep=True)
    for count in counts:
        for tick in range(count):
            log.step(plain_step(tick, armed=True))
        log.end()
    return log


async def settled(world: World, done: Callable[[], bool]) -> None:
    """Lets time pass until `done`, or nothing is sent any more."""
    quiet = 0
    while not done() and quiet < 50:
        before = len(world.sent)
        await asyncio.sleep(0.002)
        quiet = quiet + 1 if len(world.sent) == before else 0


async def listed(world: World, peer: str = "client") -> list[Any]:
    world.say(message("LOG_REQUEST_LIST", start=0, end=0xFFFF, **US), peer)
    await settled(world, lambda: False)
    return world.taken("LOG_ENTRY", peer)


async def download(world: World, entry: Any, loss: float = 0.0, peer: str = "client") -> bytes:
    """All of a log in MAVSDK's chunks; what got lost is asked for again, piece by piece."""
    rng, parts = random.Random(3), {}
    wanted = [*range(0, entry.size, MAVSDK_CHUNK)]
    for begin in wanted:
        end = min(begin + MAVSDK_CHUNK, entry.size)
        ask, count = begin, end - begin
        while True:
            world.say(message("LOG_REQUEST_DATA", id=entry.id, ofs=ask, count=count, **US), peer)
            await settled(world, lambda: False)
            for part in world.taken("LOG_DATA", peer):
                if rng.random() >= loss:
                    parts[part.ofs] = bytes(part.data[: part.count])
            missing = [at for at in range(begin, end, PART) if at not in parts]
            if not missing:
                break
            ask, count = missing[0], PART
    return b"".join(parts[at] for at in sorted(parts))[: entry.size]


@pytest.mark.long
@pytest.mark.parametrize("loss", [0.0, 0.3])
@on_virtual_time
async def test_every_byte_comes_whatever_gets_lost(tmp_path: Path, loss: float) -> None:
    log = written(tmp_path, (40, 120))
    world = world_of(log)
    entries = await listed(world)
    assert [(one.id, one.num_logs, one.last_log_num) for one in entries] == [(0, 2, 1), (1, 2, 1)]
    assert all(one.time_utc > 1_500_000_000 for one in entries)
    for entry, stored in zip(entries, log.logs(), strict=True):
        assert await download(world, entry, loss) == stored.path.read_bytes()
    log.close()


@on_virtual_time
async def test_who_asks_for_everything_is_told_where_it_ends(tmp_path: Path) -> None:
    log = written(tmp_path, (40,))
    world = world_of(log)
    (entry,) = await listed(world)
    for first in (0, entry.size - 10, entry.size, entry.size + 1):
        world.say(message("LOG_REQUEST_DATA", id=0, ofs=first, count=0xFFFFFFFF, **US))
        await settled(world, lambda: False)
        parts = world.taken("LOG_DATA")
        assert [part.ofs for part in parts] == [*range(first, first + PART * len(parts), PART)]
        assert sum(part.count for part in parts) == max(entry.size - first, 0)
        assert parts[-1].count < PART
        assert all(part.count == PART for part in parts[:-1])
    log.close()


@on_virtual_time
async def test_clients_do_not_disturb_each_other(tmp_path: Path) -> None:
    log = written(tmp_path)
    world = world_of(log)
    ours, theirs = await listed(world), await listed(world, "other")
    world.say(message("LOG_REQUEST_DATA", id=0, ofs=0, count=0xFFFFFFFF, **US), "third")
    found = await asyncio.gather(download(world, ours[1]), download(world, theirs[1], peer="other"))
    whole = log.logs()[1].path.read_bytes()
    assert [*found] == [whole, whole]
    log.close()


@on_virtual_time
async def test_numbers_stay_while_logs_come_and_go(tmp_path: Path) -> None:
    log = written(tmp_path)
    world = world_of(log)
    entries = await listed(world)
    second = log.logs()[1].path.read_bytes()
    log.logs()[0].path.unlink()
    assert await download(world, entries[1]) == second
    world.say(message("LOG_REQUEST_DATA", id=0, ofs=0, count=90, **US))
    await settled(world, lambda: False)
    assert world.taken("LOG_DATA") == []
    assert "cannot be read" in world.texts()
    log.close()


@on_virtual_time
async def test_end_ends_and_nothing_is_nothing(tmp_path: Path) -> None:
    log = written(tmp_path, ())
    world = world_of(log)
    (none,) = await listed(world)
    assert (none.num_logs, none.size) == (0, 0)
    world.say(message("LOG_REQUEST_DATA", id=0, ofs=0, count=90, **US))
    assert "log 0 does not exist" in world.texts()
    for tick in range(900):
        log.step(plain_step(tick, armed=True))
    log.end()
    await listed(world)
    world.say(message("LOG_REQUEST_DATA", id=0, ofs=0, count=0xFFFFFFFF, **US))
    world.say(message("LOG_REQUEST_END", **US))
    sent = len(world.taken("LOG_DATA"))
    await settled(world, lambda: False)
    assert len(world.taken("LOG_DATA")) == 0 < sent
    log.close()


def test_erasing_needs_the_lease_and_keeps_what_is_being_written(tmp_path: Path) -> None:
    log = written(tmp_path)
    log.step(plain_step(0, armed=True))
    log.flush()
    world = world_of(log)
    world.commander.verdict = rejected("another holds the lease")
    world.say(message("LOG_ERASE", **US))
    assert (len(log.logs()), world.texts()) == (3, "another holds the lease")
    world.commander.verdict = CommandResult(0)
    world.run(1, armed=True)
    world.say(message("LOG_ERASE", **US))
    assert (len(log.logs()), world.texts()) == (3, "no log is erased while armed: disarm first")
    world.run(1, armed=False)
    world.say(message("LOG_ERASE", **US))
    assert [one.path for one in log.logs()] == [log.path]
    assert world.commander.asked == [("take", CLIENT, "logs")] * 2
    log.close()


def test_in_real_time_the_disk_is_read_by_another_thread_and_sent_bit_by_bit(tmp_path: Path) -> None:
    log = written(tmp_path, (40,))
    world = world_of(log, lockstep=False)
    world.say(message("LOG_REQUEST_LIST", start=0, end=0xFFFF, **US))
    assert world.taken("LOG_ENTRY") == []
    entries: list[Any] = []
    for _ in patiently():
        world.run(1)
        entries = entries or world.taken("LOG_ENTRY")
        if entries:
            break
    world.say(message("LOG_REQUEST_DATA", id=0, ofs=0, count=0xFFFFFFFF, **US))
    got, most = b"", 0
    for _ in patiently():
        world.run(1, armed=True)
        parts = world.taken("LOG_DATA")
        most = max(most, len(parts))
        got += b"".join(bytes(part.data[: part.count]) for part in parts)
        if len(got) >= entries[0].size:
            break
    assert got == log.logs()[0].path.read_bytes()
    assert 0 < most <= ENTRIES_A_TICK_ARMED
    log.close()


def test_a_request_for_data_does_not_cut_off_the_list(tmp_path: Path) -> None:
    log = written(tmp_path, (20,) * 12)
    world = world_of(log, lockstep=False)
    world.say(message("LOG_REQUEST_LIST", start=0, end=0xFFFF, **US))
    found: list[Any] = []
    for _ in patiently():
        world.run(1, armed=True)
        fresh = world.taken("LOG_ENTRY")
        if fresh and not found:
            world.say(message("LOG_REQUEST_DATA", id=0, ofs=0, count=PART, **US))
        found += fresh
        if len(found) >= 12 or world.taken("LOG_DATA"):
            break
    assert [entry.id for entry in found] == [*range(12)]
    log.close()


def test_however_many_ask_a_control_period_has_a_bounded_share_and_everybody_a_turn(tmp_path: Path) -> None:
    log = written(tmp_path, (3,) * 30)
    world = world_of(log, lockstep=False)
    for client in range(MOST_READERS):
        world.say(message("LOG_REQUEST_LIST", start=0, end=0xFFFF, **US), f"client {client}")
    counts, sent = Counter[Any](), 0
    for _ in patiently():
        world.run(1, armed=True)
        entries = [peer for one, peer in world.sent if one.get_type() == "LOG_ENTRY"]
        sent = max(sent, len(entries))
        counts.update(entries)
        world.sent.clear()
        if counts.total() == 30 * MOST_READERS:
            break
    assert 0 < sent <= ENTRIES_A_TICK_ARMED
    assert set(counts.values()) == {30}
    assert len(counts) == MOST_READERS
    log.close()
