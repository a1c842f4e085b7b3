"""What takes longer with a diagram, as jobs: margins, a module for PX4, a flash rehearsed. Nothing runs natively."""

from __future__ import annotations

import base64
import io
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from twodof.blocks.schema.json_form import from_json
from twodof.compile.px4 import export
from twodof.design.margins import bode
from twodof.errors import DiagramError
from twodof.fleet.flash import rehearse
from twodof.flight.gains import DEFAULT
from twodof.flight.templates import check_template
from twodof.lab.jobs.worker import Progress
from twodof.sim.linear import LOOPS, cascade_margins

_CLOSED = {"attitude_control": ("motors", "rate", "attitude"), "position_control": ("velocity", "position")}
"""The loops that a controller of a template closes; a motor controller closes all."""


def margins(progress: Progress, text: str, rig: str) -> dict[str, Any]:
    """The margins of each loop that the diagram closes, as it flies on `rig`, and its Bode plot."""
    diagram = from_json(text)
    template = check_template(diagram).name
    loops = _CLOSED.get(template, tuple(LOOPS))
    found: dict[str, Any] = {}
    for k, name in enumerate(loops):
        progress(k / len(loops), f"the {name} loop")
        loop = cascade_margins(DEFAULT, [diagram], rig, [name])[name]
        drawn = bode(loop)
        motion = "" if loop.motion is None else loop.motion.text
        curves = {"omega": drawn.omega.tolist(), "gain": drawn.gain.tolist(), "phase": drawn.phase.tolist()}
        found[name] = loop.to_json() | {"about": LOOPS[name], "motion_text": motion, "bode": curves}
    return {"template": template, "rig": rig, "loops": found}


def px4_module(progress: Progress, text: str) -> dict[str, Any]:
    """The diagram as a module for PX4: its folder as a zip file in base 64, its parameters, and what it leaves out."""
    diagram = from_json(text)
    progress(0.1, "writing the module")
    with TemporaryDirectory(prefix="twodof-") as name:
        folder = Path(name) / "module"
        made = export(diagram, folder)
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            for path in sorted(made.files):
                archive.write(folder / path, f"{made.names.module}/{path}")
    return {
        "module": made.names.module,
        "zip": base64.b64encode(packed.getvalue()).decode("ascii"),
        "files": sorted(made.files),
        "parameters": {row.name: row.path or "" for row in made.parameters},
        "not_exported": {kept.path: kept.reason for kept in made.kept},
        "reads": list(made.role.reads),
        "writes": list(made.role.writes),
        "stops": list(made.role.stops),
    }


def rehearsal(progress: Progress, text: str, before: str | None, origin: str) -> dict[str, Any]:
    """What flashing the diagram would do: costs, margins, a flight on the virtual rig, what changes."""
    diagram = from_json(text)
    try:
        flies = None if before is None else from_json(before)
    except DiagramError as damage:
        flies, origin = None, f"the stock controller, as what flies cannot be read: {damage}"
    done = rehearse(diagram, flies, lambda what, share: progress(share, what))
    return done.to_json() | {"against": origin, "name": diagram.name}
