"""Virtual drones of a program's own: several start side by side, fly and are recorded together, and end together."""

import asyncio
import sys
import time
from contextlib import AsyncExitStack, suppress
from pathlib import Path

import pytest

from tests.patience import patiently
from twodof.errors import LinkError
from twodof.fleet import virtual_drone, virtual_drones
from twodof.flightlog.files import read_log
from twodof.gcs.async_drone import AsyncDrone

pytestmark = pytest.mark.slow

SET_UP = 250
"""Frames that a recording is set up with; the description of all parameters alone takes as many."""


def received(drone: AsyncDrone) -> int:
    """Frames that have come from the drone."""
    return sum(sender.received for sender in drone.statistics.senders.values())


@pytest.mark.long
def test_several_drones_are_recorded_in_one_script(tmp_path: Path) -> None:
    """Each with noise of its own; with the block their programs are gone."""

    async def record(urls: list[str]) -> list[int]:
        async with AsyncExitStack() as stack:
            drones = [await stack.enter_async_context(await AsyncDrone.connect(url)) for url in urls]
            before = [received(drone) for drone in drones]
            for number, drone in enumerate(drones):
                await stack.enter_async_context(drone.record(tmp_path / f"{number}.mcap"))
            asked = [received(drone) - count for drone, count in zip(drones, before, strict=True)]
            await asyncio.gather(*(drone.run(0.2) for drone in drones))
            return asked

    with virtual_drones(2, "lab", rings=True) as urls:
        asked = asyncio.run(record(urls))
    assert len(set(urls)) == 2
    logs = [read_log(tmp_path / f"{number}.mcap") for number in range(2)]
    assert [len(log["q"]) for log in logs] == [50, 50]
    assert (logs[0]["gyr"].value != logs[1]["gyr"].value).any()
    assert max(asked) < SET_UP, "what a recording asks for beforehand"
    for url in urls:
        with pytest.raises(LinkError):
            asyncio.run(AsyncDrone.connect(url, timeout=1.0))


@pytest.mark.long
def test_what_keeps_a_drone_from_starting_is_told() -> None:
    with pytest.raises(LinkError, match=r"nowhere\.json"), virtual_drone("nowhere.json"):
        pytest.fail("it came up")


def test_the_time_to_start_is_one_for_all_drones_and_none_leaves_a_pipe_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first one listens late, the others never."""
    first = f"mkdir '{tmp_path / 'begun'}' 2>/dev/null && sleep 2 && echo 'listening on tcpin://127.0.0.1:1 '"
    program = tmp_path / "python"
    program.write_text(f"#!/bin/sh\n{first}\nexec sleep 60\n")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    monkeypatch.setattr(sys.modules[virtual_drone.__module__], "START_S", 3.0)  # the package has a function of its name
    before = pipes()
    start = time.monotonic()
    with pytest.raises(LinkError), virtual_drones(3):
        pytest.fail("they came up")
    assert time.monotonic() - start < 4.9  # 3 s more from the first one on would be 5
    for _ in patiently():  # the first one's pipe is read to its end by a thread
        if len(pipes() - before) == 0:
            break


def pipes() -> set[str]:
    """The pipes that this process has open."""
    found = set()
    for descriptor in Path("/proc/self/fd").iterdir():
        with suppress(OSError):
            found.add(str(descriptor.readlink()))
    return {one for one in found if one.startswith("pipe:")}
