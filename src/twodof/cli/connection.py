"""Connections to drones: `twodof drones`, `kill`, `key`, `parameters`, and what commands share to connect and run."""

import asyncio
import signal
from collections import Counter
from collections.abc import Coroutine, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from twodof.cli.options import Force, Json, argument, flag, option, read_input
from twodof.cli.output import print_result, table
from twodof.errors import LinkError, ParameterError, RefusalReason, Rejected, shown
from twodof.fleet.local_drone import controller_in_words, with_port_owner
from twodof.flightlog.atomic import write_text
from twodof.flightlog.files import check_folder
from twodof.gcs.async_drone import DEFAULT_URL
from twodof.gcs.discovery import LOOPBACK, discover
from twodof.gcs.drone import Drone
from twodof.gcs.parameter_file import MAX_BYTES, ParameterFile
from twodof.gcs.parameters import REAL32, ParameterDescription, ParameterEntry
from twodof.link.signing import Key, write_key

UrlOfDrone = Annotated[str, option("The drone's address, as `twodof up` or `twodof drones` prints it.")]
SystemOfDrone = Annotated[
    int | None, option("The drone's MAVLink system id, if there are several drones.", min=1, max=255)
]
KeyOfDrone = Annotated[Path | None, option("File of the key that signs all messages.")]


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
    host: Annotated[list[str] | None, argument("Other computers to ask.", "HOST")] = None,
    timeout: Annotated[float, option("Time to listen [s].", min=0.1, max=60.0)] = 3.0,
    json: Json = False,
) -> None:
    """List the drones on PX4's ports of this computer, or of HOST. Sends no command."""
    found = asyncio.run(discover(timeout, [LOOPBACK, *(host or ())]))
    rows = table("drone", "connect to", "mode", "", "autopilot", "")
    drones_at = Counter(one.url for one in found)
    for one in found:
        # Where several are heard, `Drone.connect` must be told which.
        place = f"{one.url}, drone={one.system}" if drones_at[one.url] > 1 else one.url
        flies = "" if one.changed is None else controller_in_words(one.controller, one.changed)
        rows.add_row(str(one.system), place, one.mode, "armed" if one.armed else "", one.autopilot, flies)
    shown = rows if found else f"no drone was heard within {timeout:g} s"
    print_result(json, [one._asdict() for one in found], [shown])


def kill(
    url: UrlOfDrone = DEFAULT_URL,
    drone: SystemOfDrone = None,
    key: KeyOfDrone = None,
    release: Annotated[bool, flag("Let a drone that was killed be armed again.", "--release")] = False,
    json: Json = False,
) -> None:
    """Stop the motors now, in flight too, even if another program commands the drone. No lease is needed.

    The kill is repeated until the drone reports that it is disarmed. No program can arm it until --release, which takes
    the lease. Exit status 2: no drone answered, or the drone did not confirm.
    """
    if release:
        _release(url, drone, key, json)
        return
    there = Drone.connect(url, key=key, drone=drone, take_lease=False)
    with there:
        before = there.state
        there.kill()
    was = f"it was armed, in mode {before.mode}" if before.armed else "it was not armed"
    until = f", and held so until released: twodof kill --release --url {url}" if there.state.killed else ""
    document = {"url": url, "was_armed": before.armed, "mode": before.mode, "held": there.state.killed}
    print_result(json, document, [f"motors off ({was}){until}"])


def _release(url: str, drone: int | None, key: Path | None, json: bool) -> None:
    """Let a killed drone be armed again and print its earlier state."""
    with connect(url, key=key, drone=drone) as there:
        before = there.state
        there.release()
    said = "released: it may be armed again" if before.killed else "it was not killed"
    print_result(json, {"url": url, "was_held": before.killed, "held": there.state.killed}, [said])


def key(file: Annotated[Path, argument("File to write; it must not exist.", "FILE")], json: Json = False) -> None:
    """Write a random key to a new file that only you can read.

    Copy the file over a safe channel to every program that takes part, and pass it with --key. The printed fingerprint
    identifies the key without revealing it.
    """
    made = Key.fresh()
    write_key(file, made)
    document = {"file": str(file), "fingerprint": made.fingerprint}
    print_result(json, document, [f"written: {file}, fingerprint {made.fingerprint}"])


def parameters(
    wanted: Annotated[
        list[str] | None,
        argument("Parameters to show or to set: a name, or a path such as attitude_control.k_q.", "[NAME[=VALUE]]..."),
    ] = None,
    url: UrlOfDrone = DEFAULT_URL,
    drone: SystemOfDrone = None,
    key: KeyOfDrone = None,
    changed: Annotated[bool, flag("Show only parameters that are not at their defaults.", "--changed")] = False,
    save: Annotated[
        Path | None, option("Write all parameters to this file, which QGroundControl loads (.params).")
    ] = None,
    load: Annotated[
        Path | None, option("Set the parameters that differ in this file of QGroundControl (.params), and show them.")
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Show a drone's parameters, or set several at once: all of them, or none.

    If your own controller flies, its parameters also have the paths in its diagram. It takes no lease:
    you can tune the gains of a drone that another program flies, unless that program forbids it. If the drone
    refuses a value or does not know a name: exit status 2, and nothing was changed.
    """
    names, changes = _parsed(wanted or ())
    if save is not None:
        check_folder(save, force)
    file = None if load is None else ParameterFile.read(read_input(load, MAX_BYTES), str(load))
    with Drone.connect(url, key=key, drone=drone, take_lease=False) as there:
        described = there.parameters.describe() if there.there.ours else {}
        if file is not None:
            differs, missing = file.against(there.parameters.all())
            names, changes = [*names, *(name for name in differs if name not in changes)], {**differs, **changes}
            _print_loaded(len(differs), missing)
            if file.system not in (0, own := there.there.session.system):
                typer.echo(f"note: the file is of vehicle {file.system}, this is vehicle {own}", err=True)
        every = file is None and (save is None or changed or json)
        rows = _rows(there, names, changes, described) if names or every else []
        if save is not None:
            entries = there.parameters.all().values()
            write_text(save, ParameterFile.of(entries, there.there.session.system).text())
            typer.echo(f"written: {save}", err=True)
    if not (rows or every or json):
        return
    if changed:
        rows = [row for row in rows if row["default"] is not None and row["value"] != row["default"]]
    made = table("name", "value", "default", "from", "to", "unit", "is", right=range(1, 5))
    for column in made.columns[:-1]:  # in a narrow terminal the words are broken, no name and no number is cut
        column.no_wrap = True
    for row in rows:
        numbers = (_number(row[key]) for key in ("value", "default", "low", "high"))
        made.add_row(row["name"], *numbers, row["unit"], row["text"])
    shown = "all are at their defaults" if changed and not rows else made
    print_result(json, {"url": url, "set": changes, "parameters": rows}, [shown])


def _print_loaded(differs: int, missing: Sequence[str]) -> None:
    """Print on stderr how many values differ, so that stdout has the table or JSON alone."""
    lacks = f"; the drone does not have {len(missing)}: {', '.join(missing[:5])}" if missing else ""
    typer.echo(f"{differs} differ on the drone and are set{lacks}", err=True)


def _parsed(wanted: Iterable[str]) -> tuple[list[str], dict[str, float]]:
    """Return the names to show and the values to set. Raises ParameterError for a value that cannot be read."""
    names: list[str] = []
    changes: dict[str, float] = {}
    for one in wanted:
        name, set_it, text = one.partition("=")
        if set_it:
            try:
                changes[name] = float(text)
            except ValueError:
                raise ParameterError(f"{shown(text)} is not a number", name, "nothing was changed") from None
        names.append(name)
    return [*dict.fromkeys(names)], changes


def _rows(
    drone: Drone, names: Iterable[str], changes: Mapping[str, float], described: Mapping[str, ParameterDescription]
) -> list[dict[str, Any]]:
    """Set the `changes`, then return the rows of `names`, or of all parameters."""
    if changes:
        drone.parameters.change(changes)
    if not names:
        return [entry.to_json() for entry in drone.parameters.all().values()]
    paths = {row.path: row.name for row in described.values() if row.path}
    values = {paths.get(name, name): drone.parameters[name] for name in names}
    return [ParameterEntry(name, value, REAL32, 0, described.get(name)).to_json() for name, value in values.items()]


def _number(value: float | None) -> str:
    return "" if value is None or abs(value) > 3e38 else f"{value:.9g}"
