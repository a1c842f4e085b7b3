"""`twodof up`: virtual drones with flight controller and companion each, on ports of their own, until Ctrl-C."""

from __future__ import annotations

import asyncio
import json as json_text
import signal
import sys
from dataclasses import dataclass
from typing import Annotated, Any

import typer

from twodof.cli.children import MOST_RESTARTS, WITHIN_S, Child, Children
from twodof.cli.output import Json
from twodof.cli.ports import MOST_DRONES, check_free
from twodof.errors import LinkError
from twodof.link import ports
from twodof.link.connection import Connection
from twodof.link.opening import open_transport

app = typer.Typer(add_completion=False, rich_markup_mode=None)

ANSWER_S = 60.0
"""How long a program may take until it is heard [s]: the first one compiles the flight code and the rig."""

_PROBE = 240  # system of who only listens whether a drone is there; none of those that clients use


@dataclass(frozen=True)
class Place:
    """Ports of the drone `index` (docs/protocol.md), all on this machine."""

    index: int

    @property
    def system(self) -> int:
        """Its MAVLink system."""
        return self.index + 1

    @property
    def fcu(self) -> str:
        """The flight controller itself."""
        return f"tcp://127.0.0.1:{ports.FLIGHT_CONTROLLER + self.index}"

    @property
    def companion(self) -> str:
        """The companion, for who opens a connection."""
        return f"tcp://127.0.0.1:{ports.COMPANION_TCP + self.index}"

    def described(self, lockstep: bool) -> dict[str, Any]:
        """Where to connect with what."""
        return {
            "index": self.index,
            "system": self.system,
            "fcu": self.fcu,
            # Time that is granted by one client: straight to the flight controller, as nobody else is to be there.
            "drone": self.fcu if lockstep else f"udp://127.0.0.1:{ports.COMPANION_ONBOARD + self.index}",
            "mavsdk": f"udpin://127.0.0.1:{ports.ONBOARD + self.index}",
            "mavproxy": f"tcp:127.0.0.1:{ports.COMPANION_TCP + self.index}",
            "qgroundcontrol": str(ports.GROUND_STATION),
        }


@app.command()
def up(
    drones: Annotated[int, typer.Option(min=1, max=MOST_DRONES, help="How many.")] = 1,
    first: Annotated[
        int, typer.Option(min=0, max=9, help="Number of the first, 0 to 9: its ports and system come from it.")
    ] = 0,
    rig: Annotated[str, typer.Option(help="lab, paper, or a JSON file of rig parameters.")] = "lab",
    rings: Annotated[bool, typer.Option("--rings/--free", help="The rings lock the cart: pitch only.")] = False,
    controller: Annotated[
        list[str] | None,
        typer.Option(metavar="DIAGRAM", help="Fly this controller, in a sandbox; may be repeated. See `twodof fcu`."),
    ] = None,
    lockstep: Annotated[
        bool, typer.Option("--lockstep", help="Time stands still until a client grants it; else it runs as ours.")
    ] = False,
    json: Json = False,
) -> None:
    """Start virtual drones, each with its flight controller and companion; say where to connect; run until Ctrl-C.

    A program that ends is started again (the drone then stands disarmed at its start), up to three times a minute;
    after that all end. With --json one line of JSON says where they are, once all answer. Exit status 1: a program did
    not start, or could not be kept running.
    """
    if first + drones > MOST_DRONES:
        raise typer.BadParameter(f"drones have the numbers 0 to {MOST_DRONES - 1}")
    check_free(first, drones)
    places = [Place(index) for index in range(first, first + drones)]
    options = ["--rig", rig, *(["--rings"] if rings else []), *(["--lockstep"] if lockstep else [])]
    options += [option for name in controller or [] for option in ("--controller", name)]
    raise typer.Exit(asyncio.run(_run(places, options, lockstep, json)))


async def _run(places: list[Place], options: list[str], lockstep: bool, json: bool) -> int:
    stopped = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stopped.set)
    urls: dict[str, tuple[str, int]] = {}
    programs = []
    for place in places:
        for name, url, arguments in (
            (f"flight controller {place.system}", place.fcu, ["fcu", "--index", str(place.index), *options]),
            (f"companion {place.system}", place.companion, ["companion", "--index", str(place.index)]),
        ):
            urls[name] = (url, place.system)
            programs.append(Child(name, arguments))

    async def answers(child: Child) -> None:
        await child.listening.wait()  # else it might be another one at the same port that is heard
        await heard(*urls[child.name], ANSWER_S)

    children = Children(programs, _tell, answers)
    ending = asyncio.ensure_future(stopped.wait())
    running = asyncio.ensure_future(_keep(children, places, lockstep, json))
    try:
        await asyncio.wait((ending, running), return_when=asyncio.FIRST_COMPLETED)
        if not running.done() and not json:
            sys.stdout.write("ending all\n")
            sys.stdout.flush()
        return running.result() if running.done() else 0
    finally:
        for task in (ending, running):
            task.cancel()
        await asyncio.gather(ending, running, return_exceptions=True)
        await children.end()
        if stopped.is_set() and not json:
            sys.stdout.write("all have ended\n")


async def _keep(children: Children, places: list[Place], lockstep: bool, json: bool) -> int:
    await children.start()
    say(places, lockstep, json)
    await children.run()
    return 1


async def heard(url: str, system: int, timeout: float) -> None:
    """Waits for a heartbeat of the flight controller `system` at `url`.

    Raises LinkError if none comes within `timeout` [s].
    """
    try:
        async with asyncio.timeout(timeout):
            async with Connection(await open_transport(url, timeout), _PROBE, 1) as connection:
                while True:
                    got = await connection.receive(1.0)
                    if got is None or got.message.get_type() != "HEARTBEAT":
                        continue
                    if (got.frame.system, got.frame.component) == (system, 1):
                        return
    except TimeoutError:
        raise LinkError(f"no heartbeat of system {system} within {timeout:g} s", url, "see what it says") from None


def _tell(line: str) -> None:
    sys.stderr.write(f"{line}\n")


def say(places: list[Place], lockstep: bool, json: bool) -> None:
    """Say where the drones are: to people, or as one line of JSON."""
    rows = [place.described(lockstep) for place in places]
    if json:
        sys.stdout.write(json_text.dumps({"drones": rows, "lockstep": lockstep}) + "\n")
        sys.stdout.flush()
        return
    for row in rows:
        sys.stdout.write(f'drone {row["system"]} is up\n  Python          Drone.connect("{row["drone"]}")\n')
        if not lockstep:
            sys.stdout.write(
                f"  MAVSDK          {row['mavsdk']}\n  MAVProxy        mavproxy.py --master={row['mavproxy']}\n"
            )
    sys.stdout.write(
        "Time stands still but when a client of ours lets it pass (`drone.run`). MAVSDK, MAVProxy and QGroundControl\n"
        "grant none and see it stand still: leave --lockstep out for them.\n"
        if lockstep
        else "QGroundControl finds them by itself (UDP 14550).\n"
    )
    sys.stdout.write(
        f"A program that ends is started again, up to {MOST_RESTARTS} times in {WITHIN_S:g} s. Ctrl-C ends all.\n"
    )
    sys.stdout.flush()
