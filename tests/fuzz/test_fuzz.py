"""Every target of the fuzzer, briefly and the same each time; in the soak for as long as one wants.

TWODOF_FUZZ_SECONDS says how long each target is fuzzed in the soak; two hours in all by default.
"""

import os
from pathlib import Path

import pytest

from tests.fuzz.runner import NAMES, fuzz, is_guided, kept, load

pytestmark = pytest.mark.slow

SOAK_S = float(os.environ.get("TWODOF_FUZZ_SECONDS", "1800"))
# Seconds each; a busy computer has minutes.
RUNS = {"framing": 8000, "logs": 200, "diagram": 40, "ftp": 300}


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_briefly(name: str, tmp_path: Path) -> None:
    """By seeded mutations: what coverage guides costs seconds before it begins, and has the soak."""
    found = fuzz(name, RUNS[name], 300.0, 1, tmp_path, guided=False)
    assert (found["findings"], found["said"]) == ([], "")
    assert found["runs"] == RUNS[name]


@pytest.mark.soak
@pytest.mark.parametrize("name", NAMES)
def test_for_hours(name: str, tmp_path: Path) -> None:
    found = fuzz(name, 1 << 40, SOAK_S, 2, tmp_path)
    assert (found["findings"], found["said"]) == ([], "")
    if not found["guided"]:
        pytest.skip(f"{found['runs']} seeded mutations ran without coverage: atheris is not installed")


@pytest.mark.parametrize("guided", [True, False])
def test_a_finding_is_found_and_kept(guided: bool, tmp_path: Path) -> None:
    """A target with a fault in it."""
    if guided and not is_guided():
        pytest.skip("atheris is not installed")
    found = fuzz("faulty", 200_000, 60.0, 1, tmp_path, guided)
    assert "the fault" in str(found["said"])
    assert len(found["findings"]) == 1


@pytest.mark.parametrize("name", NAMES)
def test_seeds_are_inputs_that_hold(name: str) -> None:
    target = load(name)
    for data in [*target.seeds(), *(path.read_bytes() for path in kept(name))]:
        assert len(data) <= 20_000
        target.attempt(data)
