"""Set-points as they may fly: limited, and while the failsafe acts its own."""

from typing import Any

from twodof.blocks import Block, Port, State, int32, maximum, minimum, to_real, where
from twodof.flight.declarations import SET_POINTS, ports, tunable, tunables
from twodof.flight.failsafe.state_machine import BRAKE, DESCEND, FLYING, LEVEL
from twodof.flight.failsafe.timers import ticks
from twodof.flight.finite import finite
from twodof.signals import ATTITUDE, OFF, POSITION


class SafeSetPoints(Block):
    """Mode and set-points for the controllers.

    Flying: those given, each within its limit (one inside passes with its bits), 0 for one that is not a number. Level:
    attitude mode, theta0 = 0, the thrust that flew last. Brake: the same with the pitch that stops the cart and brings
    it back. That is theta0 = brake_x (x - place) + brake_v v, within +-`brake_tilt`; `place` is x within +-`rail_hold`.
    The position loop would not do: the faster the cart is, the further it tilts, into the stop. Descend: as level, and
    the thrust fades to 0 within `descent`. Where no thrust flew when the failsafe began to act, and whenever the motors
    are stopped, the mode is off: no action starts motors that stood.
    """

    inputs = (*ports("state", "timer", "stopped", "mode", *SET_POINTS, "ax0", "x", "v"), Port("T_flown"))
    outputs = ports("mode", *SET_POINTS, "ax0")
    states = (State("thrust"),)
    derived = (Port("per_tick"),)
    params = (tunable("failsafe.descent"), *tunables("failsafe.safe"))

    def prepare(self, p: Any, t: Any) -> Any:
        return 1.0 / to_real(ticks(p.descent, t.dt))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        def within(name: str, low: Any, high: Any) -> Any:
            return where(finite(u[name]), maximum(low, minimum(high, u[name])), 0.0)

        given = {
            "thrust": within("thrust", 0.0, 1.0),
            "M_open": within("M_open", -1.0, 1.0),
            "ax0": where(finite(u.ax0), u.ax0, 0.0),
        }
        for name in ("x0", "v0", "theta0", "q0"):
            given[name] = within(name, -p[f"{name}_limit"], p[f"{name}_limit"])
        flying = u.state == int32(FLYING)
        braking = u.state == int32(BRAKE)
        acting = (u.state >= int32(LEVEL)) & (u.state <= int32(DESCEND))
        standing = u.stopped | (acting & ~(x.thrust > 0.0))
        asked = where(u.mode > int32(POSITION), int32(OFF), u.mode)
        mode = where(flying, asked, int32(ATTITUDE))
        fade = where(u.state == int32(DESCEND), maximum(0.0, 1.0 - to_real(u.timer) * p.per_tick), 1.0)
        place = maximum(-p.rail_hold, minimum(p.rail_hold, u.x))
        back = p.brake_x * (u.x - place) + p.brake_v * u.v
        tilt = maximum(-p.brake_tilt, minimum(p.brake_tilt, back))
        own = {"thrust": x.thrust * fade, "theta0": where(braking & finite(tilt), tilt, 0.0)}
        return {"mode": where(standing, int32(OFF), mode)} | {
            name: where(flying, value, own.get(name, 0.0)) for name, value in given.items()
        }

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        held = maximum(0.0, minimum(p.thrust_held, u.T_flown))
        return where((u.state == int32(FLYING)) & finite(u.T_flown), held, where(u.stopped, 0.0, x.thrust))
