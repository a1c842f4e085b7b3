"""Gain scheduling by thrust: mu depends on T, so the moment is divided by what T multiplies it with."""

from twodof.blocks import Diagram
from twodof.blocks.library import Constant, Divide, Gain, Saturation, Sum, Switch
from twodof.errors import ParameterError, is_number
from twodof.flight.starters.position import motor_pairs
from twodof.flight.templates import MOTOR
from twodof.signals import HOVER

LEAST_THRUST = 0.05
"""Below it the schedule stays where it is there [-]: the motors then hardly turn, and M is clipped."""


def gain_ratio(thrust: float, curve: float, designed_at: float = HOVER) -> float:
    """Return mu at `thrust` over mu at the design's thrust, for a pair's thrust (1 - curve) u + curve u^2.

    The pairs get T + M and T - M. Their thrusts differ by 2 (1 - curve + 2 curve T) M, which is exactly linear in M.
    Raises ParameterError for a curve or thrust outside 0 to 1.
    """
    for name, value in (("curve", curve), ("thrust", thrust), ("designed_at", designed_at)):
        if not is_number(value, 0.0, 1.0):
            raise ParameterError(f"{name} = {value!r:.40} is out of range", "schedule", "give 0 to 1")
    if curve == 1.0 and designed_at == 0.0:
        raise ParameterError("with curve = 1, no moment acts at thrust 0", "schedule", "give a designed_at above 0")
    return (1.0 - curve + 2.0 * curve * thrust) / (1.0 - curve + 2.0 * curve * designed_at)


def scheduled_motor(curve: float, designed_at: float = HOVER) -> Diagram:
    """Return a mixer diagram like the stock one, with the moment of closed loops divided by `gain_ratio`.

    Whatever controls the pitch then meets the mu that it was designed for, at any thrust. In open loop M is flown as
    it is given. `models.plant.thrust_curve` finds the curve from mu at rest and in hover. Raises ParameterError as
    `gain_ratio`.
    """
    gain_ratio(designed_at, curve, designed_at)
    d = Diagram("scheduled_motor", "the stock mixer, the moment scheduled by thrust")
    for port in MOTOR.inputs:
        d.input(port.name, port.kind, unit=port.unit)
    scale = 1.0 - curve + 2.0 * curve * designed_at
    d.param("slope", 2.0 * curve / scale, low=0.0, high=1e3, text="of mu over thrust, over mu at the design's")
    d.param("at_rest", (1.0 - curve) / scale, low=0.0, high=1.0 + 1e-9, text="mu at no thrust, over mu at the design's")
    d.add("within", Saturation(LEAST_THRUST, 1.0), u="thrust_0", position=(160.0, 160.0))
    d.add("rising", Gain(1.0), params={"k": "slope"}, u="within", position=(280.0, 160.0))
    d.add("rest", Constant(1.0), params={"value": "at_rest"}, position=(280.0, 240.0))
    d.add("ratio", Sum("++"), a="rising", b="rest", position=(400.0, 180.0))
    d.add("scheduled", Divide(), a="M_0", b="ratio", position=(520.0, 120.0))
    d.add("asked", Switch(), condition="FLAG_RATE_ENABLED", a="scheduled", b="M_0", position=(640.0, 80.0))
    motor_pairs(d, "thrust_0", "asked")
    return d
