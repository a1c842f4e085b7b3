"""The parameters of the users' controllers that fly, as rows of the vehicle's list.

A parameter has the same name as in the diagram's PX4 module (docs/explanation/targets.md), so that a ground station's
file fits both. A value at its default flies with all bits of the diagram's number, although the wire carries float32.
"""

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from twodof.blocks import Diagram, Param
from twodof.blocks.declarations import rows_of
from twodof.blocks.expressions.numbers import FLOATS
from twodof.blocks.schema.json_form import to_json
from twodof.compile.program.lower import lower
from twodof.compile.px4.names import harmless, module_names
from twodof.compile.px4.parameters import LARGEST_FLOAT, LARGEST_INT, SMALLEST_INT, ExportedParameter, diagram_rows
from twodof.errors import listed
from twodof.fcu.parameters.table import VehicleParameter, wire_rows
from twodof.flight.templates import by_kind
from twodof.parameters import float32_decimal
from twodof.signals import PERIOD

LONGEST_TEXT, LONGEST_UNIT = 160, 20
"""Longest text and unit that are taken from an unchecked diagram."""


@dataclass(frozen=True)
class UserParameters:
    """Tunable parameters of the controller `name` of the template `kind`; `identity` is the SHA-256 of its JSON `text`.

    `rows` are the parameters in the vehicle's list; `remark` says which ones of the diagram are not, "" if all are.
    """

    kind: str
    name: str
    identity: str
    rows: tuple[VehicleParameter, ...]
    remark: str = ""
    text: str = field(default="", repr=False)
    _elements: Mapping[str, tuple[Param, tuple[VehicleParameter, ...]]] = field(default_factory=dict, repr=False)

    def flying(self, values: Mapping[str, float]) -> dict[str, Any]:
        """Return the values to fly by path (`attitude_control.k_q`), lists for arrays; `values` are by name."""
        flying: dict[str, Any] = {}
        for path, (declared, rows) in self._elements.items():
            defaults = np.ravel(np.asarray(declared.value), order="F").tolist()
            numbers = [
                _exact(declared, row, values[row.name], defaults[place if len(defaults) > 1 else 0])
                for place, row in enumerate(rows)
            ]
            flying[path] = numbers[0] if declared.width is None else rows_of(numbers, declared.shape)
        return flying


def user_parameters(controllers: Iterable[Diagram]) -> tuple[UserParameters, ...]:
    """Return the tunable parameters of `controllers`, in the order of templates: names of later ones may be shortened.

    Raises DiagramError for two parameters with the same name.
    """
    taken = {row.name for row in wire_rows(1)}
    found = []
    for kind, diagram in sorted(by_kind(controllers).items()):
        user = _of(kind, diagram, taken)
        taken |= {row.name for row in user.rows}
        found.append(user)
    return tuple(found)


def _of(kind: str, diagram: Diagram, taken: Iterable[str]) -> UserParameters:
    program = lower(diagram, PERIOD)
    shown, kept = diagram_rows(program, module_names(diagram.name).prefix, taken, kind)
    rows: list[VehicleParameter] = []
    elements: dict[str, tuple[Param, tuple[VehicleParameter, ...]]] = {}
    for one in shown:
        if one.fixed:
            continue
        row = _row(kind, diagram.name, one)
        rows.append(row)
        path = f"{kind}.{one.path}"
        _, before = elements.get(path, (None, ()))
        elements[path] = program.parameters[one.path].declared, (*before, row)
    left = [one.path for one in kept]
    remark = f"{kind}: {len(left)} parameters are not shown: {listed(left, 3)}"[:200] if left else ""
    text = to_json(diagram)
    identity = hashlib.sha256(text.encode()).hexdigest()
    return UserParameters(kind, diagram.name, identity, tuple(rows), remark, text, elements)


def _row(kind: str, diagram: str, one: ExportedParameter) -> VehicleParameter:
    path = f"{kind}.{one.place}"
    text = ": ".join(filter(None, (path, one.text)))
    default, low, high = one.default, one.low, one.high
    if one.kind == "real":
        default, low, high = float32_decimal(default), float32_decimal(low), float32_decimal(high)
    return VehicleParameter(
        one.name,
        default,
        low,
        high,
        harmless(one.unit, LONGEST_UNIT),
        harmless(text, LONGEST_TEXT),
        kind="float" if one.kind == "real" else "int32",
        tuning=True,
        group=f"Controller {diagram}",
        user_path=path,
        bounded=one.low not in (-LARGEST_FLOAT, SMALLEST_INT) or one.high not in (LARGEST_FLOAT, LARGEST_INT),
    )


def _exact(declared: Param, row: VehicleParameter, value: float, default: Any) -> Any:
    """Return the number that flies for a row's value."""
    if declared.kind == "bool":
        return bool(value)
    if declared.kind not in FLOATS:
        return int(value)
    # A bound, too, may lie between two numbers of float32.
    return float(default) if value == row.default else min(max(float(value), declared.low), declared.high)
