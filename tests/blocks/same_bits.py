"""Comparison of two values of the language to the bit."""

from typing import Any

import numpy as np

from twodof.blocks.expressions.numbers import Integer


def same_bits(a: Any, b: Any) -> bool:
    """Return True if two numbers (or Vectors) are equal to the bit; all NaNs are equal, -0.0 differs from 0.0."""
    if isinstance(a, tuple):
        return len(a) == len(b) and all(same_bits(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, Integer):
        return type(a) is type(b) and a.value == b.value
    if isinstance(a, np.floating):
        if np.isnan(a) or np.isnan(b):
            return bool(np.isnan(a) and np.isnan(b))
        return type(a) is type(b) and a.tobytes() == b.tobytes()
    return bool(a == b)
