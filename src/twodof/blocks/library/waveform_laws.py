"""Laws of test signals, which the blocks that play them share with `twodof.excitation`, which stores them.

`shifted` takes numbers of the block language as well as Python's. Sources: Jategaonkar, Flight Vehicle
System Identification, chapter 2; Golomb, Shift Register Sequences.
"""

from collections.abc import Mapping
from typing import Any

LAWS = ("linear", "logarithmic")
"""How a sweep's frequency goes from its start to its end."""

MAX_LINES = 500
MAX_HARMONIC = 10_000
"""Of a multisine."""

PATTERNS: Mapping[str, tuple[int, ...]] = {"doublet": (1, -1), "3-2-1-1": (3, -2, 1, -1)}
"""Signals that are held at plus or minus their amplitude: for how many times the unit of time, with the sign."""

# Feedback taps of the primitive polynomials of lowest weight: the register runs through all 2^order - 1 states.
TAPS: Mapping[int, tuple[int, ...]] = {
    3: (3, 2),
    4: (4, 3),
    5: (5, 3),
    6: (6, 5),
    7: (7, 6),
    8: (8, 6, 5, 4),
    9: (9, 5),
    10: (10, 7),
    11: (11, 9),
    12: (12, 6, 4, 1),
    13: (13, 4, 3, 1),
    14: (14, 5, 3, 1),
    15: (15, 14),
    16: (16, 15, 13, 4),
}
"""By the order of a pseudo-random binary sequence."""


def shifted(register: Any, order: int) -> Any:
    """Return a linear feedback shift register of `order` bits after one step; its lowest bit is the output."""
    feedback = register & 0
    for tap in TAPS[order]:
        feedback = feedback ^ (register >> (order - tap))
    return (register >> 1) | ((feedback & 1) << (order - 1))
