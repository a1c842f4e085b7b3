"""`twodof design rail`: promise, fly as always, verdict."""

import json
from pathlib import Path

import pytest

from tests.cli.test_interrupts import interrupted
from twodof.cli.app import run
from twodof.experiment.flight import Laboratory
from twodof.flightlog.files import write_log
from twodof.models.plant import PAPER_PITCH_RATE, PAPER_VELOCITY_GREYBOX

pytestmark = pytest.mark.slow

FEW = ["--members", "80"]


def models(folder: Path, spread: float) -> list[str]:
    """The documents of a pitch and of a cart as `twodof identify --out` writes them, of the `paper` rig."""

    def row(value: float) -> dict[str, object]:
        return {"value": value, "unit": "", "sigma": spread * value, "sigma_robust": None}

    pitch, cart = PAPER_PITCH_RATE, PAPER_VELOCITY_GREYBOX
    documents = {
        "pitch.json": {
            "estimates": {"mu": row(pitch.mu), "tau": row(pitch.tau)},
            "fixed": {"w_n": pitch.w_n, "xi": pitch.xi},
            "correlation": [[1.0, 0.0], [0.0, 1.0]],
            "noise": {"q": 0.06},
        },
        "cart.json": {
            "estimates": {"k_v": row(cart.k_v), "x_0": row(0.1), "p_v": row(cart.p_v)},
            "correlation": [[1.0, 0.0, 0.5], [0.0, 1.0, 0.0], [0.5, 0.0, 1.0]],
        },
    }
    for name, document in documents.items():
        (folder / name).write_text(json.dumps(document))
    return [str(folder / name) for name in documents]


@pytest.mark.long
def test_what_is_promised_is_what_an_experiment_flies(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """The flight comes another way: one rig, the experiment's own closed loop, a log of its own."""
    spec = tmp_path / "spec.toml"
    spec.write_text("[pitch]\nbandwidth = 5.0\n[rail]\nvelocity_bandwidth = 2.0\nrail_use = 0.35\n")
    promised, picture = tmp_path / "rail.json", tmp_path / "rail.svg"
    command = ["design", "rail", *models(tmp_path, 0.03), *FEW, "--spec", str(spec), "--promise", str(promised)]
    assert run([*command, "--plot", str(picture), "--json"]) == 0
    assert "promised" in picture.read_text()
    said = json.loads(capfd.readouterr().out)
    assert all(row["met"] for row in said["specification"])
    log = tmp_path / "flight.mcap"
    write_log(Laboratory("paper").fly("velocity-doublets", seed=5).log, log)
    flown = tmp_path / "flown.svg"
    assert run(["design", "verdict", str(promised), str(log), "--plot", str(flown), "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["stands"]
    assert "promised and flown" in flown.read_text()
    # the other gains were not promised: theta and v leave their bands
    other = tmp_path / "other.mcap"
    write_log(Laboratory("paper", gains="student").fly("velocity-doublets", seed=5).log, other)
    assert run(["design", "verdict", str(promised), str(other), "--json"]) == 1


@pytest.mark.long
def test_a_specification_that_is_missed_is_status_1(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    spec = tmp_path / "spec.toml"
    spec.write_text("[rail]\nvelocity_bandwidth = 60.0\n")
    assert run(["design", "rail", *models(tmp_path, 0.01), *FEW, "--spec", str(spec)]) == 1
    assert "MISSED velocity bandwidth" in capfd.readouterr().out


@pytest.mark.long
def test_the_search_ends_at_once_and_leaves_nothing(tmp_path: Path) -> None:
    spec, folder = tmp_path / "spec.toml", tmp_path / "run"
    spec.write_text("[rail]\nvelocity_bandwidth = 6.0\novershoot = 0.01\n")
    folder.mkdir()
    command = ["design", "rail", *models(tmp_path, 0.01), "--spec", str(spec), "--out", "gains.json"]
    assert interrupted(3.0, folder, *command, "--promise", "promise.json", "--plot", "promise.png") == ""


@pytest.mark.parametrize(
    "changed",
    [
        ["--goal", "nan"],
        ["--goal", "9"],
        ["--members", "1"],
        ["--rig", "nothing"],
        ["--spec", "nothing"],
        ["--plot", "a.txt"],
    ],
)
def test_refuses_bad_options(changed: list[str], tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert run(["design", "rail", *models(tmp_path, 0.01), *changed]) == 2
    assert "remedy" in capfd.readouterr().err
