"""What the starter diagrams share: a template's ports, parameters with bounds, unit and text, the attitude loop."""

from collections.abc import Sequence

from twodof.blocks import Diagram
from twodof.blocks.library import Gain, Saturation, Sum, Switch
from twodof.flight.gains import Gains
from twodof.flight.templates import Template


def with_ports(template: Template, name: str, text: str) -> Diagram:
    """An empty diagram with the inputs of `template`."""
    d = Diagram(name, text)
    for port in template.inputs:
        d.input(port.name, port.kind, unit=port.unit)
    return d


def tuned(d: Diagram, name: str, value: float | Sequence[float], unit: str, low: float, high: float, text: str) -> None:
    """Declares a tunable parameter of the diagram, a number or an array, to which its parts bind theirs."""
    width = len(value) if isinstance(value, Sequence) else None
    d.param(
        name,
        list(value) if isinstance(value, Sequence) else value,
        width=width,
        unit=unit,
        low=low,
        high=high,
        text=text,
    )


def rate_gains(d: Diagram, gains: Gains) -> tuple[float, float, float]:
    """Declares the gains of the rate loop as parameters q_kp, q_ki, q_kd; returns their values."""
    kp, ki, kd = gains.rate
    tuned(d, "q_kp", kp, "s/rad", 0.0, 1.0, "rate P")
    tuned(d, "q_ki", ki, "1/rad", 0.0, 5.0, "rate I")
    tuned(d, "q_kd", kd, "s2/rad", 0.0, 0.05, "rate D")
    return kp, ki, kd


def pitch_loop(d: Diagram, kp: float) -> None:
    """Adds q_0_used = theta_kp (theta_0 - theta) within +-20 rad/s, or q_0 where the attitude loop is open."""
    tuned(d, "theta_kp", kp, "1/s", 0.0, 50.0, "attitude P")
    d.add("pitch_error", Sum("+-", unit="rad"), a="theta_0", b="theta", position=(160.0, 20.0))
    d.add("pitch_gain", Gain(1.0, unit="rad/s"), params={"k": "theta_kp"}, u="pitch_error", position=(280.0, 20.0))
    d.add("rate_limit", Saturation(-20.0, 20.0, unit="rad/s"), u="pitch_gain", position=(400.0, 20.0))
    d.add(
        "q_0_used",
        Switch(unit="rad/s"),
        condition="FLAG_ATTITUDE_ENABLED",
        a="rate_limit",
        b="q_0",
        position=(520.0, 60.0),
    )
