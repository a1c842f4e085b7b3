"""Faults as blocks: what becomes of a signal from a moment on. Kind, size and moment are parameters."""

from math import inf, nan
from typing import Any

from twodof.blocks import Block, Param, Port, State, int32, maximum, minimum, store, to_int32, to_real, where
from twodof.blocks.noise import normal
from twodof.signals import RAIL_CENTRE

RING = 64
"""Samples that a late signal may be old, and one: .25 s."""

STREAM = 9
"""Stream of the noise generator."""

KINDS = (
    "none",
    "frozen",
    "frozen with noise",
    "step",
    "drift",
    "stuck",
    "clipped",
    "late",
    "swapped",
    "scaled",
    "noise",
    "spikes",
    "dropouts",
    "NaN",
    "infinite",
    "square",
)
"""What becomes of a number u by a fault of `size` s: see `Fault`."""

FLAG_KINDS = ("none", "never", "always", "rarely", "missed", "once", "late")
"""What becomes of a flag: see `FlagFault`."""


def _due(t: Any, onset: Any) -> Any:
    """Return True from `onset` ms after the start on; a base tick is 1 ms."""
    return to_int32(t.tick) >= onset


class Noise(Block):
    """A standard normal for each sample, that all faults share: an instance has one fault."""

    outputs = (Port("n"),)
    params = (Param("seed", 1, "uint32"),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return normal(p.seed, STREAM, t.tick)


class Mirrored(Block):
    """The range as a sensor at the rail's other end gives it."""

    inputs = (Port("dist"),)
    outputs = (Port("mirrored"),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return 2.0 * RAIL_CENTRE - u.dist


class Fault(Block):
    """A number u with a fault of the kind `kind` and the size s, from `onset` ms on.

    `frozen`: the last one before. `frozen with noise`: that + s n. `step`: u + s. `drift`: u + s for each second.
    `stuck`: s. `clipped`: within +-s. `late`: that of s ms ago (to .25 s). `swapped`: its partner. `scaled`: s u.
    `noise`: u + s n. `spikes`: u + s in one sample of `period`. `dropouts`: 0 in one of `period`. `NaN`.
    `infinite`: with the sign of s. `square`: u + s and u - s in turn, each for `period` samples.
    """

    inputs = (Port("u"), Port("partner"), Port("n"))
    outputs = (Port("y"),)
    states = (State("held"), State("ring", width=RING), State("place", 0, "int32"), State("count", 0, "int32"))
    params = (
        Param("kind", 0, "int32", low=0, high=len(KINDS) - 1),
        Param("size", 0.0),
        Param("period", 25, "int32", low=1),
        Param("onset", 2**30, "int32"),
    )

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        seconds = to_real(x.count) * t.dt
        back = maximum(int32(1), minimum(int32(RING - 1), to_int32(p.size / (1e3 * t.dt) + 0.5)))
        turn = x.count % p.period == int32(0)
        half = (x.count // p.period) & int32(1) == int32(0)
        made = {
            "none": u.u,
            "frozen": x.held,
            "frozen with noise": x.held + p.size * u.n,
            "step": u.u + p.size,
            "drift": u.u + p.size * seconds,
            "stuck": p.size,
            "clipped": maximum(-p.size, minimum(p.size, u.u)),
            "late": x.ring[(x.place - back) & int32(RING - 1)],
            "swapped": u.partner,
            "scaled": p.size * u.u,
            "noise": u.u + p.size * u.n,
            "spikes": where(turn, u.u + p.size, u.u),
            "dropouts": where(turn, 0.0, u.u),
            "NaN": nan,
            "infinite": where(p.size < 0.0, -inf, inf),
            "square": where(half, u.u + p.size, u.u - p.size),
        }
        y = u.u
        for number, kind in enumerate(KINDS[1:], 1):
            y = where(p.kind == int32(number), made[kind], y)
        return where(_due(t, p.onset), y, u.u)

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        due = _due(t, p.onset)
        return {
            "held": where(due, x.held, u.u),
            "ring": store(x.ring, x.place, u.u),
            "place": (x.place + int32(1)) & int32(RING - 1),
            "count": where(due, x.count + int32(1), int32(0)),
        }


class FlagFault(Block):
    """A flag with a fault of the kind `kind`, from `onset` ms on.

    `never`: false. `always`: true. `rarely`: what it is in one sample of `period`, else false. `missed`: false in one
    of `period`. `once`: true in the first sample. `late`: that of `period` samples ago.
    """

    inputs = (Port("u", "bool"),)
    outputs = (Port("y", "bool"),)
    states = (State("ring", width=RING, kind="int32"), State("place", 0, "int32"), State("count", 0, "int32"))
    params = (
        Param("kind", 0, "int32", low=0, high=len(FLAG_KINDS) - 1),
        Param("period", 2, "int32", low=1),
        Param("onset", 2**30, "int32"),
    )

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        made = {
            "never": False,
            "always": True,
            "rarely": u.u & (x.count % p.period == int32(0)),
            "missed": u.u & (x.count % p.period != int32(0)),
            "once": u.u | (x.count == int32(0)),
            "late": x.ring[(x.place - p.period) & int32(RING - 1)] == int32(1),
        }
        y = u.u
        for number, kind in enumerate(FLAG_KINDS[1:], 1):
            y = where(p.kind == int32(number), made[kind], y)
        return where(_due(t, p.onset), y, u.u)

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {
            "ring": store(x.ring, x.place, where(u.u, int32(1), int32(0))),
            "place": (x.place + int32(1)) & int32(RING - 1),
            "count": where(_due(t, p.onset), x.count + int32(1), int32(0)),
        }
