"""Output of commands: JSON for machines on stdout, tables for people on stdout, progress and errors on stderr."""

import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any

import typer
from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from twodof.errors import TwodofError, finite, printable


def print_json(document: Any, indent: int | None = 2) -> bool:
    """Print one JSON document; a number that JSON lacks (NaN, infinity) becomes null.

    `indent` None writes one line, for a reader that follows the running program. Returns False if the reader has left.
    """
    try:
        sys.stdout.write(json.dumps(finite(document), indent=indent, allow_nan=False) + "\n")
        sys.stdout.flush()
    except BrokenPipeError:
        reader_has_left()
        return False
    return True


def print_start(json: bool, document: Any, text: str) -> None:
    """Print where a program that goes on running is reached: with `json` the document on one line, else the text."""
    if json:
        print_json(document, indent=None)
    else:
        sys.stdout.write(text)
        sys.stdout.flush()


def table(*columns: str, right: Iterable[int] = (), **more: Any) -> Table:
    """Return a table without lines, whose columns at the places `right` are aligned there; `more` as rich's Table."""
    made = Table(*columns, box=None, pad_edge=False, **more)
    for place in right:
        made.columns[place].justify = "right"
    return made


def exit_unless(good: bool) -> None:
    """End the command with exit status 1 unless the work was `good`."""
    if not good:
        raise typer.Exit(1)


def print_result(json: bool, document: Any, lines: Iterable[RenderableType]) -> None:
    """Print the result of a command: with `json` the document, else the lines, which may be tables."""
    if json:
        print_json(document)
        return
    console = table_console()
    for line in lines:
        console.print(line)


def say_line(text: object) -> None:
    """Print a line on stderr; its words may come from a drone or a file."""
    sys.stderr.write(f"{printable(text)}\n")
    sys.stderr.flush()


def one_line(text: object) -> str:
    """Return a text from a file or a drone on one line, without control characters."""
    return " ".join(printable(text).splitlines())


def broken_output() -> str | None:
    """Return why a line cannot be written to standard output, None if it can."""
    try:
        sys.stdout.write("\n")
        sys.stdout.flush()
    except OSError as error:
        return error.strerror
    return None


def reader_has_left() -> None:
    """Discard further output, since the reader of stdout has left (`twodof ... | head`)."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class _PlainConsole(Console):
    """A console for which every text is just that, wherever it comes from: nothing in it is markup or a control code.

    Colour is what the code asks for by `style`.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(markup=False, emoji=False, highlight=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """Return a printable text from a string of a print or a table."""
        return super().render_str(printable(text), **options)


class _TableConsole(_PlainConsole):
    """A console whose command ends with its own status when the reader leaves before the end."""

    def on_broken_pipe(self) -> None:
        self.quiet = True
        reader_has_left()


def print_error(error: TwodofError) -> None:
    """Print an error on stderr: what, where and remedy; in colour on a terminal."""
    console = _PlainConsole(stderr=True, soft_wrap=True)
    console.print("error:", style="bold red", end=" ")
    console.print(error.what)
    if error.where:
        console.print(f"  where: {error.where}")
    if error.remedy:
        console.print(f"  remedy: {remedy_in_shell(error.remedy)}")


def table_console() -> Console:
    """Return the console for tables: as wide as the terminal, or wide enough for any table without one."""
    width = None if sys.stdout.isatty() else 1000
    return _TableConsole(soft_wrap=True, width=width)


@contextmanager
def progress(values: Callable[[], str] | None = None) -> Iterator[Callable[[str, float], None]]:
    """Show a progress bar on stderr and yield a function that takes the current step and the share done, 0 to 1.

    "" keeps the earlier step. The text of `values` stands behind the bar. Without a terminal nothing is drawn.
    """
    narrow = values is not None
    bar = Progress(
        TextColumn("{task.description:<22}" if narrow else "{task.description:<44}", markup=False),
        BarColumn(20 if narrow else 40),
        TimeElapsedColumn(),
        TextColumn("{task.fields[values]}", markup=False),
        console=_PlainConsole(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty(),
    )
    with bar:
        task = bar.add_task("", total=1.0, values="")

        def report(text: str, share: float) -> None:
            bar.update(task, description=printable(text) or None, completed=share)
            if values is not None and not bar.disable:
                bar.update(task, values=printable(values()))

        yield report


IN_SHELL = MappingProxyType(
    {
        "with `at`": "with --at",
        "(in Python overwrite=True)": "",
        "or watch with take_lease=False": "or end who has it",
        "parameters.all() lists": "`twodof parameters` lists",
        "drone.release()": "`twodof kill --release`",
        "describe(log) lists the log's events": "`twodof log info` lists the log's events",
        "write_log converts it": "`twodof log convert` converts it",
        "write it with to_json": "write it as `twodof diagram new`, `twodof calibrate --out` or Python's to_json do",
        "(leave it out of `estimate`)": "(leave it out of --estimate)",
    }
)
"""Words of a remedy for Python -> words for the command line in their place."""


def remedy_in_shell(remedy: str) -> str:
    """Return the remedy with options and commands in place of calls."""
    for call, words in IN_SHELL.items():
        remedy = remedy.replace(call, words)
    return remedy.strip()
