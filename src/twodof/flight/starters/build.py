"""What the starter diagrams share: the ports of a template, and parameters with bounds, unit and text."""

from __future__ import annotations

from collections.abc import Sequence

from twodof.blocks import Diagram
from twodof.flight.templates import Template


def with_ports(template: Template, name: str, text: str) -> Diagram:
    """An empty diagram with the inputs of `template`."""
    d = Diagram(name, text)
    for port in template.inputs:
        d.input(port.name, port.kind, unit=port.unit)
    return d


def tuned(d: Diagram, name: str, value: float | Sequence[float], unit: str, low: float, high: float, text: str) -> None:
    """Declares a tunable parameter of the diagram, a number or an array, to which its parts bind theirs."""
    if isinstance(value, (int, float)):
        d.param(name, value, unit=unit, low=low, high=high, text=text)
    else:
        d.param(name, list(value), width=len(value), unit=unit, low=low, high=high, text=text)
