"""`twodof lab`: the laboratory in the browser, until Ctrl-C."""

import asyncio
import os
import sys
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from twodof.cli import options
from twodof.cli.drone.until_told import until_told
from twodof.cli.interrupts import INTERRUPTED
from twodof.cli.output import Json, print_json
from twodof.flight.controller_store import data_folder
from twodof.lab.links import drawn_tokens, links, who_gets_in
from twodof.lab.serve import serve
from twodof.lab.settings import COMMAND_TOKEN, LOOPBACK, PORT, WATCH_TOKEN, LabSettings
from twodof.link.signing import read_key

app = typer.Typer(add_completion=False, rich_markup_mode=None)


@app.command()
def lab(
    connect: Annotated[
        list[str] | None,
        typer.Option(metavar="URL", help="A drone; may be repeated. Left out: those of this computer, as they come."),
    ] = None,
    host: options.PageHost = LOOPBACK,
    port: Annotated[int, typer.Option(min=0, max=65535, help="TCP port; 0: a free one.")] = PORT,
    token: options.PageToken = False,
    key: options.KeyFile = None,
    logs: Annotated[
        list[Path] | None,
        typer.Option(metavar="FOLDER", exists=True, file_okay=False, help="Show its logs too; may be repeated."),
    ] = None,
    open_page: options.OpenPage = False,
    json: Json = False,
) -> None:
    """Serve the page in which drones are flown, tuned and identified; say its link; run until Ctrl-C.

    Only this computer reaches it, unless --host says otherwise: then only who has the link. There are two, one to
    command and one to watch; each start draws new ones. With --json one line of JSON says them. Exit status: 0 ended by
    Ctrl-C or SIGTERM, 2 the port is taken or an option is wrong.
    """
    if key is not None:
        read_key(key)
    tokens = drawn_tokens(host, os.environ.get(COMMAND_TOKEN, ""), os.environ.get(WATCH_TOKEN, ""), token)
    urls, folders = tuple(connect or ()), tuple(logs or ())
    settings = LabSettings(
        data_folder(), host, port, urls, key, tokens.command, tokens.watch, logs=folders, token_always=token
    )
    listens = False

    def ready(found: int) -> None:
        nonlocal listens
        listens = True
        say(settings, found, json)
        if open_page:
            webbrowser.open(links(settings, found)["command"])

    asyncio.run(until_told(serve(settings, ready)))
    raise typer.Exit(0 if listens else INTERRUPTED)


def say(settings: LabSettings, port: int, json: bool) -> None:
    """Say the links: to people, or as one line of JSON."""
    found = links(settings, port)
    if json:
        print_json({"port": port, "page": found}, indent=None)
        return
    sys.stdout.write(f"listening on http://{settings.host}:{port}\nthe page         {found['command']}\n")
    sys.stdout.write(f"only to watch    {found['watch']}\n{who_gets_in(settings)}")
    sys.stdout.flush()
