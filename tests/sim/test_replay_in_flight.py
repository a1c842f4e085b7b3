"""A log carries what a replay needs: gains that were changed in flight, the user's controllers and their tuning."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from tests.gcs.virtual import on_board
from twodof.cli.app import run
from twodof.errors import CompileError, shown
from twodof.experiment.flight import Laboratory
from twodof.experiment.fly import fly
from twodof.flight.gains import DEFAULT
from twodof.flightlog.files import read_log, write_log
from twodof.flightlog.log import FlightLog
from twodof.gcs.drone import Drone
from twodof.sim.replay import replay

pytestmark = pytest.mark.slow

EXACT = 1e-6
"""What float32 on the wire leaves of a moment."""


def tuned_flight(drone: Drone) -> None:
    """Steps of the pitch, the cart locked; before each pair the gains are set."""
    drone.run(0.5)
    drone.arm()
    for gain in (5.0, 9.0):
        drone.parameters.update({"ATT_KP": gain, "RATE_KP": 0.006 * gain})
        for goal in (0.0, 0.1):
            drone.set_pitch(goal)
            drone.run(1.5)
    drone.disarm()


@pytest.mark.long
def test_a_recording_keeps_changes_of_gains_in_flight(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "tuned.mcap"
    with on_board(lockstep=True) as there, Drone.connect(there.url) as drone:
        drone.reset(rings=True)
        with drone.record(path):
            tuned_flight(drone)
    log = read_log(path)
    told = [{"ATT_KP": 5.0, "RATE_KP": 0.03}, {"ATT_KP": 9.0, "RATE_KP": 0.054}]
    rows = log.provenance["changes"]
    assert [{name: value for _, name, value in rows[k : k + 2]} for k in (0, 2)] == told
    assert len({time for time, _, _ in rows}) == 2, "all of a change at one time"
    found = replay(log, precision="float32")
    assert max(found.nrms.values()) < EXACT
    assert min(found.coverage.values()) > 0.9
    assert max(replay(log, DEFAULT).nrms.values()) > 0.1, "with the gains of the start it is judged wrong"
    assert run(["replay", str(path)]) == 0
    assert "not the gains it was flown with?" not in capfd.readouterr().err


@pytest.mark.long
def test_an_experiment_flown_with_a_flashed_controller_keeps_its_diagram_and_its_tuning(tmp_path: Path) -> None:
    told: list[float] = []

    def tune(_: str, share: float) -> None:
        if share > 0.6 and not told:
            told.append(share)
            drone.parameters["attitude_control.k_q"] = 0.12

    with (
        on_board(lockstep=True, controllers=["lqr-attitude"], trusted=True) as there,
        Drone.connect(there.url) as drone,
    ):
        drone.parameters["attitude_control.k_theta"] = 1.1
        flight = fly("attitude-steps", drone, x_start=0.0, progress=tune)
    assert told
    write_log(flight.log, tmp_path / "own.csv")
    log = read_log(tmp_path / "own.csv")
    assert log.provenance["controllers"]["attitude_control"]["diagram"]["diagram"]["name"]
    assert log.provenance["controllers"]["attitude_control"]["parameters"]["k_theta"] == 1.1
    assert [(name, value) for _, name, value in log.provenance["changes"]] == [("attitude_control.k_q", 0.12)]
    found = replay(log, precision="float32")
    assert found.nrms["M"] < EXACT
    assert found.coverage["M"] > 0.9


@pytest.fixture(scope="module")
def flown() -> FlightLog:
    return Laboratory("lab", controllers=["pid-attitude", "pid-position"]).fly("position-sweep").log


@pytest.fixture(scope="module")
def before(flown: FlightLog) -> Mapping[str, float]:
    """Return the NRMS of its replay."""
    return replay(flown).nrms


def test_a_simulated_flight_with_two_controllers_is_given_back(before: Mapping[str, float]) -> None:
    assert before.keys() == {"M", "theta0", "T"}
    assert max(before.values()) < 1e-12


def test_a_users_controller_is_not_judged_before_its_first_reset(flown: FlightLog) -> None:
    ((start, end),) = flown.armed()
    found = replay(flown.slice(start + 5.0, end - 1.0))
    assert (found.nrms, {*found.coverage.values()}) == ({}, {0.0})


@pytest.mark.parametrize(
    "value", ["?", None, math.nan, math.inf, True, 10**400, -(10**400), [], {}, [1.0, 2.0]], ids=shown
)
def test_a_value_that_its_parameter_refuses_counts_as_not_noted(
    flown: FlightLog, before: Mapping[str, float], value: object
) -> None:
    """Of a user's controller, at the start and in flight, and of the drone's own gains."""
    values = {"theta_kp": value, "x_kp": value}
    noted = {name: {**row, "parameters": values} for name, row in flown.provenance["controllers"].items()}
    changes = [[12.0, name, value] for name in ("RATE_KP", "attitude_control.theta_kp", "position_control.x_kp")]
    spoil = {"controllers": noted, "changes": [*changes, [value, "RATE_KP", 1.0]]}
    assert replay(FlightLog(flown.channels, flown.provenance | spoil)).nrms == before


def test_a_value_out_of_its_bounds_counts_as_not_noted(flown: FlightLog, before: Mapping[str, float]) -> None:
    row = flown.provenance["controllers"]["attitude_control"]
    noted = {**flown.provenance["controllers"], "attitude_control": {**row, "parameters": {"q_n": -1.0}}}
    changes = [[12.0, "attitude_control.q_n", -1.0]]
    found = replay(FlightLog(flown.channels, flown.provenance | {"controllers": noted, "changes": changes}))
    assert found.nrms == pytest.approx(before, abs=1e-12)


def test_a_logs_own_diagram_runs_in_the_sandbox_or_not_at_all(
    flown: FlightLog, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Anybody may have written it. The stock loops need no sandbox."""
    monkeypatch.setattr("twodof.compile.wasm.target.find_spec", lambda _: None)
    with pytest.raises(CompileError, match="pip install wasmtime ziglang"):
        replay(flown)
    assert replay(flown, DEFAULT).nrms


@pytest.mark.parametrize(
    "spoil",
    [
        {"controllers": {"attitude_control": {"name": "mine", "sha256": "0"}}},
        {"controllers": {"attitude_control": {"diagram": {"diagram": 3}}}},
        {"changes": [[12.0, "attitude_control.kd[99]", 1.0], ["x"], [0.0, "RATE_KP", "?"], [1.0, "RATE_KP", -1.0]]},
        {"changes": 3},
    ],
)
def test_what_somebody_else_noted_does_not_end_it(flown: FlightLog, spoil: dict[str, Any]) -> None:
    found = replay(FlightLog(flown.channels, flown.provenance | spoil))
    assert set(found.nrms) <= {"M", "q0", "theta0", "T"}
