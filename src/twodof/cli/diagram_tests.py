"""`twodof diagram test`: run the tests of a diagram, say what does not hold, when and by how much."""

import importlib
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

from twodof.cli.options import Force, Json, Reals, argument, flag, option
from twodof.cli.output import exit_unless, print_json, table, table_console
from twodof.compile.diagram_test.coverage import Coverage, measure_coverage
from twodof.compile.diagram_test.run_scenarios import run_scenarios, to_junit
from twodof.compile.diagram_test.scenario import ScenarioResult
from twodof.compile.diagram_test.scenario_file import read_scenarios
from twodof.flight.starters import DIAGRAM_HELP, load_diagram
from twodof.flightlog.atomic import atomic_write
from twodof.flightlog.files import check_folder

RunOn = Literal["reference", "native", "wasm", "cortex-m7"]
"""Target that runs the tests, as `run_scenarios` names it."""


def run_tests(
    diagram: Annotated[str, argument(DIAGRAM_HELP, "DIAGRAM")],
    tests: Annotated[list[Path], argument("Files of tests (TOML).", "TESTS...")],
    target: Annotated[RunOn, option("What runs it; all give the same bits.")] = "native",
    precision: Reals = "float64",
    junit: Annotated[Path | None, option("Write the results as JUnit XML.", "FILE")] = None,
    html: Annotated[Path | None, option("Write a page with plots of what failed.", "FILE")] = None,
    coverage: Annotated[bool, flag("Say which decisions were never taken.", "--coverage")] = False,
    coverage_min: Annotated[
        float | None, option("Fail if fewer sides are taken.", "PERCENT", min=0.0, max=100.0)
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Run tests of a diagram: what goes in, and what must hold of what comes out. Exit status 1 if one fails.

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
        _write(junit, to_junit(results))
    if html is not None:
        page = importlib.import_module("twodof.report.report_page")  # matplotlib takes a second to load
        _write(html, page.failed_tests_page(tested.name, every))
    enough = covered is None or 100.0 * covered.share >= (coverage_min or 0.0)
    passed = enough and all(one.passed for one in every)
    if json:
        files = {file: list(map(_plain, found)) for file, found in results.items()}
        print_json({"passed": passed, "files": files, "coverage": covered and _plain_coverage(covered)})
    else:
        _print(results)
        if covered is not None:
            _print_coverage(covered)
        if not enough:
            table_console().print(f"  FAILED coverage: below {coverage_min:g} %")
        for path in filter(None, (junit, html)):
            table_console().print(f"written: {path}")
    exit_unless(passed)


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


def _plain_coverage(covered: Coverage) -> dict[str, Any]:
    rows = [
        {**asdict(d), "taken": [side for i, side in enumerate(d.sides) if i in taken]}
        for d, taken in covered.taken.items()
    ]
    return {"percent": 100.0 * covered.share, "sides": covered.sides, "decisions": rows}


def _print_coverage(covered: Coverage) -> None:
    console = table_console()
    missing = covered.missing
    console.print(
        f"coverage: {covered.sides - len(missing)} of the {covered.sides} sides of {len(covered.taken)} decisions were "
        f"taken, {100.0 * covered.share:.1f} %"
    )
    if missing:
        console.print("never taken:")
        rows = table("block", "where", "decision", "side")
        for decision, side in missing:
            place = decision.place or decision.kind
            rows.add_row(decision.path, place, decision.text, side)
        console.print(rows)
