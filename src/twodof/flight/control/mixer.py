"""Mixer: thrust and moment to the commands of the fore and aft rotor pairs."""

from __future__ import annotations

from typing import Any

from twodof.blocks import Block, Port, maximum, minimum


class Mixer(Block):
    """fore = T + M, aft = T - M, each clipped to [0, 1], as the drone's logs show (no thrust is traded for moment).

    Unsaturated, (fore + aft) / 2 = T and (fore - aft) / 2 = M. `saturated` says that a command was clipped.
    """

    inputs = (Port("T"), Port("M"))
    outputs = (Port("fore"), Port("aft"), Port("saturated", "bool"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        fore, aft = u.T + u.M, u.T - u.M
        clipped_fore, clipped_aft = (maximum(0.0, minimum(1.0, command)) for command in (fore, aft))
        return {
            "fore": clipped_fore,
            "aft": clipped_aft,
            "saturated": (clipped_fore != fore) | (clipped_aft != aft),
        }
