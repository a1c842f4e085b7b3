"""`twodof fcu`: a virtual drone that speaks MAVLink, until it is interrupted."""

import asyncio
from pathlib import Path
from typing import Annotated

from twodof.cli import options
from twodof.cli.connection import run_until_signal
from twodof.cli.options import Json, option
from twodof.cli.output import print_start
from twodof.fleet.local_drone import controller_in_words
from twodof.flight.controller_store import data_folder
from twodof.flight.starters import DIAGRAM_HELP
from twodof.link.signing import Signing, Stamps, read_key
from twodof.link.transport.url import Ports
from twodof.sim.virtual_drone import VirtualDrone


def fcu(
    listen: Annotated[
        list[str] | None,
        option(
            f"Address to listen at; repeatable. Default: tcpin://127.0.0.1:{Ports.FLIGHT_CONTROLLER} + index. "
            "Port 0: a free one.",
            "URL",
        ),
    ] = None,
    index: options.Index = 0,
    rig: options.Rig = "lab",
    rings: options.Rings = False,
    controller: Annotated[
        list[str] | None,
        option(f"Fly this controller in place of the stock one of its template; repeatable. {DIAGRAM_HELP}", "DIAGRAM"),
    ] = None,
    trust: options.Trust = False,
    lockstep: options.Lockstep = False,
    seed: options.Seed = 1,
    noise: options.Noise = 1.0,
    charge: options.Charge = 1.0,
    precision: options.Precision = "float64",
    safety_switch: options.SafetySwitch = True,
    rate: Annotated[
        str, option("Rates of the streams that each client gets: onboard, or ground for a ground station.")
    ] = "onboard",
    state: Annotated[
        Path | None,
        option(
            "Folder for parameters, logs and uploaded controllers; default: drone-INDEX in the user's data folder.",
            "FOLDER",
        ),
    ] = None,
    fresh: options.Fresh = False,
    key: options.KeyFile = None,
    json: Json = False,
) -> None:
    """Run a virtual drone: the simulated rig, and the flight controller's program, reached over MAVLink.

    It prints a line `listening on URL` for each link once clients can connect (with --json one line of JSON). Ctrl-C or
    SIGTERM ends it: motors off, log closed, exit status 0.
    """
    folder = data_folder() / f"drone-{index}" if state is None else state
    signing = None
    if key is not None:
        folder.mkdir(parents=True, exist_ok=True)
        signing = Signing(read_key(key), Stamps(folder / "stamps.json"))
    drone = VirtualDrone(
        rig,
        {"seed": seed, "noise": noise, "charge_start": charge, "rings": rings},
        controller or [],
        trust,
        precision,
        lockstep,
        index,
        safety_switch,
        folder,
        signing,
        rate=rate,
        fresh=fresh,
    )
    urls = listen or [f"tcpin://127.0.0.1:{Ports.FLIGHT_CONTROLLER + index}"]
    asyncio.run(run_until_signal(serve(drone, urls, json)))


async def serve(drone: VirtualDrone, urls: list[str], json: bool) -> None:
    """Run the drone until cancelled, and print the addresses at which it listens."""
    async with drone:
        opened = [await drone.listen(url) for url in urls]
        what = drone.flown
        document = {
            "system": drone.server.system,
            "lockstep": drone.controller.lockstep,
            "listening": opened,
            "controller": what.controller,
            "changed": what.changed,
        }
        links = "".join(f"listening on {url}\n" for url in opened)
        print_start(json, document, f"{links}{controller_in_words(what.controller, what.changed)}\n")
        await drone.wait()
