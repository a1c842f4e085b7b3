"""What the workbench does with a diagram's text, in its own process: each takes and gives plain data."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from twodof.blocks import Diagram
from twodof.blocks.schema.json_form import block_shape, from_json, to_json
from twodof.blocks.schema.json_form import catalogue as library_catalogue
from twodof.blocks.schema.loader import Loader
from twodof.compile.builder import emit_program
from twodof.compile.c_files.source_map import source_map
from twodof.compile.program.check import check as check_diagram
from twodof.compile.program.flatten import AlgebraicLoop
from twodof.compile.wasm.module import find_wasm_compiler
from twodof.errors import CompileError, DiagramError, TwodofError
from twodof.flight.starters import STARTERS, starter
from twodof.flight.templates import TEMPLATES, check_template, nearest_template, template_fit
from twodof.signals import PERIOD
from twodof.sim.portable_loop import portable_loop


def catalogue() -> dict[str, Any]:
    """The library's blocks, the starter diagrams, and the drone's templates with their ports.

    `not_simulated` says why no diagram can be simulated here; "" where it can.
    """
    return {
        "not_simulated": _no_compiler(),
        "blocks": [entry.to_json() for entry in library_catalogue()],
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


def canonical(text: str) -> dict[str, Any]:
    """The diagram as it is kept."""
    return {"text": to_json(from_json(text))}


def shapes(blocks: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Of each block its ports and parameters, or why it cannot be made."""
    return [_shape(form) for form in blocks]


def _shape(form: dict[str, Any]) -> dict[str, Any]:
    try:
        return block_shape(Loader().block(form, str(form.get("type", ""))[:80])).to_json()
    except TwodofError as error:
        return _told(error)


def check(text: str) -> dict[str, Any]:
    """All problems of a diagram, what is odd about it, how large it is, and which template it fits or nearly fits."""
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
    told: dict[str, Any] = {"what": error.what, "where": error.where, "remedy": error.remedy}
    return told | ({"loop": list(error.signals)} if isinstance(error, AlgebraicLoop) else {})


def code(text: str, precision: str) -> dict[str, Any]:
    """The C of a diagram at 250 Hz, line by line with the block that each belongs to."""
    emitted = emit_program(from_json(text), PERIOD, precision)
    found = source_map(emitted.flat, emitted.source, emitted.layout)
    return {
        "lines": [[line.text, line.block, line.part] for line in found.lines],
        "kinds": found.kinds,
        "left_out": list(found.left_out),
    }


def template(text: str) -> dict[str, str]:
    """The template that a diagram fits. Raises DiagramError for one that fits none."""
    return {"template": check_template(from_json(text)).name}


def compiled(text: str, rig: str) -> dict[str, Any]:
    """The diagram in its closed loop as WebAssembly, to be run where the module does: in the reader's browser."""
    return portable_loop(from_json(text), rig=rig).to_json()
