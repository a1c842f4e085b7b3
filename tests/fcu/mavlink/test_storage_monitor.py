"""Storage monitor: each trouble of the disk is told once."""

from pathlib import Path

import pytest

from tests.fcu.mavlink.world import step
from tests.fcu.steps import plain_step
from twodof.errors import ParameterError
from twodof.fcu.mavlink.command_service import LOOK_TICKS, StorageMonitor
from twodof.fcu.onboard_log.logger import OnboardLogger
from twodof.fcu.parameters.parameter_store import ParameterStore

ERROR, WARNING = 3, 4


def test_a_disk_that_refuses_is_told_once_for_each_trouble(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    remarks: list[tuple[int, str]] = []
    store = ParameterStore(tmp_path / "file" / "p.json")
    log = OnboardLogger(tmp_path / "logs", store, lockstep=True)
    keeping = StorageMonitor(store, log, remarks)

    def seconds(count: int) -> list[tuple[int, str]]:
        for tick in range(count * LOOK_TICKS):
            keeping.after(step(tick))
        said, remarks[:] = remarks[:], []
        return said

    assert seconds(2) == []
    store.set("RATE_KP", 0.07)
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
