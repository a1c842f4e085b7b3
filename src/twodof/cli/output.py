"""What commands print: JSON for machines on stdout, tables for people on stdout, progress and errors on stderr."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from twodof.errors import TwodofError

Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else on stdout.")]


def print_json(document: Any) -> None:
    """One JSON document on stdout; a number that JSON lacks (NaN, infinity) becomes null."""
    sys.stdout.write(json.dumps(_plain(document), indent=2, allow_nan=False) + "\n")


def _plain(value: Any) -> Any:
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def print_error(error: TwodofError) -> None:
    """What went wrong, where, and what to do about it, on stderr; to a terminal in colour."""
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    console.print("error:", style="bold red", end=" ")
    console.print(error.what, markup=False)
    if error.where:
        console.print(f"  where: {error.where}", markup=False)
    if error.remedy:
        console.print(f"  remedy: {error.remedy}", markup=False)


def table_console() -> Console:
    """The console for tables: as wide as the terminal, or wide enough for any table where there is none."""
    width = None if sys.stdout.isatty() else 120
    return Console(highlight=False, soft_wrap=True, width=width)


class Steps:
    """A progress bar over named steps; `self(text)` begins the next one."""

    def __init__(self, bar: Progress, total: int) -> None:
        self._bar = bar
        self._task = bar.add_task("", total=total)
        self._begun = False

    def __call__(self, text: str) -> None:
        """Begin the step that `text` names: the one before it is done."""
        self._bar.update(self._task, description=text, advance=1 if self._begun else 0)
        self._begun = True

    def finish(self) -> None:
        """All steps are done."""
        self._bar.update(self._task, description="done", completed=self._bar.tasks[0].total)


@contextmanager
def steps(total: int) -> Iterator[Steps]:
    """A progress bar of `total` steps on stderr; without a terminal nothing is drawn."""
    console = Console(stderr=True)
    bar = Progress(
        TextColumn("{task.description:<38}"), BarColumn(), TimeElapsedColumn(), console=console, transient=True
    )
    with bar:
        progress = Steps(bar, total)
        yield progress
        progress.finish()
