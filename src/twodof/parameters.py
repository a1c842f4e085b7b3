"""PARAMETERS: what may be tuned while the drone flies; ParameterSet: bounded, all or nothing, undoable.

A name has at most 16 characters, as MAVLink's PARAM_SET carries it. Where the real drone has the parameter
too, `drone` is what QGroundControl calls it there, and a ParameterSet answers to either name. Bounds are the
drone's where it has them.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from numbers import Real
from types import MappingProxyType
from typing import Literal

from twodof.errors import ParameterError

NAME_LENGTH = 16
UNDO_STEPS = 100
_VERSION = 1


@dataclass(frozen=True)
class Parameter:
    """One tunable number: `low` <= value <= `high` in `unit`; one of kind "int32" is a whole number."""

    name: str
    default: float
    low: float
    high: float
    unit: str
    text: str
    drone: str = ""
    kind: Literal["float", "int32"] = "float"

    def __post_init__(self) -> None:
        if not 1 <= len(self.name) <= NAME_LENGTH or not self.name.isascii():
            raise ParameterError(f"a name has 1 to {NAME_LENGTH} ASCII characters", self.name)
        if not all(isfinite(bound) for bound in (self.low, self.default, self.high)):
            raise ParameterError("default and bounds must be finite", self.name)
        if not self.low <= self.default <= self.high:
            raise ParameterError(f"default {self.default:g} is outside {self.low:g} to {self.high:g}", self.name)
        whole = all(float(number).is_integer() for number in (self.low, self.default, self.high))
        if self.kind == "int32" and not (whole and -(2**31) <= self.low <= self.high < 2**31):
            raise ParameterError("default and bounds must be whole numbers of 32 bits", self.name)

    def kept(self, value: float) -> float:
        """A value within the bounds as a set keeps it: int for int32, else float."""
        return int(value) if self.kind == "int32" else float(value)


PARAMETERS: tuple[Parameter, ...] = (
    Parameter("RATE_KP", 0.0854, 0.0, 0.12, "s/rad", "rate loop, proportional gain", "FC_PARAM_4"),
    Parameter("RATE_KI", 0.251, 0.0, 0.5, "1/rad", "rate loop, integral gain", "FC_PARAM_5"),
    Parameter("RATE_KD", 0.00054, 0.0, 0.003, "s^2/rad", "rate loop, derivative gain", "FC_PARAM_6"),
    Parameter("RATE_N", 100.0, 1.0, 250.0, "1/s", "rate loop, bandwidth of the derivative's filter"),
    Parameter("ATT_KP", 11.0, 0.0, 15.0, "1/s", "attitude loop, proportional gain", "FC_PARAM_11"),
    Parameter("VEL_KP", 2.4, 0.0, 4.0, "N s/m", "velocity loop, proportional gain", "FC_PARAM_13"),
    Parameter("VEL_KI", 2.81, 0.0, 4.0, "N/m", "velocity loop, integral gain", "FC_PARAM_14"),
    Parameter("POS_KP", 1.5, 0.0, 2.5, "1/s", "position loop, proportional gain", "FC_PARAM_19"),
    Parameter("THRUST_BAR", 0.4, 0.05, 1.0, "-", "thrust held while flying level"),
    Parameter("THRUST_ETA", 6.3386, 1.0, 20.0, "N", "force at full thrust, of the projection to theta0"),
    Parameter("M_MAX", 1.0, 0.0, 1.0, "-", "limit of the moment commanded"),
    Parameter("X0_MAX", 0.3, 0.0, 0.4, "m", "limit of the position set-point"),
)

PRESETS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "default": MappingProxyType({}),
        "student": MappingProxyType(
            {
                "RATE_KP": 0.0651,
                "RATE_KI": 0.35,
                "RATE_KD": 0.000896,
                "ATT_KP": 6.1986,
                "VEL_KP": 2.19,
                "VEL_KI": 1.46,
                "POS_KP": 0.7,
            }
        ),
    }
)
"""Sets of values flown on the real drone, as differences from the defaults."""


class ParameterSet(Mapping[str, float]):
    """Values of a table of parameters. What is read is always a whole, valid set.

    A change takes effect entirely or not at all, and each is one step that `undo` takes back. `revision`
    counts the changes, undone ones too, so that a reader sees that something changed.
    """

    def __init__(self, values: Mapping[str, float] | None = None, table: tuple[Parameter, ...] = PARAMETERS) -> None:
        """Defaults of `table`, then `values`. Raises ParameterError as `update` does."""
        self._rows = {row.name: row for row in table}
        self._alias = {row.drone: row.name for row in table if row.drone}
        if len(self._rows) != len(table) or len({*self._rows, *self._alias}) != len(table) + len(self._alias):
            raise ParameterError("two parameters have one name", ", ".join(row.name for row in table))
        self._values: Mapping[str, float] = {row.name: row.kept(row.default) for row in table}
        self._values = {**self._values, **self._checked(values or {})}
        self._undo: list[Mapping[str, float]] = []
        self._redo: list[Mapping[str, float]] = []
        self.revision = 0

    def __getitem__(self, name: str) -> float:
        """A value, by either name. Raises ParameterError for an unknown one."""
        return self._values[self.row(name).name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)

    def __contains__(self, name: object) -> bool:
        return name in self._rows or name in self._alias

    def row(self, name: str) -> Parameter:
        """Bounds, unit and text of a parameter, by either name. Raises ParameterError for an unknown one."""
        row = self._rows.get(self._alias.get(name, name))
        if row is None:
            raise ParameterError("no such parameter", str(name), f"there are: {', '.join(self._rows)}")
        return row

    def snapshot(self) -> dict[str, float]:
        """All values at one moment, as a copy."""
        return dict(self._values)

    def set(self, name: str, value: float) -> None:
        """Changes one value. Raises ParameterError as `update` does."""
        self.update({name: value})

    def update(self, changes: Mapping[str, float]) -> None:
        """Changes several values together, as one step to undo.

        Raises ParameterError, and then changes nothing, if a name is unknown or given twice, or a value is no
        number, not finite or outside its bounds; the message lists every fault.
        """
        checked = self._checked(changes)
        changed = {name: value for name, value in checked.items() if value != self._values[name]}
        if changed:
            self._undo = [*self._undo[-(UNDO_STEPS - 1) :], self._values]
            self._redo = []
            self._commit({**self._values, **changed})

    def reset(self) -> None:
        """Back to the defaults, as one step to undo."""
        self.update({row.name: row.default for row in self._rows.values()})

    def undo(self) -> None:
        """Takes the latest change back. Raises ParameterError if there is none (100 are kept)."""
        if not self._undo:
            raise ParameterError("there is nothing to undo", "parameters")
        self._redo.append(self._values)
        self._commit(self._undo.pop())

    def redo(self) -> None:
        """Makes the change again that `undo` took back. Raises ParameterError if there is none."""
        if not self._redo:
            raise ParameterError("there is nothing to redo", "parameters")
        self._undo.append(self._values)
        self._commit(self._redo.pop())

    def forget(self) -> None:
        """Forgets what could be undone or made again."""
        self._undo, self._redo = [], []

    @property
    def before(self) -> Mapping[str, float] | None:
        """The values that `undo` would bring back; None if there are none."""
        return MappingProxyType(self._undo[-1]) if self._undo else None

    @property
    def after(self) -> Mapping[str, float] | None:
        """The values that `redo` would bring; None if there are none."""
        return MappingProxyType(self._redo[-1]) if self._redo else None

    def to_json(self) -> str:
        """The values as JSON; numbers read back to the same bits."""
        return json.dumps({"version": _VERSION, "parameters": self.snapshot()}, indent=2)

    def load_json(self, text: str) -> None:
        """Takes the values of a JSON text over, as one step to undo; what it does not name stays.

        Raises ParameterError, and then changes nothing.
        """
        try:
            content = json.loads(text)
        except (ValueError, RecursionError) as reason:
            raise ParameterError(f"is no JSON: {reason}", "parameters", "write it with to_json") from reason
        if not isinstance(content, dict) or content.get("version") != _VERSION:
            raise ParameterError(f"is not of version {_VERSION}", "parameters", "write it with to_json")
        values = content.get("parameters")
        if not isinstance(values, dict):
            raise ParameterError("has no table 'parameters'", "parameters", "write it with to_json")
        self.update(values)

    def check(self, changes: Mapping[str, float]) -> tuple[dict[str, float], list[str]]:
        """The changes that are right, by main name and as they would be kept, and what is wrong with the others."""
        good: dict[str, float] = {}
        faults = []
        for name, value in changes.items():
            fault = self._fault(name, value)
            if fault:
                faults.append(f"{name}: {fault}")
                continue
            row = self.row(name)
            if row.name in good:
                faults.append(f"{name}: given twice")
            good[row.name] = row.kept(value)
        return good, faults

    def _checked(self, changes: Mapping[str, float]) -> dict[str, float]:
        good, faults = self.check(changes)
        if faults:
            raise ParameterError("; ".join(faults), "parameters", "nothing was changed")
        return good

    def _fault(self, name: str, value: float) -> str:
        """What is wrong with a value, or ""."""
        if name not in self:
            return f"no such parameter, there are {', '.join(self._rows)}"
        row = self.row(name)
        # bool is a number to Python, and `True` for a gain is a mistake
        if isinstance(value, bool) or not isinstance(value, Real):
            return f"{value!r} is no number"
        if isinstance(value, int) and abs(value) > 2**1000:  # beyond any float, which isfinite does not take
            return f"is outside {row.low:g} to {row.high:g} {row.unit}"
        if not isfinite(value) or not row.low <= value <= row.high:
            return f"{float(value):g} is outside {row.low:g} to {row.high:g} {row.unit}"
        if row.kind == "int32" and not float(value).is_integer():
            return f"{float(value):g} is no whole number"
        return ""

    def _commit(self, values: Mapping[str, float]) -> None:
        # One assignment: a reader in another thread sees the old set or the new one, never a mixture.
        self._values = values
        self.revision += 1
