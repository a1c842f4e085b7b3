"""The past inputs of a delay: a ring of the last `ring` samples, whose counters come round or stop.

A counter that ran on for ever would not let `linearize` see that the ring is the same at every step.
"""

import math
from collections.abc import Callable
from typing import Any

from twodof.blocks.declarations import State
from twodof.blocks.expressions.arrays import store
from twodof.blocks.expressions.expr import int32, where


def past_states(ring: int) -> tuple[State, ...]:
    """The samples, where the next one goes, and how many there are."""
    return (
        State("past", 0.0, width=ring),
        State("position", 0, kind="int32"),
        State("age", 0, kind="int32"),
    )


def remember(present: Any, x: Any, ring: int) -> dict[str, Any]:
    """The states of the next step, with `present` among the samples."""
    after = x.position + 1
    return {
        "past": store(x.past, x.position, present),
        "position": where(after < ring, after, int32(0)),
        "age": where(x.age < ring, x.age + 1, x.age),
    }


def past_input(present: Any, x: Any, fits: Any, ring: int) -> Callable[[Any], Any]:
    """The input some steps ago (0 to ring - 1), that of step 0 for any time before; NaN unless `fits`."""

    def ago(steps: Any) -> Any:
        back = x.position - steps
        place = where(x.age < steps, int32(0), where(back < 0, back + ring, back))
        # More than the ring keeps is not a number rather than a wrong one.
        past = where(fits, x.past[place], math.nan)
        return where((steps == 0) | (x.age == 0), present, past)

    return ago
