"""`twodof margins`, `bode`, `rlocus` and `step` of a user's loop, from a fitted model, a diagram or as written."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.cli.program import Shell
from twodof.blocks import Diagram
from twodof.blocks.library import Gain
from twodof.cli.app import run
from twodof.flight.starters import save_diagram

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fitted model of .5 / (z - .9), and a diagram of a gain of 2."""
    made = tmp_path_factory.mktemp("loop")
    generator = np.random.default_rng(1)
    u = np.sign(generator.standard_normal(400)).repeat(5)
    y = lfilter([0.0, 0.5], [1.0, -0.9], u) + 1e-4 * generator.standard_normal(u.size)
    table = np.column_stack([0.1 * np.arange(u.size), u, y])
    np.savetxt(made / "data.csv", table, delimiter=",", header="t,u,y", comments="")
    columns = ["--input", "u", "--output", "y", "--time", "t"]
    model = ["identify", str(made / "data.csv"), "--model", "oe:1,1,1", *columns, "--out", str(made / "model.json")]
    assert run(model) == 0
    d = Diagram("twice")
    d.input("e")
    d.add("gain", Gain(2.0), u="e")
    d.output("u", "gain")
    save_diagram(d, made / "gain.json")
    return made


def answer(arguments: list[str], shell: Shell, status: int = 0) -> dict[str, float]:
    found: dict[str, float] = shell([*arguments, "--json"], status).json
    return found


def test_a_fitted_model_and_a_diagram_make_a_loop(folder: Path, shell: Shell) -> None:
    found = answer(["margins", str(folder / "model.json"), str(folder / "gain.json")], shell)
    # 2 * .5 / (z - .9): L is -1 at z = -1 with 1.9 times the gain, and |z - .9| is 1 at cos = .405.
    assert found["dt"] == pytest.approx(0.1)
    assert found["gain_margin"] == pytest.approx(1.9, rel=1e-3)
    assert found["crossover"] == pytest.approx(math.acos(0.81 / 1.8) / 0.1, rel=1e-3)
    again = answer(["margins", str(folder / "model.json"), "2"], shell)
    assert again["gain_margin"] == found["gain_margin"]
    assert answer(["margins", str(folder / "model.json"), "4"], shell, status=1)["stable"] is False


def test_figures_of_a_step_are_those_in_closed_form(shell: Shell) -> None:
    found = answer(["step", "1 / (s + 1)", "3"], shell)["step"]
    assert isinstance(found, dict)
    # T = 3 / (s + 4): .75 (1 - exp(-4 t)); the samples are exact, and the figures linear between them.
    assert found["final"] == pytest.approx(0.75)
    assert found["rise_time"] == pytest.approx(math.log(9.0) / 4.0, rel=1e-3)
    assert found["settling_time"] == pytest.approx(math.log(50.0) / 4.0, rel=1e-3)


@pytest.mark.long
def test_a_loop_that_comes_back_to_0_has_a_peak_alone(shell: Shell) -> None:
    # T = s / (2 s + 1): it jumps to 1/2.
    assert shell(["step", "s / (s + 1)"]).out.splitlines()[-1] == "final value 0, peak 0.5"


@pytest.mark.parametrize("command", ["margins", "bode", "rlocus", "step"])
@pytest.mark.parametrize("period", [[], ["--period", "0.1"]])
def test_each_command_draws(command: str, period: list[str], folder: Path, tmp_path: Path) -> None:
    picture = tmp_path / "loop.svg"
    loop = ["2 exp(-0.3 s) / (1.5 s + 1)", "1.5 + 1 / s", *period]
    assert run([command, *loop, "--plot", str(picture)]) == 0
    text = picture.read_text()
    axes = {"margins": 7, "bode": 2, "rlocus": 1, "step": 1}[command]
    assert text.count('id="axes_') >= axes  # a blot at 0 has axes of its own
    if command == "bode":
        for words in ("deg at 2 rad/s", "dB at"):
            assert words in text


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["1 / (z - 1)"], "no sample time"),
        (["nothing.json"], "cannot be read"),
        (["data.csv"], "not a transfer function"),
        (["model.json", "1", "--input", "w"], "name one: --input NAME"),
        (["1 / s", "1", "--period", "-1"], "give a time above 0"),
        (["model.json", "1", "--period", "0.3"], "sample times"),
    ],
)
def test_mistakes_are_named(arguments: list[str], reason: str, folder: Path, shell: Shell) -> None:
    own = [str(folder / one) if (folder / one).is_file() and one != "data.csv" else one for one in arguments]
    assert reason in shell(["margins", *own], 2).err
