"""Damaged files of every format, by every command that reads one: a result or a typed refusal, in bounds."""

import random
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.flightlog.limited import Limited, limited
from tests.flightlog.synthetic import attitude_steps
from tests.flightlog.test_bombs import COMMANDS, used
from tests.flightlog.test_ulog_file import px4_log
from tests.fuzz.runner import mutated
from twodof.errors import LogError
from twodof.flightlog.contents import describe
from twodof.flightlog.files import read_log, write_log

SUFFIXES = (".mat", ".mcap", ".parquet", ".csv", ".ulg")


@pytest.fixture(scope="module")
def process() -> Iterator[Limited]:
    with limited() as made:
        yield made


def whole(suffix: str, folder: Path) -> bytes:
    """A small sound file."""
    if suffix == ".ulg":
        return px4_log()
    path = folder / f"whole{suffix}"
    write_log(attitude_steps().slice(100.0, 106.0), path)
    return path.read_bytes()


def read(suffix: str, rounds: int, seed: int, folder: Path) -> int:
    """How many of the mutants were read; each one that is not gives a LogError."""
    chance, data, path, count = random.Random(seed), whole(suffix, folder), folder / f"a{suffix}", 0
    for _ in range(rounds):
        path.write_bytes(mutated(chance, [data], 1 << 26))
        try:
            describe(read_log(path))
            count += 1
        except LogError:
            continue
    return count


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_mutants_are_logs_or_log_errors(suffix: str, tmp_path: Path) -> None:
    assert read(suffix, 20, 1, tmp_path) < 20


@pytest.mark.soak
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_ten_thousand_mutants(suffix: str, tmp_path: Path) -> None:
    assert 0 <= read(suffix, 2000, 2, tmp_path) < 2000


@pytest.mark.soak
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_mutants_by_every_command(suffix: str, process: Limited, tmp_path: Path) -> None:
    chance, data = random.Random(3), whole(suffix, tmp_path)
    for _ in range(20):
        file = tmp_path / f"a{suffix}"
        file.write_bytes(mutated(chance, [data], 1 << 26))
        wrong = [one for command in COMMANDS if (one := used(process, command, file, tmp_path))]
        if wrong:
            shutil.copy(file, tmp_path / f"bad{suffix}")
        assert wrong == []
