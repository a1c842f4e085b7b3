"""The pitch axis beyond the linear model: gravity, a hardening spring, dry friction with true sticking."""

from __future__ import annotations

from typing import Any

from twodof.blocks.block import Block, Clock, Param, Port, State, library_block
from twodof.blocks.elementary import sin
from twodof.blocks.expr import int32, maximum, minimum, store, to_int32, to_real, where


@library_block("models.PitchPendulum")
class PitchPendulum(Block):
    """q' = mu M - 2 xi w_n q - w_n^2 sin(theta) - hardening theta^3 - friction, theta' = q.

    Friction is Coulomb's: it opposes q with `coulomb` (1 + `asymmetry`) for q > 0, `coulomb` (1 - `asymmetry`) for
    q < 0 [rad/s^2], and holds the drone at rest while the rest of the right-hand side is smaller. It acts once a step,
    as an impulse that knows when in the step the rotation stops: so the drone sticks exactly, and what is simulated
    stays a smooth function of the parameters, which an estimation needs.
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
        Param("mu", 358.5, unit="rad/s^2", text="gain from normalised moment to angular acceleration"),
        Param("coulomb", 0.0, unit="rad/s^2", low=0.0, text="dry friction"),
        Param("asymmetry", 0.0, low=-1.0, high=1.0, text="share by which friction differs with direction"),
        Param("hardening", 0.0, unit="rad/s^2", text="cubic part of the spring"),
        Param("theta_0", 0.0, unit="rad", text="pitch at the start"),
        Param("q_0", 0.0, unit="rad/s", text="pitch rate at the start"),
    )

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """The states."""
        return {"theta": x.theta, "q": x.q}

    def derivative(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """All but the dry friction while it moves; nothing while it sticks."""
        drive, stuck = self._drive(u, x, p)
        return {"theta": x.q, "q": where(stuck, 0.0, drive)}

    def project(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """The dry friction's impulse over the step; the angle as if it had acted evenly over it."""
        drive, stuck = self._drive(u, x, p)
        more, less = p.coulomb * (1.0 + p.asymmetry), p.coulomb * (1.0 - p.asymmetry)
        before = x.q - drive * t.dt
        # A rotation that stops after a part of the step goes on the other way, if the drive exceeds the friction there.
        slowed, lifted = x.q - more * t.dt, x.q + less * t.dt
        left_up = t.dt - before / (more - drive)
        left_down = t.dt + before / (less + drive)
        from_up = where(slowed < 0.0, minimum(0.0, (drive + less) * left_up), slowed)
        from_down = where(lifted > 0.0, maximum(0.0, (drive - more) * left_down), lifted)
        after = where(stuck, x.q, where(before > 0.0, from_up, from_down))
        return {"theta": x.theta - 0.5 * t.dt * (x.q - after), "q": after}

    def _drive(self, u: Any, x: Any, p: Any) -> tuple[Any, Any]:
        """The right-hand side without dry friction, and whether that holds it at rest."""
        spring = p.w_n * p.w_n * sin(x.theta) + p.hardening * (x.theta * x.theta * x.theta)
        drive = p.mu * u.M - 2.0 * p.xi * p.w_n * x.q - spring
        held = (drive <= p.coulomb * (1.0 + p.asymmetry)) & (-drive <= p.coulomb * (1.0 - p.asymmetry))
        return drive, (x.q == 0.0) & held


@library_block("models.InputDelay")
class InputDelay(Block):
    """Delay of a held input by `tau` seconds, not a multiple of the tick: y(t) = u(t - tau), u = u[0] before the start.

    A continuous block behind it sees the change inside the step (an edge). Unlike the library's fractional delay it
    starts from the record's own first value, so a trim moment needs no parameter. `tau` is at most `ring - 2` ticks.
    """

    def __init__(self, ring: int = 64) -> None:
        self.ring = ring
        self.inputs = (Port("u"),)
        self.outputs = (Port("y"),)
        self.params = (Param("tau", 0.0, unit="s", low=0.0, text="delay of the input"),)
        self.derived = (Port("whole", "int32"), Port("fraction"))
        self.states = (State("past", 0.0, width=ring), State("step", 0, kind="int32"))

    def prepare(self, p: Any, t: Clock) -> dict[str, Any]:
        """The delay in whole ticks and the fraction of one that is left."""
        # A delay that is a multiple of the tick up to rounding is that multiple.
        steps = p.tau / t.dt
        whole = to_int32(steps + 1e-9)
        return {"whole": whole, "fraction": maximum(steps - to_real(whole), 0.0)}

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """The input of `whole + 1` ticks ago if the delay ends inside the step."""
        return self._ago(where(p.fraction > 0.0, p.whole + 1, p.whole), u, x)

    def edges(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, tuple[Any, Any]]:
        """The younger value arrives after `fraction` of the step."""
        return {"y": (p.fraction, self._ago(p.whole, u, x))}

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """Keep the input."""
        return {"past": store(x.past, x.step % self.ring, u.u), "step": x.step + 1}

    def _ago(self, steps: Any, u: Any, x: Any) -> Any:
        then = where(x.step < steps, int32(0), x.step - steps)
        return where((steps == 0) | (x.step == 0), u.u, x.past[then % self.ring])
