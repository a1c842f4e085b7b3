"""One parameter of a drone as a client has it: what the drone told of it, and how the drone describes it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from twodof.errors import ParameterError, shown
from twodof.link.mavlink.messages import int_of_float
from twodof.parameters import PARAMETERS, Parameter

INT32, REAL32 = 6, 9
"""MAV_PARAM_TYPE."""
MOST = 5000
"""Parameters of a drone that are kept."""
BY_NAME: Mapping[str, Parameter] = MappingProxyType(
    {name: row for row in PARAMETERS for name in (row.name, row.drone) if name}
)
"""What the package knows, by its own names and the real drone's."""
_TYPES = MappingProxyType({"Int32": "int32", "Float": "float"})
_LARGEST = 3.4028234663852886e38  # of float32: what has no bounds


@dataclass(frozen=True)
class ParameterDescription(Parameter):
    """A parameter as the drone describes it; `path` is where it stands in a user's controller that flies there."""

    path: str = ""


class ParameterEntry(NamedTuple):
    """A parameter as the drone told it: `kind` is a MAV_PARAM_TYPE, `described` what it says of it if it was asked."""

    name: str
    value: float
    kind: int
    place: int
    described: ParameterDescription | None = None

    @property
    def row(self) -> Parameter | None:
        """Bounds, unit and text: the drone's description, or what the package knows, or None."""
        return self.described or BY_NAME.get(self.name)


def same_as(name: str) -> str:
    """Our name of a number that `name` is only the real drone's name of; "" for any other."""
    row = BY_NAME.get(name)
    return "" if row is None or row.name == name else row.name


def entry_of(got: Any) -> ParameterEntry:
    """What a PARAM_VALUE tells."""
    value = float(int_of_float(got.param_value)) if got.param_type == INT32 else _decimal(got.param_value)
    return ParameterEntry(str(got.param_id), value, int(got.param_type), int(got.param_index))


def read_description(content: bytes) -> list[ParameterDescription]:
    """The rows of a drone's parameters.json. Raises ValueError, LookupError, TypeError, ParameterError for none."""
    return [_described(row) for row in json.loads(content)["parameters"][:MOST]]


def _described(row: Any) -> ParameterDescription:
    kind = _TYPES[row["type"]]
    low, high = (-_LARGEST, _LARGEST) if kind == "float" else (-(2**31), 2**31 - 1)
    return ParameterDescription(
        str(row["name"]),
        row["default"],
        row.get("min", low),
        row.get("max", high),
        str(row.get("units", "")),
        str(row.get("shortDesc", "")),
        kind="float" if kind == "float" else "int32",
        path=str(row.get("path", "")),
    )


def checked(entry: ParameterEntry, value: float) -> float:
    """A value that the parameter can have. Raises ParameterError."""
    row = entry.row
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise ParameterError(f"{shown(value)} is not a number", entry.name, "nothing was changed")
    if entry.kind not in (INT32, REAL32):
        raise ParameterError(f"has the type {entry.kind}, which is not set from here", entry.name)
    if entry.kind == INT32 and (value != int(value) or not -(2**31) <= value < 2**31):
        raise ParameterError(f"{value:g} is not an int32", entry.name, "nothing was changed")
    if row is not None and not row.low <= value <= row.high:
        raise ParameterError(
            f"{value:g} is outside {row.low:g} to {row.high:g} {row.unit}", entry.name, "nothing was changed"
        )
    return value


def _decimal(value: float) -> float:
    """The shortest decimal that is this float32: 0.07 was sent, 0.07 is read."""
    return float(str(np.float32(value)))
