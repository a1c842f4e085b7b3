"""Mixer: from thrust and moment, or from single motors' commands, to the commands of the fore and aft rotor pairs."""

from functools import reduce
from math import nan
from operator import and_
from typing import Any

from twodof.blocks import Block, Port, int32, maximum, minimum, where
from twodof.flight.declarations import finite, ports
from twodof.flight.templates import AFT_MOTORS, FORE_MOTORS
from twodof.signals import ATTITUDE, OFF, POSITION, RATE, VELOCITY


class Mixer(Block):
    """fore = T + M, aft = T - M, each clipped to [0, 1], as the drone's logs show (no thrust is traded for moment).

    Unsaturated, (fore + aft) / 2 = T and (fore - aft) / 2 = M. `saturated` is true if a command was clipped.
    """

    inputs = ports("T", "M")
    outputs = (*ports("fore", "aft"), Port("saturated", "bool"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        fore, aft = u.T + u.M, u.T - u.M
        clipped_fore, clipped_aft = (maximum(0.0, minimum(1.0, command)) for command in (fore, aft))
        return {"fore": clipped_fore, "aft": clipped_aft, "saturated": (clipped_fore != fore) | (clipped_aft != aft)}


class FiniteCommands(Block):
    """M and T unchanged, or both 0, which stops the motors, if one of them is infinite or NaN."""

    inputs = outputs = ports("M", "T")

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        sound = finite(u.M) & finite(u.T)
        return {"M": where(sound, u.M, 0.0), "T": where(sound, u.T, 0.0)}


class MotorFlags(Block):
    """Flags of the closed loops, for a motor controller."""

    inputs = ports("mode")
    outputs = tuple(Port(name, "bool") for name in ("rate", "attitude", "velocity", "position"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {
            "rate": u.mode >= int32(RATE),
            "attitude": u.mode >= int32(ATTITUDE),
            "velocity": u.mode >= int32(VELOCITY),
            "position": u.mode == int32(POSITION),
        }


class RotorPairs(Block):
    """Commands of the rotor pairs from those of the single motors: the mean of the two motors of a pair.

    The rig prevents roll and yaw, so only the mean of a pair acts on the drone. Each command is limited to [0, 1]; it
    is 0 if it is infinite or NaN, or if the mode is off. M = (fore - aft) / 2 and T = (fore + aft) / 2; `M_shown` and
    `T_shown` are the same, or NaN while a motor's command is not finite.
    """

    inputs = (*ports("mode"), *(Port(f"motor_{n}") for n in (1, 2, 3, 4)))
    outputs = (*ports("fore", "aft", "M", "T"), Port("M_shown"), Port("T_shown"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        off = u.mode <= int32(OFF)

        def command(motor: str) -> Any:
            asked = u[motor]
            return where(off | ~finite(asked), 0.0, maximum(0.0, minimum(1.0, asked)))

        fore, aft = (0.5 * (command(a) + command(b)) for a, b in (FORE_MOTORS, AFT_MOTORS))
        moment, thrust = 0.5 * (fore - aft), 0.5 * (fore + aft)
        lost = ~off & ~reduce(and_, [finite(u[motor]) for motor in (*FORE_MOTORS, *AFT_MOTORS)])
        return {
            "fore": fore,
            "aft": aft,
            "M": moment,
            "T": thrust,
            "M_shown": where(lost, nan, moment),
            "T_shown": where(lost, nan, thrust),
        }
