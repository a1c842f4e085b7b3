"""Battery: state of charge, and the voltage sag that lowers the thrust."""

from typing import Any

from twodof.blocks import Block, Param, Port, State, maximum, minimum, sqrt
from twodof.blocks.block import Clock


class BatteryPack(Block):
    """A pack with an open-circuit voltage that falls linearly with the charge, and an inner resistance.

    The current is that of hover times load^(3/2), the power that momentum theory gives for the thrust. The load is that
    of the sample before, as the thrust depends on the supply. `supply`, the factor on all thrusts, is the square of the
    terminal voltage over that of a full pack in hover. So rig parameters that were found with a fresh pack hold.
    """

    crossing = True  # reads the load at each of its own, slower ticks
    inputs = (Port("load"),)
    outputs = (Port("supply"), Port("voltage", unit="V"), Port("charge"))
    params = (
        Param("capacity", 1.3, unit="A*h", low=0.01, high=1e9),
        Param("voltage_full", 12.6, unit="V", low=1.0, high=100.0, text="open circuit, full"),
        Param("voltage_empty", 10.5, unit="V", low=0.5, high=100.0, text="open circuit, empty"),
        Param("resistance", 0.03, unit="Ohm", low=0.0, high=10.0),
        Param("hover_current", 6.0, unit="A", low=0.0, high=200.0),
        Param("charge_start", 1.0, low=0.0, high=1.0),
    )
    states = (State("charge", "charge_start"), State("load"))
    derived = (Port("per_capacity", unit="1/(A*s)"), Port("per_reference", unit="1/V"))

    def prepare(self, p: Any, t: Clock) -> Any:
        reference = p.voltage_full - p.resistance * p.hover_current
        return {"per_capacity": 1.0 / (3600.0 * p.capacity), "per_reference": 1.0 / maximum(reference, 0.1)}

    def _current(self, x: Any, p: Any) -> Any:
        return p.hover_current * x.load * sqrt(x.load)

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        open_circuit = p.voltage_empty + (p.voltage_full - p.voltage_empty) * x.charge
        voltage = maximum(0.0, open_circuit - p.resistance * self._current(x, p))
        share = voltage * p.per_reference
        return {"supply": share * share, "voltage": voltage, "charge": x.charge}

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        used = self._current(x, p) * p.per_capacity * t.dt
        return {"charge": minimum(1.0, maximum(0.0, x.charge - used)), "load": maximum(u.load, 0.0)}
