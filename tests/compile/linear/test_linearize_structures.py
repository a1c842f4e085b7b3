"""The ready-made structures' linear models: against textbook matrices, and against what the compiled program does."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from tests.compile.linear.linear_diagrams import DT
from twodof.compile import build
from twodof.compile.linear.linear_model import LinearModel
from twodof.compile.linear.linearize import linearize
from twodof.errors import DiagramError
from twodof.models import Structure, free_response, longitudinal, pitch_and_velocity, pitch_rate, rail, velocity
from twodof.signals import GRAVITY

pytestmark = pytest.mark.slow

Array = np.ndarray[Any, Any]

W, XI, MU, K, P = 3.437, 0.0836, 358.5, 4.748, 1.168
LAG = 0.011
LIFT = 0.3  # quadratic share of the thrust curve
X_U, X_Q, M_U, M_Q, X_D, M_D = -0.1068, 0.1192, -5.9755, -2.6478, -10.1647, 450.71
TILT = 0.3  # rad: where the structures with sines are linearized


def hanging() -> dict[str, float]:
    """The moment that holds the hardening pendulum at TILT, without dry friction."""
    return {"M": (W * W * math.sin(TILT) + 2.0 * TILT**3) / 130.0, "coulomb": 0.0, "hardening": 2.0, "theta_0": TILT}


SOFT = -(W * W * math.cos(TILT) + 6.0 * TILT**2)
PITCH = [[0, 1], [-W * W, -2 * XI * W]]
PLANTS: dict[str, tuple[Structure, dict[str, float], Any, Any, Any, Any]] = {
    "pitch_rate": (pitch_rate(), {}, PITCH, [[0], [MU]], np.eye(2), [[0], [0]]),
    "pitch_rate_lag": (
        pitch_rate(lag=True),
        {"dead_time": 0.0151},
        [[0, 1, 0], [-W * W, -2 * XI * W, MU], [0, 0, -1 / LAG]],
        [[0], [0], [1 / LAG]],
        np.eye(2, 3),
        [[0], [0]],
    ),
    "velocity": (velocity(), {"tau": 0.0107}, [[0, 1], [0, -P]], [[0], [-K]], np.eye(2), [[0], [0]]),
    "rail": (
        rail(),
        {"tau": 0.0062},
        [[0, 0, 0], [0, 0, 1], [-K, 0, -P]],
        [[1], [0], [0]],
        np.eye(3),
        np.zeros((3, 1)),
    ),
    "pitch_and_velocity": (
        pitch_and_velocity(),
        {"tau": 0.02},
        [[0, 1, 0, 0], [-W * W, -2 * XI * W, 0, 0], [0, 0, 0, 1], [-K, 0, 0, -P]],
        [[0], [MU], [0], [0]],
        np.eye(4),
        np.zeros((4, 1)),
    ),
    "free_response": (
        free_response(),
        hanging(),
        [[0, 1], [SOFT, -2 * XI * W]],
        [[0], [130.0]],
        np.eye(2),
        [[0], [0]],
    ),
    "rail as it is": (
        rail(),
        {},
        [[0, 0, 0], [0, 0, 1], [-K, 0, -P]],
        [[1], [0], [0]],
        np.eye(3),
        np.zeros((3, 1)),
    ),
    "free_response at rest without friction": (
        free_response(),
        {"coulomb": 0.0, "hardening": 2.0},
        PITCH,
        [[0], [130.0]],
        np.eye(2),
        [[0], [0]],
    ),
    "longitudinal": (
        longitudinal(),
        {"tau": 0.01},
        [[X_U, X_Q, -GRAVITY], [M_U, M_Q, 0], [0, 1, 0]],
        [[X_D], [M_D], [0]],
        [*np.eye(3), [X_U, X_Q, 0]],
        [[0], [0], [0], [X_D]],
    ),
}


@cache
def structure_model(name: str) -> LinearModel:
    structure, at, *_ = PLANTS[name]
    return linearize(structure.diagram, DT, at=at, trim=name == "free_response")


def textbook(delay: float, a: Any, b: Any, c: Any, d: Any, z: complex) -> Array:
    """G(z) of x' = A x + B u(t - tau) with u held, read at the samples (Franklin, Powell, Workman, 3rd ed., 4.3)."""
    whole = math.floor(delay / DT + 1e-9)
    old = max(delay / DT - whole, 0.0) * DT  # of a step the older of two samples acts for this long
    n, m = np.shape(b)

    def held(h: float) -> tuple[Array, Array]:
        block = expm(np.block([[np.array(a, float), np.array(b, float)], [np.zeros((m, n + m))]]) * h)
        return block[:n, :n], block[:n, n:]

    (phi, _), (rest, late), (_, early) = held(DT), held(DT - old), held(old)
    drive = (rest @ early / z + late) * z**-whole
    seen = z ** -(whole + (1 if old > 1e-9 else 0))
    return np.asarray(np.array(c) @ np.linalg.solve(z * np.eye(n) - phi, drive) + np.array(d) * seen)


@pytest.mark.parametrize("name", PLANTS)
def test_a_structure_is_its_textbook_plant_behind_a_hold_and_its_delay(name: str) -> None:
    structure, at, *plant = PLANTS[name]
    model = structure_model(name)
    assert model.dt == DT
    assert model.outputs == structure.outputs
    assert model.inputs == structure.inputs
    own = "dead_time" if name == "pitch_rate_lag" else "tau"
    delay = at.get(own, float(structure.diagram.params[own].value))
    omega = np.geomspace(0.3, 0.9 * math.pi / DT, 25)
    found = model.response(omega)
    expected = np.array([textbook(delay, *plant, z) for z in np.exp(1j * omega * DT)])
    # RK4 misses (omega DT)^5 / 120 of a state, below 1e-11 a step; the slow poles multiply that.
    exact = not name.startswith(("rail", "free_response"))
    for k in range(len(omega)):
        np.testing.assert_allclose(found[k], expected[k], rtol=1e-10 if exact else 1e-7, atol=1e-13)


def test_held_by_dry_friction_it_is_refused() -> None:
    """At rest, pushed less than the friction holds, the compiled structure does not move: 0, and beside it not 0."""
    with pytest.raises(DiagramError, match="what rests there goes on resting") as found:
        linearize(free_response().diagram, DT)
    assert found.value.where == "plant"
    assert "take out the friction" in found.value.remedy


@pytest.mark.parametrize("name", PLANTS)
def test_a_structure_flies_as_its_model_does(name: str) -> None:
    """Half the difference of two flights of the compiled program, of small inputs u and -u about the point."""
    structure, at, *_ = PLANTS[name]
    model = structure_model(name)
    (port,) = structure.inputs
    machine = build(structure.diagram, DT).machine()
    small = np.random.Generator(np.random.PCG64(2)).standard_normal(300) * 1e-5
    small[:100] = 1e-5  # a step first

    def flight(sign: float) -> Array:
        machine.set_many({n: v for n, v in at.items() if n != port})
        machine.reset()
        machine.run(70, {port: at.get(port, 0.0)})  # the ring is full, the point is an equilibrium
        out = machine.run(300, {port: at.get(port, 0.0) + sign * small})
        return np.array([out[n] for n in structure.outputs]).T

    moved = (flight(1.0) - flight(-1.0)) / 2.0
    x, expected = np.zeros(len(model.a)), np.empty_like(moved)
    for k in range(300):
        expected[k] = model.c @ x + model.d[:, 0] * small[k]
        x = model.a @ x + model.b[:, 0] * small[k]
    assert np.abs(moved).max(axis=0).min() > 0.0
    # Roundings of numbers of about 1 in each of 370 steps, and the cube of the small motion.
    np.testing.assert_allclose(moved, expected, atol=1e-12)


IN_FLIGHT: dict[str, tuple[Structure, dict[str, float]]] = {
    "rail": (
        rail(thrust=True),
        {"q": 0.3, "M": 0.05, "T": 0.42, "theta_0": 0.2, "v_0": 0.4, "coulomb": 0.3, "tau": 0.0062},
    ),
    "free_response": (free_response(), {"M": 0.02, "q_0": 1.3, "theta_0": -0.2}),
}


@pytest.mark.parametrize("name", IN_FLIGHT)
def test_in_flight_each_column_is_a_difference_of_the_compiled_step(name: str) -> None:
    """With sliding friction, sines and thrust: next states and outputs for each state, sample and input at +-h."""
    structure, at = IN_FLIGHT[name]
    inputs = {n: at.get(n, 0.0) for n in structure.inputs}
    starts = {n: v for n, v in at.items() if n not in inputs}
    machine = build(structure.diagram, DT).machine()
    machine.set_many(starts)
    machine.reset()
    point: dict[str, Any] = {f"plant.{n[:-2]}": v for n, v in starts.items() if n.endswith("_0")}
    point |= {f"plant.{n}": 0.0 for n in structure.outputs if f"plant.{n}" not in point}
    machine.run(70, inputs)
    rings = [n for n in structure.diagram.parts if n in ("delay", "rotors")]
    kept = {f"{r}.past": np.array(machine.state(f"{r}.past")) for r in rings}
    now = {r: int(machine.state(f"{r}.position")) for r in rings}
    model = linearize(structure.diagram, DT, at={**at, **point, **{n: list(v) for n, v in kept.items()}})
    assert not any(np.ptp(v) for v in kept.values())
    assert sum("past" in n for n in model.states) >= 2

    def place(name: str, ahead: int) -> tuple[str, int]:
        """The ring and the place of a sample's name, \"delay.past[k-2]\"."""
        path, _, age = name.partition("[k-")
        ring = path.partition(".")[0]
        return path, (now[ring] + ahead - int(age[:-1])) % len(kept[path])

    def after(name: str, shift: float) -> tuple[Array, Array]:
        for r, position in now.items():
            machine.set_state(f"{r}.position", position)
            machine.set_state(f"{r}.past", kept[f"{r}.past"])
        for path, value in point.items():
            machine.set_state(path, value + (shift if path == name else 0.0))
        if "[k-" in name:
            path, at_place = place(name, 0)
            machine.set_state(path, kept[path] + shift * np.eye(len(kept[path]))[at_place])
        y = machine.step({n: v + (shift if n == name else 0.0) for n, v in inputs.items()})
        new = [machine.state(p)[i] for p, i in (place(n, 1) for n in model.states if "[k-" in n)]
        found = iter(new)
        x = np.array([next(found) if "[k-" in n else machine.state(n) for n in model.states])
        return x, np.array([y[n] for n in model.outputs])

    h = 1e-5
    for to_x, to_y, names in ((model.a, model.c, model.states), (model.b, model.d, model.inputs)):
        for j, column in enumerate(names):
            up, down = after(column, h), after(column, -h)
            np.testing.assert_allclose(to_x[:, j], (up[0] - down[0]) / (2 * h), atol=2e-8)
            np.testing.assert_allclose(to_y[:, j], (up[1] - down[1]) / (2 * h), atol=2e-8)
