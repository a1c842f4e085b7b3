"""User controllers with parameters of all kinds, for tests of what can be tuned."""

from collections.abc import Iterable
from typing import Any

from twodof.blocks import Block, Diagram, Param, Port, where
from twodof.flight.templates import ATTITUDE, MOTOR, POSITION, Template

KIND = ATTITUDE.name


class Law(Block):
    """P on pitch and rate, times a gain that `prepare` makes of two parameters and that is NaN where both are 0."""

    inputs = tuple(Port(p.name, p.kind, unit=p.unit) for p in ATTITUDE.inputs)
    outputs = (Port("M"),)
    params = (
        Param("above", 2.0, low=0.0, high=10.0, text="counter of the gain"),
        Param("below", 2.0, low=0.0, high=10.0),
        Param("steps", 3, "int32", low=-5, high=7),
        Param("mask", 9, "uint32"),
        Param("inverted", False, "bool"),
        Param("weights", (1 / 3, 2 / 3), width=2, low=-1.0, high=1.0, unit="1/s"),
        Param("fixed", 1.0, tunable=False),
        Param("free", 0.1),
    )
    derived = (Port("gain"),)

    def prepare(self, p: Any, t: Any) -> Any:
        return {"gain": p.above / p.below}

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        right = 0.0854 * (where(u.FLAG_ATTITUDE_ENABLED, 11.0 * (u.theta_0 - u.theta), u.q_0) - u.q)
        return where(p.inverted, -1.0, 1.0) * p.gain * right


def tuned(name: str = "mine", template: Template = ATTITUDE) -> Diagram:
    """An attitude controller with parameters of all kinds."""
    d = with_inputs(name, template)
    d.add("law", Law(), inputs={port.name: port.name for port in ATTITUDE.inputs})
    d.output("M", "law.M")
    return d


class Numbers(Block):
    """Gives 0, with real parameters of these names, each of `width` elements."""

    outputs = (Port("y"),)

    def __init__(self, names: Iterable[str], width: int | None = None) -> None:
        self.params = tuple(Param(name, 0.5, width=width, low=0.0, high=1.0) for name in names)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return 0.0


def with_names(names: Iterable[str], template: Template = ATTITUDE, diagram: str = "mine", parts: int = 1) -> Diagram:
    """A controller that gives 0, each of its `parts` with parameters of these names."""
    d = with_inputs(diagram, template)
    for part in range(parts):
        d.add(f"part{part}", Numbers(names))
    for port in template.outputs:
        d.output(port.name, "part0.y")
    return d


def with_inputs(name: str, template: Template) -> Diagram:
    """A diagram that has the inputs of a template."""
    d = Diagram(name)
    for port in template.inputs:
        d.input(port.name, port.kind, unit=port.unit)
    return d


ALL = (ATTITUDE, MOTOR, POSITION)
