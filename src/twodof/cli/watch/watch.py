"""`twodof watch`: the live values and states of drones, in a terminal or as JSON; it commands nothing."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.live import Live
from rich.text import Text

from twodof.cli.drone.until_told import until_told
from twodof.cli.output import Json, print_json, table_console
from twodof.cli.watch.reading import line, reading
from twodof.cli.watch.screen import known, screen
from twodof.cli.watch.watched_drone import WatchedDrone
from twodof.errors import LinkLost, TwodofError
from twodof.gcs.discovery import LOOPBACK, discover, urls
from twodof.link.signing import read_key

app = typer.Typer(add_completion=False, rich_markup_mode=None)

FIRST_VALUES_S = 2.0
"""How long the first samples of a drone that is heard are waited for [s]."""
_LISTEN_S = 3.0
_SCREEN_S, _LINES_S = 0.2, 1.0


@app.command()
def watch(
    at: Annotated[
        list[str] | None,
        typer.Argument(metavar="URL", help="Where drones are, as `twodof up` says; none: those of this machine."),
    ] = None,
    drone: Annotated[int | None, typer.Option(min=1, max=255, help="Its system, where several are heard.")] = None,
    key: Annotated[Path | None, typer.Option(help="File of the key that signs everything.")] = None,
    window: Annotated[float, typer.Option(min=1.0, max=600.0, help="How much the charts show [s].")] = 20.0,
    every: Annotated[
        float | None,
        typer.Option(
            min=0.05, max=60.0, help="Time between two pictures (.2) or lines of a pipe or of --json (1) [s]."
        ),
    ] = None,
    once: Annotated[bool, typer.Option("--once", help="Say how they stand now, and end.")] = False,
    json: Json = False,
) -> None:
    """Show how drones fly, until Ctrl-C: states, failsafe, words, and charts of theta, q, M and x.

    It takes no lease and changes nothing; a drone that is lost is looked for again. Into a pipe it writes a line a
    drone, with --json one JSON document a line. Exit status: 0 ended by Ctrl-C or by --once, 2 no drone was heard.
    """
    if key is not None:
        read_key(key)
    status = asyncio.run(_watch(at or [], drone, key, window, every, once, json))
    raise typer.Exit(status)


async def _watch(
    at: list[str], system: int | None, key: Path | None, window: float, every: float | None, once: bool, json: bool
) -> int:
    async def work() -> None:
        drones = [WatchedDrone(url, number, key, window) for url, number in await _places(at, system)]
        await _first(drones)
        tasks = [asyncio.create_task(one.watch()) for one in drones]
        try:
            if once:
                await _first_values(drones)
                _say(drones, json, indent=2)
            else:
                await _show(drones, window, every, json)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    await until_told(work())
    return 0


async def _places(at: Sequence[str], system: int | None) -> list[tuple[str, int | None]]:
    """What to watch: what was named, else what is heard. Raises LinkLost where nothing is."""
    if at:
        return [(url, system) for url in at]
    # Not the ports to which drones send: who watches must not keep another program from them.
    places = [url for url in urls([LOOPBACK]) if not url.startswith("udpin")]
    found = [one for one in await discover(_LISTEN_S, places=places) if system in (None, one.system)]
    if not found:
        which = "no drone" if system is None else f"no drone {system}"
        remedy = "start one with `twodof up`, or say where it is: twodof watch URL"
        raise LinkLost(f"{which} was heard on this machine within {_LISTEN_S:g} s", LOOPBACK, remedy)
    return [(one.url, one.system) for one in found]


async def _first(drones: Sequence[WatchedDrone]) -> None:
    """Connect to all side by side; those that do not answer are looked for later. Raises where none answers."""
    ends = await asyncio.gather(*(one.connect() for one in drones), return_exceptions=True)
    errors = [end for end in ends if isinstance(end, BaseException)]
    for one, end in zip(drones, ends, strict=True):
        if isinstance(end, TwodofError):
            one.miss(end)
    if len(errors) == len(drones) or not all(isinstance(error, TwodofError) for error in errors):
        for one in drones:
            await one.leave()
        raise errors[0]


async def _first_values(drones: Sequence[WatchedDrone]) -> None:
    with suppress(TimeoutError):
        async with asyncio.timeout(FIRST_VALUES_S):
            while not known([one for one in drones if one.heard]):
                await asyncio.sleep(0.02)


async def _show(drones: Sequence[WatchedDrone], window: float, every: float | None, json: bool) -> None:
    """Until cancelled: pictures on a terminal, else lines."""
    console = table_console()
    if json or not console.is_terminal or console.is_dumb_terminal:
        await _first_values(drones)
        while True:
            _say(drones, json, indent=None)
            await asyncio.sleep(every or _LINES_S)
    with Live(console=console, screen=True, auto_refresh=False, transient=True) as live:
        while True:
            live.update(_picture(drones, console, window), refresh=True)
            await asyncio.sleep(every or _SCREEN_S)


def _picture(drones: Sequence[WatchedDrone], console: Console, window: float) -> Text:
    width, height = console.size
    return screen(drones, width, height, window)


def _say(drones: Sequence[WatchedDrone], json: bool, indent: int | None) -> None:
    if json:
        print_json({"drones": [reading(one) for one in drones]}, indent)
        return
    for one in drones:
        sys.stdout.write(line(one) + "\n")
    sys.stdout.flush()
