"""A user's program beside the drone: it flies, it ends, it is told to end; a file that is not a program is refused."""

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.gcs.virtual import OnBoard, on_board
from tests.patience import PATIENCE_S
from twodof.gcs.app import FINE, NO_APP, RAISED, run

pytestmark = pytest.mark.slow

HOLDS = """
async def main(drone):
    await drone.run(0.3)
    await drone.arm()
    await drone.level_hold()
    print(drone.session.connection.system, drone.session.connection.component, flush=True)
    await drone.run({seconds})
"""


@pytest.fixture
def there() -> Iterator[OnBoard]:
    """A virtual drone in real time, rings locked, with another system id than the first one's."""
    with on_board(conditions={"rings": True}, index=2) as made:
        yield made


def test_a_program_on_board_disarms_at_its_end(there: OnBoard, tmp_path: Path) -> None:
    file = tmp_path / "holds.py"
    file.write_text(HOLDS.format(seconds=60.0))
    command = [sys.executable, "-m", "twodof.gcs.app", str(file), "--url", there.url]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert child.stdout is not None
        assert child.stdout.readline() == "3 192\n"
        assert there.drone.commander.armed
        assert there.drone.commander.lease.holder == (3, 192)
        child.send_signal(signal.SIGTERM)
        _, errors = child.communicate(timeout=PATIENCE_S)
        assert (child.returncode, errors) == (FINE, "")
    finally:
        child.kill()
        child.wait(timeout=PATIENCE_S)
    assert not there.drone.commander.armed
    assert there.drone.commander.lease.holder is None


def test_what_it_raises_disarms_and_is_its_end(there: OnBoard, tmp_path: Path) -> None:
    file = tmp_path / "falls.py"
    file.write_text(HOLDS.format(seconds=0.1) + "    raise RuntimeError('fell over')\n")
    with pytest.raises(RuntimeError, match="fell over"):  # which ends a process of its own with status 1
        run([str(file), "--url", there.url])
    assert not there.drone.commander.armed


def test_no_program_is_a_mistake_that_is_not_tried_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for text, said in (
        ("x = 1", "async def main"),
        ("def main(drone): ...", "async def main"),
        ("1 +", "invalid syntax"),
    ):
        file = tmp_path / "none.py"
        file.write_text(text)
        assert run([str(file), "--url", "mem://nowhere"]) == NO_APP
        assert said in capsys.readouterr().err
    assert run([str(tmp_path / "missing.py"), "--url", "mem://nowhere"]) == NO_APP
    file.write_text(HOLDS.format(seconds=1.0))
    assert run([str(file), "--url", "mem://nowhere", "--timeout", "0.1"]) == RAISED
    assert "no answer" in capsys.readouterr().err
