"""What flies on a drone: the parameters that were tuned, and the diagrams of the user's controllers."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from twodof.errors import Rejected
from twodof.gcs.control.parameters import AsyncParameters
from twodof.gcs.mavlink.deadline import Deadline
from twodof.gcs.mavlink.files import AsyncFiles
from twodof.parameters import PARAMETERS

FOLDER = "/etc/extras"
_DIAGRAM = "_control.json"
_ALSO = frozenset(row.drone for row in PARAMETERS if row.drone)  # the same numbers under the real drone's names


@dataclass(frozen=True)
class ActiveController:
    """`parameters` that are not at their defaults, by name; `diagrams` of the user's controllers, JSON by template.

    `known` is False where the drone does not tell.
    """

    parameters: Mapping[str, float] = field(default_factory=dict)
    diagrams: Mapping[str, bytes] = field(default_factory=dict)
    known: bool = True

    def provenance(self) -> dict[str, Any]:
        """For a log: `parameters`, and `controllers` by template with name and SHA-256 of the JSON; {} if unknown."""
        controllers = {
            template: {"name": _name(content), "sha256": hashlib.sha256(content).hexdigest()}
            for template, content in self.diagrams.items()
        }
        return {"parameters": dict(self.parameters), "controllers": controllers} if self.known else {}


async def read_active_controller(
    parameters: AsyncParameters, files: AsyncFiles, deadline: Deadline
) -> ActiveController:
    """Asks the drone. Raises Timeout, LinkLost."""
    try:
        names = [entry.name for entry in await files.list(FOLDER, deadline.left)]
    except Rejected:  # one that has no such folder is none of ours
        return ActiveController(known=False)
    diagrams = {
        name.removesuffix(".json"): await files.read(f"{FOLDER}/{name}", deadline.left)
        for name in names
        if name.endswith(_DIAGRAM)
    }
    with suppress(Rejected):  # what it does not describe has the package's defaults
        await parameters.describe(deadline.left)
    tuned = {
        name: entry.value
        for name, entry in (await parameters.all(deadline.left)).items()
        if name not in _ALSO and entry.row is not None and entry.value != entry.row.default
    }
    return ActiveController(tuned, diagrams)


def _name(content: bytes) -> str:
    """The diagram's own name, "" if it says none."""
    try:
        name = json.loads(content)["diagram"]["name"]
    except (ValueError, LookupError, TypeError, RecursionError):
        return ""
    return name if isinstance(name, str) else ""
