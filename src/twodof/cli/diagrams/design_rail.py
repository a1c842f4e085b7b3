"""`twodof design rail`: what the velocity and position loops will do, on the identified pitch and cart."""

import json as json_text
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from twodof.cli.options import Seed
from twodof.cli.output import Force, Json, print_json, progress, say_line, table_console
from twodof.errors import LogError, ParameterError
from twodof.flight.gains import load_gains
from twodof.flight.starters import DIAGRAM_HELP, load_diagram
from twodof.flightlog.atomic import atomic_write, check_free
from twodof.flightlog.provenance import read_bytes
from twodof.sim.promised.rail_family import RailFamily
from twodof.sim.promised.rail_promise import MEMBERS, STEPS, rail_promise
from twodof.sim.promised.rail_specification import check_rail, read_rail_specification

MAX_BYTES = 1 << 24


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
    promise_file: Annotated[
        Path | None, typer.Option("--promise", metavar="FILE", help="Write what is promised there, as JSON.")
    ] = None,
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
    Exit status 1: a member meets an end stop, or the specification is missed.
    """
    if promise_file is not None:
        check_free(promise_file, force)
    family = RailFamily.from_identified(_document(pitch), _document(cart), rig)
    diagrams, flown = [load_diagram(one) for one in controller or []], load_gains(gains)
    asked = None if spec is None else read_rail_specification(spec)
    which = loop.value if loop is not None else (asked.loop if asked is not None else "velocity")
    step = goal if goal is not None else (asked.step if asked is not None else STEPS[which][2])
    with progress() as report:
        made = rail_promise(
            family,
            which,
            gains=flown,
            controllers=diagrams,
            goal=step,
            members=members,
            seed=seed,
            said=lambda share: report("flying the members", 0.9 * share),
        )
        report("the margins", 0.9)
        checked = () if asked is None else check_rail(asked, family, flown, diagrams, made)
    if promise_file is not None and not made.lost:
        with atomic_write(promise_file, "w") as file:
            json_text.dump(made.to_json(), file, allow_nan=False)
    if json:
        print_json({"promise": made.to_json(), "specification": [one.to_json() for one in checked]})
    else:
        table_console().print(made.table())
        for one in checked:
            table_console().print(one.text)
        if promise_file is not None and not made.lost:
            say_line(f"written: {promise_file}")
    if made.lost or not all(one.met for one in checked):
        raise typer.Exit(1)


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
