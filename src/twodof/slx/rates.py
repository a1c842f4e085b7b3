"""Sample times of a model: the base period, and at which of its ticks each block runs.

A block without a sample time of its own takes the fastest one of its inputs, as Simulink does.
"""

from collections import deque
from collections.abc import Mapping, Set
from fractions import Fraction
from functools import reduce
from math import gcd, lcm

from twodof.blocks.diagram import BASE, Rate
from twodof.slx.translation import NotTranslated

Key = tuple[str, str]
"""A block: path of its system and identifier."""
CONTINUOUS = ("Integrator", "SecondOrderIntegrator", "TransferFcn", "StateSpace", "ZeroPole", "Derivative",
              "TransportDelay")  # fmt: skip
"""Types whose step is the solver's."""

EVERY_SECOND = ("DigitalClock", "DiscreteIntegrator", "DiscretePulseGenerator", "DiscreteStateSpace", "UnitDelay",
                "ZeroOrderHold")  # fmt: skip
"""Types with a sample time of 1 s where the file does not say it."""


def base_period(times: Mapping[float, str], given: float | None = None) -> float:
    """Return the longest period [s] of which all `times` are multiples, or the `given` one; each has a place's name.

    Raises NotTranslated where there is none, or a time is no multiple of the given one.
    """
    if given is not None:
        for time, where in times.items():
            if abs(time / given - round(time / given)) > 1e-6:
                raise NotTranslated(f"{time:g} s ({where}) is no multiple of {given:g} s (--dt)")
        return given
    parts = [Fraction(time).limit_denominator(10**7) for time in times]
    below = lcm(*(part.denominator for part in parts))
    common = Fraction(reduce(gcd, (int(part * below) for part in parts)), below)
    nearest = min(times)
    if common == Fraction(nearest).limit_denominator(10**7):
        return nearest  # its own bits
    if common * 10**5 < max(parts):
        several = ", ".join(f"{time:g} s ({where})" for time, where in sorted(times.items()))
        raise NotTranslated(f"these periods have no common one: {several}")
    return float(common)


def inherited(declared: Mapping[Key, Rate], sources: Mapping[Key, Set[Key]]) -> dict[Key, Rate]:
    """Return the rates of all blocks that have one, `declared` or from the blocks in `sources` that feed them."""
    rates = dict(declared)
    followers: dict[Key, list[Key]] = {}
    for key, feeding in sources.items():
        for one in feeding:
            followers.setdefault(one, []).append(key)
    waiting = deque(declared)
    while waiting:
        for key in followers.get(waiting.popleft(), ()):
            found = [rates[one] for one in sources[key] if one in rates]
            fastest = min(found)
            if any(one.divider % fastest.divider or (one.offset - fastest.offset) % fastest.divider for one in found):
                fastest = BASE
            if key not in declared and (faster := min(fastest, rates.get(key, fastest))) != rates.get(key):
                rates[key] = faster
                waiting.append(key)
    return rates
