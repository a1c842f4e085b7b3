"""Rotors: delay and lag of a command, thrust curve, trim moment of the wake; and the battery."""

from typing import Any

from twodof.blocks import Block, Param, Port, State, int32, maximum, minimum, sqrt, store, to_int32, to_real, where
from twodof.blocks.block import Clock
from twodof.blocks.elementary.functions import exp
from twodof.signals import HOVER

STILL = 1e-9
"""Share of full speed below which a rotor is at rest, so that a spin-down does not end in subnormal numbers."""


class BatteryPack(Block):
    """A pack with an open-circuit voltage that falls linearly with the charge, an inner resistance and polarisation.

    The current is that of hover times load^(3/2), the power that momentum theory gives for the thrust. The load is that
    of the sample before, as the thrust depends on the supply. The share `polarised_share` of the resistance has a
    capacitor beside it (Thevenin's model), and its voltage follows the current with `polarised_time`. `supply`, the
    factor on all thrusts, is the square of the terminal voltage over that of a full pack after a long hover.
    """

    crossing = True  # reads the load at each of its own, slower ticks
    inputs = (Port("load"),)
    outputs = (Port("supply"), Port("voltage", unit="V"), Port("charge"))
    params = (
        Param("capacity", 1.3, unit="A*h", low=0.01, high=1e9),
        Param("voltage_full", 12.6, unit="V", low=1.0, high=100.0, text="open circuit, full"),
        Param("voltage_empty", 10.5, unit="V", low=0.5, high=100.0, text="open circuit, empty"),
        Param("resistance", 0.03, unit="Ohm", low=0.0, high=10.0),
        Param("polarised_share", 0.0, low=0.0, high=1.0, text="share of the resistance that follows the current late"),
        Param("polarised_time", 7.0, unit="s", low=0.01, high=3600.0, text="time constant of that share"),
        Param("hover_current", 6.0, unit="A", low=0.0, high=200.0),
        Param("charge_start", 1.0, low=0.0, high=1.0),
        Param("polarised_start", 0.0, low=0.0, high=2.0, text="share of the hover's polarisation at the start"),
    )
    states = (State("charge", "charge_start"), State("polarised", "polarised_start"), State("load"))
    derived = (Port("per_capacity", unit="1/(A*s)"), Port("per_reference", unit="1/V"), Port("follow"))

    def prepare(self, p: Any, t: Clock) -> Any:
        reference = p.voltage_full - p.resistance * p.hover_current
        return {
            "per_capacity": 1.0 / (3600.0 * p.capacity),
            "per_reference": 1.0 / maximum(reference, 0.1),
            "follow": 1.0 - exp(-t.dt / p.polarised_time),
        }

    def _current(self, x: Any, p: Any) -> Any:
        return p.hover_current * x.load * sqrt(x.load)

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        open_circuit = p.voltage_empty + (p.voltage_full - p.voltage_empty) * x.charge
        felt = (1.0 - p.polarised_share) * self._current(x, p) + p.polarised_share * (p.hover_current * x.polarised)
        voltage = maximum(0.0, open_circuit - p.resistance * felt)
        share = voltage * p.per_reference
        return {"supply": share * share, "voltage": voltage, "charge": x.charge}

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        used = self._current(x, p) * p.per_capacity * t.dt
        polarised = x.polarised + p.follow * (x.load * sqrt(x.load) - x.polarised)
        return {
            "charge": minimum(1.0, maximum(0.0, x.charge - used)),
            "polarised": where(polarised < STILL, 0.0, polarised),
            "load": maximum(u.load, 0.0),
        }


PAIRS = ("fore", "aft")

RING = 64
"""Length of the ring of past commands in ticks; the longest pure delay is two ticks less."""


def lift(speed: Any, curve: Any) -> Any:
    """Return the share of full thrust at `speed` u, a share of full speed: (1 - a) u + a u^2 with a = `curve`."""
    return speed * ((1.0 - curve) + curve * speed)


class Rotors(Block):
    """Two rotor pairs: pure delay, first-order lag of the speed, thrust curve, and the trim moment of their wake.

    A command reaches its rotors `delay` s later. If that ends inside a tick, the rotors receive the held command's mean
    over the tick, so the impulse of an edge is exact. With a `lag` below half a tick the rotors follow at once.

    In hover the trim moment is `trim_start` at first and `trim` once the wake has built up, with the time constant
    `wake_lag`. The real drone shows this: the mean M of the first second after a start differs from that of the hover
    after it, and a doublet flown 0.14 s after a restart meets hardly any trim. At a pitch theta the wake settles at
    1 / (1 + (`wake_fade` theta)^2) of its size in level hover: in the logged steps the trim fades while the drone stays
    pitched.
    """

    inputs = (Port("fore"), Port("aft"), Port("supply"), Port("theta", unit="rad"))
    outputs = (
        Port("thrust", unit="N"),
        Port("moment", unit="N*m"),
        Port("running"),
        Port("load"),
        *(Port(f"load_{pair}") for pair in PAIRS),
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
        trim = load * (p.trim_start + (p.trim - p.trim_start) * x.wake)
        return {
            "thrust": p.pair_thrust * total,
            "moment": (p.arm * p.pair_thrust) * (up_fore - up_aft) + trim,
            "running": minimum((fore + aft) * (0.5 / HOVER), 1.0),
            "load": load,
            "load_fore": 2.0 * up_fore * p.per_hover,
            "load_aft": 2.0 * up_aft * p.per_hover,
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
