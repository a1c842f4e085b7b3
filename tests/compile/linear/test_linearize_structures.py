"""The ready-made structures' linear models: against textbook matrices, and against what the compiled program does."""

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from tests.compile.linear.linear_diagrams import DT
from twodof.compile.linear.linear_model import LinearModel
from twodof.compile.linear.linearize import linearize
from twodof.errors import DiagramError
from twodof.models import Structure, free_response, longitudinal, pitch_and_velocity, pitch_rate, rail, velocity
from twodof.signals import GRAVITY

pytestmark = pytest.mark.slow

Array = np.ndarray[Any, Any]

W, XI, MU, K, P = 3.437, 0.0836, 358.5, 4.748, 1.168
LAG = 0.011
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
    "free_response": (free_response(), hanging(), [[0, 1], [SOFT, -2 * XI * W]], [[0], [130.0]], np.eye(2), [[0], [0]]),
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
    with pytest.raises(DiagramError, match="a state at rest there stays at rest") as found:
        linearize(free_response().diagram, DT)
    assert found.value.where == "plant"
    assert "take out the friction" in found.value.remedy
