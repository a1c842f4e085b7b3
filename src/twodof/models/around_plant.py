"""Blocks around the plant of a structure: the delay of its input, and constants added to its signals.

The past inputs of a delay are a ring of the last `ring` samples. Its counters wrap or stop at a limit: with a counter
that grew for ever, `linearize` could not find a steady state.
"""

import math
from collections.abc import Callable
from typing import Any

from twodof.blocks.block import Block, Clock, library_block
from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.expressions.arrays import store
from twodof.blocks.expressions.expr import int32, to_int32, to_real, where


def past_states(ring: int, *inputs: str) -> tuple[State, ...]:
    """Return the states of the rings of `inputs`: samples, place of the next sample, and number of samples."""
    return (
        *(State(f"past_{one}", 0.0, width=ring) for one in inputs),
        State("position", 0, kind="int32"),
        State("age", 0, kind="int32"),
    )


def remember(u: Any, x: Any, ring: int, *inputs: str) -> dict[str, Any]:
    """Return the states of the next step, with the present `inputs` among the samples."""
    after = x.position + 1
    return {
        **{f"past_{one}": store(x[f"past_{one}"], x.position, u[one]) for one in inputs},
        "position": where(after < ring, after, int32(0)),
        "age": where(x.age < ring, x.age + 1, x.age),
    }


def past_input(u: Any, x: Any, input: str, fits: Any, ring: int) -> Callable[[Any], Any]:
    """Return a function from a number of steps to the input so many steps ago; before step 0 that of step 0.

    Its value is NaN unless `fits`, which says that the ring is long enough.
    """
    present, samples = u[input], x[f"past_{input}"]

    def ago(steps: Any) -> Any:
        back = x.position - steps
        place = where(x.age < steps, int32(0), where(back < 0, back + ring, back))
        # More than the ring keeps is not a number rather than a wrong one.
        past = where(fits, samples[place], math.nan)
        return where((steps == 0) | (x.age == 0), present, past)

    return ago


def whole_and_part(delay: Any, t: Clock) -> tuple[Any, Any]:
    """Return the whole ticks of a delay [s] and the rest as a share of a tick; up to rounding there is none."""
    steps = delay / t.dt
    whole = to_int32(steps + 1e-9)
    part = steps - to_real(whole)
    return whole, where(part > 1e-9, part, 0.0)


@library_block("models.InputDelay")
class InputDelay(Block):
    """Delay of a held input by `tau` seconds, of any length: y(t) = u(t - tau), u = u[0] before the start.

    A continuous block behind it sees the change inside the step (an edge). Unlike the library's fractional delay it
    starts from the record's own first value, so a trim moment needs no parameter. `tau` is at most `ring - 2` ticks;
    a longer one gives NaN.
    """

    def __init__(self, ring: int = 64) -> None:
        self.ring = ring
        self.inputs = (Port("u"),)
        self.outputs = (Port("y"),)
        self.params = (Param("tau", 0.0, unit="s", low=0.0, text="delay of the input"),)
        self.derived = (Port("whole", "int32"), Port("fraction"), Port("fits", "bool"))
        self.states = past_states(ring, "u")

    def prepare(self, p: Any, t: Clock) -> dict[str, Any]:
        """Split the delay into whole ticks and the fraction of a tick."""
        whole, part = whole_and_part(p.tau, t)
        return {"whole": whole, "fraction": part, "fits": p.tau / t.dt <= self.ring - 2.0}

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Return the input of `whole + 1` ticks ago if the delay ends inside the step, else of `whole` ticks ago."""
        ago = past_input(u, x, "u", p.fits, self.ring)
        return ago(where(p.fraction > 0.0, p.whole + 1, p.whole))

    def edges(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, tuple[Any, Any]]:
        """Return the younger value, which arrives after `fraction` of the step."""
        return {"y": (p.fraction, past_input(u, x, "u", p.fits, self.ring)(p.whole))}

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        return remember(u, x, self.ring, "u")


@library_block("models.Offset")
class Offset(Block):
    """y = u + sign * offset, in `unit`."""

    def __init__(self, unit: str = "", sign: float = 1.0) -> None:
        self.sign = sign
        self.inputs = (Port("u", unit=unit),)
        self.outputs = (Port("y", unit=unit),)
        self.params = (Param("offset", 0.0, unit=unit, text="constant part"),)

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return u.u + self.sign * p.offset


@library_block("models.Bend")
class Bend(Block):
    """y = u - bend u^3: the effect of a large command is less than proportional."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)
    params = (Param("bend", 0.0, text="share of the input's cube that is missing"),)

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return u.u - p.bend * (u.u * u.u * u.u)
