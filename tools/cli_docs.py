"""Writes docs/reference/command-line.md from what the commands say of themselves: `python tools/cli_docs.py`.

A test compares the page with what this gives.
"""

import inspect
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from twodof.cli.app import app

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "command-line.md"

INTRODUCTION = """# The command line

Made by `tools/cli_docs.py` from the commands' own help; do not edit. On the terminal `twodof --help` lists the commands
and `twodof COMMAND --help` explains one.

Most commands take `--json`: then standard output holds one JSON document, and all words go to standard error. The exit
status is 0 if all is well, 1 if a flight, a fit or a tool went wrong, 2 for a mistake in the command line, and 130
after Ctrl-C. An error says what is wrong, where, and what to do.

A file that is there is kept: a command refuses to replace it without `--force`, a function of Python without
`overwrite=True`. A key is never replaced. `px4 export` replaces an export that nobody changed without being asked.
"""


def render() -> str:
    """The page's text."""
    root: Any = typer.main.get_command(app)
    context = typer.Context(root, info_name="twodof")
    lines = [INTRODUCTION]
    for name in root.list_commands(context):
        command = root.get_command(context, name)
        lines += _command(f"twodof {name}", command, typer.Context(command, info_name=name, parent=context))
    return "\n".join(lines)


def _command(name: str, command: Any, context: Any, level: str = "##") -> Iterator[str]:
    """A command's text and its table of arguments and options, then the commands below it."""
    yield from (f"{level} {name}", "", inspect.cleandoc(command.help or ""), "")
    records = [parameter.get_help_record(context) for parameter in command.params if "--help" not in parameter.opts]
    rows = [f"| `{record[0].strip()}` | {_cell(record[1])} |" for record in records if record]
    if rows:
        yield from ("| argument or option | |", "|---|---|", *rows, "")
    for part in command.list_commands(context) if hasattr(command, "list_commands") else ():
        below = command.get_command(context, part)
        yield from _command(f"{name} {part}", below, typer.Context(below, info_name=part, parent=context), "###")


def _cell(text: str) -> str:
    """A text as a cell of a table."""
    return " ".join(text.split()).replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(render(), encoding="utf-8")
    sys.stdout.write(f"{PAGE} written\n")
