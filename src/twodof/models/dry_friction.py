"""The pitch axis and the cart beyond the linear models: gravity, a hardening spring, dry friction with true sticking.

A step integrates everything but the dry (Coulomb) friction, which then acts as an impulse. The impulse takes into
account when within the step the motion stops. So sticking is exact, and the response varies smoothly with the
parameters, whose derivatives an estimation needs, even where a stop moves from one step to the next.
"""

import math
from typing import Any

from twodof.blocks.block import Block, Clock, library_block
from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.elementary.functions import sin, tanh
from twodof.blocks.expressions.expr import maximum, minimum, where


def sticks(speed: Any, drive: Any, more: Any, less: Any) -> Any:
    """Return True if friction holds a body at rest; `drive` is its acceleration by all other forces.

    Friction opposes a positive speed with `more`, a negative one with `less` (both >= 0, as accelerations).
    """
    return (speed == 0.0) & (drive <= more) & (-drive <= less)


def after_friction(speed: Any, drive: Any, more: Any, less: Any, dt: Any) -> Any:
    """Return the speed after a step of `dt` with friction, from the `speed` after the step without friction."""
    before = speed - drive * dt
    # A motion that stops after a part of the step goes on the other way, if the drive exceeds the friction there.
    slowed, lifted = speed - more * dt, speed + less * dt
    left_up = dt - before / (more - drive)
    left_down = dt + before / (less + drive)
    from_up = where(slowed < 0.0, minimum(0.0, (drive + less) * left_up), slowed)
    from_down = where(lifted > 0.0, maximum(0.0, (drive - more) * left_down), lifted)
    moved = where(sticks(speed, drive, more, less), speed, where(before > 0.0, from_up, from_down))
    # Without friction nothing is computed from a quotient that at rest is 0 / 0.
    return where((more == 0.0) & (less == 0.0), speed, moved)


_ERF = math.sqrt(2.0 / math.pi)


@library_block("models.PitchPendulum")
class PitchPendulum(Block):
    """q' = mu M - 2 xi w_n q - w_n^2 sin(theta) - hardening theta^3 - friction, theta' = q.

    Where a linear spring makes the share `springy` of w_n^2, theta takes the place of that share of sin(theta).
    Friction is Coulomb's. It opposes q with `coulomb` (1 + `asymmetry`) for q > 0 and `coulomb` (1 - `asymmetry`) for
    q < 0 [rad/s2]. It holds a drone at rest while the other terms of the right-hand side are smaller.
    """

    inputs = (Port("M"),)
    outputs = (Port("theta", unit="rad"), Port("q", unit="rad/s"))
    states = (State("theta", "theta_0", unit="rad", continuous=True), State("q", "q_0", unit="rad/s", continuous=True))
    params = (
        Param("w_n", 3.437, unit="rad/s", low=0.0, text="natural frequency of small swings"),
        Param("xi", 0.0836, text="viscous damping ratio"),
        Param("mu", 358.5, unit="rad/s2", text="gain from normalised moment to angular acceleration"),
        Param("coulomb", 0.0, unit="rad/s2", low=0.0, text="dry friction"),
        Param("asymmetry", 0.0, low=-1.0, high=1.0, text="share by which friction differs with direction"),
        Param("hardening", 0.0, unit="rad/s2", text="cubic part of the spring"),
        Param("springy", 0.0, text="share of a linear spring in the stiffness; the rest is gravity's"),
        Param("theta_0", 0.0, unit="rad", text="pitch at the start"),
        Param("q_0", 0.0, unit="rad/s", text="pitch rate at the start"),
    )

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        return {"theta": x.theta, "q": x.q}

    def derivative(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """Return the derivatives of theta and q without dry friction; 0 while the pitch sticks."""
        drive, more, less = self._drive(u, x, p)
        return {"theta": x.q, "q": where(sticks(x.q, drive, more, less), 0.0, drive)}

    def project(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """Apply the dry friction's impulse; the angle moves as if it had acted evenly over the step."""
        after = after_friction(x.q, *self._drive(u, x, p), t.dt)
        return {"theta": x.theta - 0.5 * t.dt * (x.q - after), "q": after}

    def _drive(self, u: Any, x: Any, p: Any) -> tuple[Any, Any, Any]:
        """Return the right-hand side without dry friction, and the friction for q > 0 and for q < 0."""
        restoring = sin(x.theta)
        restoring = restoring + p.springy * (x.theta - restoring)
        spring = p.w_n * p.w_n * restoring + p.hardening * (x.theta * x.theta * x.theta)
        drive = p.mu * u.M - 2.0 * p.xi * p.w_n * x.q - spring
        return drive, p.coulomb * (1.0 + p.asymmetry), p.coulomb * (1.0 - p.asymmetry)


@library_block("models.Lift")
class Lift(Block):
    """Thrust of both rotor pairs, commanded T +- M, over that of level flight at `hover`.

    A pair gives (1 - curve) u + curve u^2 for a command u within 0 to 1. A hard pitch manoeuvre lifts more: the square
    of M adds to the thrust of both pairs, and a pair at rest cannot give a negative thrust.
    """

    inputs = (Port("M"), Port("T"))
    outputs = (Port("lift"),)
    params = (
        Param("curve", 0.3, low=0.0, high=1.0, text="quadratic share of the thrust curve"),
        Param("hover", 0.4, low=0.01, high=1.0, text="thrust command at which k_v is stated"),
        Param("supply", 1.0, low=0.1, high=10.0, text="thrust over that at which k_v is stated, by the battery"),
    )
    derived = (Port("per_hover"),)

    def prepare(self, p: Any, t: Clock) -> dict[str, Any]:
        return {"per_hover": 0.5 * p.supply / self._pair(p.hover, p)}

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        fore, aft = (maximum(0.0, minimum(1.0, command)) for command in (u.T + u.M, u.T - u.M))
        return (self._pair(fore, p) + self._pair(aft, p)) * p.per_hover

    @staticmethod
    def _pair(command: Any, p: Any) -> Any:
        return command * ((1.0 - p.curve) + p.curve * command)


@library_block("models.Rail")
class Rail(Block):
    """theta' = q, x' = v, v' = -k_v lift sin(theta) - p_v v - dry friction: paper equation (9) without small angles.

    `lift` is the thrust over that at which k_v is stated (a constant 1 where it does not vary).

    The drone's centre lies below the bearing, so the thrust accelerates the common centre of mass, whose speed is v.
    The cart is `lever` sin(theta) behind it (physics, equation 2). Without the lever, k_v is found 1.6 % too small from
    a doublet of the rig `lab`, whose lever is 4 mm.

    The measured q is integrated to theta here. The on-board estimate of theta errs while the cart accelerates, as it
    takes the direction of the measured acceleration for that of gravity.
    """

    inputs = (Port("q", unit="rad/s"), Port("lift"))
    outputs = (Port("theta", unit="rad"), Port("x", unit="m"), Port("v", unit="m/s"))
    states = (
        State("theta", "theta_0", unit="rad", continuous=True),
        State("x", "x_0", unit="m", continuous=True),
        State("v", "v_0", unit="m/s", continuous=True),
    )
    params = (
        Param("k_v", 4.748, unit="m/s2", text="gain from pitch to deceleration"),
        Param("p_v", 1.168, unit="1/s", text="pole of the linear friction"),
        Param("coulomb", 0.0, unit="m/s2", low=0.0, text="dry friction of the rail"),
        Param("lever", 0.0, unit="m", text="way of the cart that a radian of pitch takes back"),
        Param("theta_0", 0.0, unit="rad", text="pitch at the start, from where the cart would not accelerate"),
        Param("x_0", 0.0, unit="m", text="position at the start"),
        Param("v_0", 0.0, unit="m/s", text="velocity at the start"),
    )

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        return {"theta": x.theta, "x": x.x - p.lever * (sin(x.theta) - sin(p.theta_0)), "v": x.v}

    def derivative(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """Return the derivatives of theta, x and v without dry friction; that of v is 0 while the cart sticks."""
        drive = -p.k_v * u.lift * sin(x.theta) - p.p_v * x.v
        return {"theta": u.q, "x": x.v, "v": where(sticks(x.v, drive, p.coulomb, p.coulomb), 0.0, drive)}

    def project(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """Apply the dry friction's impulse; the position moves as if it had acted evenly over the step."""
        drive = -p.k_v * u.lift * sin(x.theta) - p.p_v * x.v
        after = after_friction(x.v, drive, p.coulomb, p.coulomb, t.dt)
        return {"x": x.x - 0.5 * t.dt * (x.v - after), "v": after}


@library_block("models.CartPush")
class CartPush(Block):
    """Pitch acceleration `push` caused by the cart's motion and by the bearing's dry friction, from the measured pitch.

    The drone's centre lies below the bearing: q' + coupling v' = the rest (physics, equation 1). The air that a moving
    drone meets pitches it by M_u v. The cart follows v' =
    -k_v sin(theta) - p_v v - lever q' - dry friction. Rings stop it `play` either way of where it starts, and a stop
    takes the whole speed. `coulomb` opposes q. The input is the measured pitch, since a simulated one lacks the effect
    of gusts. A measurement acts on later steps only, so the model holds in closed loop too. The rotors' wake pitches a
    level drone by `wake`, and leaves a pitched one slowly (physics, equation 14a).
    """

    inputs = (Port("theta", unit="rad"), Port("q", unit="rad/s"))
    outputs = (Port("push", unit="rad/s2"),)
    states = (
        State("x", unit="m"),
        State("v", unit="m/s"),
        State("q", unit="rad/s"),
        State("gone"),
        State("begun", False, "bool"),
    )
    params = (
        Param("coupling", 0.0, unit="rad/m", text="pitch rate that a unit of the cart's speed takes away"),
        Param("lever", 0.0, unit="m", text="speed of the cart that a unit of the pitch rate takes away"),
        Param("play", 0.0005, unit="m", low=0.0, text="way of the cart to its stops, either way"),
        Param("k_v", 4.748, unit="m/s2", text="gain from pitch to deceleration"),
        Param("p_v", 1.168, unit="1/s", text="pole of the linear friction"),
        Param("rail_coulomb", 0.0, unit="m/s2", low=0.0, text="dry friction of the rail"),
        Param("coulomb", 0.0, unit="rad/s2", text="dry friction of the bearing"),
        Param("q_noise", 0.0, unit="rad/s", low=0.0, text="standard deviation of the measured q about the true one"),
        Param("wake", 0.0, unit="rad/s2", text="pitch acceleration of a level drone by its rotors' wake"),
        Param("wake_fade", 0.0, unit="1/rad", low=0.0, text="how soon the wake fades with the pitch"),
        Param("wake_lag", 1.0, unit="s", low=0.01, text="time in which it fades and comes back"),
        Param("M_u", 0.0, unit="rad/(m s)", text="pitch acceleration by a unit of the cart's speed"),
    )

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        _, speed = self._next(u, x, p, t)
        # The true q near 0 may have the other sign. The expected sign is erf(z / sqrt(2)), here to 1e-3.
        z = u.q / maximum(p.q_noise, 1e-9)
        bearing = p.coulomb * tanh(_ERF * (z + 0.044715 * (z * z * z)))
        return -(p.coupling * ((speed - x.v) / t.dt)) + p.M_u * (0.5 * (x.v + speed)) - bearing - p.wake * x.gone

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        place, speed = self._next(u, x, p, t)
        slant = (p.wake_fade * u.theta) * (p.wake_fade * u.theta)
        gone = x.gone + t.dt / p.wake_lag * (slant / (1.0 + slant) - x.gone)
        return {"x": place, "v": speed, "q": u.q, "gone": gone, "begun": True}

    def _next(self, u: Any, x: Any, p: Any, t: Clock) -> tuple[Any, Any]:
        """Place and speed after this step; the change of q is that since the step before."""
        turned = where(x.begun, u.q - x.q, 0.0)
        drive = -p.k_v * sin(u.theta) - p.p_v * x.v - p.lever * (turned / t.dt)
        held = sticks(x.v, drive, p.rail_coulomb, p.rail_coulomb)
        moved = after_friction(x.v + drive * t.dt, drive, p.rail_coulomb, p.rail_coulomb, t.dt)
        speed = where(held, 0.0, moved)
        place = x.x + (0.5 * t.dt) * (x.v + speed)
        stopped = (place >= p.play) | (place <= -p.play)
        return maximum(-p.play, minimum(p.play, place)), where(stopped, 0.0, speed)
