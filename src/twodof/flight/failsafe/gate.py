"""Gate of the failsafe: the set-points that it lets pass, and the commands that reach the motors."""

from typing import Any

from twodof.blocks import Block, Port, State, int32, maximum, minimum, to_real, where
from twodof.flight.declarations import COMMANDS, SET_POINTS, finite, ports, tunable, tunables
from twodof.flight.failsafe.flags import ticks
from twodof.flight.failsafe.state_machine import BRAKE, DESCEND, FLYING, LEVEL
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


class OutputSelector(Block):
    """Chooses between the user's controller and the stock one, and stops the motors.

    `own_fore`, ... are the user's commands. They fly while `own`, if they are numbers and the controller was in time
    (not `own_late`). Else the stock commands fly, from that very tick on. Where those are not numbers either, or the
    motors are `stopped`, both pairs get 0 in that tick. Every output lies within [0, 1].
    """

    inputs = ports("stopped", "own", "own_late", *COMMANDS, *(f"own_{name}" for name in COMMANDS))
    outputs = ports(*COMMANDS, "own_lost", "command_lost")

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        def numbers(prefix: str) -> Any:
            fore, aft, moment, thrust = (finite(u[f"{prefix}{name}"]) for name in COMMANDS)
            return fore & aft & moment & thrust

        healthy = numbers("own_") & ~u.own_late
        use_own = u.own & healthy
        sound = use_own | numbers("")
        fly = ~u.stopped & sound

        def passed(name: str) -> Any:
            return where(fly, where(use_own, u[f"own_{name}"], u[name]), 0.0)

        return {
            "fore": maximum(0.0, minimum(1.0, passed("fore"))),
            "aft": maximum(0.0, minimum(1.0, passed("aft"))),
            "M": passed("M"),
            "T": passed("T"),
            "own_lost": u.own & ~healthy,
            "command_lost": ~u.stopped & ~sound,
        }


class StandbyReset(Block):
    """Which controllers hold their integrals in reset: those that do not fly. `own_given` is the constant `given`."""

    inputs = ports("in_reset", "own")
    outputs = (Port("own_in_reset", "bool"), Port("stock_in_reset", "bool"), *ports("own_given"))

    def __init__(self, given: bool) -> None:
        self.given = given

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {
            "own_in_reset": u.in_reset | ~u.own,
            "stock_in_reset": u.in_reset | u.own,
            "own_given": self.given,
        }
