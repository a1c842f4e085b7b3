"""Experiments with a user's controllers: good data, or data with the fault; never a crash."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twodof.blocks import Diagram
from twodof.blocks.library import Gain, Step
from twodof.errors import DiagramError, ParameterError
from twodof.experiment.flight import Flight, Laboratory
from twodof.flight.starters import new_diagram, starter
from twodof.flight.starters.attitude import with_ports
from twodof.flight.templates import ATTITUDE, MOTOR, POSITION, Template
from twodof.flightlog.files import read_log, write_log
from twodof.flightlog.log import FlightLog
from twodof.signals import PERIOD

pytestmark = pytest.mark.slow


def breaks(template: Template, at: float, values: dict[str, tuple[float, float]]) -> Diagram:
    """A controller whose outputs change from one value to another at a time [s]."""
    d = with_ports(template, "breaks", "")
    for name, (before, after) in values.items():
        d.add(f"{name}_step", Step(at, before, after))
        d.output(name, f"{name}_step")
    return d


def check(flight: Flight, name: str) -> Any:
    return next(c for c in flight.checks if c.name == name)


def finite(log: FlightLog) -> bool:
    return all(np.isfinite(log[name].value).all() for name in log)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_moment_without_a_number_stops_the_motors(bad: float, tmp_path: Path) -> None:
    laboratory = Laboratory("lab", controllers=[breaks(ATTITUDE, 3.0, {"M": (0.0, bad)})])
    flight = laboratory.fly("attitude-steps")
    assert not flight.good
    found = check(flight, "commands finite")
    assert not found.passed
    assert found.seen.startswith("M is not finite from 3.000 s on, in ")
    assert finite(flight.log)
    # Up to there and after the end, where the mode is off; M has a gap between, and the motors gave nothing in it.
    assert len(flight.log["theta"]) - len(flight.log["M"]) == int(found.seen.split("in ")[1].split()[0])
    for suffix in (".mat", ".parquet", ".csv"):
        write_log(flight.log, tmp_path / f"flight{suffix}")
        assert len(read_log(tmp_path / f"flight{suffix}")["M"]) == len(flight.log["M"])


def test_the_drone_falls_as_if_switched_off() -> None:
    """Seen at the truth: after the moment is lost the pitch moves as with both pairs at rest."""
    laboratory = Laboratory("paper", controllers=[breaks(ATTITUDE, 1.0, {"M": (0.05, math.inf)})], noise=0.0)
    out = {}
    for name, value in (("lost", math.inf), ("none", 0.0)):
        machine = laboratory.loop.machine
        machine.reset()
        machine.set("flight.cascade.attitude_control.M_step.after", value)
        thrust = np.where(np.arange(500) < 250, 0.4, 0.0 if name == "none" else 0.4)
        out[name] = laboratory.loop.fly(500, {"mode": "attitude", "thrust": thrust})
    assert np.isinf(out["lost"]["M"][250:]).all()
    assert np.array_equal(out["lost"]["fore"], out["none"]["fore"])
    assert out["lost"]["true_theta"].tobytes() == out["none"]["true_theta"].tobytes()


@pytest.mark.parametrize(
    "controller",
    [
        breaks(POSITION, 9.0, {"thrust": (0.4, math.nan), "theta_0": (0.0, 0.0)}),
        breaks(POSITION, 9.0, {"thrust": (0.4, 0.4), "theta_0": (0.0, math.nan)}),
        breaks(MOTOR, 9.0, {f"motor_{n}": (0.4, math.nan if n == 3 else 0.4) for n in (1, 2, 3, 4)}),
        breaks(MOTOR, 9.0, {f"motor_{n}": (0.4, -math.inf) for n in (1, 2, 3, 4)}),
    ],
    ids=["thrust", "theta_0", "one motor", "all motors"],
)
def test_whatever_is_no_number_ends_as_data(controller: Diagram) -> None:
    laboratory = Laboratory("lab", controllers=[controller])
    for name in ("velocity-doublets", "doublet"):
        flight = laboratory.fly(name)
        assert finite(flight.log)
        # A doublet is flown in the rings, where no position controller is asked.
        reached = "motor_1" in controller.outputs or name == "velocity-doublets"
        assert check(flight, "commands finite").passed is not reached


def test_a_controller_that_drives_into_the_stop_is_data_too() -> None:
    wild = with_ports(ATTITUDE, "wild", "positive feedback")
    wild.add("gain", Gain(3.0), u="theta")
    wild.output("M", "gain")
    flight = Laboratory("lab", controllers=[wild]).fly("velocity-doublet")
    assert not flight.good
    assert not check(flight, "clear of the pitch stop").passed
    assert flight.x_start == 0.0


@pytest.mark.long
def test_controllers_by_name_file_and_diagram_fly_the_same_bits(tmp_path: Path) -> None:
    new_diagram("lqr-attitude", tmp_path / "mine.json")
    logs = [
        Laboratory("lab", controllers=[source]).fly("attitude-steps").log
        for source in ("lqr-attitude", tmp_path / "mine.json", starter("lqr-attitude"))
    ]
    for name in logs[0]:
        assert logs[0][name].value.tobytes() == logs[1][name].value.tobytes() == logs[2][name].value.tobytes()
    kept = logs[0].provenance["controllers"]["attitude_control"]
    assert kept["name"] == "lqr_attitude"
    assert kept["sha256"] == logs[1].provenance["controllers"]["attitude_control"]["sha256"]
    assert "controllers" not in Laboratory("lab").fly("impulse").log.provenance


def test_float32_flies_as_float64_does_but_for_rounding() -> None:
    flights = [
        Laboratory("lab", controllers=["notch-attitude"], precision=precision, noise=0.0).fly("attitude-steps")
        for precision in ("float64", "float32")
    ]
    theta = [flight.log["theta"].value for flight in flights]
    assert theta[0].tobytes() != theta[1].tobytes()
    # Eight seconds before the steps, in which single precision of the cart and the range may move the estimate by
    # some 1e-4 rad; the steps are of .17 rad.
    assert np.abs(theta[0] - theta[1]).max() < 2e-3
    assert len(theta[0]) * PERIOD > 15.0


def test_what_cannot_fly_is_refused_before_it_flies() -> None:
    with pytest.raises(DiagramError, match="this is neither a file nor a starter diagram"):
        Laboratory("lab", controllers=["lqr"])
    with pytest.raises(ParameterError, match=r"no parameter named 'attitude_control.kp'"):
        Laboratory("lab", controllers=["lqr-attitude"], tuning={"attitude_control.kp": 1.0})
    with pytest.raises(DiagramError, match="unknown precision"):
        Laboratory("lab", precision="float16")
