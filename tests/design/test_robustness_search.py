"""Search of the least stable member against a dense search, and controllers that are not robust."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from twodof.cli.app import run
from twodof.design.pitch_family import PARAMETERS, PitchFamily, PitchMembers
from twodof.design.pitch_loop import PitchLoop
from twodof.design.robustness import robustness
from twodof.design.sampled_controller import SampledController
from twodof.flight.gains import STUDENT
from twodof.flight.starters.attitude import pid_attitude

pytestmark = pytest.mark.slow

BASE = SampledController.of(pid_attitude(STUDENT))


def searched(rng: np.random.Generator, factor: float) -> tuple[float, float]:
    """(largest radius by the search, by 3,000 directions) of a random family, the controller `factor` too loud."""
    values = {
        "w_n": rng.uniform(2.5, 4.0),
        "xi": rng.uniform(0.05, 0.2),
        "mu": rng.uniform(270.0, 380.0),
        "dead_time": rng.uniform(0.008, 0.02),
        "lag": rng.uniform(0.002, 0.011),
    }
    sigmas = {"mu": rng.uniform(0.01, 0.06) * values["mu"], "dead_time": rng.uniform(0.0003, 0.002), "lag": 0.0008}
    family = PitchFamily.of(values, sigmas)
    controller = SampledController(BASE.a, BASE.b, factor * BASE.c, factor * BASE.d)
    found = robustness(controller, family, members=100)
    directions = rng.standard_normal((3000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    # chi-square, 3 degrees of freedom, 99.9 %
    far = math.sqrt(16.266) * directions
    rows = np.array([values[name] for name in sigmas]) + far * list(sigmas.values())
    low, high = np.array([PARAMETERS[name] for name in sigmas]).T
    rows = rows[((rows >= low) & (rows <= high)).all(axis=1)]
    columns = {name: np.full(len(rows), float(values[name])) for name in PARAMETERS}
    columns |= {name: rows[:, i] for i, name in enumerate(sigmas)}
    return found.radius, float(PitchLoop(PitchMembers(**columns), controller).radii().max())


@pytest.mark.long
@pytest.mark.parametrize("count", [4, pytest.param(100, marks=pytest.mark.soak)])
def test_search_misses_nothing_that_a_dense_one_finds(count: int) -> None:
    rng = np.random.default_rng(count)
    both = [searched(rng, float(factor)) for factor in np.linspace(1.2, 3.0, count)]
    # 16.266 is chi-square's 99.9 % to five digits: the border is met to 1e-5 of its distance
    assert all(search >= dense - 1e-5 for search, dense in both), both
    assert {search >= 1.0 for search, _ in both} == {False, True}, "the cases are on both sides of the border"


@pytest.mark.long
def test_what_is_not_robust_is_not_written(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    row = {"unit": "", "sigma_robust": None}
    model = {
        "estimates": {"mu": {"value": 320.0, "sigma": 70.0, **row}, "tau": {"value": 0.03, "sigma": 0.012, **row}},
        "fixed": {"w_n": 3.0, "xi": 0.1},
        "correlation": [[1.0, 0.0], [0.0, 1.0]],
        "noise": {"q": 0.05},
    }
    (tmp_path / "model.json").write_text(json.dumps(model))
    command = ["design", "controller", str(tmp_path / "model.json"), "--members", "100"]
    out, promised = tmp_path / "mine.json", tmp_path / "promise.json"
    assert run([*command, "--out", str(out), "--promise", str(promised), "--json"]) == 1
    found = json.loads(capfd.readouterr().out)
    assert not found["robustness"]["robust"]
    assert found["written"] == {}
    assert not out.exists()
    assert not promised.exists()
    assert run([*command, "--crossover", "8", "--out", str(out), "--promise", str(promised)]) == 0
    assert out.exists()
    assert promised.exists()


@pytest.mark.parametrize(
    "changed",
    [
        ["--crossover", "nan"],
        ["--crossover", "1e9"],
        ["--phase-margin", "700"],
        ["--members", "1"],
        ["--gust", "nan"],
        ["--gust-time", "0"],
        ["--goal", "0"],
        ["--separation", "nan"],
        ["--plot", "p.txt"],
        ["--spec", "nothing.toml"],
    ],
)
def test_refuses_bad_options(changed: list[str], tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    model = {"model": {"w_n": 3.4, "xi": 0.08, "mu": 358.5, "tau": 0.02}}
    (tmp_path / "model.json").write_text(json.dumps(model))
    out = tmp_path / "mine.json"
    assert run(["design", "controller", str(tmp_path / "model.json"), "--out", str(out), *changed]) == 2
    said = capfd.readouterr().err
    assert "remedy" in said
    assert not out.exists()
