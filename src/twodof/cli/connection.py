"""Connections to drones: `twodof drones`, `kill` and `key`, and what other commands share to connect and to run."""

import asyncio
import signal
from collections import Counter
from collections.abc import Coroutine, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

from twodof.cli.options import Json, argument, flag, option
from twodof.cli.output import print_json, table, table_console
from twodof.errors import LinkError, RefusalReason, Rejected
from twodof.fleet.local_drone import controller_in_words, with_port_owner
from twodof.gcs.async_drone import DEFAULT_URL
from twodof.gcs.discovery import LOOPBACK, discover
from twodof.gcs.drone import Drone
from twodof.link.signing import Key, write_key

UrlOfDrone = Annotated[str, option("Where the drone is, as `twodof up` or `twodof drones` says.")]
SystemOfDrone = Annotated[int | None, option("Its system, where several are heard.", min=1, max=255)]
KeyOfDrone = Annotated[Path | None, option("File of the key that signs everything.")]


def connect(url: str, key: Path | None = None, drone: int | None = None) -> Drone:
    """Connect to the drone at `url` and take its lease; parameters as `Drone.connect`.

    Raises as that does, and Rejected if another program has the lease.
    """
    with lease_refusals(url):
        return Drone.connect(url, key=key, drone=drone)


@contextmanager
def lease_refusals(url: str) -> Iterator[None]:
    """Replace the remedy of a refused lease of the drone at `url` by what the shell can do."""
    try:
        yield
    except Rejected as refusal:
        if refusal.code is not RefusalReason.LEASE:
            raise
        remedy = (
            f"wait until it is given up, or end who has it; `twodof kill --url {url}` stops the motors all the same"
        )
        raise Rejected(refusal.what, refusal.where, remedy, refusal.code) from refusal


async def run_until_signal(work: Coroutine[object, object, int | None]) -> int | None:
    """Return the result of `work`; None if SIGINT or SIGTERM cancelled it.

    Raises as `work` does; an error about a port in use names the program that has it.
    """
    task = asyncio.ensure_future(work)

    def cancel() -> None:
        if not task.cancelling():  # a second Ctrl-C does not disturb how it ends
            task.cancel()

    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, cancel)
    try:
        return await task
    except asyncio.CancelledError:
        return None
    except LinkError as error:
        raise with_port_owner(error) from error


def drones(
    host: Annotated[list[str] | None, argument("Machines to ask besides this one.", "HOST")] = None,
    timeout: Annotated[float, option("How long to listen [s].", min=0.1, max=60.0)] = 3.0,
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
    rows = table("drone", "connect to", "mode", "", "autopilot", "")
    drones_at = Counter(one.url for one in found)
    for one in found:
        # Where several are heard, `Drone.connect` must be told which.
        place = f"{one.url}, drone={one.system}" if drones_at[one.url] > 1 else one.url
        flies = "" if one.changed is None else controller_in_words(one.controller, one.changed)
        rows.add_row(str(one.system), place, one.mode, "armed" if one.armed else "", one.autopilot, flies)
    console.print(rows)


def kill(
    url: UrlOfDrone = DEFAULT_URL,
    drone: SystemOfDrone = None,
    key: KeyOfDrone = None,
    release: Annotated[bool, flag("Let a drone that was killed be armed again.", "--release")] = False,
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
    """Let a killed drone be armed again and print its earlier state."""
    with connect(url, key=key, drone=drone) as there:
        before = there.state
        there.release()
    if json:
        print_json({"url": url, "was_held": before.killed, "held": there.state.killed})
    else:
        table_console().print("released: it may be armed again" if before.killed else "it was not killed")


def key(
    file: Annotated[Path, argument("Where to write it; no file may be there.", "FILE")],
    json: Json = False,
) -> None:
    """Draw a key at random and write it to a new file that only its owner can read.

    All who are to understand each other get a copy of the file, by a way that nobody listens to, and name it with
    --key. What is printed is its fingerprint, which tells two keys apart and gives neither away.
    """
    made = Key.fresh()
    write_key(file, made)
    if json:
        print_json({"file": str(file), "fingerprint": made.fingerprint})
    else:
        table_console().print(f"written: {file}, fingerprint {made.fingerprint}")
