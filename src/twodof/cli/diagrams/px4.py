"""`twodof px4 export` and `twodof px4 check`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from twodof.cli.output import Json, print_json, table_console
from twodof.compile.px4 import export as export_module
from twodof.compile.px4.checkout import check as check_module
from twodof.compile.px4.export import airframe_id
from twodof.flight.starters import DIAGRAM_HELP, load_diagram

app = typer.Typer(
    help="Make a module for PX4 of a diagram, and see whether a PX4 fits it.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)


@app.command()
def export(
    diagram: Annotated[str, typer.Argument(help=DIAGRAM_HELP)],
    out_dir: Annotated[Path, typer.Argument(help="The folder to write: a new one, an empty one or an earlier export.")],
    log: Annotated[
        list[str] | None, typer.Option("--log", help="Log also this signal: its path, part.port. May be repeated.")
    ] = None,
    prefix: Annotated[
        str,
        typer.Option(help="How the parameters' names begin: 1 to 5 capitals or digits. By default the name decides."),
    ] = "",
    force: Annotated[
        bool, typer.Option("--force", help="Replace an earlier export even if its files were changed or added to.")
    ] = False,
    json: Json = False,
) -> None:
    """Write a diagram as an external module for PX4 v1.14 to v1.17: C, work item, parameters, message, airframe.

    The same diagram gives the same bytes. README.md in the folder says how it is built and started.
    """
    module = export_module(load_diagram(diagram), out_dir, log or (), prefix, force)
    if json:
        print_json(
            {
                "folder": str(out_dir),
                "module": module.names.module,
                "airframe": airframe_id(module.names),
                "parameters": {row.name: row.path or None for row in module.parameters},
                "not_exported": {kept.path: kept.reason for kept in module.kept},
                "reads": list(module.role.reads),
                "writes": list(module.role.writes),
                "stops": list(module.role.stops),
                "files": sorted(module.files),
            }
        )
        return
    console = table_console()
    console.print(f"{out_dir}: module {module.names.module}, {len(module.files)} files")
    table = Table("parameter in PX4", "in the diagram", box=None, pad_edge=False)
    for row in module.parameters:
        element = "" if row.index is None else f"[{row.index}]"
        table.add_row(row.name, f"{row.path}{element}" if row.path else "(the module's own)")
    console.print(table)
    for kept in module.kept:
        console.print(f"not in PX4: {kept.path}: {kept.reason}")
    console.print(f"reads {', '.join(module.role.reads)}")
    console.print(f"writes {', '.join(module.role.writes)}; stops {', '.join(module.role.stops)}")
    console.print(f"next: twodof px4 check PX4_DIR {out_dir}; then README.md there")


@app.command()
def check(
    px4_dir: Annotated[Path, typer.Argument(help="A checkout of PX4.")],
    out_dir: Annotated[Path, typer.Argument(help="A folder that `twodof px4 export` wrote.")],
    json: Json = False,
) -> None:
    """Compare an exported module with a checkout of PX4: its version, and what its build does not show.

    Nothing is written. Exit status 0: it fits, perhaps with warnings; 1: it does not.
    """
    found = check_module(px4_dir, out_dir)
    if json:
        rows = [{"level": r.level, "what": r.what, "where": r.where, "remedy": r.remedy} for r in found.rows]
        print_json({"fits": found.fits, "module": found.module, "version": found.version, "findings": rows})
    else:
        console = table_console()
        for row in found.rows:
            console.print(f"{row.level}: {row.where}: {row.what} ({row.remedy})")
        verdict = "fits" if found.fits else "does not fit"
        console.print(f"{found.module} {verdict} {px4_dir}, version {found.version}")
    if not found.fits:
        raise typer.Exit(1)
