"""The gate: the last thing before the motors. What is right passes with its bits, all else is replaced or 0."""

from typing import Any

from twodof.blocks import Block, Port, maximum, minimum, where
from twodof.flight.declarations import COMMANDS, ports
from twodof.flight.finite import finite


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
