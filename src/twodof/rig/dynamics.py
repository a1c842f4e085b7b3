"""Dynamics: pitch about the bearing and the cart on its rail, coupled by the thrust and the drone's offset centre.

Sliding friction acts as an impulse at the end of the step, clamped so that it stops the motion and never reverses it.
The position moves as if the friction had acted evenly over the step. A body at rest is held in `derivative`: its
acceleration is exactly 0 while the load stays within the friction or presses against a stop. So it stays at rest to
the bit. End stops with their restitution, and the rings that lock the cart (1DoF), act at the end of the step too.
"""

import math
from typing import Any

from twodof.blocks import Block, Param, Port, State, maximum, minimum, sqrt, where
from twodof.blocks.block import Clock
from twodof.blocks.elementary.functions import cos_octant, exp, sin_octant
from twodof.blocks.noise import normal
from twodof.models import dry_friction
from twodof.signals import GRAVITY

GUST_STREAM = 2
"""Stream of the noise generator that makes the gusts."""


class Turbulence(Block):
    """Moment of a first-order (Gauss-Markov) gust, in proportion to the thrust.

    `gust` [N m] is its standard deviation in hover, `gust_time` its correlation time. On the drone it makes q wander
    by .06 rad/s in a level hold.
    """

    crossing = True
    inputs = (Port("load"),)
    outputs = (Port("moment", unit="N*m"),)
    params = (
        Param("gust", 0.0, unit="N*m", low=0.0, high=1.0, text="standard deviation in hover"),
        Param("gust_time", 0.1, unit="s", low=1e-3, high=100.0, text="correlation time"),
        Param("noise", 1.0, low=0.0, high=100.0, text="gain of all noise, 0 for none"),
        Param("seed", 1, "uint32", text="of all noise of the rig"),
    )
    derived = (Port("keep"), Port("fresh"))
    states = (State("gust"),)

    def prepare(self, p: Any, t: Clock) -> Any:
        keep = exp(-t.dt / p.gust_time)
        return {"keep": keep, "fresh": sqrt(1.0 - keep * keep)}

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return (p.noise * p.gust) * u.load * x.gust

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return p.keep * x.gust + p.fresh * normal(p.seed, GUST_STREAM, t.tick)


COORDINATES = (("theta", "rad"), ("q", "rad/s"), ("x", "m"), ("v", "m/s"))

SLOW_PITCH = 0.02
"""Pitch rate [rad/s] below which a rebound from an end stop is not made: the drone rests at the stop."""

SLOW_CART = 0.005
"""Speed [m/s] below which a rebound of the cart is not made: it rests at the stop."""


def sine_cosine(angle: Any) -> tuple[Any, Any]:
    """Return (sin, cos) of an angle [rad], |angle| <= pi/2, from those of its half, which need no range reduction."""
    s, c = sin_octant(0.5 * angle), cos_octant(0.5 * angle)
    return 2.0 * s * c, 1.0 - 2.0 * s * s


def most_at_rest(friction: Any, place: Any, low: Any, high: Any) -> tuple[Any, Any]:
    """Return the most negative and most positive loads under which a body at `place` stays at rest.

    Between the stops these are `friction` either way; a stop bears any load that presses against it.
    """
    # A stop bears any load that presses against it, friction at most its own either way.
    return -where(place <= low, math.inf, friction), where(place >= high, math.inf, friction)


def stays_at_rest(speed: Any, load: Any, most: tuple[Any, Any]) -> Any:
    """Return True if a body with `speed` is at rest and stays so under `load`; `most` is from `most_at_rest`."""
    # Together, so that a body in motion (most of the time) asks nothing of its load.
    return (speed == 0.0) & ((load <= most[1]) & (most[0] <= load))


def after_friction(place: Any, speed: Any, loss: Any, dt: Any) -> tuple[Any, Any]:
    """Return (place, speed) after friction that takes at most `loss` of the speed within the step of `dt` s."""
    lost = maximum(-loss, minimum(loss, speed))
    return place - (0.5 * dt) * lost, speed - lost


def after_reversal(place: Any, speed: Any, drive: Any, friction: Any, dt: Any) -> tuple[Any, Any]:
    """Return (place, speed) after `friction`, as `dry_friction.after_friction`, which knows when the motion stopped.

    What rests was held within the step.
    """
    after = where(speed == 0.0, 0.0, dry_friction.after_friction(speed, drive, friction, friction, dt))
    return place - (0.5 * dt) * (speed - after), after


def after_stops(place: Any, speed: Any, low: Any, high: Any, restitution: Any, rest: Any) -> tuple[Any, Any]:
    """Return (place, speed) after the stops at `low` and `high`.

    A body beyond a stop returns with `restitution` of its speed; if that is slower than `rest`, it rests at the stop.
    """
    stop = where(place > high, high, low)
    hit = ((place > high) & (speed > 0.0)) | ((place < low) & (speed < 0.0))
    back = -restitution * speed
    ends = abs(back) < rest
    after_place = where(ends, stop, stop - restitution * (place - stop))
    return where(hit, after_place, place), where(hit, where(ends, 0.0, back), speed)


class Dynamics(Block):
    """theta, q, x, v of the drone on its cart; docs/explanation/physics.md, equations (1) to (4).

        J q' + m_d d cos(theta) v' = moment + gust - m_d g d sin(theta) - k theta - c q - friction

        k = k_1 - k_r r + (1 - r) k_3 theta^2, r: `running`

        m v' + m_d d cos(theta) q' = m_d d sin(theta) q^2 - thrust sin(theta) + f - c_x v - friction

    `running` in [0, 1] leads from the friction and stiffness with the rotors at rest to those with them running:
    running rotors shake the bearing, and take away `softening` and the cubic spring. The rings of 1DoF are stops
    `ring_play` either way of `ring_place`, without a rebound. The sine and cosine of theta are states too: s' = c q,
    c' = -s q. They are computed from theta at the end of each step only, so no stage of the integration needs a
    trigonometric function. Friction acts on each coordinate by itself. A torque that stops the pitch also moves the
    cart, which changes the effective inertia by (m_d d)^2 / (J m); this .3 % is neglected.
    """

    inputs = (Port("thrust", unit="N"), Port("moment", unit="N*m"), Port("gust", unit="N*m"), Port("running"))
    outputs = tuple(Port(name, unit=unit) for name, unit in COORDINATES)
    params = (
        Param("mass_drone", 0.374, unit="kg", low=0.01, high=10.0),
        Param("mass_cart", 0.160, unit="kg", low=0.01, high=10.0),
        Param("inertia", 2.6e-3, unit="kg*m2", low=1e-5, high=1.0, text="of the drone about the bearing"),
        Param("offset", 5e-3, unit="m", low=-0.1, high=0.1, text="centre of mass below the bearing"),
        Param("spring", 0.0, unit="N*m/rad", low=0.0, high=10.0, text="linear spring"),
        Param("softening", 0.0, unit="N*m/rad", low=-10.0, high=10.0, text="stiffness that running rotors take"),
        Param("hardening", 0.0, unit="N*m/rad3", low=0.0, high=10.0, text="cubic spring (the cable), rotors at rest"),
        Param("viscous_idle", 0.0, unit="N*m*s", low=0.0, high=1.0, text="bearing, rotors at rest"),
        Param("viscous_run", 0.0, unit="N*m*s", low=0.0, high=1.0, text="bearing, rotors running"),
        Param("coulomb_idle", 0.0, unit="N*m", low=0.0, high=1.0, text="bearing, rotors at rest"),
        Param("coulomb_run", 0.0, unit="N*m", low=0.0, high=1.0, text="bearing, rotors running"),
        Param("pitch_stop", 0.87, unit="rad", low=0.01, high=1.5, text="end stops at +- this"),
        Param("pitch_bounce", 0.75, low=0.0, high=1.0, text="restitution of the end stops"),
        Param("rail_viscous", 0.3, unit="N*s/m", low=0.0, high=100.0),
        Param("rail_coulomb", 0.0, unit="N", low=0.0, high=10.0),
        Param("rail_force", 0.0, unit="N", low=-10.0, high=10.0, text="steady push along the rail"),
        Param("rail_stop", 0.4, unit="m", low=0.01, high=10.0, text="ends of the rail at +- this"),
        Param("rail_bounce", 0.3, low=0.0, high=1.0, text="restitution of the ends of the rail"),
        Param("rings", False, "bool", text="the rings lock the cart (1DoF)"),
        Param("ring_place", 0.0, unit="m", low=-10.0, high=10.0, text="where they lock it"),
        Param("ring_play", 5e-4, unit="m", low=0.0, high=0.1, text="play either way"),
        Param("theta_start", 0.0, unit="rad", low=-1.5, high=1.5),
        Param("q_start", 0.0, unit="rad/s", low=-100.0, high=100.0),
        Param("x_start", 0.0, unit="m", low=-10.0, high=10.0),
        Param("v_start", 0.0, unit="m/s", low=-10.0, high=10.0),
    )
    states = (
        *(State(name, f"{name}_start", unit=unit, continuous=True) for name, unit in COORDINATES),
        State("sine", "sine_start", continuous=True),
        State("cosine", "cosine_start", continuous=True),
    )
    derived = (
        Port("mass", unit="kg"),
        Port("offset_mass", unit="kg*m"),
        Port("per_inertia"),
        Port("per_mass"),
        Port("low", unit="m"),
        Port("high", unit="m"),
        Port("bounce"),
        Port("inertia_mass"),
        Port("weight", unit="N*m"),
        Port("sine_start"),
        Port("cosine_start"),
    )

    def prepare(self, p: Any, t: Clock) -> Any:
        mass = p.mass_drone + p.mass_cart
        sine, cosine = sine_cosine(p.theta_start)
        return {
            "mass": mass,
            "offset_mass": p.mass_drone * p.offset,
            "per_inertia": 1.0 / p.inertia,
            "per_mass": 1.0 / mass,
            "low": where(p.rings, p.ring_place - p.ring_play, -p.rail_stop),
            "high": where(p.rings, p.ring_place + p.ring_play, p.rail_stop),
            "bounce": where(p.rings, 0.0, p.rail_bounce),
            "inertia_mass": p.inertia * mass,
            "weight": p.mass_drone * p.offset * GRAVITY,
            "sine_start": sine,
            "cosine_start": cosine,
        }

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return {name: x[name] for name, _ in COORDINATES}

    def derivative(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        torque, coulomb = self._torque(u, x, p)
        force = (p.offset_mass * x.q * x.q - u.thrust) * x.sine + p.rail_force - p.rail_viscous * x.v
        coupling = p.offset_mass * x.cosine
        alone = torque * p.per_inertia
        # Asked twice, and only of a pitch at rest: so computed once, and only then.
        least, greatest = most_at_rest(coulomb, x.theta, -p.pitch_stop, p.pitch_stop)
        most = where(x.q == 0.0, least, 0.0), where(x.q == 0.0, greatest, 0.0)
        stuck = stays_at_rest(x.q, torque, most)
        load = force - where(stuck, 0.0, coupling * alone)
        locked = stays_at_rest(x.v, load, most_at_rest(p.rail_coulomb, x.x, p.low, p.high))
        cart = where(locked, 0.0, force * p.per_mass)  # with the pitch at rest
        still = stays_at_rest(x.q, torque - coupling * cart, most)
        per_det = 1.0 / (p.inertia_mass - coupling * coupling)
        q_rate = where(locked, alone, (p.mass * torque - coupling * force) * per_det)
        v_rate = where(locked, 0.0, (p.inertia * force - coupling * torque) * per_det)
        return {
            "theta": x.q,
            "q": where(still, 0.0, q_rate),
            "x": x.v,
            "v": where(still, cart, v_rate),
            "sine": x.cosine * x.q,
            "cosine": -x.sine * x.q,
        }

    def _torque(self, u: Any, x: Any, p: Any) -> tuple[Any, Any]:
        """Return the moment about the bearing without dry friction, and the dry friction [N m]."""
        viscous = p.viscous_idle + (p.viscous_run - p.viscous_idle) * u.running
        coulomb = p.coulomb_idle + (p.coulomb_run - p.coulomb_idle) * u.running
        cable = (1.0 - u.running) * (p.hardening * (x.theta * x.theta))
        spring = x.theta * (p.spring - p.softening * u.running + cable)
        return u.moment + u.gust - p.weight * x.sine - spring - viscous * x.q, coulomb

    def project(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        torque, coulomb = self._torque(u, x, p)
        place, slid = after_friction(x.x, x.v, p.rail_coulomb * p.per_mass * t.base_dt, t.base_dt)
        place, speed = after_stops(place, slid, p.low, p.high, p.bounce, SLOW_CART)
        theta, turned = after_reversal(x.theta, x.q, torque * p.per_inertia, coulomb * p.per_inertia, t.base_dt)
        theta, q = after_stops(theta, turned, -p.pitch_stop, p.pitch_stop, p.pitch_bounce, SLOW_PITCH)
        # An impulse on one coordinate leaves the momentum of the other as it is. Friction holds what rests against the
        # small impulses of friction, not against those of an impact.
        sine, cosine = sine_cosine(theta)
        coupling = p.offset_mass * cosine
        kick_q = (coupling * p.per_inertia) * (speed - where(q == 0.0, slid, x.v))
        kick_v = (coupling * p.per_mass) * (q - where(speed == 0.0, turned, x.q))
        return {"theta": theta, "q": q - kick_q, "x": place, "v": speed - kick_v, "sine": sine, "cosine": cosine}
