"""`twodof parameters`: see and set what can be tuned on a drone, the parameters of your own controller too."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from twodof.cli.connection import KeyOfDrone, SystemOfDrone, UrlOfDrone
from twodof.cli.input import read_input
from twodof.cli.options import Force, Json, argument, flag, option
from twodof.cli.output import print_json, table, table_console
from twodof.errors import ParameterError, shown
from twodof.flightlog.atomic import atomic_write
from twodof.flightlog.files import check_folder
from twodof.gcs.async_drone import DEFAULT_URL
from twodof.gcs.drone import Drone
from twodof.gcs.parameter_file import MAX_BYTES, ParameterFile
from twodof.gcs.parameters import REAL32, ParameterDescription, ParameterEntry


def parameters(
    wanted: Annotated[
        list[str] | None,
        argument("Which to show, or to set: a name, or a path such as attitude_control.k_q.", "[NAME[=VALUE]]..."),
    ] = None,
    url: UrlOfDrone = DEFAULT_URL,
    drone: SystemOfDrone = None,
    key: KeyOfDrone = None,
    changed: Annotated[bool, flag("Of all, show those that are not at their defaults.", "--changed")] = False,
    save: Annotated[Path | None, option("Write all to this file, which QGroundControl loads (.params).")] = None,
    load: Annotated[
        Path | None, option("Set what differs in this file of QGroundControl's (.params), and show it.")
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Show a drone's parameters, or set some: those that you give act together at one tick, or none does.

    If your own controller flies there, the paths in its diagram name its parameters too. It takes no lease:
    gains of a drone that another program flies are tuned in flight, unless that program withholds it. If the drone
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
            with atomic_write(save, "w") as out:
                out.write(ParameterFile.of(entries, there.there.session.system).text())
            typer.echo(f"written: {save}", err=True)
    if not (rows or every or json):
        return
    if changed:
        rows = [row for row in rows if row["default"] is not None and row["value"] != row["default"]]
    if json:
        print_json({"url": url, "set": changes, "parameters": rows})
        return
    if changed and not rows:
        table_console().print("all are at their defaults")
        return
    made = table("name", "value", "default", "from", "to", "unit", "is", right=range(1, 5))
    for column in made.columns[:-1]:  # in a narrow terminal the words are broken, no name and no number is cut
        column.no_wrap = True
    for row in rows:
        numbers = (_number(row[key]) for key in ("value", "default", "low", "high"))
        made.add_row(row["name"], *numbers, row["unit"], row["text"])
    table_console().print(made)


def _print_loaded(differs: int, missing: Sequence[str]) -> None:
    """Print on stderr how many values differ, so that stdout has the table or JSON alone."""
    lacks = f"; the drone does not have {len(missing)}: {', '.join(missing[:5])}" if missing else ""
    typer.echo(f"{differs} differ on the drone and are set{lacks}", err=True)


def _parsed(wanted: Iterable[str]) -> tuple[list[str], dict[str, float]]:
    """Return the names to show and the values to set. Raises ParameterError for a value that is not a number."""
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
