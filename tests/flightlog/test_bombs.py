"""Any file below 64 MB: less than 2 GiB of memory and 10 s, or a typed refusal, for each command."""

import os
import shutil
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.flightlog.bombs import BOMBS
from tests.flightlog.limited import Limited, Used, limited
from twodof.flightlog.files import write_log
from twodof.flightlog.log import Channel, FlightLog

pytestmark = pytest.mark.slow

MIB = 2048
CPU_S = 10.0
TYPED = {0, 1, 2}

Arguments = Callable[[Path, Path], list[str | Path]]
COMMANDS: dict[str, Arguments] = {
    "info": lambda file, _: ["log", "info", file],
    "info --json": lambda file, _: ["log", "info", file, "--json"],
    "recover": lambda file, out: ["log", "recover", file, out / "whole.mcap"],
    "plot": lambda file, out: ["log", "plot", file, "--out", out / "a.png"],
    "to mat": lambda file, out: ["log", "convert", file, out / "a.mat"],
    "to mcap": lambda file, out: ["log", "convert", file, out / "a.mcap"],
    "to parquet": lambda file, out: ["log", "convert", file, out / "a.parquet"],
    "to csv": lambda file, out: ["log", "convert", file, out / "a.csv"],
    "replay": lambda file, _: ["replay", file],
    "simulate": lambda file, _: ["simulate", "--like", file],
    "identify": lambda file, _: ["identify", file, "--experiment", "doublet"],
}


@pytest.fixture(scope="module")
def process() -> Iterator[Limited]:
    with limited() as made:
        yield made


def used(process: Limited, command: str, file: Path, folder: Path) -> str:
    """Return the description of a failure, "" for none."""
    out = folder / "out"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    return wrong(f"{command} {file.name}", process.run(*COMMANDS[command](file, out)))


def wrong(what: str, found: Used) -> str:
    fine = found.status in TYPED and found.cpu_s < CPU_S and found.peak_mib < MIB and "Traceback" not in found.said
    return "" if fine else f"{what}: {found.status}, {found.cpu_s:.1f} s, {found.peak_mib:.0f} MiB, {found.said[-300:]}"


# These are logs, if strange ones: what is made of them takes a second or two by other commands.
LOGS = {"gaps_everywhere", "modes_that_flip", "open_loop_that_flips", "thrust_that_flips", "steps_far_apart"}


def test_there_are_enough_of_them() -> None:
    assert len(BOMBS) >= 2 * len(COMMANDS)
    assert {Path(name).suffix for name in BOMBS} == {".mcap", ".mat", ".parquet", ".csv", ".ulg"}


@pytest.mark.long
def test_bombs(process: Limited, tmp_path: Path) -> None:
    """Each by one command, in turn."""
    found = []
    for number, name in enumerate(BOMBS):
        file = tmp_path / name
        file.write_bytes(BOMBS[name]())
        assert file.stat().st_size < 64_000_000
        command = "info" if name.partition(".")[0] in LOGS else [*COMMANDS][number % len(COMMANDS)]
        found.append(used(process, command, file, tmp_path))
        file.unlink()
    assert [one for one in found if one] == []


@pytest.mark.soak
@pytest.mark.parametrize("name", BOMBS)
def test_every_bomb_by_every_command(name: str, process: Limited, tmp_path: Path) -> None:
    file = tmp_path / name
    file.write_bytes(BOMBS[name]())
    assert file.stat().st_size < 64_000_000
    assert [one for command in COMMANDS if (one := used(process, command, file, tmp_path))] == []


@pytest.mark.long
def test_a_long_log_is_not_refused(process: Limited, tmp_path: Path) -> None:
    """Not hostile: 20 minutes of noise at 250 Hz."""
    chance = np.random.default_rng(1)
    time = 0.004 * np.arange(300_000)
    noise = {name: Channel(time, chance.standard_normal(300_000), name=name) for name in ("q", "theta", "M", "T")}
    write_log(FlightLog(noise), tmp_path / "a.parquet")
    found = process.run("log", "convert", tmp_path / "a.parquet", tmp_path / "a.mcap")
    assert (found.status, wrong("convert", found)) == (0, "")


@pytest.mark.long
def test_what_is_not_a_file_is_refused_at_once(process: Limited, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.mcap")
    (tmp_path / "zero.mat").symlink_to("/dev/zero")
    (tmp_path / "none.csv").symlink_to("/dev/null")
    (tmp_path / "folder.ulg").mkdir()
    (tmp_path / "proc.parquet").symlink_to("/proc/self/mem")
    with socket.socket(socket.AF_UNIX) as listening, (tmp_path / "huge.mcap").open("wb") as huge:
        listening.bind(str(tmp_path / "socket.ulg"))
        huge.truncate(1 << 40)
        for number, file in enumerate(sorted(tmp_path.iterdir())):
            command = [*COMMANDS][number]
            found = process.run(*COMMANDS[command](file, tmp_path / "out"))
            assert (found.status, wrong(command, found)) == (2, ""), (command, file.name)
            assert "error: " in found.said
        for option, name in (("--gains", "pipe.mcap"), ("--rig", "zero.mat")):
            found = process.run("simulate", "doublet", option, tmp_path / name)
            assert (found.status, wrong(option, found)) == (2, ""), (option, name)


@pytest.mark.long
def test_the_measure_measures(process: Limited, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time,theta\n0,0\n")
    found = process.run("log", "info", tmp_path / "a.csv")
    assert found.status == 0
    assert 0.0 < found.cpu_s < CPU_S
    assert 50.0 < found.peak_mib < MIB
    assert wrong("x", Used(0, "", 11.0, 1.0))
    assert wrong("x", Used(0, "", 1.0, 3000.0))
    assert wrong("x", Used(98, "", 1.0, 1.0))
