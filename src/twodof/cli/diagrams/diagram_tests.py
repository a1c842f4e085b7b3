"""`twodof diagram test`: run the tests of a diagram, say what does not hold, when and by how much."""

import importlib
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from twodof.cli.options import RealType
from twodof.cli.output import Force, Json, print_json, table_console
from twodof.compile.diagram_test.judgement import ScenarioResult
from twodof.compile.diagram_test.junit import to_junit
from twodof.compile.diagram_test.run_scenarios import run_scenarios
from twodof.compile.diagram_test.scenario_file import read_scenarios
from twodof.flight.starters import DIAGRAM_HELP, load_diagram
from twodof.flightlog.atomic import atomic_write
from twodof.flightlog.files import check_folder


class RunOn(StrEnum):
    """What runs the tests, as `run_scenarios` names it."""

    reference = "reference"
    native = "native"
    wasm = "wasm"
    cortex_m7 = "cortex-m7"


def run_tests(
    diagram: Annotated[str, typer.Argument(metavar="DIAGRAM", help=DIAGRAM_HELP)],
    tests: Annotated[list[Path], typer.Argument(metavar="TESTS...", help="Files of tests (TOML).")],
    target: Annotated[RunOn, typer.Option(help="What runs it; all give the same bits.")] = RunOn.native,
    precision: Annotated[RealType, typer.Option(help="The type of a real.")] = RealType.float64,
    junit: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the results as JUnit XML.")] = None,
    html: Annotated[Path | None, typer.Option(metavar="FILE", help="Write a page with plots of what failed.")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Run tests of a diagram: what goes in, and what must hold of what comes out. Exit status 1 if one fails."""
    for path in filter(None, (junit, html)):
        check_folder(path, force)
    tested = load_diagram(diagram)
    results: dict[str, list[ScenarioResult]] = {}
    for file in tests:
        given = read_scenarios(file)
        results[str(file)] = run_scenarios(
            tested, given.scenarios, given.dt, precision.value, target.value, given.integrator
        )
    every = [one for found in results.values() for one in found]
    if junit is not None:
        _write(junit, to_junit(results))
    if html is not None:
        page = importlib.import_module("twodof.report.pages.failed_tests_page")  # matplotlib takes a second to load
        _write(html, page.failed_tests_page(tested.name, every))
    passed = all(one.passed for one in every)
    if json:
        print_json({"passed": passed, "files": {file: list(map(_plain, found)) for file, found in results.items()}})
    else:
        _print(results)
        for path in filter(None, (junit, html)):
            table_console().print(f"written: {path}")
    if not passed:
        raise typer.Exit(1)


def _write(path: Path, text: str) -> None:
    with atomic_write(path, "w") as file:
        file.write(text)


def _plain(result: ScenarioResult) -> dict[str, Any]:
    return {"name": result.name, "passed": result.passed, "checks": [asdict(j) for j in result.judgements]}


def _print(results: dict[str, list[ScenarioResult]]) -> None:
    console = table_console()
    for file, found in results.items():
        console.print(file)
        for result in found:
            for j in result.judgements:
                console.print(f"  {'ok    ' if j.passed else 'FAILED'} {result.name}: {j.check}: {j.text}")
    every = [one for found in results.values() for one in found]
    console.print(f"{sum(one.passed for one in every)} of {len(every)} tests passed")
