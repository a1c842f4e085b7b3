"""`twodof fcu`: a virtual drone that speaks MAVLink, until it is interrupted."""

from __future__ import annotations

import asyncio
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from twodof.cli.diagram_argument import DIAGRAM_HELP
from twodof.flight.slot import data_folder
from twodof.link.key import read_key
from twodof.link.ports import FLIGHT_CONTROLLER
from twodof.link.signing import Signing
from twodof.link.stamps import Stamps
from twodof.sim.rig_host import SEEDS
from twodof.sim.virtual_drone import VirtualDrone

app = typer.Typer(add_completion=False, rich_markup_mode=None)

MOST_DRONES = 199
"""A client may be system 200 and above."""


@app.command()
def fcu(
    listen: Annotated[
        list[str] | None,
        typer.Option(
            metavar="URL",
            help=f"Where to listen, may be repeated; left out: tcpin://127.0.0.1:{FLIGHT_CONTROLLER} + index. "
            "Port 0: one that is free.",
        ),
    ] = None,
    index: Annotated[
        int, typer.Option(min=0, max=MOST_DRONES - 1, help="Number of the drone: system is index + 1.")
    ] = 0,
    rig: Annotated[str, typer.Option(help="lab, paper, or a JSON file of rig parameters.")] = "lab",
    lockstep: Annotated[
        bool, typer.Option("--lockstep", help="Time stands still until a client grants it; faster than real time.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, max=SEEDS - 1, help="Seed of the noise.")] = 1,
    noise: Annotated[float, typer.Option(min=0.0, max=100.0, help="Gain of all noise; 0: none.")] = 1.0,
    rings: Annotated[bool, typer.Option(help="The rings lock the cart: pitch only.")] = False,
    safety_switch: Annotated[
        bool,
        typer.Option("--safety-switch/--no-safety-switch", help="Whether it was pressed, so that motors may turn."),
    ] = True,
    controller: Annotated[
        list[str] | None,
        typer.Option(
            metavar="DIAGRAM",
            help=f"Fly this controller in place of the stock one of its template; may be repeated. {DIAGRAM_HELP}",
        ),
    ] = None,
    trust: Annotated[
        bool, typer.Option("--trust", help="Compile those controllers into the flight code: no sandbox.")
    ] = False,
    precision: Annotated[str, typer.Option(help="float64, or float32 as a flight controller computes.")] = "float64",
    rate: Annotated[
        str, typer.Option(help="Streams that every client gets: onboard, or ground as a ground station wants them.")
    ] = "onboard",
    state: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="For parameters, logs and uploaded controllers; left out: drone-INDEX in the user's data folder.",
        ),
    ] = None,
    key: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Sign everything with this key and take in nothing unsigned.")
    ] = None,
) -> None:
    """Fly a virtual drone: its rig, and the flight controller's program, which clients reach over MAVLink.

    It prints a line `listening on URL` for each link once clients may come, and ends by Ctrl-C or SIGTERM: motors off,
    log closed, exit status 0.
    """
    folder = data_folder() / f"drone-{index}" if state is None else state
    signing = None
    if key is not None:
        folder.mkdir(parents=True, exist_ok=True)
        signing = Signing(read_key(key), Stamps(folder / "stamps.json"))
    drone = VirtualDrone(
        rig,
        {"seed": seed, "noise": noise, "rings": rings},
        controller or [],
        trust,
        precision,
        lockstep,
        index,
        safety_switch,
        folder,
        signing,
        rate=rate,
    )
    asyncio.run(_run(drone, listen or [f"tcpin://127.0.0.1:{FLIGHT_CONTROLLER + index}"]))


async def _run(drone: VirtualDrone, urls: list[str]) -> None:
    loop, end = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, end.set)
    async with drone:
        for url in urls:
            sys.stdout.write(f"listening on {await drone.listen(url)}\n")
        sys.stdout.flush()
        running, ended = asyncio.ensure_future(drone.wait()), asyncio.ensure_future(end.wait())
        await asyncio.wait((running, ended), return_when=asyncio.FIRST_COMPLETED)
        ended.cancel()
        if running.done():
            running.result()
        running.cancel()
        with suppress(asyncio.CancelledError):
            await running
