"""JSON that every browser reads: what is not a finite number is null, since JSON has neither NaN nor infinity."""

from __future__ import annotations

import json
from math import isfinite
from typing import Any

import numpy as np
from fastapi.responses import JSONResponse


def finite(value: Any) -> Any:
    """The value with null for each NaN and infinity, and with lists for arrays of numpy."""
    if isinstance(value, float):  # numpy's float64 is one
        return float(value) if isfinite(value) else None
    if isinstance(value, dict):
        return {str(key): finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [finite(one) for one in value]
    if isinstance(value, np.ndarray):
        return finite(value.tolist())
    if isinstance(value, np.generic):
        return finite(value.item())
    return value


def dumps(value: Any) -> str:
    """The text of a value, see `finite`. Raises TypeError for what JSON has no form of."""
    return json.dumps(finite(value), ensure_ascii=False, allow_nan=False, separators=(",", ":"))


class FiniteJSON(JSONResponse):
    """An answer of JSON without NaN."""

    def render(self, content: Any) -> bytes:
        """The bytes of the answer."""
        return dumps(content).encode("utf-8", "replace")
