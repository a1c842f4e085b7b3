"""The rig's equations written a second time, for other people's integrators: scipy's and MuJoCo's."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from twodof.blocks import Diagram
from twodof.blocks.library.delays import ZeroOrderHold
from twodof.rig.dynamics import Dynamics

SMOOTH: Mapping[str, float] = {
    "mass_drone": 0.374,
    "mass_cart": 0.16,
    "inertia": 2.6e-3,
    "offset": 0.03,
    "spring": 0.004,
    "softening": 0.0,
    "hardening": 0.0,
    "viscous_idle": 4e-4,
    "viscous_run": 4e-4,
    "coulomb_idle": 0.0,
    "coulomb_run": 0.0,
    "rail_viscous": 0.3,
    "rail_coulomb": 0.0,
    "rail_force": 0.05,
    "rail_stop": 10.0,
    "pitch_stop": 1.5,
}
"""A rig without friction that breaks: no Coulomb friction, no stop in reach; the offset is large, so it couples."""


def dynamics() -> Diagram:
    """The Dynamics block alone, under held inputs."""
    d = Diagram("dynamics", "pitch and cart")
    d.add("dynamics", Dynamics())
    for name, unit in (("thrust", "N"), ("moment", "N*m"), ("gust", "N*m"), ("running", "")):
        d.input(name, unit=unit)
        d.add(f"{name}_held", ZeroOrderHold(unit=unit), u=name)
        d.connect(f"{name}_held", f"dynamics.{name}")
    for name in ("theta", "q", "x", "v"):
        d.output(name, f"dynamics.{name}")
    return d


def settings(values: Mapping[str, object]) -> dict[str, object]:
    """Parameter paths in `dynamics()`."""
    return {f"dynamics.{name}": value for name, value in values.items()}


def slopes(
    state: NDArray[np.float64], p: Mapping[str, float], thrust: float, moment: float, running: float
) -> NDArray[np.float64]:
    """Return the time derivative of the state by Lagrange's equations; without sticking friction."""
    theta, q, _, v = state
    m = p["mass_drone"] + p["mass_cart"]
    lever = p["mass_drone"] * p["offset"]
    mass = np.array([[p["inertia"], lever * np.cos(theta)], [lever * np.cos(theta), m]])
    force = np.array(
        [
            moment
            - lever * 9.81 * np.sin(theta)
            - (p["spring"] - running * p["softening"]) * theta
            - (1.0 - running) * p["hardening"] * theta**3
            - p["viscous_run"] * q,
            lever * np.sin(theta) * q**2 - thrust * np.sin(theta) + p["rail_force"] - p["rail_viscous"] * v,
        ]
    )
    q_rate, v_rate = np.linalg.solve(mass, force)
    return np.array([q, q_rate, v, v_rate])


def energy(state: NDArray[np.float64], p: Mapping[str, float]) -> NDArray[np.float64]:
    """Kinetic and potential energy [J] of states (n, 4), rotors at rest or without hardening; rail force left out."""
    theta, q, _, v = state.T
    m = p["mass_drone"] + p["mass_cart"]
    lever = p["mass_drone"] * p["offset"]
    kinetic = 0.5 * m * v**2 + 0.5 * p["inertia"] * q**2 + lever * np.cos(theta) * q * v
    potential = lever * 9.81 * (1.0 - np.cos(theta)) + 0.5 * p["spring"] * theta**2 + 0.25 * p["hardening"] * theta**4
    return kinetic + potential


def momentum(state: NDArray[np.float64], p: Mapping[str, float]) -> NDArray[np.float64]:
    """Momentum along the rail [N s] of states (n, 4)."""
    theta, q, _, v = state.T
    return (p["mass_drone"] + p["mass_cart"]) * v + p["mass_drone"] * p["offset"] * np.cos(theta) * q


MUJOCO = """
<mujoco>
  <option timestep="0.001" integrator="RK4" gravity="0 0 -9.81"/>
  <worldbody>
    <body name="cart">
      <joint name="rail" type="slide" axis="1 0 0" damping="{rail_viscous}"/>
      <inertial pos="0 0 0" mass="{mass_cart}" diaginertia="1 1 1"/>
      <body name="drone">
        <joint name="pitch" type="hinge" axis="0 -1 0" damping="{viscous_run}" stiffness="{spring}"/>
        <inertial pos="0 0 -{offset}" mass="{mass_drone}" diaginertia="1 {own_inertia} 1"/>
        <site name="rotors"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor site="rotors" gear="0 0 1 0 0 0"/>
  </actuator>
</mujoco>
"""
"""The rig for MuJoCo: x forward, z up, so the pitch axis points right and thrust along the body's z."""


def mujoco_model(p: Mapping[str, float]) -> str:
    """`MUJOCO` with the numbers of `p`; its inertia is about the centre of mass, ours about the bearing."""
    return MUJOCO.format(**p, own_inertia=p["inertia"] - p["mass_drone"] * p["offset"] ** 2)
