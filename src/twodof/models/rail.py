"""The cart on its rail as the gyro and the range sensor see it, without any estimate in between."""

from __future__ import annotations

from typing import Any

from twodof.blocks.block import Block, Clock, library_block
from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.elementary.functions import sin
from twodof.blocks.expressions.expr import maximum, minimum, where
from twodof.models.friction import after_friction, sticks


@library_block("models.Lift")
class Lift(Block):
    """Thrust of both rotor pairs, commanded T +- M, over that of level flight at `hover`.

    A pair gives (1 - curve) u + curve u^2 for a command u within 0 to 1. A hard pitch manoeuvre lifts more: the square
    of M adds to both pairs, and a pair at rest cannot give less than nothing.
    """

    inputs = (Port("M"), Port("T"))
    outputs = (Port("lift"),)
    params = (
        Param("curve", 0.3, low=0.0, high=1.0, text="quadratic share of the thrust curve"),
        Param("hover", 0.4, low=0.01, high=1.0, text="thrust command at which k_v is stated"),
    )
    derived = (Port("per_hover"),)

    def prepare(self, p: Any, t: Clock) -> dict[str, Any]:
        """One over the thrust at hover."""
        return {"per_hover": 0.5 / self._pair(p.hover, p)}

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """The two pairs."""
        fore, aft = (maximum(0.0, minimum(1.0, command)) for command in (u.T + u.M, u.T - u.M))
        return (self._pair(fore, p) + self._pair(aft, p)) * p.per_hover

    @staticmethod
    def _pair(command: Any, p: Any) -> Any:
        return command * ((1.0 - p.curve) + p.curve * command)


@library_block("models.Rail")
class Rail(Block):
    """theta' = q, x' = v, v' = -k_v lift sin(theta) - p_v v - dry friction: paper equation (9) without small angles.

    `lift` is the thrust over that at which k_v is stated (a constant 1 where it does not vary).

    The measured q is integrated to theta here, since an on-board estimate of theta errs while the cart accelerates:
    it takes the accelerometer for the direction of gravity.
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
        Param("theta_0", 0.0, unit="rad", text="pitch at the start, from where the cart would not accelerate"),
        Param("x_0", 0.0, unit="m", text="position at the start"),
        Param("v_0", 0.0, unit="m/s", text="velocity at the start"),
    )

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """The states."""
        return {"theta": x.theta, "x": x.x, "v": x.v}

    def derivative(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """All but the dry friction while it moves; nothing while it sticks."""
        drive = -p.k_v * u.lift * sin(x.theta) - p.p_v * x.v
        return {"theta": u.q, "x": x.v, "v": where(sticks(x.v, drive, p.coulomb, p.coulomb), 0.0, drive)}

    def project(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """The dry friction's impulse over the step; the position as if it had acted evenly over it."""
        drive = -p.k_v * u.lift * sin(x.theta) - p.p_v * x.v
        after = after_friction(x.v, drive, p.coulomb, p.coulomb, t.dt)
        return {"x": x.x - 0.5 * t.dt * (x.v - after), "v": after}
