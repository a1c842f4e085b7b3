"""A continuous integrator that can be reset, from an initial value that may be a signal."""

from collections.abc import Sequence
from typing import Any

from twodof.blocks.diagram import Diagram
from twodof.blocks.library.continuous import ResetIntegrator, ResetLatch

__all__ = ["resettable_integrator"]


def resettable_integrator(
    name: str,
    reset: str = "level",
    initial: Any = 0.0,
    limits: Sequence[float] | None = None,
    width: int | None = None,
    unit: str = "",
) -> Diagram:
    """A diagram with y' = u, y from `initial`, or with initial="input" from the input `x0`; for the base rate.

    With `reset` there is a bool input `clear`. It acts at each tick at which it is true ("level"), or at its edges
    ("rising", "falling" or "either"; the first tick is not one). Then y becomes the initial value before the outputs
    are computed, and is integrated from there. With "none" the input `clear` is absent. The output y depends on
    `clear` and `x0` in the same tick: a loop through them needs a delay. Raises DiagramError for another `reset`, or
    limits that are none.
    """
    d = Diagram(name)
    latch = ResetLatch(reset, initial, width, unit)
    d.input("u", width=width)
    for port in latch.inputs:
        d.input(port.name, port.kind, port.width, port.unit)
    for param in latch.params:
        d.param(param.name, initial, width=width, unit=unit)
    d.add(
        "latch",
        latch,
        params={param.name: param.name for param in latch.params},
        inputs={port.name: port.name for port in latch.inputs},
    )
    d.add("integrator", ResetIntegrator(limits, width, unit), u="u", x0="latch.x0", start="latch.start")
    d.output("y", "integrator")
    return d
