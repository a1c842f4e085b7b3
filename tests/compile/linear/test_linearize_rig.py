"""The whole rig's linear model: against its equations by hand and scipy's exponential, and against compiled flights."""

from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from twodof.compile.linear import integer_states
from twodof.compile.linear.linearize import linearize
from twodof.errors import DiagramError
from twodof.rig.rig import BASE_DT, TRUTH, rig
from twodof.signals import GRAVITY

pytestmark = pytest.mark.slow

Array = np.ndarray[Any, Any]

THRUST = 0.4
HOVER: dict[str, Any] = {
    "fore": THRUST,
    "aft": THRUST,
    "rotors.fore": THRUST,
    "rotors.aft": THRUST,
    "rotors.fore_ring": [THRUST] * 64,
    "rotors.aft_ring": [THRUST] * 64,
}
"""Level and at rest in mid-rail, the rotors at hover and their commands on the way."""

AIR = ("battery.supply", "turbulence.moment")  # what the slower parts do to the rotors and the drone


def test_the_rig_at_hover_is_its_equations_behind_the_rotors_delay() -> None:
    """Delay, lag, thrust curve, coupled masses: docs/explanation/physics.md for small angles, held over each tick."""
    model = linearize(rig(), BASE_DT, at=HOVER, inputs=["fore", "aft", *AIR], outputs=TRUTH)
    assert model.dt == BASE_DT
    assert [n for n in model.states if "ring" not in n] == [
        *(f"dynamics.{n}" for n in TRUTH),
        "rotors.fore",
        "rotors.aft",
    ]
    p = {name: float(param.value) for name, param in rig().params.items()}
    supply = model.point["battery.supply"]
    lift, slope = (1 - p["curve"]) * THRUST + p["curve"] * THRUST**2, 1 - p["curve"] + 2 * p["curve"] * THRUST
    s, m = p["mass_drone"] * p["offset"], p["mass_drone"] + p["mass_cart"]
    mass = np.linalg.inv([[p["inertia"], s], [s, m]])  # to (q', v')
    turn = p["arm"] * p["pair_thrust"] * supply * slope
    moved = mass @ [
        [-s * GRAVITY - p["spring"], -p["viscous_run"], 0, 0, turn, -turn],
        [-2 * p["pair_thrust"] * supply * lift, 0, 0, -p["rail_viscous"], 0, 0],
    ]
    a = np.zeros((6, 6))
    a[0, 1] = a[2, 3] = 1.0
    a[1], a[3] = moved
    a[4, 4] = a[5, 5] = -1 / p["lag"]
    b = np.zeros((6, 3))
    b[4, 0] = b[5, 1] = 1 / p["lag"]
    b[[1, 3], 2] = mass @ [1.0, 0.0]  # a gust's moment
    ah = np.block([[a, b], [np.zeros((3, 9))]]) * BASE_DT
    held = expm(ah)
    rk4 = np.eye(9) + ah + ah @ ah / 2 + ah @ ah @ ah / 6 + ah @ ah @ ah @ ah / 24  # the exponential's series to dt^4
    for omega in np.geomspace(0.5, 1500.0, 20):
        z = np.exp(1j * omega * BASE_DT)
        found = model.response(omega)[0][:, [0, 1, 3]]
        # From a command to the angle dt^3 / lag leads and the series ends before dt^5 / lag^3: it tells at high speed.
        for step, accuracy in ((rk4, 1e-9), (held, 1e-5))[: 2 if omega < 100.0 else 1]:
            plant = np.linalg.solve(z * np.eye(6) - step[:6, :6], step[:6, 6:])[:4]
            plant[:, :2] *= z ** -(p["delay"] / BASE_DT)
            np.testing.assert_allclose(found, plant, rtol=accuracy, atol=1e-13)
    assert set(model.remarks) == {"battery.supply"}  # level and in trim, more thrust moves nothing


def test_the_range_sensors_own_clock_is_refused_with_the_outputs_that_do_without(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(integer_states, "MAX_STEPS", 1000)  # of 20,000, each of which takes its time
    with pytest.raises(DiagramError, match="phase do not settle or repeat") as found:
        linearize(rig(), BASE_DT, at=HOVER)
    assert found.value.where == "range"
    assert "ask for the outputs acc_x, acc_z, gyro_y, theta, q, x, v, load, voltage, charge only" in found.value.remedy


def test_on_a_stop_and_held_by_friction_it_is_refused() -> None:
    cut = ["fore", "aft", *AIR]
    for at in ({"dynamics.x": 0.4}, {"coulomb_run": 0.001}):
        with pytest.raises(DiagramError, match="on a kink") as found:
            linearize(rig(), BASE_DT, at=HOVER | at, inputs=cut, outputs=TRUTH)
        assert found.value.where == "dynamics"
