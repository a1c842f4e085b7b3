"""Whether two values of the language are the same."""

from typing import Any

import numpy as np

from twodof.blocks.expressions.numbers import Integer


def same_bits(a: Any, b: Any) -> bool:
    """Whether two numbers (or Vectors) are the same value to the bit; all NaNs are one value, -0.0 differs from 0.0."""
    if isinstance(a, tuple):
        return len(a) == len(b) and all(same_bits(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, Integer):
        return type(a) is type(b) and a.value == b.value
    if isinstance(a, np.floating):
        if np.isnan(a) or np.isnan(b):
            return bool(np.isnan(a) and np.isnan(b))
        return type(a) is type(b) and a.tobytes() == b.tobytes()
    return bool(a == b)
