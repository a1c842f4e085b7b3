"""What clients need to show events in words: a JSON file, made of the table, that they fetch by MAVLink FTP.

Source: `validation/schema.json` of MAVLink's libevents, version 2 of the format.
"""

import json
from typing import Any

from twodof.fcu.px4_compat.event_enumerations import ENUMERATIONS, EventEnumeration
from twodof.fcu.px4_compat.event_table import COMPONENT, EVENTS, EventType
from twodof.link.mavlink.modes import MODES

EVENTS_FILE = "events.json"
EVENTS_TYPE = 4
"""COMP_METADATA_TYPE_EVENTS."""
NAMESPACE = "twodof"


def definitions() -> bytes:
    """The file."""
    groups: dict[str, Any] = {}
    for event in EVENTS:
        groups.setdefault(event.group, {"events": {}})["events"][str(event.number)] = _event(event)
    component = {
        "namespace": NAMESPACE,
        "enums": {name: _enumeration(one) for name, one in ENUMERATIONS.items()},
        "event_groups": groups,
        "supported_protocols": ["health_and_arming_check"],
        "navigation_mode_groups": {
            "groups": {str(place): [mode.custom_mode] for place, mode in enumerate(MODES)},
        },
    }
    return json.dumps({"version": 2, "components": {str(COMPONENT): component}}, separators=(",", ":")).encode()


def _enumeration(one: EventEnumeration) -> dict[str, Any]:
    bits = {"is_bitfield": True, "separator": "; "} if one.bits else {}
    entries = {str(value): {"name": name, "description": text} for value, name, text in one.entries}
    return {"type": one.kind, "description": one.text, **bits, "entries": entries}


def _event(event: EventType) -> dict[str, Any]:
    made: dict[str, Any] = {"name": event.name, "message": event.message}
    if event.text:
        made["description"] = event.text
    if event.kind:
        made["type"] = event.kind
    if event.arguments:
        made["arguments"] = [{"type": kind, "name": name} for name, kind in event.arguments]
    return made
