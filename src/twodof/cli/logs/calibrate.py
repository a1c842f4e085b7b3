"""`twodof calibrate`: the lab rig's parameters from the real drone's logs."""

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from twodof.calibrate import FLIGHTS, UNKNOWNS, Calibration
from twodof.calibrate import calibrate as calibrate_rig
from twodof.cli.output import Force, Json, print_json, progress, table_console
from twodof.errors import LogError
from twodof.flightlog.files import check_folder
from twodof.flightlog.public_data import find
from twodof.rig.parameters import save_rig

app = typer.Typer(add_completion=False, rich_markup_mode=None)


@app.command()
def calibrate(
    data: Annotated[Path | None, typer.Option(metavar="FOLDER", help="Folder of the logs; default: found.")] = None,
    leave_one_out: Annotated[
        bool,
        typer.Option(
            "--leave-one-out", help="Also predict each flight from all others, and say what gusts leave of it."
        ),
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Write the rig as JSON, for `--rig FILE`.")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Calibrate the virtual rig on the logs of the real drone; exit status 1 if the search did not converge."""
    if out is not None:
        check_folder(out, force)  # before minutes of search
    folder = _folder() if data is None else data
    with progress() as report:
        found = calibrate_rig(folder, leave_one_out, report)
    if out is not None:
        save_rig(found.rig, out, force)
    if json:
        print_json(
            {
                "converged": found.converged,
                "rig": dict(found.rig.snapshot()),
                "estimate": {
                    name: {"value": value, "sigma": found.deviation[name]} for name, value in found.estimate.items()
                },
                "fit_percent": {name: dict(fits) for name, fits in found.fit.items()},
                "left_out_fit_percent": {name: dict(fits) for name, fits in found.left_out.items()},
                "ceiling_fit_percent": {name: dict(fits) for name, fits in found.ceiling.items()},
                "file": None if out is None else str(out),
            }
        )
    else:
        _print(found, out)
    if not found.converged:
        raise typer.Exit(1)


def _folder() -> Path:
    folders = {find(flight.name).parent for flight in FLIGHTS}
    if len(folders) > 1:
        raise LogError(
            "the public logs lie in several folders", ", ".join(map(str, sorted(folders))), "name one with --data"
        )
    return folders.pop()


def _print(found: Calibration, out: Path | None) -> None:
    console = table_console()
    table = Table("unknown", "value", "1 sigma", "meaning", box=None, pad_edge=False)
    for unknown in UNKNOWNS:
        value, sigma = found.estimate[unknown.name], found.deviation[unknown.name]
        table.add_row(unknown.name, f"{value:.5g}", f"{sigma:.2g}", unknown.text)
    console.print(table)
    fits = Table("flight", "theta", "q", "x", "v", "", box=None, pad_edge=False)
    for flight in FLIGHTS:
        for word, group in (("", found.fit), ("left out", found.left_out), ("ceiling", found.ceiling)):
            if flight.name in group:
                row = group[flight.name]
                fits.add_row(flight.name, *(f"{row[channel]:.1f}" for channel in ("theta", "q", "x", "v")), word)
    console.print("\nFIT, %:")
    console.print(fits)
    console.print("converged" if found.converged else "NOT converged: the best set seen is given")
    if out is not None:
        console.print(f"written: {out}")
