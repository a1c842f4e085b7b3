"""`twodof diagram export`: the C file and the header of a diagram."""

from pathlib import Path
from typing import Annotated

import typer

from twodof.cli.options import RealType
from twodof.cli.output import Force, Json, print_json, table_console
from twodof.compile.c_files.c_files import c_files
from twodof.flight.starters import DIAGRAM_HELP, load_diagram


def export(
    diagram: Annotated[str, typer.Argument(metavar="DIAGRAM", help=DIAGRAM_HELP)],
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Where to write NAME.h and NAME.c.", show_default="this folder")
    ] = Path(),
    dt: Annotated[float, typer.Option("--dt", metavar="SECONDS", help="Base tick.")] = 0.004,
    precision: Annotated[RealType, typer.Option(help="The type of a real.")] = RealType.float64,
    log: Annotated[
        list[str] | None, typer.Option("--log", metavar="PATH", help="Return this signal too. May be repeated.")
    ] = None,
    name: Annotated[str, typer.Option(metavar="NAME", help="How all names begin. By default the diagram's name.")] = "",
    tables: Annotated[
        bool, typer.Option("--tables", help="With tables of parameters and signals, for live tuning and logging.")
    ] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a diagram as a C file and a header, for your own firmware or program.

    The header has an example of the loop that calls it.
    """
    made = c_files(load_diagram(diagram), dt, precision.value, log or (), name=name, tables=tables)
    paths = made.write(folder, force)
    if json:
        sizes = dict(zip(("real", "P", "S", "U", "Y"), made.emitted.sizes, strict=True))
        print_json({"name": made.name, "files": [str(path) for path in paths], "sizes": sizes})
        return
    table_console().print(f"written: {', '.join(map(str, paths))}")
