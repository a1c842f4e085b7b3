"""Metadata: what QGroundControl shows of parameters and events, as JSON files that it fetches by MAVLink FTP.

COMPONENT_METADATA names the general file, which names the others. Sources: MAVLink guide, "Component Metadata
Protocol"; schemas general and parameter, version 1.
"""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from twodof.fcu.mavlink.files.file_tree import EXTRAS, mavlink_crc32
from twodof.fcu.mavlink.wire_tick import MASK_32
from twodof.fcu.parameters.parameter_store import ParametersRelisted, ParameterStore
from twodof.fcu.parameters.row import VehicleParameter
from twodof.fcu.px4_compat.event_definitions import EVENTS_FILE, EVENTS_TYPE, definitions
from twodof.link.mavlink.messages import message

GENERAL, PARAMETERS = "component_general.json", "parameters.json"
_PARAMETER_TYPE = 1
"""COMP_METADATA_TYPE_PARAMETER."""
_KINDS = MappingProxyType({"int32": "Int32", "float": "Float"})


class Metadata:
    """The files that describe the vehicle, and the answer to a request for COMPONENT_METADATA.

    `files`, by name, describe the parameters and events, and hold the users' diagrams that fly. They are made from
    `store`, and made anew when other parameters are listed there.
    """

    def __init__(self, store: ParameterStore, time_boot_ms: Callable[[], int] = lambda: 0) -> None:
        self.files = self._made(store)
        self._time_boot_ms = time_boot_ms
        store.bus.subscribe(ParametersRelisted, lambda _: self._renew(store))

    def _renew(self, store: ParameterStore) -> None:
        self.files = self._made(store)

    @staticmethod
    def _made(store: ParameterStore) -> Mapping[str, bytes]:
        diagrams = {f"{one.kind}.json": one.text.encode() for one in store.carried}
        return MappingProxyType({**metadata_files(store.rows), **diagrams})

    def message(self, _command: object = None) -> Iterable[Any]:
        """COMPONENT_METADATA."""
        crc = mavlink_crc32(self.files[GENERAL])
        return [
            message(
                "COMPONENT_METADATA",
                time_boot_ms=self._time_boot_ms() & MASK_32,
                file_crc=crc,
                uri=_uri(GENERAL).encode(),
            )
        ]


def metadata_files(rows: Sequence[VehicleParameter]) -> Mapping[str, bytes]:
    """The files by name, made of the parameters `rows` and of the table of events."""
    parameters = _json({"version": 1, "parameters": [_parameter(row) for row in rows]})
    described = ((_PARAMETER_TYPE, PARAMETERS, parameters), (EVENTS_TYPE, EVENTS_FILE, definitions()))
    general = {
        "version": 1,
        "metadataTypes": [
            {"type": kind, "uri": _uri(name), "fileCrc": mavlink_crc32(content)} for kind, name, content in described
        ],
    }
    return MappingProxyType({GENERAL: _json(general)} | {name: content for _, name, content in described})


def _parameter(row: VehicleParameter) -> dict[str, Any]:
    text = row.text if row.user_path else row.text[0].upper() + row.text[1:] if row.text else row.name
    made: dict[str, Any] = {
        "name": row.name,
        "type": _KINDS[row.kind],
        "shortDesc": text,
        "units": row.unit,
        "default": row.kept(row.default),
        "group": row.group,
        "category": "Standard" if row.acts else "Developer",
        "rebootRequired": row.reboot,
        "readOnly": row.fixed,
    }
    if row.bounded:
        made |= {"min": row.kept(row.low), "max": row.kept(row.high)}
    if row.user_path:
        made["path"] = row.user_path  # no key of the schema's, which allows others: by this our own clients find it
    if said := _conditions(row):
        made["longDesc"] = said
    if row.kind == "float":
        made["decimalPlaces"] = 6
    return made


def _conditions(row: VehicleParameter) -> str:
    said = [f"Another name of {row.of}."] if row.of else []
    if row.fixed:
        said.append("Fixed.")
    elif row.disarmed:
        said.append("Changed only while disarmed.")
    return " ".join(said)


def _uri(name: str) -> str:
    return f"mftp://{EXTRAS}/{name}"


def _json(content: object) -> bytes:
    return json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
