"""What the cart does to the pitch: its acceleration, where the rings leave it play, its speed, and the bearing's dry
friction.
"""

from typing import Any

from twodof.blocks.block import Block, Clock, library_block
from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.elementary.functions import sin
from twodof.blocks.expressions.expr import maximum, minimum, where
from twodof.models.dry_friction import after_friction, sticks


@library_block("models.CartPush")
class CartPush(Block):
    """Pitch acceleration `push` by a cart that moves and by the bearing's dry friction, from the measured pitch.

    The drone's centre lies below the bearing: q' + coupling v' = the rest (physics, equation 1). The air that a moving
    drone meets pitches it by M_u v. The cart follows v' =
    -k_v sin(theta) - p_v v - lever q' - dry friction. Rings stop it `play` either way of where it starts, and a stop
    takes the whole speed. `coulomb` opposes q. The measured pitch drives it, since a simulated one does not know the
    gusts. What is measured up to a step acts behind it, so this holds in closed loop too.
    """

    inputs = (Port("theta", unit="rad"), Port("q", unit="rad/s"))
    outputs = (Port("push", unit="rad/s2"),)
    states = (
        State("x", unit="m"),
        State("v", unit="m/s"),
        State("q", unit="rad/s"),
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
        Param("M_u", 0.0, unit="rad/(m s)", text="pitch acceleration by a unit of the cart's speed"),
    )

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        _, speed = self._next(u, x, p, t)
        bearing = where(u.q > 0.0, p.coulomb, where(u.q < 0.0, -p.coulomb, 0.0))
        return -(p.coupling * ((speed - x.v) / t.dt)) + p.M_u * (0.5 * (x.v + speed)) - bearing

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        place, speed = self._next(u, x, p, t)
        return {"x": place, "v": speed, "q": u.q, "begun": True}

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
