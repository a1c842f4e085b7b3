"""Experiments on the virtual rig: they fit, repeat to the bit, are recognised in their own log, and replay from it."""

import re
from math import radians

import numpy as np
import pytest

from twodof.errors import ExperimentError, ParameterError
from twodof.excitation import Doublet
from twodof.experiment.experiments import EXPERIMENTS, IDENTIFICATION, Experiment, experiment, script
from twodof.experiment.flight import STOP_MARGIN, Laboratory
from twodof.flight.gains import DEFAULT, STUDENT
from twodof.flightlog.contents import describe
from twodof.flightlog.steps import BOOT
from twodof.signals import PERIOD
from twodof.sim.replay import replay

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=["paper", "lab"])
def laboratory(request: pytest.FixtureRequest) -> Laboratory:
    return Laboratory(request.param)


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_ready_made_experiment_fits_and_its_data_are_good(laboratory: Laboratory, name: str) -> None:
    flight = laboratory.fly(experiment(name), seed=5)
    assert flight.good, flight.checks
    (excited,) = (check.seen for check in flight.checks if check.name == "excited")
    assert re.match(r"(q moves by \S+ rad/s|theta moves by \S+ rad|v moves by \S+ m/s|x moves by \S+ m),", excited)
    found = describe(flight.log)["experiment"]
    assert found is not None
    assert found["mode"] == EXPERIMENTS[name].mode
    # The set-point reaches the log as the double that was flown; a sweep's crest need not fall on a sample (1 %).
    assert found["amplitude"] == pytest.approx(EXPERIMENTS[name].excitation.peak, rel=0.01)


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_a_simulated_flight_replays_from_its_own_log(laboratory: Laboratory, name: str) -> None:
    result = replay(laboratory.fly(experiment(name), seed=5).log, DEFAULT)
    # The same compiled loops on the same doubles; only the integral's seed is recovered from M, to a rounding.
    assert all(error < 1e-14 for error in result.nrms.values())
    assert all(share > 0.98 for share in result.coverage.values())
    assert bool(result.nrms) == (EXPERIMENTS[name].thrust > 0.0)


def test_the_same_seed_gives_the_same_bits_and_another_does_not(laboratory: Laboratory) -> None:
    one, two, other = (laboratory.fly(IDENTIFICATION["doublet"], seed).log for seed in (7, 7, 8))
    again = Laboratory(laboratory.rig_name).fly(IDENTIFICATION["doublet"], 7).log
    for name in one:
        assert one[name].value.tobytes() == two[name].value.tobytes() == again[name].value.tobytes()
    assert one["gyr"].value.tobytes() != other["gyr"].value.tobytes()


def test_the_doublet_is_flown_about_the_found_trim() -> None:
    laboratory = Laboratory("lab", conditions={"trim": 0.02})
    flight = laboratory.fly(IDENTIFICATION["doublet"], seed=3)
    begin = script(flight.experiment).begin
    moment = flight.log["M"].value
    played = flight.experiment.excitation.at(np.arange(200) * PERIOD)
    trim = moment[begin]
    assert np.abs(moment[begin : begin + 200] - trim - played).max() < 1e-15
    level = moment[begin - 500 : begin].mean()
    assert trim == pytest.approx(level, abs=0.003)  # the hold's memory is 5 s, this mean takes its last 2 s
    assert abs(trim) > 0.01


def test_a_doublet_that_needs_more_rail_than_there_is_is_refused(laboratory: Laboratory) -> None:
    too_long = experiment("velocity-doublet", excitation=Doublet(radians(20.0), 2.0, unit="rad"))
    with pytest.raises(ExperimentError, match=r"would travel \d\.\d+ m, and the rail leaves 0\.76 m"):
        laboratory.fly(too_long)


def test_a_doublet_that_would_hit_the_pitch_stop_is_refused(laboratory: Laboratory) -> None:
    with pytest.raises(ExperimentError, match="the stop is at 50 deg"):
        laboratory.fly(experiment("doublet", excitation=Doublet(0.09, 0.6)))


def test_the_start_leaves_the_same_room_on_both_sides() -> None:
    laboratory = Laboratory("paper", noise=0.0)
    flight = laboratory.fly(IDENTIFICATION["velocity-doublet"])
    x = flight.log["x_true"].value[script(flight.experiment).begin :]
    assert x.max() == pytest.approx(-x.min(), abs=2e-3)


def test_rates_in_the_log_are_the_drones() -> None:
    log = Laboratory("lab").fly(IDENTIFICATION["velocity-doublet"], seed=1).log
    seconds = log.span[1] - BOOT
    for name, rate in (("gyr", 250.0), ("theta", 250.0), ("x", 100.0), ("dist", 18.35)):
        assert len(log[name]) / seconds == pytest.approx(rate, abs=1.0 / seconds + 0.01 * rate)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"mode": "acro"}, "unknown mode 'acro'"),
        ({"mode": "rate"}, "and the rate loop in 'rad/s'"),
        ({"rest": -1.0}, "rest = -1"),
        ({"thrust": 2.0}, "the thrust 2 is out of bounds"),
        ({"colour": 1}, "has no field 'colour'"),
    ],
)
def test_an_experiment_that_makes_no_sense_is_refused(fields: dict[str, object], message: str) -> None:
    with pytest.raises(ExperimentError, match=message):
        experiment("doublet", **fields)


def test_a_loop_that_needs_the_cart_is_not_flown_with_rings() -> None:
    with pytest.raises(ExperimentError, match="the rings lock it"):
        Experiment("x", "velocity", Doublet(0.2, 2.0, unit="m/s"), rings=True)


def test_an_experiment_and_gains_are_named(laboratory: Laboratory) -> None:
    named, own = laboratory.fly("impulse", seed=2**32 - 1), laboratory.fly(IDENTIFICATION["impulse"], seed=2**32 - 1)
    assert named.log["q"].value.tobytes() == own.log["q"].value.tobytes()
    for path, value in STUDENT.parameters().items():
        machine = Laboratory(laboratory.rig_name, gains="student").loop.machine
        assert machine.get(f"flight.cascade.{path}") == value
    with pytest.raises(ExperimentError, match="no experiment called 'doublt'"):
        laboratory.fly("doublt")
    with pytest.raises(ExperimentError, match="a NoneType is not an experiment"):
        laboratory.fly(None)


@pytest.mark.parametrize("seed", [-1, 2**32, 1.5, True, "1", float("nan")])
def test_a_seed_that_the_noise_cannot_take_is_refused(laboratory: Laboratory, seed: int) -> None:
    with pytest.raises(ExperimentError, match="seed must be an integer 0 to 4294967295"):
        laboratory.fly("impulse", seed=seed)


@pytest.mark.parametrize("noise", [-1.0, float("nan"), float("inf"), "1"])
def test_a_wrong_noise_is_refused_with_the_rig(noise: float) -> None:
    with pytest.raises(ParameterError, match="noise"):
        Laboratory("lab", noise=noise)


@pytest.mark.parametrize("seed", [224, 339])
def test_a_stop_that_is_struck_between_two_samples_is_seen(seed: int) -> None:
    # The gusts of these seeds swing the drone to its stop at 1.6 and 3.6 rad/s: no sample is nearer than .0019 rad.
    laboratory, flown = Laboratory("lab"), experiment("doublet")
    plan = script(flown)
    theta = laboratory.signals(flown, plan, 0.0, seed)["true_theta"][plan.begin : plan.end]
    stop = laboratory.parameters["pitch_stop"]
    assert stop - 0.01 < np.abs(theta).max() < stop - STOP_MARGIN
    (pitch,) = (check for check in laboratory.fly(flown, seed).checks if check.name == "clear of the pitch stop")
    assert not pitch.passed
