"""`twodof campaign EXPERIMENT...`: fly experiments many times and see how often the default fit holds the truth."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from twodof.campaign.coverage import COLUMNS, FLOWN, IdentifiedByDefault, coverage, drawn_drones, failures
from twodof.campaign.plan import plan
from twodof.campaign.workers import campaign as run_campaign
from twodof.cli.options import Force, Json, Rig, argument, option
from twodof.cli.output import print_result, progress, say_line, table
from twodof.errors import ExperimentError, nearest


def campaign(
    experiments: Annotated[list[str], argument(f"Of {', '.join(FLOWN)}.", "EXPERIMENT...")],
    rig: Rig = "lab",
    seeds: Annotated[int, option("Flights of each experiment, with seeds from 1 on.", min=1, max=100_000)] = 72,
    out: Annotated[
        Path | None,
        option(
            "Write the figures of each flight to this file, one JSON line each; the same command continues it.", "FILE"
        ),
    ] = None,
    drawn: Annotated[bool, option("Fly a different drone each time, drawn from the prior of the fit.")] = False,
    processes: Annotated[int | None, option("Number of processes; default: one per core.", min=1, max=1024)] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Fly experiments on a virtual rig, identify each flight by itself, and count the intervals that hold the truth.

    Each flight is identified as by `twodof identify` and the page. Printed for each unknown: the rig's own value, what
    a flight claims (the median standard deviation), how many 95 % intervals hold the truth, the p-value of that count,
    and bias and spread of the estimates over the claim.

    A campaign that was stopped, by Ctrl-C or a kill, continues from FILE.
    """
    for name in experiments:
        if name not in FLOWN:
            raise ExperimentError(f"no experiment called {name!r:.80}", "EXPERIMENT", f"take {nearest(name, FLOWN)}")
    if len(set(experiments)) < len(experiments):
        raise typer.BadParameter("an experiment is named twice")
    if out is not None and force:
        out.unlink(missing_ok=True)
    numbers = range(1, seeds + 1)
    runs = drawn_drones(rig, experiments, numbers) if drawn else plan(numbers, cases=experiments)
    with progress() as report:
        rows = run_campaign(
            IdentifiedByDefault(rig),
            runs,
            out,
            name=f"coverage on {rig}{', drawn' if drawn else ''}",
            processes=processes,
            say=say_line,
            report=lambda done: report(runs[done - 1].case, done / len(runs)),
        )
    found = list(coverage(rows))
    shown = table(*COLUMNS, right=range(2, 8))
    for one in found:
        shown.add_row(*one.text)
    missed = failures(rows)
    print_result(json, {"rig": rig, "coverage": [asdict(one) for one in found], "failures": missed}, [shown])
    for line in () if json else missed:
        say_line(f"note: {line}")
