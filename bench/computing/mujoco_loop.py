"""The rig as MuJoCo sees it: a cart that slides, a drone that pitches on it; and the cascade around it in Python."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import mujoco

from twodof.flight.gains import DEFAULT, Gains
from twodof.rig.rotors import lift
from twodof.signals import HOVER

TICK = 0.001
TICKS = 4
SAMPLE = TICK * TICKS
T_BAR, ETA_T, N = 0.4, 6.3386, 100.0

# x forward, z up, so nose-up is a rotation about -y. The rotors' thrust curve is its tangent in hover.
MODEL = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="{tick}" integrator="RK4" gravity="0 0 -9.81"/>
  <worldbody>
    <body name="cart">
      <joint name="x" type="slide" axis="1 0 0" limited="true" range="{low} {high}"
             damping="{rail_viscous}" frictionloss="{rail_coulomb}"/>
      <inertial pos="0 0 0" mass="{mass_cart}" diaginertia="1e-4 1e-4 1e-4"/>
      <body name="drone">
        <joint name="theta" type="hinge" axis="0 -1 0" limited="true" range="{nose_down} {nose_up}"
               damping="{viscous_run}" frictionloss="{coulomb_run}" stiffness="{spring}"/>
        <inertial pos="0 0 {below}" mass="{mass_drone}" diaginertia="{inertia} {inertia} {inertia}"/>
        <site name="fore" pos="{arm} 0 0"/>
        <site name="aft" pos="{back} 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <general name="fore" site="fore" gear="0 0 1 0 0 0" ctrllimited="true" ctrlrange="0 1" dyntype="filter"
             dynprm="{lag}" gainprm="{gain}" biastype="affine" biasprm="{bias}"/>
    <general name="aft" site="aft" gear="0 0 1 0 0 0" ctrllimited="true" ctrlrange="0 1" dyntype="filter"
             dynprm="{lag}" gainprm="{gain}" biastype="affine" biasprm="{bias}"/>
  </actuator>
</mujoco>
"""


@dataclass
class Cascade:
    """The flight code's laws, in floats: position P, velocity PI, attitude P and rate PID with filtered derivative."""

    gains: Gains = DEFAULT
    velocity_sum: float = 0.0
    rate_sum: float = 0.0
    slope: float = 0.0
    error: float = 0.0

    def step(self, x0: float, theta: float, q: float, x: float, v: float) -> tuple[float, float]:
        """(fore, aft) commands from the set-point x0 [m] and the state [rad, rad/s, m, m/s]."""
        kp, ki, kd = self.gains.rate
        velocity_kp, velocity_ki = self.gains.velocity
        e = self.gains.position * (x0 - x) - v
        self.velocity_sum += velocity_ki * SAMPLE * e
        theta0 = -math.atan((velocity_kp * e + self.velocity_sum) / (T_BAR * ETA_T))
        thrust = T_BAR / math.cos(theta0)
        e = self.gains.attitude * (theta0 - theta) - q
        self.rate_sum += ki * SAMPLE * e
        lag = 1.0 / N
        self.slope = (lag * self.slope + (e - self.error)) / (lag + SAMPLE)
        self.error = e
        moment = kp * e + self.rate_sum + kd * self.slope
        return min(1.0, max(0.0, thrust + moment)), min(1.0, max(0.0, thrust - moment))


class MujocoLoop:
    """The rig with the parameters of a `twodof.rig` set, hovering at mid rail."""

    def __init__(self, rig: Mapping[str, float]) -> None:
        curve, pair = rig["curve"], rig["pair_thrust"]
        gain = pair * (1.0 - curve + 2.0 * curve * HOVER)
        offset = rig["offset"]
        text = MODEL.format(
            tick=TICK,
            low=-rig["rail_stop"],
            high=rig["rail_stop"],
            rail_viscous=rig["rail_viscous"],
            rail_coulomb=rig["rail_coulomb"],
            mass_cart=rig["mass_cart"],
            nose_down=-rig["pitch_stop"],
            nose_up=rig["pitch_stop"],
            viscous_run=rig["viscous_run"],
            coulomb_run=rig["coulomb_run"],
            spring=rig["spring"] - rig["softening"],
            below=-offset,
            mass_drone=rig["mass_drone"],
            inertia=rig["inertia"] - rig["mass_drone"] * offset**2,
            arm=rig["arm"],
            back=-rig["arm"],
            lag=max(rig["lag"], 1e-4),
            gain=gain,
            bias=pair * lift(HOVER, curve) - gain * HOVER,
        )
        self.model = mujoco.MjModel.from_xml_string(text)
        self.data = mujoco.MjData(self.model)
        self.data.ctrl[:] = HOVER
        self.data.act[:] = HOVER
        self.cascade = Cascade()

    def physics(self, ticks: int) -> None:
        """`ticks` ticks with the commands held."""
        for _ in range(ticks // TICKS):
            mujoco.mj_step(self.model, self.data, nstep=TICKS)

    def fly(self, ticks: int, x0: float) -> None:
        """`ticks` ticks, the cascade at every fourth drawing the cart to x0 [m]."""
        data, cascade = self.data, self.cascade
        for _ in range(ticks // TICKS):
            x, theta = data.qpos
            v, q = data.qvel
            data.ctrl[:] = cascade.step(x0, theta, q, x, v)
            mujoco.mj_step(self.model, data, nstep=TICKS)
