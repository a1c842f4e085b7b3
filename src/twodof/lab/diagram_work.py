"""Work on diagrams in processes of their own: checks, code, margins, PX4 modules and rehearsals, as plain data."""

import base64
import io
import zipfile
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from twodof.blocks import Diagram
from twodof.blocks.schema.json_form import block_shape, from_json, to_json
from twodof.blocks.schema.json_form import catalogue as library_catalogue
from twodof.blocks.schema.loader import Loader
from twodof.compile.builder import emit_program
from twodof.compile.c_files.c_files import source_map
from twodof.compile.program.check import check as check_diagram
from twodof.compile.program.flatten import AlgebraicLoop
from twodof.compile.px4 import export
from twodof.compile.wasm.module import find_wasm_compiler
from twodof.design.margins import bode
from twodof.errors import CompileError, DiagramError, TwodofError
from twodof.fleet.flash import rehearse
from twodof.flight.gains import DEFAULT
from twodof.flight.starters import STARTERS, starter
from twodof.flight.templates import TEMPLATES, check_template, nearest_template, template_fit
from twodof.lab.answers import refusal_of
from twodof.lab.processes import Progress
from twodof.signals import PERIOD
from twodof.sim.linear import LOOPS, cascade_margins
from twodof.sim.portable_loop import portable_loop
from twodof.slx.importer import import_system
from twodof.slx.inspection import SUFFIXES
from twodof.slx.matlab.script import read_workspace
from twodof.slx.matlab.values import Value
from twodof.slx.model import read_model
from twodof.slx.picture import sheet_svg


def catalogue() -> dict[str, Any]:
    """Return the library's blocks, the starter diagrams, and the drone's templates with their ports.

    `not_simulated` says why no diagram can be simulated here, "" if diagrams can.
    """
    return {
        "not_simulated": _no_compiler(),
        "blocks": list(library_catalogue()),
        "starters": {name: {"name": d.name, "text": d.text} for name in STARTERS for d in (starter(name),)},
        "templates": {
            t.name: {
                "text": t.text,
                "inputs": [port._asdict() for port in t.inputs],
                "outputs": [port._asdict() for port in t.outputs],
            }
            for t in TEMPLATES.values()
        },
    }


def _no_compiler() -> str:
    try:
        find_wasm_compiler()
    except CompileError as error:
        return f"{error.what}: {error.remedy}; then load this page again"
    return ""


def canonical(text: str) -> dict[str, str]:
    """Return the diagram in the form of its file."""
    return {"text": to_json(from_json(text))}


def shapes(blocks: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return each block's ports and parameters, or the error of a wrong block."""
    return [_shape(form) for form in blocks]


def _shape(form: dict[str, Any]) -> dict[str, Any]:
    try:
        return block_shape(Loader().block(form, str(form.get("type", ""))[:80]))
    except TwodofError as error:
        return _told(error)


def check(text: str) -> dict[str, Any]:
    """Return a diagram's problems, remarks and sizes, and the template that it fits or nearly fits."""
    try:
        diagram = from_json(text)
    except DiagramError as error:
        return {"fine": False, "problems": [_told(error)], "remarks": [], "sizes": None, "template": None}
    found = check_diagram(diagram, PERIOD)
    return {
        "fine": found.fine,
        "problems": [_told(error) for error in found.problems],
        "remarks": [asdict(remark) for remark in found.remarks],
        "sizes": None if found.sizes is None else asdict(found.sizes),
        "template": _fit(diagram, found.fine),
    }


def _fit(diagram: Diagram, fine: bool) -> dict[str, Any] | None:
    meant = nearest_template(diagram)
    if meant is None:
        return None
    fit = template_fit(diagram, meant)
    faults = [*fit.faults, *([str(fit.refusal)] if fit.refusal is not None and fine else [])]
    return {"name": meant, "fits": fit.fits, "faults": faults}


def _told(error: TwodofError) -> dict[str, Any]:
    return refusal_of(error) | ({"loop": list(error.signals)} if isinstance(error, AlgebraicLoop) else {})


def code(text: str, precision: str) -> dict[str, Any]:
    """Return the C of a diagram at 250 Hz, line by line with the block of each."""
    emitted = emit_program(from_json(text), PERIOD, precision)
    found = source_map(emitted)
    return {"lines": [[line.text, line.block, line.part] for line in found.lines], "left_out": list(found.left_out)}


def template(text: str) -> str:
    """Return the template that a diagram fits. Raises DiagramError if it fits none."""
    return check_template(from_json(text)).name


def compiled(text: str, rig: str) -> dict[str, Any]:
    """Return the diagram in its closed loop as WebAssembly, to be run in the reader's browser."""
    return portable_loop(from_json(text), rig=rig)


MOST_PICTURE, MOST_ROWS = 4 << 20, 2000
"""Most letters of the picture of a Simulink sheet; most subsystems, and most lines of the report of an import."""


def simulink(folder: str, names: list[str], sizes: list[int], system: str) -> dict[str, Any]:
    """Draw a system of the first model, list its subsystems, and translate the system.

    The file "files" in `folder` has the contents of `names`: model, libraries, workspaces. Raises DiagramError.
    """
    place, known, notes = Path(folder), dict[str, Value](), list[str]()
    with (place / "files").open("rb") as stream:
        for name, size in zip(names, sizes, strict=True):
            (place / name).write_bytes(stream.read(size))
            if not name.lower().endswith(SUFFIXES):
                notes += [f"{name}, line {one.line}: {one.why}" for one in read_workspace(place / name, known, [place])]
    model = read_model(place / names[0])
    svg = sheet_svg(model, system)
    if len(svg) > MOST_PICTURE:
        raise DiagramError("the sheet is too large to be drawn", system or names[0], "import one of its subsystems")
    found = import_system(model, system, known, [place], otherwise=PERIOD)
    return {
        "name": model.name,
        "release": model.release,
        "systems": [[path, len(one.blocks)] for path, one in model.root.walk()][:MOST_ROWS],
        "svg": svg,
        "report": [asdict(line) for line in found.report[:MOST_ROWS]],
        "counts": Counter(line.status for line in found.report),
        "notes": [*notes, *found.notes][:MOST_ROWS],
        "dt": found.dt,
        "text": "" if found.diagram is None else to_json(found.diagram),
    }


_CLOSED = {"attitude_control": ("motors", "rate", "attitude"), "position_control": ("velocity", "position")}
"""The loops that a controller of a template closes; a motor controller closes all."""


def margins(progress: Progress, text: str, rig: str) -> dict[str, Any]:
    """Return the margins and the Bode plot of each loop that the diagram closes on `rig`."""
    diagram = from_json(text)
    template = check_template(diagram).name
    loops = _CLOSED.get(template, tuple(LOOPS))
    found: dict[str, Any] = {}
    for k, name in enumerate(loops):
        progress(k / len(loops), f"the {name} loop")
        loop = cascade_margins(DEFAULT, [diagram], rig, [name])[name]
        motion = "" if loop.motion is None else loop.motion.text
        curves = {key: values.tolist() for key, values in bode(loop)._asdict().items()}
        found[name] = loop.to_json() | {"about": LOOPS[name], "motion_text": motion, "bode": curves}
    return {"template": template, "rig": rig, "loops": found}


def px4_module(progress: Progress, text: str) -> dict[str, Any]:
    """Return the diagram as a module for PX4: a zip file in base 64, its parameters, and the parts left out."""
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
    """Rehearse flashing the diagram: costs, margins, a flight on the virtual rig, and the changes."""
    diagram = from_json(text)
    try:
        flies = None if before is None else from_json(before)
    except DiagramError as damage:
        flies, origin = None, f"the stock controller, as the active one cannot be read: {damage}"
    done = rehearse(diagram, flies, lambda what, share: progress(share, what))
    return done.to_json() | {"against": origin, "name": diagram.name}
