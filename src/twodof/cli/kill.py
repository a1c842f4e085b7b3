"""`twodof kill`: the motors of a drone off, from the shell, whoever has its lease."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twodof.cli.output import Json, print_json, table_console
from twodof.gcs.async_drone import DEFAULT_URL
from twodof.gcs.drone import Drone

app = typer.Typer(add_completion=False, rich_markup_mode=None)


@app.command()
def kill(
    url: Annotated[str, typer.Option(help="Where the drone is, as `twodof up` or `twodof drones` says.")] = DEFAULT_URL,
    drone: Annotated[int | None, typer.Option(min=1, max=255, help="Its system, where several are heard.")] = None,
    key: Annotated[Path | None, typer.Option(help="File of the key that signs everything.")] = None,
    json: Json = False,
) -> None:
    """Motors off, now: in flight too, whatever it does and whoever commands it. It needs no lease and takes none.

    The kill is said again until the drone is seen to be disarmed. Exit status 2: no drone was heard, or it was not seen
    to obey.
    """
    there = Drone.connect(url, key=key, drone=drone, take_lease=False)
    with there:
        before = there.state
        there.kill()
    if json:
        print_json({"url": url, "was_armed": before.armed, "mode": before.mode, "killed": True})
    else:
        was = f"it was armed, in mode {before.mode}" if before.armed else "it was not armed"
        table_console().print(f"motors off ({was})", markup=False)
