"""A flight of the virtual rig, whose truth is known, read by both methods at once."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from twodof.design.pitch_family import PitchFamily
from twodof.errors import IdentificationError
from twodof.excitation import Multisine
from twodof.experiment.experiments import Experiment
from twodof.experiment.flight import Laboratory
from twodof.flightlog.log import Channel, FlightLog
from twodof.identify import cut, fit
from twodof.identify.identified_flight import IdentifiedFlight, identify_flight
from twodof.identify.ready_made import (
    FlownMachine,
    experiment_in,
    gyro_noise,
    machine_of,
    structure_for,
    sufficiency,
    true_values,
)
from twodof.identify.record import Record
from twodof.models import pitch_rate
from twodof.rig.parameters import load_rig
from twodof.rig.rig import model_parameters

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def logs() -> dict[str, FlightLog]:
    laboratory = Laboratory("paper")
    return {name: laboratory.fly(name).log for name in ("impulse", "doublet", "velocity-doublet", "attitude-steps")}


@pytest.fixture(scope="module")
def doublet(logs: dict[str, FlightLog]) -> IdentifiedFlight:
    return identify_flight(logs["doublet"], impulse=logs["impulse"], structure="pitch-rate")


@pytest.mark.long
def test_both_methods_find_the_rig(doublet: IdentifiedFlight) -> None:
    """The paper's rig is linear and has the paper's w_n of Table 1; its gain by hand is read to 5 %."""
    assert doublet.greybox.fixed["w_n"] == pytest.approx(3.437, rel=1e-3)
    rows = {row["name"]: row for row in doublet.view()["estimates"]}
    assert rows["mu"]["simple"] == pytest.approx(rows["mu"]["value"], rel=0.05)
    assert rows["mu"]["low"] < rows["mu"]["value"] < rows["mu"]["high"]
    assert rows["mu"]["text"] == "gain from normalised moment to angular acceleration"
    assert not rows["mu"]["held"]
    assert rows["w_n"]["value"] == doublet.greybox.fixed["w_n"]
    assert (rows["w_n"]["held"], rows["w_n"]["sigma"], rows["w_n"]["unit"]) == (True, None, "rad/s")


def test_values_by_hand_are_left_out_where_their_own_checks_fail(doublet: IdentifiedFlight) -> None:
    doubted = replace(doublet, simple=replace(doublet.simple, left=0.2))
    assert "not known better" in doubted.view()["simple_text"]
    assert {row["simple"] for row in doubted.view()["estimates"]} == {None}


@pytest.mark.long
def test_the_view_is_json_and_its_curves_agree(doublet: IdentifiedFlight) -> None:
    view = json.loads(json.dumps(doublet.view(), allow_nan=False))
    (q,) = view["outputs"]
    assert {len(q[name]) for name in ("time", "measured", "greybox", "simple", "residual")} == {len(q["time"])}
    # Six figures are sent, of signals up to some rad/s.
    for measured, model, residual in zip(q["measured"], q["greybox"], q["residual"], strict=True):
        assert measured - model == pytest.approx(residual, abs=1e-4)
    assert view["informative"]["enough"]
    assert "mu ±" in view["informative"]["text"]


@pytest.mark.long
@pytest.mark.parametrize("seed", [2, 45])
def test_a_free_response_gives_poles_and_friction(seed: int) -> None:
    """Coloured noise once took the swing of seed 45 for its own, and a held delay passed for less damping."""
    laboratory = Laboratory("lab")
    true, found = (
        model_parameters(laboratory.parameters.snapshot()),
        identify_flight(laboratory.fly("impulse", seed).log),
    )
    assert found.structure.name == "free_response"
    for name in ("w_n", "xi", "coulomb", "hardening"):
        assert abs(found.greybox[name] - true[name]) < 4.0 * found.greybox.sigma(name), name
        assert found.greybox.sigma(name) < 0.01 * true[name]


@pytest.mark.long
def test_the_friction_of_a_rig_without_any_is_not_estimated() -> None:
    """Its doubt would pass into xi. A drone with friction that is taken for such a rig is told so."""
    log, other = Laboratory("paper").fly("impulse", 2).log, Laboratory("lab").fly("impulse", 2).log
    found = identify_flight(log).greybox
    assert "coulomb" not in found.labels
    assert found.sigma("xi") < 8e-6
    assert abs(found["xi"] - 0.0836) < 4.0 * found.sigma("xi")
    mistaken = FlightLog(other.channels, {**other.provenance, "rig": "paper"})
    (said,) = [one for one in identify_flight(mistaken).greybox.suggestions if "dry friction explains" in one]
    assert "--prior coulomb=0.2,inf" in said
    told = identify_flight(mistaken, prior={"coulomb": (0.2, math.inf)}).greybox
    assert abs(told["coulomb"] - 0.254) < 4.0 * told.sigma("coulomb")
    assert not any("dry friction explains" in one for one in told.suggestions)


@pytest.mark.parametrize("said", [{"flown": {"virtual": True}}, {"drone": {"rig": "paper", "virtual": True}}])
def test_true_values_stand_beside_the_estimates(logs: dict[str, FlightLog], said: dict[str, object]) -> None:
    log = logs["doublet"]
    ours = {key: value for key, value in log.provenance.items() if key != "rig" or "drone" not in said}
    seen = identify_flight(FlightLog(log.channels, {**ours, **said}), structure="pitch-rate").view()
    truth = {row["name"]: row["truth"] for row in seen["estimates"] if row["truth"] is not None}
    poles = {"w_n": pytest.approx(3.437), "xi": pytest.approx(0.0836)}
    assert truth == {"mu": pytest.approx(358.5), "tau": pytest.approx(0.02), **poles}


def test_true_gain_is_of_the_window_alone() -> None:
    rig = load_rig("lab").snapshot()

    def volts(time: np.ndarray) -> np.ndarray:
        # As a pack polarises in hover; it rises when the motors stop.
        return np.where(time <= 3.45, 11.98 + 0.4 * np.exp(-time / 7.0), 12.2)

    steps, twice = 0.004 * np.arange(1000), 0.5 * np.arange(8)
    log = FlightLog({"T": Channel(steps, np.full(1000, 0.4)), "voltage": Channel(twice, volts(twice))})
    flown = np.linspace(1.2, 3.4, 2201)
    supply = np.mean((volts(flown) / (rig["voltage_full"] - rig["resistance"] * rig["hover_current"])) ** 2)
    known = model_parameters(rig)
    for experiment, gain in (("velocity", "k_v"), ("attitude", "mu")):
        truth = true_values(rig, experiment, log, 1.2, 3.4)
        # The voltage of the last .4 s is that of the sample before.
        assert truth[gain] == pytest.approx(supply * known[gain], rel=5e-4)


@pytest.mark.parametrize("said", [{}, {"flown": {"virtual": False}}, {"rig": "own", "flown": {"virtual": True}}])
def test_no_true_values_unless_the_log_allows(logs: dict[str, FlightLog], said: dict[str, object]) -> None:
    log = logs["impulse"]
    seen = identify_flight(FlightLog(log.channels, {**log.provenance, **said})).view()
    assert [row["truth"] for row in seen["estimates"]] == [None] * len(seen["estimates"])


def test_its_model_is_what_design_reads(doublet: IdentifiedFlight) -> None:
    family = PitchFamily.from_identified(json.loads(json.dumps(doublet.model(), allow_nan=False)))
    assert family.values["mu"] == pytest.approx(doublet.greybox["mu"])
    assert "mu" in family.uncertain


def test_insufficient_data_are_reported(logs: dict[str, FlightLog]) -> None:
    """A doublet of .6 s hardly shows the poles: alone it is not enough for them, and says so."""
    found = identify_flight(logs["doublet"], structure="pitch-rate")
    judged = sufficiency(found.greybox, ("xi",))
    share = 1.959964 * found.greybox.sigma("xi") / abs(found.greybox["xi"])
    assert judged.enough == (share <= 0.25 and "xi" not in found.greybox.at_bound)
    assert (
        judged.enough or judged.text == f"not informative enough: the 95 % intervals are wide: xi ± {100 * share:.0f} %"
    )
    assert found.simple is None
    assert "impulse" in found.refusal


@pytest.mark.parametrize(("length", "vague"), [(1.2, False), (0.5, True)])
def test_correlated_unknowns_are_remarked_where_they_are_not_known(
    logs: dict[str, FlightLog], length: float, vague: bool
) -> None:
    # 1.2 s show w_n to .2 %, also beside theta_0 with a correlation of .99; .5 s show it to 12 %, and xi to 60.
    start = float(cut(logs["doublet"], "doublet").time[0])
    found = fit(pitch_rate(lag=True), cut(logs["doublet"], "doublet", (start, start + length)))
    assert any("hardly told apart" in remark for remark in found.remarks) is vague


def test_the_velocity_shows_both_outputs(logs: dict[str, FlightLog]) -> None:
    found = identify_flight(logs["velocity-doublet"])
    names = [one["name"] for one in found.view()["outputs"]]
    assert names == ["x", "v"]
    shares = found.sufficiency.shares
    assert shares["p_v"] > 2.0 * shares["k_v"], "one doublet tells p_v to a tenth"
    assert all(math.isfinite(row["value"]) for row in found.view()["estimates"])


def test_a_flight_in_closed_loop_holds_the_rig(logs: dict[str, FlightLog]) -> None:
    found = identify_flight(logs["attitude-steps"])
    assert found.experiment == "attitude"
    # The paper's rig: mu 358.5, a pure delay of 20 ms.
    assert abs(found.greybox["mu"] - 358.5) < 3.3 * found.greybox.sigma("mu")
    assert abs(found.greybox["tau"] - 0.02) < 3.3 * found.greybox.sigma("tau")
    assert found.sufficiency.enough
    assert found.simple is None
    assert "in closed loop nothing is read by hand" in found.refusal
    assert not any(one["validation"] for one in found.view()["outputs"])


def test_the_gyros_noise_is_what_is_faster_than_the_drone() -> None:
    time = 0.004 * np.arange(5000)
    slow, noise = np.sin(2.0 * math.pi * time), np.random.default_rng(2).normal(0.0, 0.02, time.size)
    record = Record.from_columns(time, {"gyro": slow + noise, "q": slow}, ["gyro"], ["q"])
    assert gyro_noise(record) == pytest.approx(0.02 * math.sqrt(1.0 - 8.0 / 125.0), rel=0.03)
    assert gyro_noise(replace(record, dt=0.1)) == 0.0, "such a record has nothing above 8 Hz"


def test_a_flight_in_closed_loop_is_fitted_by_another_structure_too() -> None:
    found = identify_flight(Laboratory("lab").fly("attitude-steps", 1).log, structure="free-response")
    assert found.greybox.structure == "free_response"


def test_a_rig_is_not_doubted_where_it_has_nothing(logs: dict[str, FlightLog]) -> None:
    """Rotors of `paper` have no lag, its range no age, its rail no friction, and its air no gust."""
    travelled = identify_flight(logs["velocity-doublet"]).greybox
    assert travelled.fixed["tau"] == 0.0
    assert set(travelled.disturbance.walks["x"].pushes) == {"theta_0"}
    assert travelled.sigma("k_v") < 0.09  # .12 with an age of the range
    pitched = identify_flight(logs["doublet"]).greybox
    assert pitched.fixed["lag"] == 0.0005
    (gust,) = pitched.disturbance.gusts.values()
    assert gust.std < 1e-9
    assert "no pushes at M" in pitched.disturbance.text
    assert "bend" not in identify_flight(Laboratory("lab").fly("attitude-prbs", 1).log).greybox.labels


def test_lines_of_rotors_that_move_hide_less_than_white_noise_of_their_size() -> None:
    """Steps on `lab` spread by 7 rad/s2 in mu and .43 ms in tau."""
    found = identify_flight(Laboratory("lab").fly("attitude-steps", 1).log).greybox
    assert found.disturbance.louder
    assert found.sigma("mu") < 9.0
    assert found.sigma("tau") < 6e-4


@pytest.mark.long
def test_a_long_open_loop_uses_priors_of_poles() -> None:
    signal = Multisine.schroeder(0.05, 2.0, range(2, 13), lead=0.2, repeat=2)
    flown = Laboratory("lab").fly(Experiment("multisine", "open-loop", signal, rings=True, hold=20.0, rest=0.4), 2)
    whole = identify_flight(FlightLog(flown.log.channels, {"rig": "lab", "flown": {"virtual": True}}))
    found = whole.greybox
    assert set(found.prior) == {"lag", "w_n", "xi"}
    known = model_parameters(load_rig("lab").snapshot())
    # Half a per cent less than with a full battery.
    assert whole.truth["mu"] == pytest.approx(0.994 * known["mu"], abs=0.5)
    assert abs(found["mu"] - whole.truth["mu"]) < 3.3 * found.sigma("mu")
    assert abs(found["tau"] - known["tau"]) < 3.3 * found.sigma("tau")


def test_an_impulse_that_tells_nothing_of_hover_is_said_so(logs: dict[str, FlightLog]) -> None:
    laboratory = Laboratory("lab")
    log, impulse = laboratory.fly("doublet").log, logs["impulse"]
    found = identify_flight(log, impulse=impulse).greybox
    assert found["w_n"] == identify_flight(log).greybox["w_n"]
    assert any("the poles of the impulse are not used" in one for one in found.remarks)


def test_a_window_without_range_samples_means_rings() -> None:
    dist = Channel(np.array([0.0, 0.05, 0.1, 0.15]), np.array([0.5, 0.5, 0.9, 0.5]))
    for said in ({"rig": "paper"}, {"drone": {"rig": "paper"}}):
        log = FlightLog({"dist": dist}, said)
        assert machine_of(log, 0.06, 0.09) == FlownMachine("paper", free=False)
        assert machine_of(log, 0.04, 0.11) == FlownMachine("paper", free=True)


def test_what_cannot_be_asked_is_refused(logs: dict[str, FlightLog]) -> None:
    with pytest.raises(IdentificationError, match="nothing is identified from the experiment 'hovering'"):
        experiment_in(FlightLog(logs["doublet"].channels, {"experiment": "hovering"}))
    with pytest.raises(IdentificationError, match="driven by"):
        structure_for("doublet", "rail")
    with pytest.raises(IdentificationError, match="no structure"):
        structure_for("doublet", "nothing")
    with pytest.raises(IdentificationError, match="doublet only"):
        identify_flight(logs["impulse"], impulse=logs["impulse"])
