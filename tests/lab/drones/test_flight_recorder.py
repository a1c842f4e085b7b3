"""The recorder of flights, with a drone by script on virtual time: what it says of the file that it writes."""

import asyncio
import errno
import os
import time
from collections.abc import Callable
from math import inf
from pathlib import Path

import pytest

from tests.faults.virtual_time import run_virtual
from tests.gcs.peer import Peer
from twodof.flightlog import read_log
from twodof.gcs.active_controller import ActiveController
from twodof.gcs.async_drone import AsyncDrone
from twodof.lab.drones.pilot import FlightRecorder

pytestmark = pytest.mark.slow


class _Flown:
    """One flight of `seconds`, looked at all the time.

    `unclaimed` are files that were there, not whole, and not said to be written; `told` those said to be whole.
    """

    def __init__(
        self,
        folder: Path,
        seconds: float,
        telemetry: bool,
        rests: bool = False,
        each: Callable[[], None] = lambda: None,
    ) -> None:
        self.unclaimed: set[str] = set()
        self.told: list[str] = []
        self.failed: list[str] = []
        self.seen: set[str] = set()
        self.named: set[str] = set()
        self.last = ""
        self._each = each
        self._folder, self._seconds, self._telemetry, self._rests = folder, seconds, telemetry, rests
        run_virtual(self._fly())

    async def _fly(self) -> None:
        async def flying() -> ActiveController:
            return ActiveController(known=False)

        async with Peer() as peer, await AsyncDrone.connect(peer.url) as drone:
            told = (self.told.append, self.failed.append)
            recorder = FlightRecorder(drone, self._folder, flying, *told, lambda: self._rests)
            tasks = [asyncio.create_task(recorder.run()), asyncio.create_task(self._look(recorder))]
            await drone.arm()
            for tick in range(round(self._seconds / 0.1)):
                await asyncio.sleep(0.1)
                if self._telemetry:
                    peer.send("TWODOF_SAFETY", tick=25 * tick, action=0, reason=0, flags=0)
                self._each()
            self.last = recorder.name
            await drone.disarm()
            await asyncio.sleep(3.0)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _look(self, recorder: FlightRecorder) -> None:
        while True:
            self.named |= {recorder.name} - {""}
            for path in self._folder.glob("*.mcap"):
                self.seen.add(path.name)
                if path.name not in (recorder.name, *self.told):
                    self.unclaimed.add(path.name)
            await asyncio.sleep(0.0005)


def test_a_file_in_writing_is_always_named(tmp_path: Path) -> None:
    """Else the list of logs offers one that cannot be read yet."""
    flown = _Flown(tmp_path, 2.0, telemetry=True)
    assert flown.unclaimed == set()
    assert flown.seen == set(flown.told)
    assert flown.failed == []
    (name,) = flown.told
    assert len(read_log(tmp_path / name)["safety"]) == 20


def test_a_flight_of_which_nothing_came_leaves_no_file(tmp_path: Path) -> None:
    """A file without a sample cannot be read: nobody should find it in the list of logs."""
    flown = _Flown(tmp_path, 0.2, telemetry=False)
    assert flown.told == []
    assert list(tmp_path.iterdir()) == []


def test_a_flight_that_records_itself_is_not_recorded_again(tmp_path: Path) -> None:
    flown = _Flown(tmp_path, 1.0, telemetry=True, rests=True)
    assert (flown.told, flown.failed) == ([], [])
    assert list(tmp_path.iterdir()) == []


def fill_disk(monkeypatch: pytest.MonkeyPatch, room: float) -> None:
    """Leave room for the first file's head and first samples; no later write begins beyond `room` bytes of a file."""
    write, heads = os.write, dict[int, int]()

    def limited(descriptor: int, data: bytes) -> int:
        file = os.fstat(descriptor)
        head = heads.setdefault(file.st_ino, len(data))
        first = file.st_ino == next(iter(heads))
        if file.st_size > head if first else file.st_size >= room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(descriptor, data)

    monkeypatch.setattr("twodof.flightlog.append_only_file.os.write", limited)


@pytest.mark.long
@pytest.mark.parametrize("room", [0, 1])
def test_a_full_disk_is_said_once(room: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Recording is tried again, with `room` for a file's head or without, and leaves nothing behind."""
    fill_disk(monkeypatch, room)
    flown = _Flown(tmp_path, 12.0, telemetry=True, each=lambda: time.sleep(0.03))
    assert flown.last == ""
    assert len(flown.named) == len(flown.told) == len([*tmp_path.iterdir()]) == 1
    (line,) = flown.failed
    assert line.startswith("this flight is not being recorded: the disk refused: No space left on device")
    assert line.endswith("It is tried every 5 s: make room on the server's disk")
    assert str(tmp_path) not in line


@pytest.mark.long
def test_recording_goes_on_where_there_is_room_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fill_disk(monkeypatch, inf)
    flown = _Flown(tmp_path, 12.0, telemetry=True, each=lambda: time.sleep(0.03))
    assert flown.last in flown.told
    assert len(flown.named) == len(flown.told) == 2
    assert len(flown.failed) == 1
