"""Damaged files of every format, by every command that reads one: a result or a typed refusal, in bounds."""

import random
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.flightlog.limited import Limited, limited
from tests.flightlog.synthetic import attitude_steps
from tests.flightlog.test_bombs import COMMANDS, used
from tests.flightlog.test_ulog_file import px4_log
from tests.fuzz.runner import mutated
from twodof.errors import LogError
from twodof.flightlog.contents import describe
from twodof.flightlog.files import read_log, write_log
from twodof.flightlog.mcap_file import recover

SUFFIXES = (".mat", ".mcap", ".parquet", ".csv", ".ulg")
RECOVERED = (".mcap", ".ulg")


@pytest.fixture(scope="module")
def process() -> Iterator[Limited]:
    with limited() as made:
        yield made


def whole(suffix: str, folder: Path) -> bytes:
    """Return a small sound file."""
    if suffix == ".ulg":
        return px4_log(12)
    path = folder / f"whole{suffix}"
    write_log(attitude_steps().slice(100.0, 100.2), path)
    return path.read_bytes()


def read(suffix: str, rounds: int, seed: int, folder: Path) -> list[int]:
    """Return how many mutants were read and how many recovered; each other one is a LogError that names the file."""
    chance, data, path = random.Random(seed), whole(suffix, folder), folder / f"a{suffix}"
    ways = (read_log, lambda path: recover(path).log)[: 1 + (suffix in RECOVERED)]
    counts, named = [0, 0], 0
    for _ in range(rounds):
        path.write_bytes(mutated(chance, [data], 1 << 26))
        for way, function in enumerate(ways):
            try:
                log = function(path)
                describe(log)
            except LogError as reason:
                named += path.name in reason.where
                continue
            assert all(np.isfinite(channel.value).all() for channel in log.channels.values())
            counts[way] += 1
    assert sum(counts) + named == rounds * len(ways)
    return counts


@pytest.mark.long
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_mutants_are_logs_or_log_errors(suffix: str, tmp_path: Path) -> None:
    whole_ones, recovered = read(suffix, 150, 1, tmp_path)
    assert whole_ones < 150
    assert suffix not in RECOVERED or recovered > max(30, whole_ones)


@pytest.mark.soak
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_very_many_mutants(suffix: str, tmp_path: Path) -> None:
    rounds = 100_000 if suffix == ".mcap" else 2000
    assert read(suffix, rounds, 2, tmp_path)[0] < rounds


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
