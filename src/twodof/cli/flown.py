"""Output of a flight that several commands share: its log, its picture, the checks of its data."""

import importlib
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from twodof.cli.options import option
from twodof.flightlog.files import check_place, write_log
from twodof.flightlog.log import FlightLog
from twodof.report.plots.flight_view import SUFFIXES, FlightView, flight_view
from twodof.report.plots.flight_view import check_place as check_plot

if TYPE_CHECKING:
    from twodof.experiment.flight import Flight

Out = Annotated[Path | None, option("Write the flight's log (.mat, .mcap, .parquet, .csv, .ulg).")]
Plot = Annotated[Path | None, option(f"Draw the flight into a picture or a page ({', '.join(SUFFIXES)}).", "FILE")]


def check_places(out: Path | None, plot: Path | None, force: bool) -> None:
    """Raise LogError for a place that cannot be written; to be called before the flight."""
    if out is not None:
        check_place(out, force)
    if plot is not None:
        check_plot(plot, force)


def keep(flight: "Flight", rig: str, out: Path | None, plot: Path | None, force: bool) -> dict[str, Any]:
    """Write and draw the flight as the options ask; return its part of --json."""
    name = flight.experiment.name
    if out is not None:
        write_log(flight.log, out, overwrite=force)
    if plot is not None:
        draw(flight.log, plot, title=f"{name} on {rig}", force=force)
    return {
        "experiment": name,
        "rig": rig,
        "seed": flight.seed,
        "x_start_m": flight.x_start,
        "good": flight.good,
        "checks": [{"name": c.name, "passed": c.passed, "seen": c.seen} for c in flight.checks],
        "file": None if out is None else str(out),
        "plot": None if plot is None else str(plot),
    }


def check_lines(flight: "Flight", *written: Path | None) -> list[str]:
    """Return the checks of a flight's data and the files that were written."""
    checks = [f"  {'ok    ' if one.passed else 'FAILED'} {one.name}: {one.seen}" for one in flight.checks]
    return [*checks, *(f"written: {path}" for path in filter(None, written))]


def draw(
    log: FlightLog,
    path: Path,
    topics: Iterable[str] = (),
    window: tuple[float, float] | None = None,
    title: str = "",
    force: bool = False,
) -> tuple[str, ...]:
    """Draw a log and return notes on what the picture leaves out.

    Raises LogError, as `flight_view` and `write_plot`.
    """
    view = flight_view(log, topics, window, title)
    write_view(view, path, force)
    return view.notes


def write_view(view: FlightView, path: Path, force: bool = False) -> None:
    """Draw a view, importing matplotlib only now. Raises LogError as `write_plot`."""
    importlib.import_module("twodof.report.plots.flight_plot").write_plot(view, path, force)
