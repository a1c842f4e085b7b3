"""`twodof slx`: look into Simulink files, draw them, compare two and import one, without MATLAB."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

from rich.console import RenderableType
from rich.text import Text

from twodof.blocks.schema.json_form import to_json
from twodof.cli.options import Force, Json, argument, flag, group, option
from twodof.cli.output import exit_unless, one_line, print_result, table, table_console
from twodof.errors import printable
from twodof.flightlog.atomic import write_text
from twodof.flightlog.files import check_folder
from twodof.slx.difference import ModelDifference, difference
from twodof.slx.importer import Imported, import_system
from twodof.slx.inspection import Inspection, Library
from twodof.slx.inspection import inspect as inspect_model
from twodof.slx.matlab.script import read_workspace
from twodof.slx.model import read_model
from twodof.slx.picture import sheet_name, sheet_svg

slx = group("Inspect, draw, compare and import Simulink files (.slx, .mdl); no MATLAB needed.")

ModelFile = Annotated[Path, argument("A model, library or subsystem file: .slx or .mdl of any release.", "MODEL")]


@slx.command()
def inspect(
    model: ModelFile,
    path: Annotated[list[Path] | None, option("Look for libraries in this folder too; repeatable.", "FOLDER")] = None,
    json: Json = False,
) -> None:
    """List a model's contents: release, solver, sample times, blocks, libraries, code, variables that it needs."""
    found = inspect_model(read_model(model), [model.parent, *(path or [])])
    document = {
        **{key: getattr(found.model, key) for key in ("name", "kind", "release", "version", "solver", "callbacks")},
        **{key: value for key, value in vars(found).items() if key not in ("model", "libraries")},
        "libraries": [{**asdict(one), "file": None if one.file is None else str(one.file)} for one in found.libraries],
    }
    print_result(json, document, _inspection_lines(found))


Subsystem = Annotated[str, option("Only this subsystem: Controller/PID.", "PATH")]


@slx.command("import")
def import_(
    model: ModelFile,
    out: Annotated[Path | None, option("Write the diagram there, as JSON.", "FILE")] = None,
    subsystem: Subsystem = "",
    workspace: Annotated[
        list[Path] | None, option("Script (.m) or .mat file with the model's variables; repeatable.", "FILE")
    ] = None,
    path: Annotated[list[Path] | None, option("Look for libraries in this folder too; repeatable.", "FOLDER")] = None,
    dt: Annotated[float | None, option("Sample time, if no block gives it.", "SECONDS")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Translate a model, or one of its subsystems, to a diagram; report on each block.

    Exit status 1 if a block is refused: then nothing is written.
    """
    if out is not None:
        check_folder(out, force)
    names: dict[str, Any] = {}
    notes: list[str] = []
    folders = [model.parent, *(path or [])]
    for file in workspace or []:
        notes += [f"{file.name}, line {one.line}: {one.why}" for one in read_workspace(file, names, folders)]
    found = import_system(read_model(model), subsystem, names, folders, dt)
    if found.diagram is not None and out is not None:
        write_text(out, to_json(found.diagram))
    notes += found.notes
    report = [asdict(line) for line in found.report]
    document = {"fine": found.diagram is not None, "dt": found.dt, "report": report, "notes": notes}
    print_result(json, document, _import_lines(found, notes, out))
    exit_unless(found.diagram is not None)


def _import_lines(found: Imported, notes: Sequence[str], out: Path | None) -> Iterator[RenderableType]:
    yield from (f"note: {one_line(note)}" for note in notes)
    rows = table("", "", "", "", show_header=False)
    for line in found.report:
        if line.status != "imported":
            rows.add_row(line.status, one_line(line.path), line.kind, one_line(line.why))
    yield rows
    counts = Counter(line.status for line in found.report)
    yield ", ".join(f"{count} {status}" for status, count in counts.items()) + f"; period {found.dt:g} s"
    if found.diagram is not None and out is not None:
        yield f"written: {out}"


def _inspection_lines(found: Inspection) -> Iterator[RenderableType]:
    model = found.model
    rows = table("", "", show_header=False)
    saved = f"saved by {model.release}" if model.release else "of an unknown release"
    rows.add_row(model.kind, f"{model.name}, version {model.version or '?'}, {saved}")
    solver = model.solver.get("SolverName") or model.solver.get("Solver") or "?"
    step, stop = model.solver.get("FixedStep", "?"), model.solver.get("StopTime", "?")
    rows.add_row("solver", f"{solver}, fixed step {step}, until {stop} s")
    if found.sample_times:
        rows.add_row("sample times", ", ".join(f"{time} ({count})" for time, count in found.sample_times.items()))
    if found.inputs or found.outputs:
        rows.add_row("inputs", ", ".join(found.inputs) or "none")
        rows.add_row("outputs", ", ".join(found.outputs) or "none")
    total = sum(found.blocks.values())
    rows.add_row("blocks", f"{total} in {found.systems} subsystems, {found.depth} deep")
    for kind, count in found.blocks.items():
        rows.add_row("", f"{count:5d} {kind}")
    for library in found.libraries:
        rows.add_row("library", _library(library))
    for title, paths in (("MATLAB Function", found.functions), ("chart", found.charts)):
        for one in paths:
            rows.add_row(title, one)
    for name, code in model.callbacks.items():
        lines = code.splitlines()
        rows.add_row(name, lines[0] + (f" ... ({len(lines)} lines)" if len(lines) > 1 else ""))
    if found.commented:
        rows.add_row("commented out", f"{found.commented} blocks")
    if found.loose:
        rows.add_row("loose lines", f"{found.loose}: they lack a beginning or an end")
    yield rows
    if found.names:
        yield "\nnames that the model takes from the workspace:"
        names = table("", "", show_header=False)
        for name, paths in found.names.items():
            names.add_row(name, "; ".join(map(one_line, paths)))
        yield names


def _library(library: Library) -> str:
    count = f"{library.blocks} block{'s' if library.blocks > 1 else ''} of {library.name}"
    if library.own:
        return f"{count}, part of Simulink"
    return f"{count}, {library.file}" if library.file else f"{count}: not found (name its folder with --path)"


@slx.command()
def draw(
    model: ModelFile,
    out: Annotated[Path, option("Folder for the pictures, or an .svg file for one picture.", "PATH")],
    subsystem: Subsystem = "",
    force: Force = False,
) -> None:
    """Draw a model as SVG: one linked picture for each subsystem."""
    read = read_model(model)
    if out.suffix == ".svg":
        pictures = {out: subsystem}
    else:
        out.mkdir(parents=True, exist_ok=True)
        paths = [subsystem] if subsystem else [path for path, _ in read.root.walk()]
        pictures = {out / sheet_name(read, path): path for path in paths}
    for file, path in pictures.items():
        check_folder(file, force)
        write_text(file, sheet_svg(read, path))
    first = next(iter(pictures))
    more = len(pictures) - 1
    table_console().print(f"written: {first}" + (f" and {more} subsystem{'s' if more > 1 else ''}" if more else ""))


@slx.command()
def diff(
    before: Annotated[Path, argument("The model before.", "BEFORE")],
    after: Annotated[Path, argument("The model after.", "AFTER")],
    json: Json = False,
    quiet: Annotated[bool, flag("Print nothing; only set the exit status.", "--quiet")] = False,
) -> None:
    """List what differs between two models: blocks, parameters, wires, code.

    Exit status 0 if only the layout (positions, colours) differs, else 1.
    """
    found = difference(read_model(before), read_model(after))
    if json or not quiet:
        print_result(json, {"equal": found.equal, **vars(found)}, _difference_lines(found))
    exit_unless(found.equal)


def _difference_lines(found: ModelDifference) -> Iterator[RenderableType]:
    for sign, rows, colour in (("+", found.added, "green"), ("-", found.removed, "red")):
        for path, kind in rows:
            yield Text(printable(f"{sign} {one_line(path)} ({kind})"), colour)
    for was, path in found.renamed:
        yield f"= {one_line(was)} is now {one_line(path)}"
    for path, name, was, now in found.values:
        yield f"~ {one_line(path)}: {name} {one_line(was) or '(default)'} -> {one_line(now) or '(default)'}"
    for path, wire, new in found.wires:
        yield f"{'+' if new else '-'} wire {one_line(wire)}{f' in {one_line(path)}' if path else ''}"
    for name, lines in found.code:
        yield f"~ {one_line(name)}:"
        yield from (f"    {line}" for line in lines)
    if found.equal:
        yield "no difference" + (f" but the looks of {found.looks} blocks" if found.looks else "")
    elif found.looks:
        yield f"(and the looks of {found.looks} blocks)"
