"""`twodof up`: virtual drones with flight controller and companion each, on ports of their own, until Ctrl-C."""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

import typer

from twodof.cli.drone import options
from twodof.cli.output import Json, print_json_line, say_line
from twodof.errors import LinkError
from twodof.fleet.active_controller import STOCK, controller_in_words
from twodof.fleet.free_ports import MOST_DRONES, check_ports_free
from twodof.fleet.supervisor import MOST_RESTARTS, WITHIN_S, ChildProcess, ProcessSupervisor
from twodof.flight.controller_store import data_folder
from twodof.link.connection import Connection
from twodof.link.mavlink.components import AUTOPILOT
from twodof.link.mavlink.dialect import message_id
from twodof.link.mavlink.messages import message
from twodof.link.signing.frame_signing import Signing
from twodof.link.signing.key import Key, read_key
from twodof.link.signing.time_stamps import Stamps
from twodof.link.transport import ports
from twodof.link.transport.open_transport import open_transport
from twodof.sim.rig_host import SEEDS

app = typer.Typer(add_completion=False, rich_markup_mode=None)

INTERRUPTED = 130

ANSWER_S = 60.0
"""How long a program may take until it is heard [s]: the first one compiles the flight code and the rig."""

REQUEST_MESSAGE = 512

_PROBE = 240  # system of who only listens whether a drone is there; none of those that clients use


class ControllerReport(NamedTuple):
    """What a drone flies: its controller, and how many parameters differ from their defaults."""

    controller: str = STOCK
    changed: int = 0


NOTHING_KNOWN: Mapping[int, ControllerReport] = MappingProxyType({})


@dataclass(frozen=True)
class LocalDrone:
    """The drone `index`: its ports on this machine (docs/reference/protocol.md), its seed, its folders and its key."""

    index: int
    seed: int = 1
    state: Path = Path()
    key: Path | None = None

    @property
    def options(self) -> list[str]:
        """What both its programs are told."""
        return ["--index", str(self.index), *(() if self.key is None else ("--key", str(self.key)))]

    @property
    def own(self) -> list[str]:
        """What its flight controller is told besides, and no other drone's."""
        return ["--seed", str(self.seed), "--state", str(self.state)]

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
            "seed": self.seed,
            "state": str(self.state.absolute()),
            "key": None if self.key is None else str(self.key.absolute()),
            "fcu": self.fcu,
            "companion": self.companion,
            # Time that is granted by one client: straight to the flight controller, as nobody else is to be there.
            "drone": self.fcu if lockstep else f"udp://127.0.0.1:{ports.COMPANION_ONBOARD + self.index}",
            "mavsdk": f"udpin://127.0.0.1:{ports.ONBOARD + self.index}",
            "mavproxy": f"tcp:127.0.0.1:{ports.COMPANION_TCP + self.index}",
            "qgroundcontrol": f"udp://127.0.0.1:{ports.GROUND_STATION}",
        }


@app.command()
def up(
    drones: Annotated[int, typer.Option(min=1, max=MOST_DRONES, help="How many.")] = 1,
    first: Annotated[
        int, typer.Option(min=0, max=9, help="Number of the first, 0 to 9: its ports and system come from it.")
    ] = 0,
    rig: options.Rig = "lab",
    rings: options.Rings = False,
    controller: Annotated[
        list[str] | None,
        typer.Option(metavar="DIAGRAM", help="Fly this controller, in a sandbox; may be repeated. See `twodof fcu`."),
    ] = None,
    trust: options.Trust = False,
    lockstep: options.Lockstep = False,
    seed: Annotated[
        int, typer.Option(min=0, max=SEEDS - 1, help="Seed of the first one's noise; each further one has the next.")
    ] = 1,
    noise: options.Noise = 1.0,
    precision: options.Precision = "float64",
    safety_switch: options.SafetySwitch = True,
    state: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="For a folder drone-INDEX each; left out: the user's data folder."),
    ] = None,
    fresh: options.Fresh = False,
    key: options.KeyFile = None,
    json: Json = False,
) -> None:
    """Start virtual drones, each with its flight controller and companion; say where to connect; run until Ctrl-C.

    A program that ends is started again (the drone then stands disarmed at its start), up to three times a minute;
    after that all end. With --json one line of JSON says where they are, once all answer. Exit status: 0 ended by
    Ctrl-C or SIGTERM, 130 by that before all answered, 1 a program could not be kept running, 2 one did not start.
    """
    if first + drones > MOST_DRONES:
        raise typer.BadParameter(f"drones have the numbers 0 to {MOST_DRONES - 1}", param_hint="--first, --drones")
    known = None if key is None else read_key(key)
    check_ports_free(first, drones)
    given = ["--rig", rig, "--noise", str(noise), "--precision", precision]
    given += [
        option
        for option, wanted in (
            *(("--rings", rings), ("--trust", trust), ("--lockstep", lockstep), ("--fresh", fresh)),
            ("--no-safety-switch", not safety_switch),
        )
        if wanted
    ]
    given += [option for name in controller or [] for option in ("--controller", name)]
    folder = data_folder() if state is None else state
    places = [
        LocalDrone(first + number, (seed + number) % SEEDS, folder / f"drone-{first + number}", key)
        for number in range(drones)
    ]
    raise typer.Exit(asyncio.run(_run(places, given, known, lockstep, json)))


async def _run(places: list[LocalDrone], given: list[str], key: Key | None, lockstep: bool, json: bool) -> int:
    stopped = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stopped.set)
    urls: dict[str, tuple[str, LocalDrone]] = {}
    flown: dict[int, ControllerReport] = {}
    programs = []
    for place in places:
        for name, url, arguments in (
            (f"flight controller {place.system}", place.fcu, ["fcu", *place.options, *place.own, *given]),
            (f"companion {place.system}", place.companion, ["companion", *place.options]),
        ):
            urls[name] = (url, place)
            programs.append(ChildProcess(name, arguments))

    async def answers(child: ChildProcess) -> None:
        await child.listening.wait()  # else it might be another one at the same port that is heard
        url, place = urls[child.name]
        found = await wait_until_heard(url, place.system, ANSWER_S, key)
        if url == place.fcu:
            flown[place.index] = found
            # Fresh once: one that is started again flies what was sent to it meanwhile.
            child.arguments = [one for one in child.arguments if one != "--fresh"]

    children = ProcessSupervisor(programs, _tell, answers)
    ending = asyncio.ensure_future(stopped.wait())
    up_all = asyncio.Event()
    running = asyncio.ensure_future(_keep(children, places, flown, up_all, lockstep, json))
    try:
        await asyncio.wait((ending, running), return_when=asyncio.FIRST_COMPLETED)
        if not running.done() and not json:
            sys.stdout.write("ending all\n")
            sys.stdout.flush()
        return running.result() if running.done() else 0 if up_all.is_set() else INTERRUPTED
    finally:
        for task in (ending, running):
            task.cancel()
        await asyncio.gather(ending, running, return_exceptions=True)
        await children.end()
        if stopped.is_set() and not json:
            sys.stdout.write("all have ended\n")


async def _keep(
    children: ProcessSupervisor,
    places: list[LocalDrone],
    flown: Mapping[int, ControllerReport],
    up_all: asyncio.Event,
    lockstep: bool,
    json: bool,
) -> int:
    await children.start()
    up_all.set()
    say(places, lockstep, json, flown)
    await children.run()
    return 1


async def wait_until_heard(url: str, system: int, timeout: float, key: Key | None = None) -> ControllerReport:
    """What the flight controller `system` at `url` says that it flies, all signed with `key` if there is one.

    Raises LinkError if none comes within `timeout` [s].
    """
    try:
        async with asyncio.timeout(timeout):
            signing = None if key is None else Signing(key, Stamps(None))
            async with Connection(await open_transport(url, timeout), _PROBE, 1, signing) as connection:
                while True:
                    got = await connection.receive(1.0)
                    if got is None or (got.frame.system, got.frame.component) != (system, AUTOPILOT):
                        continue
                    if got.message.get_type() == "HEARTBEAT":
                        asked = {"command": REQUEST_MESSAGE, "param1": float(message_id("TWODOF_RIG"))}
                        connection.send(message("COMMAND_LONG", target_system=system, target_component=1, **asked))
                    elif got.message.get_type() == "TWODOF_RIG":
                        return ControllerReport(got.message.controller, got.message.changed)
    except TimeoutError:
        raise LinkError(f"no heartbeat of system {system} within {timeout:g} s", url, "see what it says") from None


def _tell(line: str) -> None:
    say_line(f"{datetime.now():%H:%M:%S} {line}")


def say(
    places: list[LocalDrone], lockstep: bool, json: bool, flown: Mapping[int, ControllerReport] = NOTHING_KNOWN
) -> None:
    """Say where the drones are: to people, or as one line of JSON."""
    rows = [place.described(lockstep) | flown.get(place.index, ControllerReport())._asdict() for place in places]
    if json:
        print_json_line({"drones": rows, "lockstep": lockstep})
        return
    for row in rows:
        key = f', key="{row["key"]}"' if row["key"] else ""
        what = controller_in_words(row["controller"], row["changed"])
        sys.stdout.write(
            f'drone {row["system"]} is up and {what}\n  Python          Drone.connect("{row["drone"]}"{key})\n'
        )
        if not lockstep:
            mavsdk = "" if key else f"  MAVSDK          {row['mavsdk']}\n"
            sys.stdout.write(f"{mavsdk}  MAVProxy        mavproxy.py --master={row['mavproxy']}\n")
    if key:
        sys.stdout.write("All is signed: MAVProxy and QGroundControl are to be given the key, MAVSDK takes none.\n")
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
