"""`twodof diagram`: start, check, test, draw, compile, export and linearize diagrams."""

import importlib
import json as json_text
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from rich.console import RenderableType
from rich.table import Table

from twodof.blocks.declarations import unknown_name
from twodof.cli.margins import cascade_loops
from twodof.cli.options import Force, Json, Reals, argument, flag, group, option, read_input
from twodof.cli.output import exit_unless, print_result, table, table_console
from twodof.compile.builder import emit_program
from twodof.compile.c_files.c_files import SourceLine, SourceMap, c_files, source_map
from twodof.compile.diagram_test.coverage import Coverage, measure_coverage
from twodof.compile.diagram_test.run_scenarios import run_scenarios, to_junit
from twodof.compile.diagram_test.scenario import ScenarioResult
from twodof.compile.diagram_test.scenario_file import read_scenarios
from twodof.compile.fmu.export import make_fmu
from twodof.compile.linear.linear_model import Array, LinearModel
from twodof.compile.linear.linearize import linearize as linearize_diagram
from twodof.compile.program.check import Findings
from twodof.compile.program.check import check as check_diagram
from twodof.errors import DiagramError, LogError
from twodof.flight.starters import DIAGRAM_HELP, load_diagram, new_diagram
from twodof.flight.templates import TEMPLATES, TemplateFit, nearest_template, template_fit
from twodof.flightlog.atomic import write_text
from twodof.flightlog.files import check_folder
from twodof.report.diagram_svg import find, to_svg
from twodof.report.report_page import code_page
from twodof.report.state_machine_svg import machine_at, machine_svg

diagram = group("Create, check, test, draw, export and linearize diagrams, and compute the margins of their loops.")
diagram.command("margins")(cascade_loops)

MAX_AT_BYTES = 2**20

Which = Annotated[str, argument(DIAGRAM_HELP, "DIAGRAM")]
Tick = Annotated[float, option("Base tick.", "SECONDS", "--dt")]


@diagram.command()
def new(
    starter: Annotated[str, argument(DIAGRAM_HELP.partition(", or ")[2], "STARTER")],
    file: Annotated[Path, argument("Where to write it, as JSON.", "FILE")],
    force: Annotated[bool, flag("Replace an existing file.", "--force", "--overwrite")] = False,
) -> None:
    """Write a starter diagram to a file, as a start for your own."""
    made = new_diagram(starter, file, force)
    table_console().print(f"{file}: {made.name}, {made.text}")


@diagram.command()
def check(
    diagram: Which,
    dt: Tick = 0.004,
    template: Annotated[
        str | None, option("Require that it fits this template of the drone's controllers.", "NAME")
    ] = None,
    json: Json = False,
) -> None:
    """List all problems of a diagram, or its sizes, remarks, and the template that it fits.

    Exit status 1 if it does not compile, or does not fit the template asked for.
    """
    checked = load_diagram(diagram)
    found = check_diagram(checked, dt)
    meant = template or nearest_template(checked)
    fit = None if meant is None else template_fit(checked, meant)
    document = {
        "fine": found.fine,
        "problems": [{"what": p.what, "where": p.where, "remedy": p.remedy} for p in found.problems],
        "remarks": [asdict(r) for r in found.remarks],
        "sizes": asdict(found.sizes) if found.sizes else None,
        **{key: getattr(found, key) for key in ("feedthrough", "port_feedthrough", "unread", "left_out")},
        "template": None if fit is None else {"name": meant, "fits": fit.fits, "faults": _misfits(fit, found)},
    }
    print_result(json, document, [*_finding_lines(found, dt), *_fit_lines(fit, found)])
    exit_unless(found.fine and not (template and fit is not None and not fit.fits))


def _misfits(fit: TemplateFit, found: Findings) -> list[str]:
    """Return the changes that a template needs, without the problems listed already."""
    return [*fit.faults, *([str(fit.refusal)] if fit.refusal is not None and found.fine else [])]


def _fit_lines(fit: TemplateFit | None, found: Findings) -> list[str]:
    if fit is None:
        return [f"\nit fits no template of the drone's controllers ({', '.join(TEMPLATES)})"]
    if fit.fits:
        return [f"\nit fits the template {fit.template.name}"]
    faults = _misfits(fit, found)
    heading = f"\nit does not fit the template {fit.template.name}{':' if faults else ''}"
    return [heading, *(f"  {line}" for line in faults)]


def _item_lines(title: str, items: Sequence[Any]) -> list[str]:
    rows = [f"  {item.where}: {item.what} ({item.remedy})" for item in items]
    return [f"\n{title}:", *rows] if rows else []


def _finding_lines(found: Findings, dt: float) -> Iterator[RenderableType]:
    if not found.fine:
        count = len(found.problems)
        yield f"it does not compile: {count} problem{'s' if count > 1 else ''}"
        yield from _item_lines("problems", found.problems)
        return
    yield "it compiles"
    if found.sizes:
        sizes = table(show_header=False)
        for name, value in asdict(found.sizes).items():
            if name != "rates":
                sizes.add_row(name.replace("_", " "), str(value))
        rates = (f"{1 / (dt * d):g} Hz" + (f" from tick {o}" if o else "") for d, o in found.sizes.rates)
        sizes.add_row("rates", ", ".join(rates))
        yield sizes
    if found.feedthrough:
        yield "\nin the same tick:"
        for output, inputs in found.feedthrough.items():
            yield f"  {output} <- {', '.join(inputs) or 'no input'}"
    if found.unread:
        yield f"\noutputs that nobody reads: {', '.join(found.unread)}"
    yield from _item_lines("remarks", found.remarks)


@diagram.command()
def code(
    diagram: Which,
    dt: Tick = 0.004,
    precision: Reals = "float64",
    block: Annotated[str | None, option("Only the C of this block.", "PATH")] = None,
    html: Annotated[Path | None, option("Write an HTML page that shows diagram and C side by side.", "FILE")] = None,
    out: Annotated[Path | None, option("Write the C to this file.", "FILE")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Show the generated C, each line with the path of its block."""
    for path in filter(None, (out, html)):
        check_folder(path, force)
    shown = load_diagram(diagram)
    emitted = emit_program(shown, dt, precision)
    found = source_map(emitted)
    if block is not None and block not in found.blocks:
        raise unknown_name("block", block, sorted(found.blocks), shown.name)
    if out is not None:
        write_text(out, emitted.source)
    if html is not None:
        write_text(html, code_page(shown.name, shown.text, found))
    document = {
        "blocks": {
            path: {"type": found.blocks[path], "lines": found.of(path)}
            for path in (sorted(found.blocks) if block is None else [block])
        },
        "left_out": found.left_out,
        "lines": len(found.lines),
    }
    written = ", ".join(map(str, filter(None, (out, html))))
    print_result(json, document, [f"written: {written}"] if written else _code_lines(found, block))


def _code_lines(found: SourceMap, block: str | None) -> Iterator[str]:
    """Yield path or role, line number and C in three columns, without helpers and structs."""
    chosen = (line for line in found.lines if not block or line.block == block)
    lines = [line for line in chosen if block or _is_shown(line)]
    width = min(max((len(line.block or line.role) for line in lines), default=0), 44)
    before = ("", "")
    for line in lines:
        name = line.block or line.role
        shown = name if (line.part, name) != before else ""
        before = line.part, name
        yield f"{shown[-width:]:{width}} {line.number:5d}  {line.text}".rstrip()
    if block in found.left_out:
        yield "nothing of it runs: nobody needs it"
    elif block is None and found.left_out:
        yield f"\nleft out, as nobody needs them: {', '.join(found.left_out)}"


def _is_shown(line: SourceLine) -> bool:
    return bool(line.part) and not line.part.rpartition(".")[2][0].isupper()


@diagram.command()
def render(
    diagram: Which,
    out: Annotated[Path | None, option("SVG file; default: standard output.", "FILE")] = None,
    depth: Annotated[int, option("Open sub-diagrams down to this level.", min=0, max=64)] = 0,
    path: Annotated[str, option("Draw only this sub-diagram, or state machine.", "SUB")] = "",
    force: Force = False,
) -> None:
    """Draw a diagram, or one of its state machines, as SVG."""
    if out is not None:
        if out.suffix.lower() != ".svg":
            raise LogError(f"the drawing is an SVG; {out.name} does not say so", "--out", f"name it {out.stem}.svg")
        check_folder(out, force)
    shown = load_diagram(diagram)
    machine = machine_at(shown, path)
    picture = to_svg(find(shown, path), depth) if machine is None else machine_svg(machine, path)
    if out is None:
        typer.echo(picture, nl=False)
        return
    write_text(out, picture)
    table_console().print(f"written: {out}")


@diagram.command()
def linearize(
    diagram: Which,
    dt: Tick = 0.004,
    at: Annotated[
        str | None, option("The point: a JSON object, or a file with one; default: the start.", "JSON")
    ] = None,
    trim: Annotated[bool, flag("Search for an equilibrium near the point.", "--trim")] = False,
    free: Annotated[list[str] | None, option("With --trim: an input that may move.", "INPUT")] = None,
    inputs: Annotated[
        list[str] | None,
        option("Input of the model: an input, or a signal's path, where the loop is cut.", "NAME", "--input"),
    ] = None,
    outputs: Annotated[
        list[str] | None, option("Output of the model: an output, or a signal's path.", "NAME", "--output")
    ] = None,
    time: Annotated[
        Literal["auto", "continuous", "discrete"],
        option("Continuous dx/dt, the discrete step map, or the one that fits the diagram."),
    ] = "auto",
    keep_all: Annotated[bool, flag("Keep states that have no influence on the outputs.", "--keep-all")] = False,
    json: Json = False,
) -> None:
    """Compute the exact linear model A, B, C, D of a diagram at a point."""
    found = linearize_diagram(
        load_diagram(diagram), dt, _at(at), inputs or None, outputs or None, trim, free or (), time, keep_all
    )
    print_result(json, found.to_json(), _model_lines(found))


def _at(text: str | None) -> dict[str, Any]:
    """Return the JSON object in `text`, or in the file that `text` names. Raises DiagramError, LogError."""
    if text is None:
        return {}
    try:
        found = json_text.loads(text if text.lstrip().startswith("{") else read_input(text, MAX_AT_BYTES))
    except (ValueError, RecursionError) as error:
        raise DiagramError(f"this is no JSON: {error!s:.200}", "--at", 'write {"theta": 0.1}') from error
    if not isinstance(found, dict):
        raise DiagramError("this is no JSON object", "--at", 'write {"theta": 0.1}')
    return found


def _model_lines(found: LinearModel) -> Iterator[RenderableType]:
    kind = "dx/dt" if found.dt is None else f"x[k+1], one step is {found.dt:g} s"
    n, m, p = len(found.states), len(found.inputs), len(found.outputs)
    yield f"{found.name}: {kind}; {n} states, {m} inputs, {p} outputs"
    for letter, matrix, rows, columns in (
        ("A", found.a, found.states, found.states),
        ("B", found.b, found.states, found.inputs),
        ("C", found.c, found.outputs, found.states),
        ("D", found.d, found.outputs, found.inputs),
    ):
        if matrix.size:
            yield f"\n{letter}"
            yield _matrix(matrix, rows, columns)
    if n:
        yield "\npoles"
        for pole in sorted(found.poles(), key=lambda q: (abs(q), q.imag)):
            yield f"  {_pole(complex(pole), found.dt)}"
    yield from (f"left out: {names} ({why})" for names, why in _alike(found.left_out))
    yield from (f"remark: {name}: {what}" for name, what in found.remarks.items())


def _alike(left_out: Mapping[str, str]) -> list[tuple[str, str]]:
    """Group the states that are left out by reason; an array is one name and its size."""
    groups: dict[tuple[str, str], list[str]] = {}
    for name, why in left_out.items():
        groups.setdefault((name.partition("[")[0], why), []).append(name)
    return [
        (names[0] if len(names) == 1 else f"{path}, {len(names)} elements", why)
        for (path, why), names in groups.items()
    ]


def _matrix(matrix: Array, rows: tuple[str, ...], columns: tuple[str, ...]) -> Table:
    made = table("", *columns, right=range(1, len(columns) + 1))
    for name, row in zip(rows, matrix, strict=True):
        made.add_row(name, *(f"{v:.6g}" for v in row))
    return made


def _pole(pole: complex, dt: float | None) -> str:
    """Return a pole as text, with frequency and damping unless it is 0 in the z plane."""
    text = f"{pole.real:.6g}" + (f" {'+' if pole.imag > 0 else '-'} {abs(pole.imag):.6g}j" if pole.imag else "")
    s = pole if dt is None else complex(np.log(pole)) / dt if pole else 0j
    if dt is not None and not pole:
        return f"{text}  (a delay)"
    damping = -s.real / abs(s) if s else 1.0
    return f"{text}  ({abs(s):.6g} rad/s, damping {damping:.4g})"


@diagram.command()
def export(
    diagram: Which,
    folder: Annotated[
        Path, argument("Where to write NAME.h and NAME.c.", "FOLDER", show_default="this folder")
    ] = Path(),
    dt: Tick = 0.004,
    precision: Reals = "float64",
    log: Annotated[list[str] | None, option("Return this signal too; repeatable.", "PATH", "--log")] = None,
    name: Annotated[str, option("Prefix of all names; default: the diagram's name.", "NAME")] = "",
    tables: Annotated[
        bool, flag("Add tables of parameters and signals, for live tuning and logging.", "--tables")
    ] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a diagram as a C file and a header, for your own firmware or program.

    The header has an example of the loop that calls it.
    """
    made = c_files(load_diagram(diagram), dt, precision, log or (), name=name, tables=tables)
    paths = made.write(folder, force)
    files = [str(path) for path in paths]
    sizes = dict(zip(("real", "P", "S", "U", "Y"), made.emitted.sizes, strict=True))
    print_result(json, {"name": made.name, "files": files, "sizes": sizes}, [f"written: {', '.join(files)}"])


FmiVersion = Literal["3.0", "2.0"]
"""Version of FMI."""


@diagram.command()
def fmu(
    diagram: Which,
    out: Annotated[Path, argument("The file to write.", "OUT.fmu")],
    fmi: Annotated[FmiVersion, option("Version of FMI; 2.0 has no arrays and one type of integers.")] = "3.0",
    dt: Tick = 0.004,
    precision: Reals = "float64",
    log: Annotated[list[str] | None, option("Make this signal an output too; repeatable.", "PATH", "--log")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a diagram as an FMU for co-simulation, with its C and the binary of this computer.

    Simulink, Modelica tools, Drake and others open it. One period is the base tick.
    """
    if out.suffix.lower() != ".fmu":
        raise LogError(f"an FMU ends in .fmu; {out.name} does not", "OUT.fmu", f"name it {out.stem}.fmu")
    check_folder(out, force)
    made = make_fmu(load_diagram(diagram), dt, precision, fmi, log or ())
    made.write(out, force)
    counts = {
        f"{causality}s": sum(v.causality == causality for v in made.variables)
        for causality in ("input", "output", "parameter")
    }
    told = ", ".join(f"{count} {name if count != 1 else name[:-1]}" for name, count in counts.items())
    document = {"name": made.name, "file": str(out), "fmi": fmi, **counts}
    print_result(json, document, [f"written: {out}, FMI {fmi}: {told}"])


RunOn = Literal["reference", "native", "wasm", "cortex-m7"]
"""Target that runs the tests, as `run_scenarios` names it."""


@diagram.command("test")
def run_tests(
    diagram: Annotated[str, argument(DIAGRAM_HELP, "DIAGRAM")],
    tests: Annotated[list[Path], argument("Files of tests (TOML).", "TESTS...")],
    target: Annotated[RunOn, option("How to run it; all give the same bits.")] = "native",
    precision: Reals = "float64",
    junit: Annotated[Path | None, option("Write the results as JUnit XML.", "FILE")] = None,
    html: Annotated[Path | None, option("Write an HTML page with plots of the failed tests.", "FILE")] = None,
    coverage: Annotated[bool, flag("List the decisions that were never taken.", "--coverage")] = False,
    coverage_min: Annotated[
        float | None, option("Fail if fewer sides of the decisions are taken.", "PERCENT", min=0.0, max=100.0)
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Run tests of a diagram: inputs over time, and what its outputs must be. Exit status 1 if a test fails.

    Coverage is measured on the reference, in the same precision: each limit, switch and condition has two sides.
    """
    for path in filter(None, (junit, html)):
        check_folder(path, force)
    tested = load_diagram(diagram)
    results: dict[str, list[ScenarioResult]] = {}
    covered = Coverage() if coverage or coverage_min is not None else None
    for file in tests:
        given = read_scenarios(file)
        found = run_scenarios(tested, given.scenarios, given.dt, precision, target, given.integrator)
        results[str(file)] = found
        if covered is not None:
            covered.add(measure_coverage(tested, given.scenarios, given.dt, precision, given.integrator))
    every = [one for found in results.values() for one in found]
    if junit is not None:
        write_text(junit, to_junit(results))
    if html is not None:
        page = importlib.import_module("twodof.report.report_page")  # matplotlib takes a second to load
        write_text(html, page.failed_tests_page(tested.name, every))
    enough = covered is None or 100.0 * covered.share >= (coverage_min or 0.0)
    passed = enough and all(one.passed for one in every)
    files = {file: list(map(_plain, found)) for file, found in results.items()}
    document = {"passed": passed, "files": files, "coverage": covered and _plain_coverage(covered)}
    lines = [*_result_lines(results), *([] if covered is None else _coverage_lines(covered))]
    lines += [] if enough else [f"  FAILED coverage: below {coverage_min:g} %"]
    lines += [f"written: {path}" for path in filter(None, (junit, html))]
    print_result(json, document, lines)
    exit_unless(passed)


def _plain(result: ScenarioResult) -> dict[str, Any]:
    return {"name": result.name, "passed": result.passed, "checks": [asdict(j) for j in result.judgements]}


def _result_lines(results: dict[str, list[ScenarioResult]]) -> Iterator[RenderableType]:
    for file, found in results.items():
        yield file
        for result in found:
            for j in result.judgements:
                yield f"  {'ok    ' if j.passed else 'FAILED'} {result.name}: {j.check}: {j.text}"
    every = [one for found in results.values() for one in found]
    yield f"{sum(one.passed for one in every)} of {len(every)} tests passed"


def _plain_coverage(covered: Coverage) -> dict[str, Any]:
    rows = [
        {**asdict(d), "taken": [side for i, side in enumerate(d.sides) if i in taken]}
        for d, taken in covered.taken.items()
    ]
    return {"percent": 100.0 * covered.share, "sides": covered.sides, "decisions": rows}


def _coverage_lines(covered: Coverage) -> Iterator[RenderableType]:
    missing = covered.missing
    yield (
        f"coverage: {covered.sides - len(missing)} of the {covered.sides} sides of {len(covered.taken)} decisions were "
        f"taken, {100.0 * covered.share:.1f} %"
    )
    if missing:
        yield "never taken:"
        rows = table("block", "where", "decision", "side")
        for decision, side in missing:
            place = decision.place or decision.kind
            rows.add_row(decision.path, place, decision.text, side)
        yield rows
