"""`twodof demo`: the whole way, from flying to the report."""

import time
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import Annotated, Any

from rich.console import RenderableType

from twodof.cli.options import Force, Json, option
from twodof.cli.output import exit_unless, print_result, progress, say_line, table
from twodof.errors import LogError
from twodof.experiment.experiments import IDENTIFICATION, Experiment
from twodof.experiment.flight import Flight, Laboratory
from twodof.experiment.fly import fly_series
from twodof.flightlog.atomic import write_text
from twodof.flightlog.files import check_folder
from twodof.flightlog.provenance import versions
from twodof.flightlog.public_data import VARIABLE, available
from twodof.report.characterisation.compose import CharacterisedMachine, content, rows
from twodof.report.characterisation.demonstration import REPETITIONS, comparisons, planned, real, virtual
from twodof.report.content import ParameterRow
from twodof.report.report_page import to_html
from twodof.report.wording import plain, with_sigma

_REPORT = Path("out/demo/report.html")
_RIGS = ("paper", "lab")
# What the progress bar counts besides flights: some for each rig, the real drone's logs, the report.
_OTHER_STEPS = 21


def demo(
    out: Annotated[Path, option("The report to write, an HTML page.", "FILE")] = _REPORT,
    repetitions: Annotated[
        int, option("Flights of each experiment on each rig; their spread is a result.", min=3, max=100)
    ] = REPETITIONS,
    force: Force = False,
    json: Json = False,
) -> None:
    """Fly the paper's experiments over MAVLink on virtual drones, identify, compare with its Table 1, write the report.

    Each drone is a process of its own and flies faster than real time. The real drone's logs are identified too where
    they are at hand. Exit status 1: a parameter of the virtual rigs could not be identified, or a flight was not good.
    """
    began = time.monotonic()
    _make_folder(out)
    check_folder(out, force)
    say_line("The demo flies, identifies and writes the report in 1 to 5 minutes on two idle cores.")
    with progress() as report:
        steps = count()
        expected = _OTHER_STEPS + len(_RIGS) * len(IDENTIFICATION) * repetitions

        def step(text: str) -> None:
            report(text, min(1.0, next(steps) / expected))

        flown = _fly(repetitions, step)
        rigs = list(flown.values())
        logs = available()
        drone = real(logs, step)
        tables = [planned(flown), *comparisons(logs, step)]
        step("write the report")
        machines = [*rigs, *([drone] if drone is not None else [])]
        page = to_html(content(machines, _provenance(list(logs), repetitions), tables))
        write_text(out, page)
    seconds = time.monotonic() - began
    document = {
        "machines": [{"name": machine.name, "parameters": _parameters(machine)} for machine in machines],
        "real_logs": sorted(logs),
        "report": str(out),
        "seconds": seconds,
    }
    print_result(json, document, _lines(machines, len(logs), out, seconds))
    exit_unless(not any(machine.remarks or not _complete(machine) for machine in rigs))


def _fly(repetitions: int, step: Callable[[str], None]) -> dict[str, CharacterisedMachine]:
    """Fly the paper's experiments on a drone of each rig, side by side, and identify the machines."""
    step("compile the flight code and the rigs")
    flights = {}
    for rig, name, seed, flight in fly_series(_RIGS, list(IDENTIFICATION), range(1, repetitions + 1)):
        step(f"{rig}: {name}, flight {seed} of {repetitions}")
        flights[rig, name, seed] = flight

    def identified(rig: str) -> CharacterisedMachine:
        def flown(experiment: Experiment, seed: int) -> Flight:
            return flights[rig, experiment.name, seed]

        return virtual(Laboratory(rig), flown, step, repetitions)

    return {rig: identified(rig) for rig in _RIGS}


def _provenance(logs: list[str], repetitions: int) -> dict[str, str]:
    return {
        **versions(),
        "virtual flights": f"seeds 1 to {repetitions} of each experiment on each rig, flown over MAVLink in lockstep",
        "real flights": ", ".join(logs) or "none: twodof log fetch downloads the logs of the real drone",
    }


def _make_folder(path: Path) -> None:
    """Make the report's folder before anything is flown. Raises LogError."""
    if path != _REPORT:  # a folder that somebody names is there, as everywhere
        return
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as refusal:
        raise LogError(
            f"the folder cannot be made: {refusal.strerror}", str(path.parent), "name another place with --out"
        ) from refusal


def _complete(machine: CharacterisedMachine) -> bool:
    return all(row.simple is not None and row.greybox is not None for row in rows(machine) if row.paper is not None)


def _parameters(machine: CharacterisedMachine) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for row in rows(machine):
        found[row.key] = {name: getattr(row, name) for name in ("unit", "paper", "paper_greybox", "truth")}
        for name, estimate in (("simple", row.simple), ("greybox", row.greybox)):
            found[row.key][name] = None if estimate is None else estimate.value
            found[row.key][f"{name}_sigma"] = None if estimate is None else estimate.sigma
        found[row.key]["greybox_spread"] = row.greybox_spread
    return found


def _lines(machines: list[CharacterisedMachine], logs: int, out: Path, seconds: float) -> Iterator[RenderableType]:
    for machine in machines:
        heads = ("", "unit", "paper", "truth", "simple", "grey-box")
        made = table(*heads, right=range(2, 6), title=machine.name, title_justify="left")
        for column in made.columns:
            column.min_width = 9
        for row in rows(machine):
            made.add_row(*_cells(row))
        yield made
        yield ""
    if not logs:
        yield f"The real drone's logs are missing. `twodof log fetch` downloads them; {VARIABLE} names their folder."
    yield f"Report: {out.resolve()} ({seconds:.0f} s)"


def _cells(row: ParameterRow) -> list[str]:
    paper = "–" if row.paper is None else plain(row.paper)
    if row.paper_greybox is not None:
        paper += f" / {plain(row.paper_greybox)}"
    found = ["–" if one is None else with_sigma(one) for one in (row.simple, row.greybox)]
    return [row.key, row.unit or "-", paper, "–" if row.truth is None else plain(row.truth), *found]
