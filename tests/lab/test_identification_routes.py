"""From a flight to a controller over the API alone, on a real virtual drone whose time the clients grant."""

from collections.abc import Iterator

import pytest

from tests.lab.served import ServedLab, served_lab
from tests.patience import patiently
from twodof.flight.starters import load_diagram

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedLab]:
    with served_lab(tmp_path_factory.mktemp("lab")) as found:
        yield found


@pytest.fixture(scope="module")
def flights(lab: ServedLab) -> dict[str, str]:
    """The log of each experiment, flown by the job."""
    found = {}
    for name in ("impulse", "doublet"):
        told = lab.done(lab.call("POST", "identification/fly", {"experiment": {"name": name}, "drone": 1}))
        assert told["good"], told["checks"]
        found[name] = told["log"]
    return found


@pytest.mark.long
def test_a_plan_says_what_an_experiment_will_tell(lab: ServedLab) -> None:
    asked = {"experiment": {"name": "doublet"}, "drone": 1}
    told = lab.done(lab.call("POST", "identification/plan", asked))
    rows = {row["name"]: row for row in told["unknowns"]}
    assert rows["mu"]["enough"]
    assert told["rig"] == "paper", "the virtual rig that the drone flies"
    half = {"kind": "doublet", "amplitude": 0.015, "period": 0.6, "lead": 0.2}
    weaker = lab.done(
        lab.call("POST", "identification/plan", {**asked, "experiment": {"name": "doublet", "excitation": half}})
    )
    assert {row["name"]: row for row in weaker["unknowns"]}["mu"]["sigma"] > 1.8 * rows["mu"]["sigma"]
    wild = {"kind": "doublet", "amplitude": 0.3, "period": 1.0}
    job = lab.ended(
        lab.call("POST", "identification/plan", {**asked, "experiment": {"name": "doublet", "excitation": wild}})
    )
    assert job["state"] == "failed"
    assert "smaller or shorter" in job["error"]["remedy"]


@pytest.mark.long
def test_from_a_flight_to_a_controller(lab: ServedLab, flights: dict[str, str]) -> None:
    asked = {"log": flights["doublet"], "impulse": flights["impulse"], "structure": "pitch-rate"}
    fit = lab.call("POST", "identification/fit", asked)
    told = lab.done(fit)
    view = told["view"]
    assert view["informative"]["enough"], view["informative"]["text"]
    assert view["simple"] is not None
    assert {"measured", "greybox", "simple", "residual"} <= set(view["outputs"][0])
    row = lab.call("POST", "models", {"job": fit[1]["id"], "name": "first"})[1]
    assert row["pitch"]
    quoted = {one["name"]: one["sigma"] for one in view["estimates"]}
    assert {"mu", "tau"} <= {one["name"] for one in row["values"]}
    for one in row["values"]:
        assert one["sigma"] == quoted[one["name"]], "the list of models and the table of the fit say the same"
    made = lab.done(lab.call("POST", "models/first/controller", {"name": "for the first"}))
    assert made["robustness"]["robust"], made["robustness"]["text"]
    assert load_diagram(lab.folder / "diagrams" / made["file"]).name == made["name"] == "for_the_first"
    again = lab.ended(lab.call("POST", "models/first/controller", {"name": "for the first"}))
    assert again["state"] == "failed", "a diagram that is there is kept"


@pytest.mark.long
def test_steps_that_were_flown_are_laid_over_a_prediction(lab: ServedLab) -> None:
    steps = {
        "name": "attitude-steps",
        "excitation": {"kind": "steps", "levels": [0.17, 0.0], "hold": 1.5, "unit": "rad"},
    }
    told = lab.done(lab.call("POST", "identification/fly", {"experiment": steps, "drone": 1}))
    found = lab.call("POST", "tuning/1/measured", {"log": told["log"], "goal": 0.1})[1]["steps"]
    assert [step["size"] > 0 for step in found] == [True, False]
    for step in found:
        assert step["theta"][-1] == pytest.approx(0.1, abs=0.02), "up or down, each is scaled to the goal"


@pytest.mark.long
def test_a_flight_is_stopped_and_what_was_flown_is_kept(lab: ServedLab) -> None:
    started = lab.call("POST", "identification/fly", {"experiment": {"name": "doublet", "hold": 600.0}, "drone": 1})
    job = started[1]["id"]
    for _ in patiently():
        if "hold" in lab.call("GET", f"jobs/{job}")[1]["text"]:
            break
    assert lab.call("POST", f"identification/fly/{job}/stop")[0] == 200
    told = lab.done(started)
    assert told["reason"] == "interrupted"
    assert not told["good"]
    assert (lab.folder / "flights" / told["log"]).stat().st_size > 1000
    assert any(not lab.call("GET", "drones")[1][0]["armed"] for _ in patiently())


@pytest.mark.long
@pytest.mark.parametrize(
    ("body", "status"),
    [
        ({"log": "../../etc/passwd"}, 404),
        ({"log": "not-there.mcap"}, 404),
        ({"log": "a.mcap", "kind": "nothing"}, 422),
        ({"log": "a.mcap", "window": [-1, 5]}, 422),
    ],
)
def test_a_fit_of_what_is_not_there_is_refused(lab: ServedLab, body: dict[str, object], status: int) -> None:
    assert lab.call("POST", "identification/fit", body)[0] == status
