"""Closed loop with the failsafe and injected faults: battery sag, failing controller and others."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.fmea.faults import FLAG_KINDS, KINDS, Fault, FlagFault, Noise
from twodof.blocks import Block, Diagram, Param, Port, State, where
from twodof.blocks.library.delays import ZeroOrderHold
from twodof.compile import build
from twodof.flight.core import OUTPUTS, core
from twodof.flight.declarations import FAILSAFE_INPUTS as SAFETY_INPUTS
from twodof.flight.declarations import INPUTS
from twodof.flight.failsafe.diagram import OUTPUTS as SAFETY_OUTPUTS
from twodof.flight.templates import ATTITUDE
from twodof.rig.parameters import lab
from twodof.rig.rig import BASE_DT, MEASUREMENTS, SAMPLE, TRUTH, rig

TICKS = SAMPLE[0]
PERIOD_MS = 1e3 * TICKS * BASE_DT
IMU = ("acc_x", "acc_z", "gyro_y")
FAULTS: Mapping[str, tuple[str, ...]] = {"imu_frozen": IMU, "range_silent": ("dist_new",), "sag": ("voltage",)}
"""What `fly` can be told to fail, and in which signals."""


class Failing(Block):
    """A user's attitude controller, P on pitch and rate, whose moment is `wrong` from its tick `at` on.

    The wrong moment is `wrong` times infinity (0: NaN), or for `frozen` the last one.
    """

    inputs = tuple(Port(p.name, p.kind, unit=p.unit) for p in ATTITUDE.inputs)
    outputs = (Port("M"),)
    states = (State("last"), State("count", 0, "int32"))
    params = (
        Param("at", 1_000_000, "int32", low=0),
        Param("wrong", 0.0),
        Param("frozen", False, "bool"),
    )

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        right = 0.0854 * (where(u.FLAG_ATTITUDE_ENABLED, 11.0 * (u.theta_0 - u.theta), u.q_0) - u.q)
        return where(x.count < p.at, right, where(p.frozen, x.last, p.wrong * inf))

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"last": self.output(u, x, p, t), "count": x.count + 1}


def failing_controller() -> Diagram:
    """`Failing` as a diagram of the attitude template."""
    d = Diagram("failing")
    for port in ATTITUDE.inputs:
        d.input(port.name, port.kind, unit=port.unit)
    d.add("law", Failing(), inputs={port.name: port.name for port in ATTITUDE.inputs})
    d.output("M", "law")
    return d


ASKED = [row for row in (*INPUTS, *SAFETY_INPUTS) if row[0] not in (*MEASUREMENTS, "voltage")]
"""The inputs of the loop: what is no measurement."""


@functools.cache
def compiled(own: bool, precision: str) -> Any:
    """The closed loop with places for faults; `own`: with the failing controller."""
    d = Diagram("faulty_loop")
    d.add("rig", rig())
    d.add("flight", core(controllers=[failing_controller()] if own else (), failsafe=True), rate=SAMPLE)
    for name, kind, unit, _ in ASKED:
        d.input(name, kind, unit=unit)
        d.add(f"{name}_held", ZeroOrderHold(kind=kind, unit=unit), rate=SAMPLE, u=name)
    d.add("voltage_held", ZeroOrderHold(unit="V"), rate=SAMPLE, u="rig.voltage")
    sources = {name: f"rig.{name}" for name in MEASUREMENTS} | {"voltage": "voltage_held"}
    d.add("noise", Noise(), rate=SAMPLE)
    for name in (name for names in FAULTS.values() for name in names):
        source = sources.pop(name)
        if name == "dist_new":
            d.add(name, FlagFault(), rate=SAMPLE, u=source)
        else:
            d.add(name, Fault(), rate=SAMPLE, u=source, partner=source, n="noise")
        d.connect(name, f"flight.{name}")
    for name, source in sources.items():
        d.connect(source, f"flight.{name}")
    for name, *_ in ASKED:
        d.connect(f"{name}_held", f"flight.{name}")
    for name in ("fore", "aft"):
        d.connect(f"flight.{name}", f"rig.{name}")
    for name, *_ in (*OUTPUTS, *SAFETY_OUTPUTS):
        d.output(name, f"flight.{name}")
    for name in TRUTH:
        d.output(f"true_{name}", f"rig.{name}")
    return build(d, BASE_DT, precision)


class FaultyLoop:
    """A flight of the `lab` rig with the failsafe, in steps of 4 ms, that starts disarmed and level at x = 0."""

    def __init__(self, own: bool = False, precision: str = "float64", **conditions: Any) -> None:
        self.machine = compiled(own, precision).machine()
        values = dict(lab().snapshot()) | {"rings": True, "seed": 1} | conditions
        self.machine.set_many({f"rig.{name}": value for name, value in values.items()})
        self.machine.reset()
        healthy = {"setpoint_new": True, "link_new": True, "imu_new": True, "rings": bool(values["rings"])}
        self.now: dict[str, Any] = {name: False if kind == "bool" else 0 for name, kind, *_ in ASKED}
        self.now |= healthy

    def fly(self, seconds: float, **changes: Any) -> dict[str, NDArray[Any]]:
        """Flies on with inputs changed; one may be an array with a value for each step. Each signal, (steps,).

        `imu_frozen`, `range_silent` and `sag` [V], once told, begin with the first step and do not end.
        """
        steps = round(seconds / (TICKS * BASE_DT))
        for fault in FAULTS.keys() & changes.keys():
            self._begin(fault, float(changes.pop(fault)))
        columns = {name: np.asarray(value) for name, value in changes.items()}
        self.now |= {name: c.item() if c.ndim == 0 else c[-1].item() for name, c in columns.items()}
        held = {name: np.repeat(c, TICKS) for name, c in columns.items() if c.ndim}
        out = self.machine.run(steps * TICKS, self.now | held)
        return {name: np.asarray(values[::TICKS]) for name, values in out.items()}

    def _begin(self, fault: str, size: float) -> None:
        """Puts a fault in, from now on."""
        of_kind = {
            "imu_frozen": {"kind": KINDS.index("frozen")},
            "range_silent": {"kind": FLAG_KINDS.index("never")},
            "sag": {"kind": KINDS.index("step"), "size": -size},
        }[fault]
        values = of_kind | {"onset": self.machine.tick}
        self.machine.set_many({f"{name}.{key}": value for name in FAULTS[fault] for key, value in values.items()})

    def take_off(self, seconds: float = 3.0, **setpoints: Any) -> None:
        """Arms, then flies for `seconds`, in attitude mode with thrust .4 unless the set-points say otherwise."""
        self.fly(0.4)
        armed = self.fly(0.1, arm=True)
        assert armed["state"][-1] == 2, armed["reason"][-1]
        out = self.fly(seconds, **({"mode": 3, "thrust": 0.4} | setpoints))
        assert np.all(out["action"] == 0), set(out["reason"].tolist())


def first(condition: NDArray[Any]) -> float:
    """Time from the beginning to the first step in which a condition holds [ms]; infinite if it never does."""
    steps = np.flatnonzero(condition)
    return PERIOD_MS * float(steps[0]) if steps.size else float("inf")
