"""Coverage of the default fit on both rigs, and the statistics by which it is judged."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twodof.campaign import Run, campaign
from twodof.campaign.coverage import FLOWN, IdentifiedByDefault, coverage, drawn_drones, failures
from twodof.cli.app import run
from twodof.experiment.flight import simulate
from twodof.flightlog.files import write_log
from twodof.rig.parameters import load_rig
from twodof.rig.rig import model_parameters

pytestmark = pytest.mark.slow

FLIGHTS = 72
REJECTED = 1e-3
"""p-value below which a count is not put down to chance."""


def row(number: int, value: float, sigma: float | None, prior: float | None = None) -> dict[str, Any]:
    figure = {"value": value, "sigma": sigma, "true": 10.0, "prior": prior}
    return {"run": number, "seed": number, "case": "doublet", "figures": {"converged": True, "mu": figure}}


def test_an_honest_claim_passes_and_half_of_it_does_not() -> None:
    values = 10.0 + 2.0 * np.random.default_rng(1).standard_normal(2000)
    (honest,) = coverage([row(i, value, 2.0) for i, value in enumerate(values)])
    assert honest.p_value > REJECTED
    # 4 deviations of the mean and of the deviation of 2000.
    assert abs(honest.bias) < 4.0 / math.sqrt(2000)
    assert honest.spread == pytest.approx(1.0, abs=4.0 / math.sqrt(4000))
    (small,) = coverage([row(i, value, 1.0) for i, value in enumerate(values)])
    assert small.p_value < 1e-9
    assert small.spread == pytest.approx(2.0 * honest.spread)


def test_flights_that_claim_differently_are_judged_by_their_own() -> None:
    generator = np.random.default_rng(2)
    claims = np.where(generator.random(2000) < 0.6, 1.0, 5.0)
    rows = [row(i, 10.0 + one * generator.standard_normal(), one) for i, one in enumerate(claims.tolist())]
    (found,) = coverage(rows)
    assert found.claim == 1.0
    assert found.spread == pytest.approx(1.0, abs=4.0 / math.sqrt(4000))


@pytest.mark.parametrize("covered", [60, 65, 69, 72])
def test_the_p_value_is_that_of_the_binomial(covered: int) -> None:
    chance = [math.comb(72, k) * 0.95**k * 0.05 ** (72 - k) for k in range(73)]
    rows = [row(i, 10.0 if i < covered else 20.0, 1.0) for i in range(72)]
    (found,) = coverage(rows)
    assert found.covered == covered
    assert found.p_value == pytest.approx(sum(one for one in chance if one <= chance[covered] * (1.0 + 1e-7)))


def test_what_the_data_do_not_tell_is_said() -> None:
    (repeated,) = coverage([row(i, 10.0, 0.95, 1.0) for i in range(9)])
    assert repeated.repeats_prior
    assert repeated.text[-1] == "repeats its prior"
    (told,) = coverage([row(i, 10.0, 0.5, 1.0) for i in range(9)])
    assert not told.repeats_prior
    assert told.text[-1] == "50 % of its prior left"
    (held,) = coverage([row(i, 10.0, None if i < 4 else 1.0) for i in range(9)])
    assert (held.silent, held.covered, held.text[-1]) == (4, 5, "4 at its bound")
    (never,) = coverage([row(i, 10.0, None) for i in range(3)])
    assert never.silent == never.flights == 3
    assert failures([{"run": 0, "seed": 7, "case": "doublet", "failed": "it broke"}]) == ["doublet, seed 7: it broke"]


def test_the_figures_are_those_of_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_log(simulate("velocity-doublet", "lab", seed=3).log, tmp_path / "flight.mcap")
    assert run(["identify", str(tmp_path / "flight.mcap"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)["estimates"]
    figures = IdentifiedByDefault("lab")(Run(0, 3, case="velocity-doublet"))
    for name in ("k_v", "p_v", "coulomb"):
        assert figures[name]["value"] == said[name]["value"], name
        assert figures[name]["sigma"] in (said[name]["sigma"], said[name]["sigma_robust"]), name


def test_drawn_drones_are_those_of_the_priors() -> None:
    """What the rig's models make of the changed parameters has the mean and deviation that the fit was told before."""
    rig, count = load_rig("lab").snapshot(), 2000
    runs = drawn_drones("lab", ["rate-doublets"], range(count))
    assert [run.number for run in runs] == list(range(count))
    machines = [{**rig, **run.parameters} for run in runs]
    known = [model_parameters(machine) for machine in machines]
    tau = model_parameters(rig)["tau"]
    assert [one["tau"] for one in known] == pytest.approx([tau] * count)
    wake = [machine["trim"] / rig["inertia"] for machine in machines]
    for values, (mean, width) in (([one["w_n_run"] for one in known], (2.28, 0.31)), (wake, (0.0, 4.0))):
        # 4 deviations of the mean and of the deviation.
        assert np.mean(values) == pytest.approx(mean, abs=4.0 * width / math.sqrt(count))
        assert np.std(values) == pytest.approx(width, rel=4.0 / math.sqrt(2 * count))
    for name in ("xi_run", "coulomb_run"):  # not below 0
        values = [one[name] for one in known]
        assert min(values) >= 0.0
        assert np.median(values) == pytest.approx(0.065, abs=0.01)


def test_the_command_goes_on_where_it_was(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = tmp_path / "rows.jsonl"
    asked = ["campaign", "velocity-doublet", "--rig", "paper", "--seeds", "3", "--out", str(rows), "--json"]
    assert run(asked) == 0
    first, data = json.loads(capsys.readouterr().out), rows.read_bytes()
    assert [one["unknown"] for one in first["coverage"]] == ["k_v", "p_v"]
    assert first["coverage"][0]["flights"] == 3
    rows.write_bytes(data[: data.rfind(b"\n", 0, -1) + 5])
    assert run([*asked, "--processes", "1"]) == 0
    assert json.loads(capsys.readouterr().out) == first
    assert rows.read_bytes() == data
    assert run(["campaign", "velocity-doublet", "--rig", "lab", "--seeds", "3", "--out", str(rows)]) == 2
    assert "another campaign" in capsys.readouterr().err
    assert run(["campaign", "velocity"]) == 2
    assert "velocity-doublet" in capsys.readouterr().err


@pytest.mark.parametrize(("experiment", "number"), [("multisine", 84), ("3-2-1-1", 11)])
def test_output_error_does_not_overrule_a_push_against_the_prior(experiment: str, number: int) -> None:
    """Output error takes the push for the swing here, and ends 6 and 8 deviations of its prior off."""
    drone = drawn_drones("lab", [experiment], range(1, 301))[number]
    figures = IdentifiedByDefault("lab")(drone)
    assert figures["trusted"]
    for name in ("w_n", "mu", "tau"):
        assert abs(figures[name]["value"] - figures[name]["true"]) < 3.0 * figures[name]["sigma"], name


CHEAP = [(rig, name) for rig in ("lab", "paper") for name in ("impulse", "velocity-doublet", "velocity-doublets")]
REST = [
    pytest.param(rig, name, marks=pytest.mark.soak)
    for rig in ("lab", "paper")
    for name in FLOWN
    if (rig, name) not in CHEAP and name != "position-sweep"
]


def check(rig: str, experiment: str, flights: int = FLIGHTS) -> None:
    rows = campaign(IdentifiedByDefault(rig), drawn_drones(rig, [experiment], range(1, flights + 1)))
    found = [one for one in coverage(rows) if not one.repeats_prior]
    assert found, failures(rows)
    for one in found:
        assert one.p_value > REJECTED, one.text
        if one.silent or one.prior_left > 0.3:
            continue  # an unknown at its bound is off to one side, one with a prior towards its mean
        # A third of a claim, and 4 deviations of the mean by chance.
        assert abs(one.bias) < 1.0 / 3.0 + 4.0 * one.spread / math.sqrt(one.flights), one.text


@pytest.mark.long
@pytest.mark.parametrize(("rig", "experiment"), [*CHEAP, *REST])
def test_intervals_of_the_default_hold_the_truth(rig: str, experiment: str) -> None:
    check(rig, experiment)
