"""What a log says was flown: the gains, the user's controllers, and what was tuned in flight."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from twodof.blocks import Diagram
from twodof.blocks.schema.json_form import from_json
from twodof.errors import TwodofError
from twodof.flight.gains import Gains
from twodof.flight.templates import TEMPLATES, check_template

Change = tuple[float, str, float]
"""Time [s] of the last step that may have had the old value, the parameter's name or path, and its new value."""

_MOST = 3e38


@dataclass(frozen=True)
class FlownParameters:
    """The gains at the start of a log, None where it does not say, and the `changes` in flight, by time.

    `controllers` are diagrams by template, `tuning` their parameters at the start by path. `unknown` names the user's
    controllers whose diagram the log lacks.
    """

    gains: Gains | None = None
    changes: tuple[Change, ...] = ()
    controllers: Mapping[str, Diagram] = field(default_factory=dict)
    tuning: Mapping[str, Any] = field(default_factory=dict)
    unknown: tuple[str, ...] = ()

    @classmethod
    def of(cls, provenance: Mapping[str, Any]) -> FlownParameters:
        """Of a log's provenance, which anybody may have written: what is not understood counts as not said."""
        drone = provenance.get("drone")
        drone = drone if isinstance(drone, Mapping) else {}
        noted = provenance.get("controllers") or drone.get("controllers") or {}
        found: dict[str, Diagram] = {}
        tuning: dict[str, Any] = {}
        unknown = []
        for template, row in noted.items() if isinstance(noted, Mapping) else [(str(noted), None)]:
            diagram = _diagram(template, row)
            if diagram is None:
                unknown.append(str(template))
            else:
                found[template] = diagram
                values = row.get("parameters") if isinstance(row, Mapping) else None
                inside = values if isinstance(values, Mapping) else {}
                tuning |= {f"{template}.{path}": value for path, value in inside.items()}
        changes = provenance.get("changes")
        rows = (
            [(float(row[0]), row[1], row[2]) for row in changes if _is_change(row)] if isinstance(changes, list) else []
        )
        return cls(Gains.flown(provenance), tuple(sorted(rows)), found, tuning, tuple(unknown))

    def gains_in_flight(self, start: Gains) -> list[tuple[float, Gains]]:
        """Each time [s] at which the gains changed, and those that flew from then on, from those at the `start`."""
        found: list[tuple[float, Gains]] = []
        now = start
        for time, name, value in self.changes:
            changed = now.changed(name, value)
            if changed != now:
                now = changed
                found.append((time, now))
        return found


def _diagram(template: str, row: object) -> Diagram | None:
    """The diagram that a log has of a user's controller; None if it lacks one, or if its template does not fit."""
    if not isinstance(row, Mapping) or not isinstance(row.get("diagram"), Mapping) or template not in TEMPLATES:
        return None
    try:
        diagram = from_json(json.dumps(row["diagram"]))
        check_template(diagram, template)
    except (TwodofError, ValueError):
        return None
    return diagram


def _is_change(row: object) -> bool:
    match row:
        case [time, str(), value]:
            return _is_number(time) and _is_number(value)
    return False


def _is_number(value: object) -> bool:
    """Whether it is a number that a parameter may have: no bool, not NaN, nothing that float32 does not hold."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < _MOST
