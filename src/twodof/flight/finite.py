"""Whether a number is one, and what becomes of a filter whose states are none."""

from collections.abc import Mapping
from functools import reduce
from operator import and_
from types import MappingProxyType
from typing import Any

from twodof.blocks import where


def finite(value: Any) -> Any:
    """Whether a real is finite: for an infinite one and for NaN, value - value is not 0."""
    return value - value == 0.0


PLAUSIBLE = MappingProxyType({"theta": 1.5, "bias": 100.0, "x": 1e6, "x_filter": 1e6, "v": 1e3})
"""How large a state of a filter may become at most, by name, in SI: the pitch has stops."""


def restarted(new: Mapping[str, Any], first: Mapping[str, Any]) -> dict[str, Any]:
    """The states `new` of a filter, or, if one of them is NaN or not `PLAUSIBLE`, those that it begins with.

    These are `first`, by name, 0 if unnamed. A filter that has once taken a sample that cannot be would else give no
    number for ever.
    """
    sound = reduce(and_, [abs(value) <= PLAUSIBLE[name] for name, value in new.items() if name in PLAUSIBLE])
    return {name: where(sound, value, first.get(name, 0.0)) for name, value in new.items()}
