"""Campaigns: the same bytes from any number of processes and after a kill, and failures that are data."""

import importlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tests.patience import PATIENCE_S
from twodof.campaign import RowFile, Run, campaign, drawn, plan
from twodof.errors import ExperimentError, LogError

pytestmark = pytest.mark.slow

RUNS = plan(range(1, 13))


def figures(run: Run) -> dict[str, object]:
    """Numbers that only the seed decides; later runs end first."""
    if run.seed == 5:
        raise ExperimentError("the cart touched its stop", "rail", "")
    time.sleep(0.03 / run.seed)
    drawn_numbers = np.random.default_rng(run.seed).normal(size=3)
    return {"mean": drawn_numbers.mean(), "all": drawn_numbers, "none": float("nan"), "seed": np.int64(run.seed)}


def slow_figures(run: Run) -> dict[str, object]:
    time.sleep(0.1)
    return figures(run)


class Dies:
    """A measure whose process dies on run 2: once, or each time."""

    def __init__(self, mark: Path, always: bool) -> None:
        self.mark, self.always = mark, always

    def __call__(self, run: Run) -> dict[str, object]:
        if run.number == 2 and (self.always or not self.mark.exists()):
            self.mark.touch()
            os.kill(os.getpid(), signal.SIGSEGV)
        return {"seed": run.seed}


def hangs(run: Run) -> dict[str, object]:
    while run.number == 1:
        time.sleep(0.01)
    return {"seed": run.seed}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("campaign") / "whole.jsonl"
    campaign(figures, RUNS, path, name="test", processes=1)
    return path


def test_rows_are_in_the_order_of_the_plan(whole: Path) -> None:
    head, *rows = map(json.loads, whole.read_text().splitlines())
    assert head["campaign"] == "test"
    assert [row["seed"] for row in rows] == list(range(1, 13))
    assert rows[4] == {"run": 4, "seed": 5, "failed": "rail: the cart touched its stop"}
    numbers = np.random.default_rng(3).normal(size=3)
    assert rows[2]["figures"] == {"mean": numbers.mean(), "all": numbers.tolist(), "none": None, "seed": 3}


def test_two_processes_write_the_same_bytes(whole: Path, tmp_path: Path) -> None:
    rows = campaign(figures, RUNS, tmp_path / "two.jsonl", name="test", processes=2)
    assert (tmp_path / "two.jsonl").read_bytes() == whole.read_bytes()
    assert rows == [json.loads(line) for line in whole.read_text().splitlines()[1:]]


KILLED = """
from pathlib import Path
from tests.campaign.test_campaign import RUNS, slow_figures
from twodof.campaign import campaign
if __name__ == "__main__":
    campaign(slow_figures, RUNS, Path({path!r}), name="test", processes=2)
"""


@pytest.mark.long
def test_a_killed_campaign_ends_with_the_same_bytes(whole: Path, tmp_path: Path) -> None:
    path, script = tmp_path / "killed.jsonl", tmp_path / "killed.py"
    script.write_text(KILLED.format(path=str(path)))
    root = Path(__file__).resolve().parents[2]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(root), *sys.path])}
    started = subprocess.Popen([sys.executable, str(script)], env=environment)
    deadline = time.monotonic() + PATIENCE_S
    while not path.exists() or path.read_bytes().count(b"\n") < 4:
        assert started.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.005)
    started.kill()
    started.wait()
    there = path.read_bytes()
    assert whole.read_bytes().startswith(there)
    assert 4 <= there.count(b"\n") < len(RUNS) + 1
    campaign(figures, RUNS, path, name="test", processes=2)
    assert path.read_bytes() == whole.read_bytes()


def test_a_torn_row_is_dropped(whole: Path, tmp_path: Path) -> None:
    data = whole.read_bytes()
    head = json.loads(data.splitlines()[0])
    for size in range(0, len(data), 7):
        torn = tmp_path / f"{size}.jsonl"
        torn.write_bytes(data[:size])
        with RowFile(torn, head) as file:
            assert len(file.rows) == max(0, data[:size].count(b"\n") - 1)
        assert data.startswith(torn.read_bytes())
    # The rest of the rows is what the file lacked.
    torn.write_bytes(data[:-20])
    campaign(figures, RUNS, torn, name="test", processes=1)
    assert torn.read_bytes() == data


@pytest.mark.long
def test_a_process_that_dies_is_said_and_its_run_tried_again(tmp_path: Path) -> None:
    said: list[str] = []
    once = campaign(Dies(tmp_path / "once", False), RUNS[:4], processes=2, say=said.append)
    assert [row["figures"]["seed"] for row in once] == [1, 2, 3, 4]
    assert said == ["run 2 (seed 3): its process ended (signal 11)"]
    said.clear()
    twice = campaign(Dies(tmp_path / "twice", True), RUNS[:4], processes=1, say=said.append)
    assert twice[2] == {"run": 2, "seed": 3, "failed": "its process ended (signal 11), 2 times"}
    assert [row["seed"] for row in twice if "figures" in row] == [1, 2, 4]
    assert len(said) == 2


class NotHere:
    """A measure that no other process can load."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __call__(self, run: Run) -> dict[str, object]:
        return {}

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return importlib.import_module, (self.name,)


def test_a_measure_that_cannot_be_imported_is_refused() -> None:
    with pytest.raises(ExperimentError, match="does not start: its process ended"):
        campaign(NotHere("no_such_module"), RUNS[:3], processes=2)


@pytest.mark.long
def test_a_run_that_does_not_end_is_ended() -> None:
    rows = campaign(hangs, RUNS[:3], processes=1, run_s=1.0)
    assert rows[1]["failed"] == "its process took over 1 s, 2 times"
    assert rows[2]["figures"] == {"seed": 3}


def too_much(run: Run) -> dict[str, object]:
    return {"signal": np.zeros(10_000)}


def test_signals_are_not_taken_back() -> None:
    (row,) = campaign(too_much, RUNS[:1], processes=1)
    assert "is too long" in row["failed"]


def test_the_file_of_another_campaign_is_kept(whole: Path, tmp_path: Path) -> None:
    before = whole.read_bytes()
    with pytest.raises(LogError, match="another campaign"):
        campaign(figures, RUNS[:3], whole, name="test", processes=1)
    assert whole.read_bytes() == before
    other = tmp_path / "notes.txt"
    other.write_text("what I measured\n")
    with pytest.raises(LogError, match="another campaign"):
        campaign(figures, RUNS, other, name="test", processes=1)
    assert other.read_text() == "what I measured\n"


def test_one_process_writes_at_a_time(whole: Path) -> None:
    head = json.loads(whole.read_bytes().splitlines()[0])
    with RowFile(whole, head), pytest.raises(LogError, match="is writing"):
        RowFile(whole, head)


def test_plans_pair_seeds_and_members() -> None:
    members = [{"mass": mass} for mass in (1.0, 2.0, 3.0, 4.0)]
    assert plan(range(4), members)[3] == Run(3, 3, {"mass": 4.0})
    assert [run.parameters["mass"] for run in plan((7, 8), members[:1])] == [1.0, 1.0]
    assert [(run.case, run.seed) for run in plan((1, 2), cases=("a", "b"))] == [("a", 1), ("a", 2), ("b", 1), ("b", 2)]
    for seeds, message in (
        ((1, 2), "4 sets of parameters for 2 seeds"),
        ((-1,), "not a seed"),
        ((True,), "not a seed"),
    ):
        with pytest.raises(ExperimentError, match=message):
            plan(seeds, members if message != "not a seed" else ({},))


def test_drawn_members_have_the_covariance() -> None:
    means, covariance = {"a": 1.0, "b": -2.0}, np.array([[0.04, 0.03], [0.03, 0.09]])
    members = drawn(means, covariance, 4000, seed=3)
    table = np.array([[one["a"], one["b"]] for one in members])
    # 4 deviations of a mean of 4000, and 4 of a variance, sqrt(2 / 4000) of it.
    assert (np.abs(table.mean(axis=0) - [1.0, -2.0]) < 4.0 * np.sqrt(np.diag(covariance) / 4000)).all()
    np.testing.assert_allclose(np.cov(table.T), covariance, rtol=4.0 * np.sqrt(2.0 / 4000), atol=0.005)
    assert drawn(means, covariance, 3, seed=3) == members[:3]
    bounded = drawn(means, covariance, 200, bounds={"a": (0.9, 1.1)})
    assert all(0.9 <= one["a"] <= 1.1 for one in bounded)


@pytest.mark.parametrize(
    ("covariance", "bounds", "message"),
    [
        (np.eye(3), {}, "shape"),
        ([[1.0, 2.0], [2.0, 1.0]], {}, "positive"),
        ([[1.0, 0.5], [0.0, 1.0]], {}, "symmetric"),
        (np.eye(2), {"a": (100.0, 101.0)}, "within the bounds"),
    ],
)
def test_a_covariance_that_is_none_is_refused(
    covariance: object, bounds: dict[str, tuple[float, float]], message: str
) -> None:
    with pytest.raises(ExperimentError, match=message):
        drawn({"a": 0.0, "b": 0.0}, covariance, 1, bounds=bounds)  # type: ignore[arg-type]
