"""`twodof key`: a key file, with which what is sent over MAVLink is signed."""

from pathlib import Path
from typing import Annotated

import typer

from twodof.cli.output import Json, print_json, table_console
from twodof.link.signing import Key, write_key

app = typer.Typer(add_completion=False, rich_markup_mode=None)


@app.command()
def key(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Where to write it; no file may be there.")],
    json: Json = False,
) -> None:
    """Draw a key at random and write it to a new file that only its owner can read.

    All who are to understand each other get a copy of the file, by a way that nobody listens to, and name it with
    --key. What is printed is its fingerprint, which tells two keys apart and gives neither away.
    """
    made = Key.fresh()
    write_key(file, made)
    if json:
        print_json({"file": str(file), "fingerprint": made.fingerprint})
    else:
        table_console().print(f"written: {file}, fingerprint {made.fingerprint}")
