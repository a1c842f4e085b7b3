"""The pitch axis beyond the linear model: gravity, a hardening spring, dry friction with true sticking."""

from __future__ import annotations

from typing import Any

from twodof.blocks.block import Block, Clock, library_block
from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.elementary.functions import sin
from twodof.blocks.expressions.expr import where
from twodof.models.friction import after_friction, sticks


@library_block("models.PitchPendulum")
class PitchPendulum(Block):
    """q' = mu M - 2 xi w_n q - w_n^2 sin(theta) - hardening theta^3 - friction, theta' = q.

    Friction is Coulomb's. It opposes q with `coulomb` (1 + `asymmetry`) for q > 0 and `coulomb` (1 - `asymmetry`) for
    q < 0 [rad/s2]. It holds the drone at rest while the rest of the right-hand side is smaller (see `friction`).
    """

    inputs = (Port("M"),)
    outputs = (Port("theta", unit="rad"), Port("q", unit="rad/s"))
    states = (
        State("theta", "theta_0", unit="rad", continuous=True),
        State("q", "q_0", unit="rad/s", continuous=True),
    )
    params = (
        Param("w_n", 3.437, unit="rad/s", low=0.0, text="natural frequency of small swings"),
        Param("xi", 0.0836, text="viscous damping ratio"),
        Param("mu", 358.5, unit="rad/s2", text="gain from normalised moment to angular acceleration"),
        Param("coulomb", 0.0, unit="rad/s2", low=0.0, text="dry friction"),
        Param("asymmetry", 0.0, low=-1.0, high=1.0, text="share by which friction differs with direction"),
        Param("hardening", 0.0, unit="rad/s2", text="cubic part of the spring"),
        Param("theta_0", 0.0, unit="rad", text="pitch at the start"),
        Param("q_0", 0.0, unit="rad/s", text="pitch rate at the start"),
    )

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """The states."""
        return {"theta": x.theta, "q": x.q}

    def derivative(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """All but the dry friction while it moves; nothing while it sticks."""
        drive, more, less = self._drive(u, x, p)
        return {"theta": x.q, "q": where(sticks(x.q, drive, more, less), 0.0, drive)}

    def project(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """The dry friction's impulse over the step; the angle as if it had acted evenly over it."""
        after = after_friction(x.q, *self._drive(u, x, p), t.dt)
        return {"theta": x.theta - 0.5 * t.dt * (x.q - after), "q": after}

    def _drive(self, u: Any, x: Any, p: Any) -> tuple[Any, Any, Any]:
        """The right-hand side without dry friction, and that friction for q > 0 and for q < 0."""
        spring = p.w_n * p.w_n * sin(x.theta) + p.hardening * (x.theta * x.theta * x.theta)
        drive = p.mu * u.M - 2.0 * p.xi * p.w_n * x.q - spring
        return drive, p.coulomb * (1.0 + p.asymmetry), p.coulomb * (1.0 - p.asymmetry)
