"""The user's own controller is tuned in flight: over MAVLink and in the simulator with the same bits. Its on-board log
holds the change, and flies again to the same bits.
"""

import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from tests.experiment.drones import drone_thread
from tests.experiment.test_fly import Signals, differing
from twodof.experiment.experiments import EXPERIMENTS, Script, script
from twodof.experiment.flight import Laboratory
from twodof.experiment.fly import fly
from twodof.fcu.control.flight_code import OUTPUTS, FlightCode
from twodof.fcu.control.hardware import ControlInput, SensorSample
from twodof.fcu.parameters.parameter_store import ParameterStore
from twodof.flight.starters import starter
from twodof.flightlog.steps import ASKED
from twodof.flightlog.ulog_file import ULogContents, scan_ulog
from twodof.gcs.drone import Drone
from twodof.rig.parameters import lab
from twodof.signals import TICK_US
from twodof.sim.closed_loop import InitialState
from twodof.sim.virtual_drone import VirtualRig

pytestmark = pytest.mark.slow

NAME, OWN, SEED = "attitude-steps", "lqr-attitude", 5
ENOUGH = 100
RINGS = EXPERIMENTS[NAME].rings
TUNING: Mapping[str, float] = {"attitude_control.k_q": 0.2, "attitude_control.k_past[2]": 0.05}
"""What no float32 holds, one of them an element of an array."""
WIRE = ("TLA_K_Q", "TLA_K_PAST_2")
CASES = {"inside, float64": (True, "float64"), "sandbox, float32": (False, "float32")}


@dataclass
class Flown:
    """A flight in which `TUNING` was set at the tick `at`, all of it and then a part, and its on-board log."""

    at: int
    log: ULogContents
    rows: Signals
    trusted: bool
    precision: str


@pytest.fixture(scope="module", params=["sandbox, float32", pytest.param("inside, float64", marks=pytest.mark.soak)])
def flown(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Flown]:
    trusted, precision = CASES[request.param]
    state = tmp_path_factory.mktemp("drone")
    at: list[int] = []

    def tune(_: str, share: float) -> None:
        if share > 0.6 and not at:
            at.append(drone.tick)
            drone.parameters.update(TUNING)

    options: dict[str, Any] = {"controllers": [OWN], "trusted": trusted, "precision": precision, "state": state}
    with drone_thread(**options) as url, Drone.connect(url) as drone:
        drone.parameters["SDLOG_MODE"] = 2  # log from the first tick on
        flight = fly(NAME, drone, seed=SEED, x_start=0.0, progress=tune)
        assert flight.good, flight.checks
        drone.logs.list()  # which waits for what is being written
        path = max((state / "logs").rglob("*.ulg"))
        log = scan_ulog(path.read_bytes(), NAME)
        yield Flown(at[0], log, log.topic("twodof_step"), trusted, precision)


@functools.cache
def laboratory(precision: str) -> Laboratory:
    return Laboratory("lab", controllers=[OWN], precision=precision, failsafe=True)


def simulated(flown: Flown, at: int | None) -> tuple[Script, Signals]:
    """The same in the simulator, tuned at the tick `at` (None: never)."""
    experiment, loop = EXPERIMENTS[NAME], laboratory(flown.precision).loop
    past = starter(OWN).params["k_past"].value
    loop.tune_controllers({"attitude_control.k_q": starter(OWN).params["k_q"].value, "attitude_control.k_past": past})
    plan = script(experiment, 0.0)
    loop.configure({"rings": experiment.rings, "ring_place": 0.0, "seed": SEED, "noise": 1.0})
    loop.start(InitialState(x=0.0))
    cut = plan.steps if at is None else at
    parts = []
    for part in (slice(0, cut), slice(cut, plan.steps)):
        steps = part.stop - part.start
        given = {**plan.setpoints, "arm": plan.arm}
        asked = {name: v[part] if isinstance(v, np.ndarray) and v.ndim else v for name, v in given.items()}
        parts.append(loop.fly(steps, asked) if steps else {})
        loop.tune_controllers({"attitude_control.k_q": 0.2, "attitude_control.k_past": [*past[:2], 0.05, *past[3:]]})
    return plan, {name: np.concatenate([part[name] for part in parts if part]) for name in parts[0]}


@pytest.mark.long
def test_tuning_in_flight_has_the_simulators_bits(flown: Flown) -> None:
    plan, same = simulated(flown, flown.at)
    found = differing(flown.rows, plan, same)
    # What a sandbox shows as the rate set-point while nothing flies is that of the stock controllers.
    standing = plan.steps - int(plan.arm.sum())
    assert found == {} or (not flown.trusted and found.keys() == {"q0"} and found["q0"] <= standing)
    for other in (flown.at + 1, flown.at - 1, None):
        assert "M" in differing(flown.rows, plan, simulated(flown, other)[1]), "another tick is seen"


@pytest.mark.long
def test_the_log_says_when_and_what(flown: Flown) -> None:
    own = [(time, name, value) for time, name, value in flown.log.changes if name.startswith("TLA_")]
    values = {name: np.float32(value) for name, value in zip(WIRE, TUNING.values(), strict=True)}
    assert {name: np.float32(value) for _, name, value in own} == values
    assert {time for time, _, _ in own} == {(flown.at - 1) * TICK_US}, "behind the last step with the old values"
    assert flown.log.parameters["TLA_K_Q"] == np.float32(starter(OWN).params["k_q"].value)


@pytest.mark.long
def test_the_log_flies_again_to_the_same_bits(flown: Flown) -> None:
    assert replayed(flown, with_changes=True) == 0
    assert replayed(flown, with_changes=False) == ENOUGH


def replayed(flown: Flown, with_changes: bool) -> int:
    """In how many steps, up to `ENOUGH`, a flight code with the log's inputs and parameters gives other outputs."""
    code = FlightCode([starter(OWN)], flown.trusted, precision=flown.precision)
    rig = VirtualRig(lab(), {}, flown.precision)
    rig.settle(code)
    store, rows = ParameterStore(), flown.rows
    store.carry(code.user_parameters)
    store.update(
        {
            name: value
            for name, value in flown.log.parameters.items()
            if not (store.row(name).fixed or store.row(name).of)
        }
    )
    code.set_parameters(store.flying() | store.user_values())
    code.reset(rig.reset(SEED, 0.0, 1.0, RINGS))
    changes = [change for change in flown.log.changes if with_changes]
    wrong = 0
    for k, tick in enumerate(rows["tick"].tolist()):
        due = {name: value for time, name, value in changes if time == (tick - 1) * TICK_US}
        if due:
            store.update(due)
            code.set_parameters(store.flying() | store.user_values())
        sample = SensorSample(*(rows[name][k].item() for name in SensorSample._fields))
        asked = ControlInput(*(rows[f"{ASKED}{name}"][k].item() for name in ControlInput._fields))
        step = code.step(tick, sample, asked, rings=RINGS)
        wrong += any(
            np.float64(getattr(step, name)).tobytes() != np.float64(rows[name][k]).tobytes() for name in OUTPUTS
        )
        if wrong == ENOUGH:
            break
    return wrong
