"""`twodof up`: virtual drones with flight controller and companion each, and a page for all, until Ctrl-C."""

import asyncio
import os
import sys
import webbrowser
from collections.abc import Mapping, Sequence
from contextlib import AsyncExitStack
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

import typer

from twodof.blocks.noise import SEEDS
from twodof.cli import options
from twodof.cli.connection import run_until_signal
from twodof.cli.interrupts import INTERRUPTED
from twodof.cli.options import Json, flag, option
from twodof.cli.output import print_start, say_line
from twodof.fleet.local_drone import MOST_DRONES, ControllerReport, LocalDrone, check_ports_free, controller_in_words
from twodof.fleet.local_fleet import MOST_RESTARTS, WITHIN_S, LocalFleet, LocalPage
from twodof.fleet.local_fleet import page_port as page_port_of
from twodof.flight.controller_store import data_folder
from twodof.lab.server import serve
from twodof.lab.settings import (
    COMMAND_TOKEN,
    LOOPBACK,
    PORT,
    WATCH_TOKEN,
    LabSettings,
    drawn_tokens,
    link_warning,
    links,
)
from twodof.link.signing import read_key

NOTHING_KNOWN: Mapping[int, ControllerReport] = MappingProxyType({})


def up(
    drones: Annotated[int, option("Number of drones.", min=1, max=MOST_DRONES)] = 1,
    first: Annotated[
        int,
        option("Number of the first drone, which gives its MAVLink system id and its ports.", min=1, max=MOST_DRONES),
    ] = 1,
    rig: options.Rig = "lab",
    rings: options.Rings = False,
    controller: Annotated[
        list[str] | None, option("Fly this controller, in a sandbox; repeatable. See `twodof fcu`.", "DIAGRAM")
    ] = None,
    trust: options.Trust = False,
    lockstep: options.Lockstep = False,
    seed: Annotated[
        int, option("Seed of the first drone's noise; each further drone takes the next number.", min=0, max=SEEDS - 1)
    ] = 1,
    noise: options.Noise = 1.0,
    charge: options.Charge = 1.0,
    precision: options.Precision = "float64",
    safety_switch: options.SafetySwitch = True,
    state: Annotated[
        Path | None,
        option("Folder for the drones' folders, drone-0 for drone 1; default: the user's data folder.", "FOLDER"),
    ] = None,
    fresh: options.Fresh = False,
    key: options.KeyFile = None,
    page: Annotated[bool, flag("Serve the page in the browser; never with --lockstep.", "--page/--no-page")] = True,
    page_port: Annotated[int, option("TCP port of the page; if it is taken, a free one.", min=0, max=65535)] = PORT,
    groups: Annotated[
        int,
        option(
            "Number of groups: each has its share of the drones and its own page, at the next ports.",
            min=1,
            max=MOST_DRONES,
        ),
    ] = 1,
    host: options.PageHost = LOOPBACK,
    token: options.PageToken = False,
    open_page: options.OpenPage = False,
    json: Json = False,
) -> None:
    """Start virtual drones, each with a flight controller and a companion computer, and run until Ctrl-C.

    It prints the addresses of the drones and the link of the browser page, which it also serves. By default only this
    computer can reach the page. With --host other computers can, but only by the link. The drones' own ports are open
    to this computer only. A program that ends is started again up to three times a minute; its drone is then disarmed
    and back at its start. After a fourth time in a minute all programs but the page end. With --json the addresses come
    as one line of JSON, once all drones answer. Exit status: 0 ended by Ctrl-C or SIGTERM, 130 by
    that before all answered, 1 a program could not be kept running, 2 one did not start.
    """
    index = first - 1
    if index + drones > MOST_DRONES:
        raise typer.BadParameter(f"drones have the numbers 1 to {MOST_DRONES}", param_hint="--first, --drones")
    paged = page and not lockstep
    if (host != LOOPBACK or token) and not paged:
        raise typer.BadParameter(
            "no page is served with --no-page or --lockstep", param_hint="--token" if host == LOOPBACK else "--host"
        )
    if groups > 1 and (drones % groups or not paged):
        wrong = f"{drones} drones cannot be shared equally" if drones % groups else "no page is served"
        raise typer.BadParameter(wrong, param_hint="--groups")
    known = None if key is None else read_key(key)
    check_ports_free(index, drones)
    given = ["--rig", rig, "--noise", str(noise), "--charge", str(charge), "--precision", precision]
    flags = {"--rings": rings, "--trust": trust, "--lockstep": lockstep, "--fresh": fresh}
    flags["--no-safety-switch"] = not safety_switch
    given += [name for name, wanted in flags.items() if wanted]
    given += [word for name in controller or [] for word in ("--controller", name)]
    folder = data_folder() if state is None else state
    places = [
        LocalDrone(index + number, (seed + number) % SEEDS, folder / f"drone-{index + number}", key)
        for number in range(drones)
    ]
    fleet = LocalFleet(places, given, known, _tell)
    served = [_served(places, key, host, page_port_of(page_port, host), token)] if paged else []
    for k in range(groups if groups > 1 else 0):
        own = places[k * drones // groups : (k + 1) * drones // groups]
        served.append(_served(own, key, host, page_port_of(page_port and page_port + k + 1, host), token))
    raise typer.Exit(asyncio.run(_run(fleet, places, lockstep, json, served, open_page)))


def _settings(
    host: str, port: int, token: bool, key: Path | None, connect: Sequence[str] = (), logs: Sequence[Path] = ()
) -> LabSettings:
    """Return the settings of a page's server, with tokens of the environment or drawn ones."""
    tokens = drawn_tokens(host, os.environ.get(COMMAND_TOKEN, ""), os.environ.get(WATCH_TOKEN, ""), token)
    given = (tuple(connect), key, *tokens)
    return LabSettings(data_folder(), host, port, *given, logs=tuple(logs), token_always=token, warm_up=True)


def _served(
    places: list[LocalDrone], key: Path | None, host: str, port: int, token: bool
) -> tuple[LocalPage, LabSettings]:
    """Return the server of the drones' page and its settings; its environment carries the tokens."""
    settings = _settings(host, port, token, key)
    urls = [str(place.described(False)["drone"]) for place in places]
    options = ["--host", host, *(["--token"] if token else [])]
    options += [] if key is None else ["--key", str(key.absolute())]
    environment = {COMMAND_TOKEN: settings.command_token, WATCH_TOKEN: settings.watch_token}
    return LocalPage(urls, port, options, environment, _tell), settings


async def _run(
    fleet: LocalFleet,
    places: list[LocalDrone],
    lockstep: bool,
    json: bool,
    served: Sequence[tuple[LocalPage, LabSettings]] = (),
    open_page: bool = False,
) -> int:
    """Run all programs; return the exit status once all have ended."""
    all_up = False

    async def keep() -> int:
        nonlocal all_up
        async with fleet, AsyncExitStack() as pages:
            for one, _ in served:
                await pages.enter_async_context(one)
            try:
                if not json:
                    many = f"{len(places)} drones" if len(places) > 1 else "the drone"
                    _tell(f"starting {many}; the first start compiles the flight code, which takes up to half a minute")
                await fleet.start()
                all_up = True
                found = [
                    links(settings, settings.port) if await page.listens() else None for page, settings in served
                ] or [None]
                who = link_warning(served[0][1]) if served else ""
                print_places(places, lockstep, json, fleet.reports, found, who)
                if open_page and found[0] is not None:
                    await asyncio.to_thread(webbrowser.open, found[0]["command"])
                await fleet.run()
            except asyncio.CancelledError:
                if not json:
                    sys.stdout.write("ending all\n")
                    sys.stdout.flush()
                raise
        return 1

    if status := await run_until_signal(keep()):
        return status
    if not json:
        sys.stdout.write("all have ended\n")
    return 0 if all_up else INTERRUPTED


def _tell(line: str) -> None:
    say_line(f"{datetime.now():%H:%M:%S} {line}")


def print_places(
    places: list[LocalDrone],
    lockstep: bool,
    json: bool,
    flown: Mapping[int, ControllerReport] = NOTHING_KNOWN,
    pages: Sequence[Mapping[str, str] | None] = (None,),
    who: str = "",
) -> None:
    """Print the addresses of the drones and of their `pages`, and `who` may open them: as text or one line of JSON.

    The first page is that of all drones, the others are those of the groups.
    """
    page, *groups = pages
    rows = [place.described(lockstep) | flown.get(place.index, ControllerReport())._asdict() for place in places]
    text = "" if page is None else f"the page         {page['command']}\n  only to watch  {page['watch']}\n{who}"
    share = len(places) // max(1, len(groups))
    for k, group in enumerate(groups):
        own = ", ".join(str(row["system"]) for row in rows[k * share : (k + 1) * share])
        text += f"group {k + 1}, drone {own}: {'no page' if group is None else group['command']}\n"
    for row in rows:
        key = f', key="{row["key"]}"' if row["key"] else ""
        what = controller_in_words(row["controller"], row["changed"])
        text += f'drone {row["system"]} is up and {what}\n  Python          Drone.connect("{row["drone"]}"{key})\n'
        if not lockstep:
            mavsdk = "" if key else f"  MAVSDK          {row['mavsdk']}\n"
            text += f"{mavsdk}  MAVProxy        mavproxy.py --master={row['mavproxy']}\n"
    if key:
        text += "All is signed: MAVProxy and QGroundControl are to be given the key, MAVSDK takes none.\n"
    text += (
        "Time stands still but when a client of ours lets it pass (`drone.run`). MAVSDK, MAVProxy and QGroundControl\n"
        "grant none and see it stand still: leave --lockstep out for them.\n"
        if lockstep
        else "QGroundControl finds them by itself (UDP 14550).\n"
    )
    text += f"A program that ends is started again, up to {MOST_RESTARTS} times in {WITHIN_S:g} s. Ctrl-C ends all.\n"
    print_start(json, {"drones": rows, "lockstep": lockstep, "page": page, "groups": groups}, text)


def lab(
    connect: Annotated[
        list[str] | None, option("Address of a drone; repeatable. Default: all drones of this computer.", "URL")
    ] = None,
    host: options.PageHost = LOOPBACK,
    port: Annotated[int, option("TCP port; 0 for a free one.", min=0, max=65535)] = PORT,
    token: options.PageToken = False,
    key: options.KeyFile = None,
    logs: Annotated[
        list[Path] | None,
        option("Show the logs of this folder too; repeatable.", "FOLDER", exists=True, file_okay=False),
    ] = None,
    open_page: options.OpenPage = False,
    json: Json = False,
) -> None:
    """Serve the browser page for drones that run already, print its link, and run until Ctrl-C.

    By default only this computer can reach it. With --host other computers can, but only by a link. There are two
    links, one to command and one to watch; each start makes new ones. With --json they come as one line of JSON. Exit
    status: 0 ended by Ctrl-C or SIGTERM, 2 the port is taken or an option is wrong.
    """
    if key is not None:
        read_key(key)
    settings = _settings(host, port, token, key, connect or (), logs or ())
    listens = False

    def ready(found: int) -> None:
        nonlocal listens
        listens = True
        print_links(settings, found, json)
        if open_page:
            webbrowser.open(links(settings, found)["command"])

    asyncio.run(run_until_signal(serve(settings, ready)))
    raise typer.Exit(0 if listens else INTERRUPTED)


def print_links(settings: LabSettings, port: int, json: bool) -> None:
    """Print the links as text or as one line of JSON."""
    found = links(settings, port)
    text = f"listening on http://{settings.host}:{port}\nthe page         {found['command']}\n"
    text += f"only to watch    {found['watch']}\n{link_warning(settings)}"
    print_start(json, {"port": port, "page": found}, text)
