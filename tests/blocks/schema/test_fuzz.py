"""The loader fuzzed: any input loads or is refused with a typed error, in bounded time."""

import random
from pathlib import Path

import pytest

from tests.blocks.schema.door import SECONDS, judge_many
from tests.blocks.schema.mutations import constructions, mutants
from tests.blocks.schema.test_schema import everything
from tests.compile.machine_cases import machine_case
from tests.compile.random_diagrams import Maker
from twodof.blocks.schema.json_form import to_json

pytestmark = pytest.mark.slow

BASES = [to_json(everything()), *(to_json(Maker(seed).diagram("r")) for seed in (3, 11, 23))]
BASES.append(to_json(machine_case(random.Random(4), "machine", 1)[0].diagram))
ALLOWED = {"", "DiagramError"}


def check(rows: list[dict[str, object]], names: list[str]) -> int:
    """Assert that all went as it may; how many files were loaded."""
    wrong = [
        (name, row)
        for name, row in zip(names, rows, strict=True)
        if row["error"] not in ALLOWED or float(str(row["seconds"])) > SECONDS or int(str(row["long"])) > 1000
    ]
    assert not wrong, wrong[:5]
    return sum(row["stage"] != "refused" for row in rows)


@pytest.mark.long
@pytest.mark.parametrize("every", [11, pytest.param(1, marks=pytest.mark.soak)])
def test_every_argument_of_every_block_is_bounded(every: int, tmp_path: Path) -> None:
    """Each day with every eleventh of all pairs of an argument and a value."""
    names, texts = map(list, zip(*[*constructions()][::every], strict=True))
    loaded = check(judge_many(texts, tmp_path / "files", 300), names)
    assert len(texts) / 10 < loaded < len(texts)


def fuzz(count: int, seed: int, file: Path, seconds: float) -> None:
    """Load `count` mutated files."""
    texts = list(mutants(BASES, count, seed))
    loaded = check(judge_many(texts, file, seconds), texts)
    assert count / 100 < loaded < count / 2


@pytest.mark.long
def test_mutated_files_load_or_are_refused(tmp_path: Path) -> None:
    fuzz(600, 0, tmp_path / "files", 300)


@pytest.mark.soak
@pytest.mark.parametrize("part", range(20))
def test_many_mutated_files_load_or_are_refused(part: int, tmp_path: Path) -> None:
    fuzz(20_000, 100 + part, tmp_path / "files", 3000)
