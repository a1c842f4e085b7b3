"""Options and inputs that several commands share: one name, one meaning, one help line."""

import json
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from twodof.blocks.noise import SEEDS
from twodof.errors import LogError, ParameterError


def argument(text: str, metavar: str | None = None, **more: Any) -> Any:
    """Return a command's argument with its help, for `Annotated`; `more` as typer.Argument."""
    return typer.Argument(help=text, metavar=metavar, **more)


def option(text: str, metavar: str | None = None, *names: str, **more: Any) -> Any:
    """Return an option with its help, for `Annotated`: named as its parameter, or by `names`; `more` as typer's."""
    return typer.Option(*names, help=text, metavar=metavar, **more)


def flag(text: str, *names: str) -> Any:
    """Return an option without a value, for `Annotated`."""
    return typer.Option(*names, help=text)


def group(text: str, **more: Any) -> typer.Typer:
    """Return a group of commands with its help."""
    return typer.Typer(help=text, no_args_is_help=True, add_completion=False, rich_markup_mode=None, **more)


RealType = Literal["float64", "float32"]
"""The reals of compiled code."""

_SYSTEMS = 199
"""A client may be system 200 and above."""

Force = Annotated[bool, flag("Replace an existing file.", "--force")]
Json = Annotated[bool, flag("Print one JSON document and nothing else to standard output.", "--json")]
Index = Annotated[int, option("Number of the drone: system is index + 1.", min=0, max=_SYSTEMS - 1)]
Rig = Annotated[str, option("lab, paper, or a JSON file of rig parameters.")]
Lockstep = Annotated[bool, flag("Let a client advance the time step by step, faster than real time.", "--lockstep")]
Seed = Annotated[int, option("Seed of the noise.", min=0, max=SEEDS - 1)]
Noise = Annotated[float, option("Factor on all noise; 0 for none.", min=0.0, max=100.0)]
Charge = Annotated[
    float, option("State of charge of the battery at the start; a lower charge gives less thrust.", min=0.0, max=1.0)
]
Rings = Annotated[bool, flag("Lock the cart, so that only the pitch moves, or leave it free.", "--rings/--free")]
SafetySwitch = Annotated[
    bool, flag("Start with the safety switch pressed (motors may turn) or not.", "--safety-switch/--no-safety-switch")
]
Trust = Annotated[bool, flag("Compile these controllers into the flight code, without a sandbox.", "--trust")]
Precision = Annotated[str, option("float64, or float32 as a flight controller computes.")]
Fresh = Annotated[bool, flag("Start with default parameters and without controllers from earlier flashes.", "--fresh")]
KeyFile = Annotated[Path | None, option("Sign all messages with this key and ignore unsigned ones.", "FILE")]
StockGains = Annotated[str, option("Gains of the stock loops: default, student, or a JSON file.")]
Members = Annotated[int, option("Number of sampled drones to fly.")]
Reals = Annotated[RealType, option("The type of a real.")]
PromiseFile = Annotated[
    Path | None, option("Write the promise (the prediction) to this file, as JSON.", "FILE", "--promise")
]
PromisePlot = Annotated[Path | None, option("Draw the promise (.png, .svg, .pdf, .html).", "FILE")]
PageHost = Annotated[
    str, option("Address of the page. If other computers reach it, the link's token is needed.", None, "--host")
]
PageToken = Annotated[bool, flag("Require the link's token from users of this computer too.", "--token")]
OpenPage = Annotated[bool, flag("Open the page in the browser.", "--open")]


def read_input(source: str | Path, most: int) -> bytes:
    """Return the bytes of a file or pipe, or of standard input for "-".

    Raises LogError if it cannot be read or has more than `most` bytes.
    """
    standard = str(source) == "-"
    where = "standard input" if standard else str(source)
    try:
        with nullcontext(sys.stdin.buffer) if standard else Path(source).open("rb") as file:
            content = file.read(most + 1)
    except (OSError, ValueError) as refusal:
        why = refusal.strerror if isinstance(refusal, OSError) else refusal  # a name with a null character
        raise LogError(f"cannot be read: {why}", where, "check the name and the rights") from refusal
    if len(content) > most:
        raise LogError(f"has more than {most} bytes", where, "check that it is the right file")
    return content


_MAX_JSON_BYTES = 1 << 24


def read_json(source: str | Path, remedy: str) -> Any:
    """Return the JSON of a file, or of standard input for "-". Raises LogError, ParameterError with the `remedy`."""
    try:
        return json.loads(read_input(source, _MAX_JSON_BYTES))
    except (ValueError, RecursionError) as reason:
        raise ParameterError(f"it is not JSON: {reason!s:.80}", str(source), remedy) from reason
