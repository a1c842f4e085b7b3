"""Whatever ends a writing, the file is the old one or the new one, and nothing else is left."""

import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from tests.patience import PATIENCE_S, patiently
from tests.processes import started
from twodof.errors import LogError
from twodof.flightlog.atomic import atomic_write, check_free, partial_of
from twodof.flightlog.files import check_folder


def write_half(path: Path, end: BaseException) -> None:
    with atomic_write(path, "w") as file:
        file.write("half")
        raise end


@pytest.mark.parametrize("end", [KeyboardInterrupt, SystemExit, ValueError])
def test_an_interrupted_write_changes_nothing(tmp_path: Path, end: type[BaseException]) -> None:
    path = tmp_path / "log.csv"
    path.write_text("old")
    with pytest.raises(end):
        write_half(path, end())
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_is_an_error_that_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    with pytest.raises(LogError, match="No space left"):
        write_half(path, OSError(28, "No space left on device"))
    assert list(tmp_path.iterdir()) == []


def test_a_written_file_is_whole_and_follows_the_umask(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    with atomic_write(path, "w") as file:
        file.write("θ\n")
        assert not path.exists()
    assert path.read_bytes() == "θ\n".encode()
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~mask


def test_a_link_keeps_pointing(tmp_path: Path) -> None:
    (tmp_path / "real").write_text("old")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    with atomic_write(tmp_path / "link", "w") as file:
        file.write("new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text() == "new"


def test_refusals_name_the_place(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="No such file or directory"), atomic_write(tmp_path / "no" / "a"):
        pass
    with pytest.raises(LogError, match="is a directory"), atomic_write(tmp_path):
        pass
    for check in (check_free, check_folder, partial_of):
        with pytest.raises(LogError, match="cannot be written: File name too long"):
            check(tmp_path / ("x" * 300))


def test_ctrl_c_in_a_running_program_leaves_no_file(tmp_path: Path) -> None:
    program = (
        "import sys, time\n"
        "from twodof.flightlog.atomic import atomic_write\n"
        "with atomic_write(sys.argv[1], 'w') as file:\n"
        "    file.write('half')\n"
        "    file.flush()\n"
        "    while True:\n"  # a signal that comes just before a sleep does not end it
        "        time.sleep(0.01)\n"
    )
    command = [sys.executable, "-c", program, str(tmp_path / "log.csv")]
    with started(command, stderr=subprocess.DEVNULL) as child:
        for _ in patiently():
            if any(one.stat().st_size for one in tmp_path.iterdir()):
                break
        child.send_signal(signal.SIGINT)
        assert child.wait(timeout=PATIENCE_S) != 0
    assert list(tmp_path.iterdir()) == []
