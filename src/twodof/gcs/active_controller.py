"""Active controller of a drone: its parameters, the diagrams of the user's controllers, and changes in flight."""

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from twodof.errors import Rejected
from twodof.gcs.files import AsyncFiles
from twodof.gcs.parameters import MOST, AsyncParameters, entry_of
from twodof.gcs.session import Deadline
from twodof.parameters import PARAMETERS

FOLDER = "/etc/extras"
MOST_CHANGES = 10_000
"""Changes of parameters that are kept of a flight."""
_DIAGRAM = "_control.json"
_ALSO = frozenset(row.drone for row in PARAMETERS if row.drone)  # the same numbers under the real drone's names


@dataclass(frozen=True)
class ActiveController:
    """Parameters and controllers of a drone.

    Attributes:
        parameters: values that differ from their defaults, by name
        diagrams: the user's controllers, JSON by template
        known: False if the drone does not publish them, as a plain PX4
        values: all parameters by name
        paths: places in the diagrams of the parameters of the user's controllers, by name
    """

    parameters: Mapping[str, float] = field(default_factory=dict)
    diagrams: Mapping[str, bytes] = field(default_factory=dict)
    known: bool = True
    values: Mapping[str, float] = field(default_factory=dict)
    paths: Mapping[str, str] = field(default_factory=dict)

    def provenance(self) -> dict[str, Any]:
        """Return provenance that a replay of a log needs: `parameters`, `controllers` by template; {} if unknown.

        A controller has its name, its diagram, the SHA-256 of the diagram's JSON, and all its parameters by path.
        """
        if not self.known:
            return {}
        controllers = {}
        for template, content in self.diagrams.items():
            inside = {name: path.removeprefix(f"{template}.") for name, path in self.paths.items()}
            inside = {name: path for name, path in inside.items() if path != self.paths[name]}
            diagram = _diagram(content)
            controllers[template] = {
                "name": diagram["diagram"]["name"] if diagram else "",
                "sha256": hashlib.sha256(content).hexdigest(),
                "parameters": {path: self.values[name] for name, path in inside.items() if name in self.values},
                "diagram": diagram,
            }
        return {"parameters": dict(self.parameters), "controllers": controllers}


class ParameterChanges:
    """Changes of parameters during a recording, by any client: rows [time [s], name, value].

    The time is that of the last step that may have had the old value. A parameter of a user's controller has its path
    as name, such as `attitude_control.k_q`. The first value of a parameter that was unknown `before` does
    not count.
    """

    def __init__(self, before: ActiveController) -> None:
        self.rows: list[tuple[float, str, float]] = []
        self._values = dict(before.values)
        self._paths = before.paths

    def add(self, time: float, got: Any) -> None:
        """Add a PARAM_VALUE that came at the drone's `time` [s], if its value is new."""
        name, value = str(got.param_id), entry_of(got).value
        if name in _ALSO:
            return
        if self._values.get(name, value) != value and len(self.rows) < MOST_CHANGES:
            self.rows.append((time, self._paths.get(name, name), value))
        if name in self._values or len(self._values) < MOST:
            self._values[name] = value


async def read_active_controller(
    parameters: AsyncParameters, files: AsyncFiles, deadline: Deadline
) -> ActiveController:
    """Read the active controller from the drone. Raises Timeout, LinkLost."""
    try:
        names = [entry.name for entry in await files.list(FOLDER, deadline.left)]
    except Rejected:  # a drone without this folder is another's
        return ActiveController(known=False)
    diagrams = {
        name.removesuffix(".json"): await files.read(f"{FOLDER}/{name}", deadline.left)
        for name in names
        if name.endswith(_DIAGRAM)
    }
    if diagrams:  # without one the package's defaults hold, and the description takes long to read
        with suppress(Rejected):
            await parameters.describe(deadline.left)
    entries = await parameters.all(deadline.left)
    tuned = {
        name: entry.value
        for name, entry in entries.items()
        if name not in _ALSO and entry.row is not None and entry.value != entry.row.default
    }
    values = {name: entry.value for name, entry in entries.items()}
    paths = {name: entry.described.path for name, entry in entries.items() if entry.described and entry.described.path}
    return ActiveController(tuned, diagrams, True, values, paths)


def _diagram(content: bytes) -> dict[str, Any] | None:
    """Return the JSON form of a diagram that has a name; None for anything else."""
    try:
        found = json.loads(content)
        return found if isinstance(found["diagram"]["name"], str) else None
    except (ValueError, LookupError, TypeError, RecursionError):
        return None
