"""Whether a number is one."""

from __future__ import annotations

from typing import Any


def finite(value: Any) -> Any:
    """Whether a real is neither infinite nor NaN: those leave a difference to themselves that is no 0."""
    return value - value == 0.0
