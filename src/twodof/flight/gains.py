"""Gains: the numbers of the cascade's loops, by name, by JSON file, by the path of the parameter they set."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from twodof.errors import LogError, ParameterError
from twodof.flightlog.provenance import read_bytes
from twodof.parameters import PARAMETERS, PRESETS

_NAMES = ("RATE_KP", "RATE_KI", "RATE_KD", "ATT_KP", "VEL_KP", "VEL_KI", "POS_KP")
"""What the drone calls the gains, in the order of `Gains.parameters`."""
_LARGEST = float(np.finfo(np.float32).max)
_SHAPE = '{"rate": [Kp, Ki, Kd], "attitude": Kp, "velocity": [Kp, Ki], "position": Kp}'


@dataclass(frozen=True)
class Gains:
    """The gains of the four loops: `rate` (Kp [s/rad], Ki [1/rad], Kd [s2/rad]), `attitude` Kp [1/s],
    `velocity` (Kp [N s/m], Ki [N/m]), `position` Kp [1/s]. Raises ParameterError for another number of gains and for
    what is no number, not finite or negative.
    """

    rate: tuple[float, float, float]
    attitude: float
    velocity: tuple[float, float]
    position: float

    def __post_init__(self) -> None:
        for name, count in (("rate", 3), ("velocity", 2)):
            values = getattr(self, name)
            if not isinstance(values, (tuple, list)) or len(values) != count:
                raise ParameterError(f"{values!r:.80} is not {count} numbers", name, f"give {_SHAPE}")
        for name, value in self.parameters().items():
            if isinstance(value, bool) or not isinstance(value, Real):
                raise ParameterError(f"a gain of {value!r:.80}", name, "give a number")
            if not 0.0 <= value <= sys.float_info.max:
                raise ParameterError(f"a gain of {value!r:.80}", name, "gains are finite and not negative")

    def parameters(self) -> dict[str, float]:
        """Parameter path inside the cascade -> value."""
        kp, ki, kd = self.rate
        return {
            "rate.kp": kp,
            "rate.ki": ki,
            "rate.kd": kd,
            "attitude.kp": self.attitude,
            "velocity.kp": self.velocity[0],
            "velocity.ki": self.velocity[1],
            "position.kp": self.position,
        }

    def tuned(self) -> dict[str, float]:
        """Those that are not the default ones, by the names of the drone's parameters ("RATE_KP")."""
        values = dict(zip(_NAMES, self.parameters().values(), strict=True))
        defaults = {row.name: row.default for row in PARAMETERS}
        return {name: value for name, value in values.items() if value != defaults[name]}

    @classmethod
    def flown(cls, provenance: Mapping[str, Any]) -> Gains | None:
        """The gains that a log's provenance says were flown, by the drone's parameters; None where it says nothing.

        A flight and a recording have those that were tuned, a log of our flight controller all of them, in float32.
        """
        drone = provenance.get("drone")
        known = provenance.get("parameters", drone.get("parameters") if isinstance(drone, Mapping) else None)
        if not isinstance(known, Mapping) or ("ulog" in provenance and not set(_NAMES) <= set(known)):
            return None
        if not all(_is_gain(known.get(name, 0.0)) for name in _NAMES):
            return None
        defaults = {row.name: row.default for row in PARAMETERS}
        # The shortest decimal of a float32 is what was set.
        kp, ki, kd, attitude, velocity_kp, velocity_ki, position = (
            float(str(np.float32(known[name]))) if name in known else defaults[name] for name in _NAMES
        )
        return cls((kp, ki, kd), attitude, (velocity_kp, velocity_ki), position)

    def to_json(self) -> dict[str, Any]:
        """The form `from_json` reads."""
        return {
            "rate": list(self.rate),
            "attitude": self.attitude,
            "velocity": list(self.velocity),
            "position": self.position,
        }

    @classmethod
    def from_json(cls, data: object, where: str = "gains") -> Gains:
        """Gains from `{"rate": [Kp, Ki, Kd], "attitude": Kp, "velocity": [Kp, Ki], "position": Kp}`.

        Raises ParameterError for another shape; `where` names its source in the message.
        """
        if not isinstance(data, Mapping) or set(data) != {"rate", "attitude", "velocity", "position"}:
            raise ParameterError("not a set of gains", where, f"give {_SHAPE}")
        kp, ki, kd = _numbers(data["rate"], 3, f"{where}: rate")
        velocity_kp, velocity_ki = _numbers(data["velocity"], 2, f"{where}: velocity")
        (attitude,) = _numbers([data["attitude"]], 1, f"{where}: attitude")
        (position,) = _numbers([data["position"]], 1, f"{where}: position")
        return cls((kp, ki, kd), attitude, (velocity_kp, velocity_ki), position)


def _is_gain(value: object) -> bool:
    """Whether it is a number that float32 carries and a gain may be."""
    return isinstance(value, int | float) and not isinstance(value, bool) and 0.0 <= value <= _LARGEST


def _preset(name: str) -> Gains:
    values = {row.name: row.default for row in PARAMETERS} | dict(PRESETS[name])
    kp, ki, kd, attitude, velocity_kp, velocity_ki, position = (values[one] for one in _NAMES)
    return Gains((kp, ki, kd), attitude, (velocity_kp, velocity_ki), position)


NAMED: Mapping[str, Gains] = MappingProxyType({name: _preset(name) for name in PRESETS})
"""The sets the drone was flown with: its own, and one designed by loop shaping in the course."""

MAX_BYTES = 1 << 20
"""Of a file of gains."""

DEFAULT, STUDENT = NAMED["default"], NAMED["student"]


def load_gains(source: str | Path) -> Gains:
    """The gains called `source` ("default", "student"), or those of a JSON file. Raises ParameterError."""
    if str(source) in NAMED:
        return NAMED[str(source)]
    try:
        data = json.loads(read_bytes(source, MAX_BYTES))
    except LogError as reason:
        raise ParameterError(reason.what, str(source), f"name a file or one of {', '.join(NAMED)}") from reason
    except (ValueError, RecursionError) as reason:
        raise ParameterError(f"is no JSON: {reason}", str(source), f"write {_SHAPE}") from reason
    return Gains.from_json(data, str(source))


def _numbers(values: object, count: int, where: str) -> list[float]:
    if isinstance(values, list) and len(values) == count:
        numbers = [v for v in values if isinstance(v, (int, float)) and not isinstance(v, bool)]
        if len(numbers) == count:
            return numbers
    raise ParameterError(f"{values!r:.80} is not {count} number{'s' * (count > 1)}", where, f"give {_SHAPE}")
