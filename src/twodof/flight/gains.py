"""Gains of the cascade's loops: the stock (default) gains, named sets, JSON files, and the parameters that they set."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

from twodof.errors import LogError, ParameterError
from twodof.flightlog.provenance import read_bytes
from twodof.parameters import PARAMETERS, PRESETS, ParameterSet, float32_decimal

_ROWS = {
    row.name: row for row in PARAMETERS if row.path.startswith("cascade.") and row.path[-3:] in (".kp", ".ki", ".kd")
}
"""The parameter rows of the gains by name, in the order of the fields of `Gains`."""
GAIN_NAMES = tuple(_ROWS)
"""Names of the gains as parameters of the drone ("RATE_KP")."""

_DEFAULTS = {name: row.default for name, row in _ROWS.items()}
_CASCADE = "cascade."
_SHAPE = '{"rate": [Kp, Ki, Kd], "attitude": Kp, "velocity": [Kp, Ki], "position": Kp}'


@dataclass(frozen=True)
class Gains:
    """Gains of the four loops.

    `rate` has Kp [s/rad], Ki [1/rad] and Kd [s2/rad], `attitude` Kp [1/s], `velocity` Kp [N s/m] and Ki [N/m],
    `position` Kp [1/s]. Raises ParameterError for a wrong number of gains, and for a gain outside the bounds of the
    drone's parameter.
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
        _, faults = ParameterSet(table=tuple(_ROWS.values())).check(self._named())
        if faults:
            raise ParameterError("; ".join(faults), "gains", "give values within the bounds")

    def _named(self) -> dict[str, float]:
        return dict(zip(_ROWS, (*self.rate, self.attitude, *self.velocity, self.position), strict=True))

    def parameters(self) -> dict[str, float]:
        """Return the gains by the path of their parameter inside the cascade ("rate.kp")."""
        return {_ROWS[name].path.removeprefix(_CASCADE): value for name, value in self._named().items()}

    def tuned(self) -> dict[str, float]:
        """Return the gains that differ from the defaults, by the names of the drone's parameters ("RATE_KP")."""
        return {name: value for name, value in self._named().items() if value != _DEFAULTS[name]}

    def changed(self, name: str, value: float) -> Self:
        """Return the gains with the drone's parameter `name` set to `value`, read as float32.

        Unchanged if `name` is not a gain or `value` is out of its bounds.
        """
        if name not in _ROWS or ParameterSet(table=(_ROWS[name],)).check({name: value})[1]:
            return self
        return self._of({**self._named(), name: float32_decimal(value)})

    @classmethod
    def from_provenance(cls, provenance: Mapping[str, Any]) -> Self | None:
        """Return the gains that flew, from a log's provenance. None if it does not tell them all, or one is invalid.

        A flight or recording holds those that differ from the defaults; an onboard log holds all of them, in float32.
        """
        drone = provenance.get("drone")
        known = provenance.get("parameters", drone.get("parameters") if isinstance(drone, Mapping) else None)
        if not isinstance(known, Mapping) or ("ulog" in provenance and not _ROWS.keys() <= known.keys()):
            return None
        # The value that was set is the shortest decimal of the float32.
        given = {name: float32_decimal(known[name]) for name in _ROWS if name in known}
        wrong = ParameterSet(table=tuple(_ROWS.values())).check(given)[1]
        return None if wrong else cls._of(_DEFAULTS | given)

    @classmethod
    def _of(cls, values: Mapping[str, float]) -> Self:
        kp, ki, kd, attitude, velocity_kp, velocity_ki, position = (values[name] for name in _ROWS)
        return cls((kp, ki, kd), attitude, (velocity_kp, velocity_ki), position)

    def to_json(self) -> dict[str, Any]:
        """Return the form that `from_json` reads."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in vars(self).items()}

    @classmethod
    def from_json(cls, data: object, where: str = "gains") -> Self:
        """Return the gains in `{"rate": [Kp, Ki, Kd], "attitude": Kp, "velocity": [Kp, Ki], "position": Kp}`.

        Raises ParameterError for another form; `where` names the source of `data` in the message.
        """
        if not isinstance(data, Mapping) or set(data) != {"rate", "attitude", "velocity", "position"}:
            raise ParameterError("this is not a set of gains", where, f"give {_SHAPE}")
        numbers: list[float] = []
        for name, count in (("rate", 3), ("attitude", 1), ("velocity", 2), ("position", 1)):
            numbers += _numbers(data[name] if count > 1 else [data[name]], count, f"{where}: {name}")
        try:
            return cls._of(dict(zip(_ROWS, numbers, strict=True)))
        except ParameterError as error:
            raise ParameterError(error.what, where, error.remedy) from error


NAMED: Mapping[str, Gains] = MappingProxyType(
    {name: Gains._of(_DEFAULTS | dict(values)) for name, values in PRESETS.items()}
)
"""Sets of gains that flew on the real drone: its defaults, and one designed by loop shaping in the course."""

MAX_BYTES = 1 << 20
"""Largest size of a file of gains, in bytes."""

DEFAULT, STUDENT = NAMED["default"], NAMED["student"]


def load_gains(source: str | Path) -> Gains:
    """Return the gains "default" or "student", or those of a JSON file. Raises ParameterError for any other source."""
    if str(source) in NAMED:
        return NAMED[str(source)]
    try:
        data = json.loads(read_bytes(source, MAX_BYTES))
    except LogError as reason:
        raise ParameterError(reason.what, str(source), f"name a file or one of {', '.join(NAMED)}") from reason
    except (ValueError, RecursionError) as reason:
        raise ParameterError(f"the file is not JSON: {reason}", str(source), f"write {_SHAPE}") from reason
    return Gains.from_json(data, str(source))


def _numbers(values: object, count: int, where: str) -> list[float]:
    if isinstance(values, list) and len(values) == count:
        numbers = [v for v in values if isinstance(v, (int, float)) and not isinstance(v, bool)]
        if len(numbers) == count:
            return numbers
    raise ParameterError(f"{values!r:.80} is not {count} number{'s' * (count > 1)}", where, f"give {_SHAPE}")
