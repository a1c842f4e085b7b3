"""`twodof kill`: the motors of a drone off, from the shell, though another has its lease; and letting it go again."""

from pathlib import Path
from typing import Annotated

import typer

from twodof.cli.drone.connect import connect
from twodof.cli.output import Json, print_json, table_console
from twodof.gcs.async_drone import DEFAULT_URL
from twodof.gcs.drone import Drone

app = typer.Typer(add_completion=False, rich_markup_mode=None)


@app.command()
def kill(
    url: Annotated[str, typer.Option(help="Where the drone is, as `twodof up` or `twodof drones` says.")] = DEFAULT_URL,
    drone: Annotated[int | None, typer.Option(min=1, max=255, help="Its system, where several are heard.")] = None,
    key: Annotated[Path | None, typer.Option(help="File of the key that signs everything.")] = None,
    release: Annotated[bool, typer.Option("--release", help="Let a drone that was killed be armed again.")] = False,
    json: Json = False,
) -> None:
    """Motors off, now: in flight too, and though another program commands it. It needs no lease and takes none.

    The kill is repeated until the drone is seen to be disarmed. No program can arm it until --release, which takes the
    lease. Exit status 2: no drone was heard, or it was not seen to obey.
    """
    if release:
        _release(url, drone, key, json)
        return
    there = Drone.connect(url, key=key, drone=drone, take_lease=False)
    with there:
        before = there.state
        there.kill()
    if json:
        print_json({"url": url, "was_armed": before.armed, "mode": before.mode, "held": there.state.killed})
    else:
        was = f"it was armed, in mode {before.mode}" if before.armed else "it was not armed"
        until = f", and held so until released: twodof kill --release --url {url}" if there.state.killed else ""
        table_console().print(f"motors off ({was}){until}", soft_wrap=True)


def _release(url: str, drone: int | None, key: Path | None, json: bool) -> None:
    """Let it be armed again, and say what had been."""
    with connect(url, key=key, drone=drone) as there:
        before = there.state
        there.release()
    if json:
        print_json({"url": url, "was_held": before.killed, "held": there.state.killed})
    else:
        table_console().print("released: it may be armed again" if before.killed else "it was not killed")
