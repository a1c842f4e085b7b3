"""Storing: command 245 with an answer that is true, work beside the control loop, trouble of the disk told once."""

import errno
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.fcu.mavlink.world import World, step
from tests.fcu.steps import plain_step
from tests.patience import PATIENCE_S, patiently
from twodof.errors import ParameterError
from twodof.fcu.command.command_lease import rejected
from twodof.fcu.mavlink.background import BackgroundWorker
from twodof.fcu.mavlink.command_service import LOOK_TICKS, StorageMonitor
from twodof.fcu.onboard_log.logger import OnboardLogger
from twodof.fcu.parameters import parameter_store as store_module
from twodof.fcu.parameters.parameter_store import ParameterStore
from twodof.link.mavlink.dialect import MavResult
from twodof.link.mavlink.messages import message

STORAGE = 245
LOAD, SAVE, RESET_CONFIG, RESET_SENSORS, RESET_ALL = 0.0, 1.0, 2.0, 3.0, 4.0


def changed() -> World:
    world = World()
    world.store.update({"ATT_KP": 9.0, "THRUST_BAR": 0.5})
    world.run(1)
    world.sent.clear()
    return world


@pytest.mark.parametrize("action", [RESET_CONFIG, RESET_ALL])
def test_all_are_set_to_their_defaults_which_is_told_to_all(action: float) -> None:
    world = changed()
    assert world.command(STORAGE, action, -1.0) == MavResult.ACCEPTED
    assert world.store.changed() == {}
    assert {"ATT_KP", "THRUST_BAR"} <= {value.param_id for value in world.taken("PARAM_VALUE", None)}


class Disk:
    """Stands for the disk under the files that are synced: it waits, or refuses, and notes what was done."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.done: list[str] = []
        self.error = 0
        self.answers = threading.Event()
        self.answers.set()
        self._fsync, self._replace = os.fsync, Path.replace
        patch.setattr(os, "fsync", self.fsync)
        patch.setattr(Path, "replace", lambda path, target: self.replace(path, target))

    def fsync(self, descriptor: int) -> None:
        assert threading.current_thread() is not threading.main_thread(), "the control loop waits for the disk"
        assert self.answers.wait(PATIENCE_S)
        if self.error:
            raise OSError(self.error, os.strerror(self.error))
        self._fsync(descriptor)
        self.done.append("folder" if Path(f"/proc/self/fd/{descriptor}").resolve().is_dir() else "file")

    def replace(self, path: Path, target: Path) -> Path:
        self.done.append("rename")
        return self._replace(path, target)


@contextmanager
def stored(folder: Path) -> Iterator[World]:
    """One that keeps its parameters in a file, with a change that is not written yet."""
    with ParameterStore(folder / "parameters.json") as store:
        world = World(store=store)
        store.update({"ATT_KP": 9.0})
        yield world


def answer(world: World, action: float) -> Any:
    """Return the answer to a storage command, tick by tick as in real time."""
    world.say(message("COMMAND_LONG", command=STORAGE, param1=action, target_system=1, target_component=1))
    for _ in patiently():
        if acknowledged := world.taken("COMMAND_ACK"):
            return acknowledged[0].result
        world.run(1)
    raise AssertionError


@pytest.mark.parametrize("action", [LOAD, SAVE])
def test_the_answer_comes_when_file_and_folder_are_on_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, action: float
) -> None:
    with stored(tmp_path) as world:
        world.commander.verdict = rejected("another has the lease")
        disk = Disk(monkeypatch)
        assert answer(world, action) == MavResult.ACCEPTED
        assert disk.done == ["file", "rename", "folder"]
        assert ParameterStore(tmp_path / "parameters.json").changed() == {"ATT_KP": 9.0}


@pytest.mark.parametrize("action", [SAVE, RESET_ALL])
def test_the_control_loop_does_not_wait_for_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, action: float
) -> None:
    with stored(tmp_path) as world:
        disk = Disk(monkeypatch)
        disk.answers.clear()
        world.say(message("COMMAND_LONG", command=STORAGE, param1=action, target_system=1, target_component=1))
        world.run(1000)
        assert not world.taken("COMMAND_ACK"), "acknowledged, and nothing is on the disk"
        disk.answers.set()
        for _ in patiently():
            world.run(1)
            if acknowledged := world.taken("COMMAND_ACK"):
                break
        assert [one.result for one in acknowledged] == [MavResult.ACCEPTED]
        assert disk.done == ["file", "rename", "folder"]


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EIO, errno.EROFS])
def test_a_disk_that_refuses_is_said_and_another_try_is_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: int
) -> None:
    with stored(tmp_path) as world:
        disk = Disk(monkeypatch)
        disk.error = error
        assert answer(world, SAVE) == MavResult.FAILED
        said = world.texts()
        assert "parameters are not stored" in said
        assert os.strerror(error) in said
        disk.error = 0
        world.sent.clear()
        assert answer(world, SAVE) == MavResult.ACCEPTED  # though the thread itself would try only seconds later
        assert ParameterStore(tmp_path / "parameters.json").changed() == {"ATT_KP": 9.0}


def test_a_disk_that_is_silent_has_not_stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store_module, "SAVE_S", 0.01)
    with stored(tmp_path) as world:
        disk = Disk(monkeypatch)
        disk.answers.clear()
        assert answer(world, SAVE) == MavResult.FAILED
        assert "the disk did not answer within 0.01 s" in world.texts()
        disk.answers.set()


def test_where_nothing_is_kept_nothing_is_said_to_be_stored() -> None:
    for action in (LOAD, SAVE):
        world = changed()
        assert world.command(STORAGE, action) == MavResult.UNSUPPORTED
        assert "it keeps no parameters" in world.texts()


def test_not_in_flight_and_not_by_who_may_not_command() -> None:
    world = changed()
    world.commander.armed = True
    for action in (LOAD, SAVE, RESET_CONFIG, RESET_ALL):
        assert world.command(STORAGE, action) == MavResult.TEMPORARILY_REJECTED
    world.commander.armed, world.commander.verdict = (False, rejected("another has the lease"))
    assert world.command(STORAGE, RESET_ALL) == MavResult.TEMPORARILY_REJECTED
    assert "another has the lease" in world.texts()
    assert world.store.changed() == {"ATT_KP": 9.0, "THRUST_BAR": 0.5}


@pytest.mark.parametrize(
    ("action", "answer"), [(RESET_SENSORS, MavResult.UNSUPPORTED), (5.0, MavResult.DENIED), (-1.0, MavResult.DENIED)]
)
def test_what_there_is_not_is_refused(action: float, answer: int) -> None:
    assert changed().command(STORAGE, action) == answer
    assert changed().command(STORAGE, float("nan")) == MavResult.DENIED


ERROR, WARNING = 3, 4


def test_a_disk_that_refuses_is_told_once_for_each_trouble(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    store = ParameterStore(tmp_path / "file" / "p.json")
    log = OnboardLogger(tmp_path / "logs", store, lockstep=True)
    world = World(store=store)
    remarks = world.commander.remarks
    keeping = StorageMonitor(world.px4.vehicle, log)

    def seconds(count: int) -> list[tuple[int, str]]:
        for tick in range(count * LOOK_TICKS):
            keeping.after(step(tick))
        said, remarks[:] = remarks[:], []
        return said

    assert seconds(2) == []
    store.update({"RATE_KP": 0.07})
    with pytest.raises(ParameterError):
        store.flush()
    ((severity, text),) = seconds(3)
    assert (severity, text.split(":")[0]) == (ERROR, "parameters are not stored")
    (tmp_path / "logs").rmdir()
    for tick in range(10):
        log.step(plain_step(tick, armed=True))
    log.end()
    log.dropped = 5
    said = seconds(3)
    assert [severity for severity, _ in said] == [ERROR, WARNING]
    assert said[0][1].startswith("no on-board log: ")
    assert "5 steps are missing" in said[1][1]
    # All is well again, and then not: that is news.
    (tmp_path / "file").unlink()
    store.flush()
    assert seconds(1) == []
    store.close()
    log.close()


def poll_until(background: BackgroundWorker, results: list[object], count: int) -> None:
    """Polls until `count` results were handed over."""
    for _ in patiently():
        background.poll()
        if len(results) >= count:
            break


def refuse() -> None:
    raise FileNotFoundError("no such log")


def fail() -> None:
    raise KeyError("a fault of the program")


def test_what_the_disk_refuses_is_a_result_and_the_next_work_is_done() -> None:
    background, results = BackgroundWorker(), list[object]()
    for work in (refuse, lambda: 1, lambda: 2):
        assert background.submit(work, results.append)
    poll_until(background, results, 3)
    assert isinstance(results[0], FileNotFoundError)
    assert results[1:] == [1, 2]


@pytest.mark.parametrize("inline", [False, True])
def test_a_fault_of_the_program_is_answered_and_raised_and_the_next_work_is_done(inline: bool) -> None:
    background, results = BackgroundWorker(inline), list[object]()

    def work() -> None:
        background.submit(fail, results.append)
        poll_until(background, results, 2)

    with pytest.raises(KeyError, match="a fault of the program"):
        work()
    assert isinstance(results[0], OSError)
    assert "KeyError" in str(results[0])
    assert background.submit(lambda: 1, results.append)
    poll_until(background, results, 2)
    assert results[1] == 1
