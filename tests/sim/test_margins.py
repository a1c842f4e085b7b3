"""How far healthy flights stay from the limits at which the failsafe no longer believes what its sensors say."""

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.flight.failsafe.expr_arrays import tell
from twodof.compile.builder import build
from twodof.compile.machine import CompiledProgram, Instances
from twodof.experiment.experiments import EXPERIMENTS, script
from twodof.experiment.flight import Laboratory
from twodof.flight.failsafe.causes_and_actions import BIT
from twodof.rig.rig import BASE_DT, SAMPLE
from twodof.sim.closed_loop import InitialState, closed_loop, loop_values

pytestmark = pytest.mark.slow

TICKS = SAMPLE[0]
SUMS = {
    **dict.fromkeys(("force.forth", "force.back"), "force.along_limit"),
    **dict.fromkeys(("force.hit_forth", "force.hit_back"), "force.hit_limit"),
    "motion.apart": "motion.limit",
    **dict.fromkeys(("force.up", "force.down"), "force.up_limit"),
    **dict.fromkeys(("rate.faster", "rate.slower"), "rate.turn_limit"),
}
"""Sum -> its limit, below `flight.failsafe.diagram.`."""

NEW_CAUSES = sum(BIT[name] for name in ("imu_lost", "range_lost", "force_disagrees", "rate_disagrees"))
CHUNK = 500

HARD: Mapping[str, tuple[bool, Mapping[str, Any]]] = {
    "x0 +-5 m": (False, {"mode": 5, "x0": 5.0}),
    "v0 +-9 m/s": (False, {"mode": 4, "v0": 9.0}),
    "theta0 +-.6 rad, locked": (True, {"mode": 3, "theta0": 0.6}),
    "q0 +-1 rad/s, locked": (True, {"mode": 2, "q0": 1.0}),
    "theta0 +-.3 rad": (False, {"mode": 3, "theta0": 0.3}),
}
"""Set-points far beyond those of the experiments: rings, and what changes its sign every 1.2 s."""


@functools.cache
def laboratory(rig: str) -> Laboratory:
    return Laboratory(rig)


@functools.cache
def program() -> CompiledProgram:
    log = [f"flight.failsafe.{path}" for path in SUMS]
    made = build(closed_loop(failsafe=True), BASE_DT, log=log)
    assert isinstance(made, CompiledProgram)
    return made


def experiment(rig: str, name: str) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Conditions of the rig and the inputs, (steps,) each, of a ready-made experiment."""
    one, at = EXPERIMENTS[name], laboratory(rig).start(name)
    plan = script(one, at)
    columns = {key: np.broadcast_to(np.asarray(value), (plan.steps,)) for key, value in plan.setpoints.items()}
    return {"rings": one.rings, "ring_place": at, "x_start": at}, columns | {"arm": plan.arm}


def hard(name: str) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """The same of set-points in `HARD`, armed at .4 s and flown from .5 s on."""
    rings, asked = HARD[name]
    ticks = np.arange(2500)
    sign = np.where(ticks // 300 % 2 == 0, 1.0, -1.0)
    columns = {key: np.where(ticks >= 125, value * (1 if key == "mode" else sign), 0) for key, value in asked.items()}
    return {"rings": rings}, columns | {"arm": ticks >= 100, "thrust": np.where(ticks >= 125, 0.4, 0.0)}


def used(rig: str, flight: tuple[dict[str, Any], dict[str, NDArray[Any]]], seeds: NDArray[Any]) -> dict[str, float]:
    """The largest share of each limit that is used in flight, over all seeds; the range's is of `range_error`."""
    conditions, columns = flight
    machine = Instances(program(), len(seeds))
    machine.set_many(loop_values({**laboratory(rig).parameters, **conditions}) | {"rig.seed": seeds})
    machine.reset()
    start = conditions.get("x_start", 0.0)
    states = InitialState(x=start).flight_states(path.removeprefix("flight.") for path in program().states)
    for path, value in states.items():
        machine.set_state(f"flight.{path}", value)
    healthy = {"setpoint_new": True, "link_new": True, "imu_new": True, "rings": conditions["rings"]}
    limits = {path: float(machine.get(f"flight.failsafe.{limit}")[0]) for path, limit in SUMS.items()}
    if conditions["rings"]:
        limits |= {path: 2.0 * limits[path] for path in ("force.forth", "force.back")}
    limits["range"] = float(machine.get("flight.failsafe.sensors.range_error")[0])
    largest, flown = dict.fromkeys(limits, 0.0), np.zeros(len(seeds), np.bool_)
    for begin in range(0, len(columns["arm"]), CHUNK):
        part = {name: np.repeat(column[begin : begin + CHUNK], TICKS) for name, column in columns.items()}
        out = {k: v[::TICKS] for k, v in machine.run(len(part["arm"]), healthy | part).items()}
        armed = out["armed"]
        flown |= armed.any(axis=0)
        assert not (out["reason"] & NEW_CAUSES)[armed].any()
        for path, limit in limits.items():
            away = np.where(out["dist_new"], np.abs(out["dist"] - 0.5 - out["x"]), 0.0)
            column = away if path == "range" else out[f"flight.failsafe.{path}"]
            largest[path] = max(largest[path], float(np.where(armed, column, 0.0).max()) / limit)
    assert flown.all()
    return largest


def told(what: str, shares: Mapping[str, float]) -> None:
    tell(f"{what}: " + ", ".join(f"{path} {share:.2f}" for path, share in shares.items()))


@pytest.mark.parametrize("rig", ["paper", "lab"])
@pytest.mark.parametrize("name", ["velocity-doublets", "x0 +-5 m", "theta0 +-.6 rad, locked"])
def test_healthy_flights_stay_far_from_the_limits(rig: str, name: str) -> None:
    flight = hard(name) if name in HARD else experiment(rig, name)
    shares = used(rig, flight, np.arange(1, 9, dtype=np.uint32))
    told(f"{rig} {name}", shares)
    assert max(shares.values()) < 0.6


@pytest.mark.soak
@pytest.mark.parametrize("rig", ["paper", "lab"])
def test_and_so_do_thousands_of_them(rig: str) -> None:
    """200 seeds of each experiment and each hard flight."""
    for name in (*EXPERIMENTS, *HARD):
        flight = hard(name) if name in HARD else experiment(rig, name)
        worst: dict[str, float] = {}
        for first in range(0, 200, 50):
            shares = used(rig, flight, np.arange(first + 10, first + 60, dtype=np.uint32))
            worst = {path: max(share, worst.get(path, 0.0)) for path, share in shares.items()}
        told(f"{rig} {name}", worst)
        assert max(worst.values()) < 0.7
