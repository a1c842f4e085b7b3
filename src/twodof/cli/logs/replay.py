"""`twodof replay LOG`: does the compiled flight code give back what flew?"""

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from twodof.cli.options import RealType
from twodof.cli.output import Json, one_line, print_json, say_line, table_console
from twodof.flight.gains import load_gains
from twodof.flightlog.files import read_log
from twodof.report.plots.flight_view import failsafe_bands
from twodof.sim.flown_parameters import FlownParameters
from twodof.sim.replay import replay as replay_log

app = typer.Typer(add_completion=False, rich_markup_mode=None)


# The right gains leave less than 1e-5, in float32 too; a gain that is 1 % off leaves some 1e-2 of its loop's output.
_OTHER_GAINS = 1e-3
# Of what the failsafe did.
_SHOWN = 5


@app.command()
def replay(
    file: Annotated[Path, typer.Argument(metavar="LOG", help="A closed-loop flight log.")],
    gains: Annotated[
        str | None,
        typer.Option(
            help="default, student, or a JSON file of gains; left out: those of the log if it says, else default."
        ),
    ] = None,
    precision: Annotated[RealType, typer.Option(help="Reals of the compiled code.")] = RealType.float64,
    json: Json = False,
) -> None:
    """Feed a log's inputs to the compiled flight code and compare what it gives with what was logged."""
    log, gains_given = read_log(file), gains is not None
    flown = FlownParameters.of(log.provenance)
    result = replay_log(log, None if gains is None else load_gains(gains), precision.value)
    gains = gains or ("default" if flown.gains is None else "that the log says")
    if flown.unknown or (flown.controllers and gains_given):
        names = one_line(", ".join(flown.unknown or flown.controllers))
        say_line(f"note: a controller of the user's flew ({names}), and the stock cascade is compared")
    bands = failsafe_bands(log)
    if bands:
        what = ", ".join(f"{band.start:.2f} to {band.stop:.2f} s {band.label}" for band in bands[:_SHOWN])
        say_line(f"note: the failsafe acted, whose set-points are not in the log: {what}")
    elif any(difference > _OTHER_GAINS for difference in result.nrms.values()):
        say_line(f"note: not the gains it was flown with? these are: {gains}; --gains takes others")
    if json:
        print_json(result.to_json())
        return
    console = table_console()
    table = Table("channel", "nrms", "coverage, %", box=None, pad_edge=False)
    for column in table.columns[1:]:
        column.justify = "right"
    for channel, share in result.coverage.items():
        difference = result.nrms.get(channel)
        table.add_row(channel, "-" if difference is None else f"{difference:.2e}", f"{100.0 * share:.1f}")
    console.print(table)
    windows = ", ".join(f"{start:.2f} to {end:.2f} s" for start, end in result.windows)
    console.print(f"{precision.value}, gains {gains}; compared: {windows or 'nothing, no loop was active'}")
