"""Turbulence: the random pitch moment of the rotors' own wake, which keeps a hovering drone moving."""

from typing import Any

from twodof.blocks import Block, Param, Port, State, sqrt
from twodof.blocks.block import Clock
from twodof.blocks.elementary.functions import exp
from twodof.blocks.noise import normal

GUST_STREAM = 2
"""Stream of the noise generator."""


class Turbulence(Block):
    """Moment of a first-order (Gauss-Markov) gust, in proportion to the thrust.

    `gust` [N m] is its standard deviation in hover, `gust_time` its correlation time. On the drone it makes q wander
    by .06 rad/s in a level hold.
    """

    crossing = True
    inputs = (Port("load"),)
    outputs = (Port("moment", unit="N*m"),)
    params = (
        Param("gust", 0.0, unit="N*m", low=0.0, high=1.0, text="standard deviation in hover"),
        Param("gust_time", 0.1, unit="s", low=1e-3, high=100.0, text="correlation time"),
        Param("noise", 1.0, low=0.0, high=100.0, text="gain of all noise, 0 for none"),
        Param("seed", 1, "uint32", text="of all noise of the rig"),
    )
    derived = (Port("keep"), Port("fresh"))
    states = (State("gust"),)

    def prepare(self, p: Any, t: Clock) -> Any:
        keep = exp(-t.dt / p.gust_time)
        return {"keep": keep, "fresh": sqrt(1.0 - keep * keep)}

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return (p.noise * p.gust) * u.load * x.gust

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return p.keep * x.gust + p.fresh * normal(p.seed, GUST_STREAM, t.tick)
