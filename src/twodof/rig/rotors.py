"""Rotors: the fore and aft pairs, from commands to thrust and pitch moment."""

from typing import Any

from twodof.blocks import Block, Param, Port, State, int32, maximum, minimum, store, to_int32, to_real, where
from twodof.blocks.block import Clock
from twodof.signals import HOVER

PAIRS = ("fore", "aft")

RING = 64
"""Ticks that the command ring keeps; the longest pure delay is two less."""

STILL = 1e-9
"""A rotor slower than this share of full speed stands: a spin-down must not end in subnormal numbers."""


def lift(speed: Any, curve: Any) -> Any:
    """Share of full thrust at a share `speed` of full speed: (1 - a) u + a u^2, `curve` = a."""
    return speed * ((1.0 - curve) + curve * speed)


class Rotors(Block):
    """Two rotor pairs: pure delay, first-order lag of the speed, thrust curve, and the trim moment of their wake.

    A command reaches its rotors `delay` s later. A delay between two ticks takes the mean over the tick of the held
    command, so the impulse of an edge is exact. With a `lag` below half a tick the rotors follow at once.

    The trim moment is `trim` at hover once the wake stands and `trim_start` before. The wake follows the thrust with
    `wake_lag`. The drone shows it: the mean M of the first second after a start differs from that of the hover after
    it. A doublet flown 0.14 s after a restart meets hardly any trim. At a pitch theta the wake goes to
    1 / (1 + (`wake_fade` theta)^2) of that: the steps show that the trim leaves a drone that stays pitched.
    """

    inputs = (Port("fore"), Port("aft"), Port("supply"), Port("theta", unit="rad"))
    outputs = (
        Port("thrust", unit="N"),
        Port("moment", unit="N*m"),
        Port("running"),
        Port("load"),
    )
    params = (
        Param("pair_thrust", 4.0, unit="N", low=0.1, high=100.0, text="thrust of a pair at full command"),
        Param("curve", 0.3, low=0.0, high=1.0, text="quadratic share of the thrust curve"),
        Param("arm", 0.1, unit="m", low=0.01, high=1.0, text="rotor axes to bearing, along the drone"),
        Param("delay", 0.01, unit="s", low=0.0, high=0.062, text="pure delay of the commands"),
        Param("lag", 0.011, unit="s", low=0.0, high=1.0, text="lag of the rotor speed"),
        Param("trim", 0.0, unit="N*m", low=-1.0, high=1.0, text="pitch moment of the rotors' wake in hover"),
        Param("trim_start", 0.0, unit="N*m", low=-1.0, high=1.0, text="that moment before the wake stands"),
        Param("wake_lag", 1.0, unit="s", low=0.01, high=60.0, text="time in which the wake builds up"),
        Param("wake_fade", 0.0, unit="1/rad", low=0.0, high=1000.0, text="how soon the wake fades with the pitch"),
        Param("wake_start", 0.0, low=0.0, high=2.0, text="share of the wake that stands at the start"),
    )
    derived = (
        Port("whole", "int32"),
        Port("fraction"),
        Port("direct", "bool"),
        Port("per_lag", unit="1/s"),
        Port("wake_step"),
        Port("per_hover"),
    )
    states = (
        *(State(pair, continuous=True) for pair in PAIRS),
        *(State(f"{pair}_ring", width=RING) for pair in PAIRS),
        State("place", 0, "int32"),
        State("wake", "wake_start"),
    )

    def prepare(self, p: Any, t: Clock) -> Any:
        # At least one tick: a command is read from the ring before it is written.
        ticks = maximum(p.delay / t.base_dt, 1.0)
        whole = to_int32(minimum(ticks, RING - 2.0))
        direct = p.lag < 0.5 * t.base_dt
        return {
            "whole": whole,
            "fraction": ticks - to_real(whole),
            "direct": direct,
            "per_lag": where(direct, 0.0, 1.0 / p.lag),
            "wake_step": t.base_dt / p.wake_lag,
            "per_hover": 0.5 / lift(HOVER, p.curve),
        }

    def _delayed(self, ring: Any, x: Any, p: Any) -> Any:
        back = (x.place - p.whole) & int32(RING - 1)
        older = (x.place - p.whole - 1) & int32(RING - 1)
        return ring[back] + p.fraction * (ring[older] - ring[back])

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        fore, aft = (where(p.direct, self._delayed(x[f"{pair}_ring"], x, p), x[pair]) for pair in PAIRS)
        up_fore, up_aft = lift(fore, p.curve) * u.supply, lift(aft, p.curve) * u.supply
        total = up_fore + up_aft
        load = total * p.per_hover
        trim = p.trim_start * load + (p.trim - p.trim_start) * x.wake
        return {
            "thrust": p.pair_thrust * total,
            "moment": (p.arm * p.pair_thrust) * (up_fore - up_aft) + trim,
            "running": minimum((fore + aft) * (0.5 / HOVER), 1.0),
            "load": load,
        }

    def derivative(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return {pair: (self._delayed(x[f"{pair}_ring"], x, p) - x[pair]) * p.per_lag for pair in PAIRS}

    def project(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return {pair: where(x[pair] < STILL, 0.0, x[pair]) for pair in PAIRS}

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        load = self.output(u, x, p, t)["load"]
        slant = p.wake_fade * u.theta
        wake = x.wake + p.wake_step * (load / (1.0 + slant * slant) - x.wake)
        asked = {pair: maximum(0.0, minimum(1.0, u[pair])) for pair in PAIRS}
        return {
            **{f"{pair}_ring": store(x[f"{pair}_ring"], x.place, asked[pair]) for pair in PAIRS},
            "place": (x.place + 1) & int32(RING - 1),
            "wake": where(wake < STILL, 0.0, wake),
        }
