"""`twodof design rail`: what the velocity and position loops will do, on the identified pitch and cart."""

import json as json_text
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from twodof.cli.flown import write_view
from twodof.cli.options import PromiseFile, PromisePlot, Seed
from twodof.cli.output import Force, Json, print_json, progress, say_line, table_console
from twodof.design.promise import STEPS
from twodof.design.specification import read_specification
from twodof.errors import LogError, ParameterError
from twodof.flight.gains import load_gains
from twodof.flight.starters import DIAGRAM_HELP, load_diagram
from twodof.flightlog.atomic import atomic_write, check_free
from twodof.flightlog.provenance import read_bytes
from twodof.report.plots.flight_view import check_place
from twodof.report.plots.promise_view import promise_view
from twodof.sim.promised.rail_design import RailDesign, rail_design
from twodof.sim.promised.rail_family import RailFamily
from twodof.sim.promised.rail_promise import MEMBERS, check_rail, rail_promise

MAX_BYTES = 1 << 24
_SEARCH, _FLOWN = 0.8, 0.9  # shares of the work that end there


class Loop(StrEnum):
    """Which set-point steps."""

    velocity = "velocity"
    position = "position"


def rail(
    pitch: Annotated[Path, typer.Argument(metavar="PITCH", help="The pitch's model, of `twodof identify --out`.")],
    cart: Annotated[
        Path, typer.Argument(metavar="CART", help="The cart's model, `twodof identify --out` of a velocity-doublet.")
    ],
    controller: Annotated[
        list[str] | None, typer.Option(metavar="DIAGRAM", help=f"In place of a stock loop; repeatable. {DIAGRAM_HELP}")
    ] = None,
    gains: Annotated[
        str, typer.Option(help="Of the stock loops: default, student, or a JSON file of gains.")
    ] = "default",
    loop: Annotated[Loop | None, typer.Option(help="Whose set-point steps; left out: the specification's.")] = None,
    goal: Annotated[
        float | None, typer.Option(metavar="M/S|M", help="The step; left out: the specification's, or .15.")
    ] = None,
    spec: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A specification (TOML) with a table [rail]: check it.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Search the stock loops' gains for --spec, from --gains on; write them there."
        ),
    ] = None,
    promise_file: PromiseFile = None,
    plot: PromisePlot = None,
    rig: Annotated[str, typer.Option(metavar="RIG", help="What no model tells, such as sensors, is this rig's.")] = (
        "paper"
    ),
    members: Annotated[int, typer.Option(help="How many members of the family are flown.")] = MEMBERS,
    seed: Seed = 1,
    force: Force = False,
    json: Json = False,
) -> None:
    """Promise a step of the velocity or position, by flights of the identified family on the virtual rig.

    All limits, sensors and the estimator are in these flights. `twodof design verdict` holds a log against the promise.

    With --spec and --out the gains are those that meet the specification best. They are written as `--gains` reads
    them, here and in `twodof simulate`.

    Exit status 1: a member meets an end stop, or the specification is missed.
    """
    if out is not None and (spec is None or controller):
        raise typer.BadParameter("--out searches gains of the stock loops for --spec: give --spec, and no --controller")
    for path in (out, promise_file):
        if path is not None:
            check_free(path, force)
    if plot is not None:
        check_place(plot, force)
    family = RailFamily.from_identified(_document(pitch), _document(cart), rig)
    diagrams, flown = [load_diagram(one) for one in controller or []], load_gains(gains)
    asked = None if spec is None else read_specification(spec, "rail")
    which = loop.value if loop is not None else (asked.loop if asked is not None else "velocity")
    step = goal if goal is not None else (asked.step if asked is not None else STEPS[which].goal)
    found: RailDesign | None = None
    with progress() as report:
        if out is not None and asked is not None:
            found = rail_design(
                asked, family, flown, members, seed, lambda share: report("searching the gains", _SEARCH * share)
            )
            flown = found.gains
        begun = _SEARCH if found is not None else 0.0
        made = rail_promise(
            family,
            which,
            gains=flown,
            controllers=diagrams,
            goal=step,
            members=members,
            seed=seed,
            said=lambda share: report("flying the members", begun + (_FLOWN - begun) * share),
        )
        report("the margins", _FLOWN)
        checked = () if asked is None else check_rail(asked, family, flown, diagrams, made)
    written: dict[str, str] = {}
    if made.robust:
        if out is not None:
            written["gains"] = _write(out, flown.to_json())
        if promise_file is not None:
            written["promise"] = _write(promise_file, made.to_json())
        if plot is not None:
            write_view(promise_view(made), plot, force)
            written["plot"] = str(plot)
    if json:
        print_json(
            {
                "promise": made.to_json(),
                "specification": [one.to_json() for one in checked],
                "gains": flown.to_json(),
                "written": written,
            }
        )
    else:
        if found is not None:
            kp, ki = flown.velocity
            table_console().print(f"velocity PI: Kp {kp:.4g}, Ki {ki:.4g}; position P: Kp {flown.position:.4g}")
        table_console().print(made.table())
        for one in checked:
            table_console().print(one.text)
        for name in written.values():
            say_line(f"written: {name}")
    if not made.robust or not all(one.met for one in checked):
        raise typer.Exit(1)


def _write(path: Path, document: object) -> str:
    with atomic_write(path, "w") as file:
        json_text.dump(document, file, allow_nan=False)
    return str(path)


def _document(path: Path) -> object:
    try:
        found: object = json_text.loads(read_bytes(path, MAX_BYTES))
    except LogError as reason:
        raise ParameterError(reason.what, str(path), "name a JSON file") from reason
    except (ValueError, RecursionError) as reason:
        raise ParameterError(
            f"it is not JSON: {reason!s:.80}", str(path), "give what `twodof identify --out` wrote"
        ) from reason
    return found
