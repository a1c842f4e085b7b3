"""Plots of flights for the commands that offer one; what draws is loaded where a plot is asked for, and not before."""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from twodof.flightlog.log import FlightLog
from twodof.report.plots.flight_view import SUFFIXES, flight_view

Plot = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help=f"Draw the flight into a picture or a page ({', '.join(SUFFIXES)})."),
]


def draw(
    log: FlightLog,
    path: Path,
    topics: Iterable[str] = (),
    window: tuple[float, float] | None = None,
    title: str = "",
    force: bool = False,
) -> tuple[str, ...]:
    """Draws a log, and returns what the picture leaves out. Raises LogError, as `flight_view` and `write_plot`."""
    view = flight_view(log, topics, window, title)
    importlib.import_module("twodof.report.plots.flight_plot").write_plot(view, path, force)
    return view.notes
