"""`twodof drones`: which drones can be heard, and where to connect to them."""

import asyncio
from collections import Counter
from typing import Annotated

import typer
from rich.table import Table

from twodof.cli.output import Json, print_json, table_console
from twodof.fleet.local_drone import controller_in_words
from twodof.gcs.discovery import LOOPBACK, discover

app = typer.Typer(add_completion=False, rich_markup_mode=None)


@app.command()
def drones(
    host: Annotated[list[str] | None, typer.Argument(metavar="HOST", help="Machines to ask besides this one.")] = None,
    timeout: Annotated[float, typer.Option(min=0.1, max=60.0, help="How long to listen [s].")] = 3.0,
    json: Json = False,
) -> None:
    """List the drones that are heard on PX4's ports of this machine, or answer at those of HOST. Commands nothing."""
    found = asyncio.run(discover(timeout, [LOOPBACK, *(host or ())]))
    if json:
        print_json([one._asdict() for one in found])
        return
    console = table_console()
    if not found:
        console.print(f"no drone was heard within {timeout:g} s")
        return
    table = Table("drone", "connect to", "mode", "", "autopilot", "", box=None, pad_edge=False)
    drones = Counter(one.url for one in found)
    for one in found:
        # Where several are heard, `Drone.connect` must be told which.
        place = f"{one.url}, drone={one.system}" if drones[one.url] > 1 else one.url
        flies = "" if one.changed is None else controller_in_words(one.controller, one.changed)
        table.add_row(str(one.system), place, one.mode, "armed" if one.armed else "", one.autopilot, flies)
    console.print(table)
