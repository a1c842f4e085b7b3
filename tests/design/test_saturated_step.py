"""Steps beyond what the motors give: the limits, an integral that winds up, and what anti-windup makes of it."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from twodof.cli.app import run
from twodof.design.designed_controller import acting_moment, saturated_step
from twodof.design.pitch_family import PitchFamily
from twodof.design.sampled_controller import SampledController
from twodof.errors import DiagramError, ParameterError
from twodof.flight.gains import DEFAULT, STUDENT, Gains
from twodof.flight.starters.attitude import pid_attitude
from twodof.flight.starters.position import stock_motor

pytestmark = pytest.mark.slow

VALUES = {"w_n": 3.437, "xi": 0.0836, "mu": 250.0, "dead_time": 0.0113, "lag": 0.0087}
FAMILY = PitchFamily.of(VALUES)
QUICK = Gains((0.12, 0.5, 0.001), 12.0, DEFAULT.velocity, DEFAULT.position)
"""Stable, with much of an integral: a step of 45 degrees holds the motors at their limit for a tenth of a second."""


def test_moment_of_the_pairs() -> None:
    """At T = .4 both pairs follow to .4, one to .6, none beyond: by hand."""
    for asked, acts in ((0.3, 0.3), (-0.4, -0.4), (0.5, 0.45), (0.6, 0.5), (1.0, 0.5), (-0.9, -0.5)):
        assert acting_moment(asked) == pytest.approx(acts, abs=1e-12)


def test_small_step_is_the_linear_one() -> None:
    """Within the limits the interpreted diagram on the plant is the closed loop's matrices, to rounding."""
    small = saturated_step(pid_attitude(STUDENT), FAMILY, math.radians(2.0))
    assert small.saturated == 0.0
    assert not small.winds_up
    assert small.overshoot == pytest.approx(small.linear_overshoot, abs=1e-9)
    assert small.settling_time == pytest.approx(small.linear_settling_time, abs=1e-9)
    # the step from which on M is beyond the limit: just below it does not saturate, just above it does
    assert saturated_step(pid_attitude(STUDENT), FAMILY, 0.999 * small.largest).saturated == 0.0
    assert saturated_step(pid_attitude(STUDENT), FAMILY, 1.001 * small.largest).saturated > 0.0


def test_anti_windup_takes_the_overshoot_away() -> None:
    """9 % of overshoot, where the same loop without limits has 1 %; with anti-windup none is more than that."""
    step = math.radians(45.0)
    plain = saturated_step(pid_attitude(QUICK), FAMILY, step)
    assert plain.winds_up
    assert "winds up" in plain.text
    assert plain.overshoot > plain.linear_overshoot + 0.05
    for rule in ("clamping", "back-calculation"):
        cured = saturated_step(pid_attitude(QUICK, rule), FAMILY, step)
        assert cured.saturated > 0.0
        assert not cured.winds_up
        assert cured.overshoot < plain.overshoot - 0.05
        assert cured.linear_overshoot == pytest.approx(plain.linear_overshoot, abs=1e-9)
    back = saturated_step(pid_attitude(QUICK, "back-calculation"), FAMILY, step)
    assert back.settling_time < plain.settling_time


def test_off_its_limits_anti_windup_changes_nothing() -> None:
    plain, other = (SampledController.of(pid_attitude(QUICK, rule)) for rule in ("none", "back-calculation"))
    for name in ("a", "b", "c", "d"):
        assert getattr(other, name) == pytest.approx(getattr(plain, name), abs=1e-12)


@pytest.mark.long
def test_the_command_says_that_it_winds_up(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    model = {"model": {"w_n": 3.4, "xi": 0.08, "mu": 200.0, "tau": 0.012}}
    (tmp_path / "model.json").write_text(json.dumps(model))
    command = ["design", "controller", str(tmp_path / "model.json"), "--crossover", "20", "--members", "60"]
    command += ["--separation", "1.5", "--goal", "45"]
    assert run([*command, "--out", str(tmp_path / "plain.json"), "--json"]) == 0
    plain = json.loads(capfd.readouterr().out)["saturation"]
    assert run([*command, "--out", str(tmp_path / "cured.json"), "--anti-windup", "back-calculation", "--json"]) == 0
    cured = json.loads(capfd.readouterr().out)["saturation"]
    assert plain["saturated"] > 0.0
    assert plain["winds_up"]
    assert not cured["winds_up"]
    assert cured["overshoot"] < plain["overshoot"]


@pytest.mark.parametrize("goal", [0.0, -1.0, math.nan, 7.0])
def test_refuses_with_a_remedy(goal: float) -> None:
    with pytest.raises(ParameterError) as caught:
        saturated_step(pid_attitude(), FAMILY, goal)
    assert caught.value.remedy
    with pytest.raises(DiagramError):
        saturated_step(stock_motor(), FAMILY)
    with pytest.raises(DiagramError):
        pid_attitude(anti_windup="wishing")
    assert np.isfinite(saturated_step(pid_attitude(), FAMILY, 0.1, 0.2).overshoot)
