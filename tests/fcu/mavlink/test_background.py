"""Work in the background: in order, what it raises is a result, and a fault of the program is never silent."""

from __future__ import annotations

import pytest

from tests.patience import patiently
from twodof.fcu.mavlink.background import BackgroundWorker


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
