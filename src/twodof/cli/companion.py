"""`twodof companion`: pass MAVLink between the flight controller and several clients; run a user's app on board."""

import asyncio
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import typer

from twodof.cli.connection import run_until_signal
from twodof.cli.options import Index, Json, argument, flag, option
from twodof.cli.output import print_start, say_line
from twodof.companion.app_supervisor import MISTAKE, AppLimits, AppSupervisor, RestartPolicy
from twodof.companion.companion import Companion
from twodof.companion.links import Serve, px4_links
from twodof.fleet.local_drone import MOST_DRONES
from twodof.link.mavlink.dialect import COMPANION
from twodof.link.signing import Signing, Stamps, read_key
from twodof.link.transport.url import Ports

companion = typer.Typer(add_completion=False, rich_markup_mode=None)
# Where the app comes to: this machine only, at a port that is free.
APP_LINK = Serve("tcpin://127.0.0.1:0", "onboard", on_board=True)
# Streams of signatures are told apart by it: what we answer in the vehicle's name is not its own.
LINK_ID = COMPANION
MIB = 1 << 20


@dataclass(frozen=True)
class _Options:
    """Values of the options."""

    vehicle: str
    serve: tuple[Serve, ...]
    system: int
    key: Path | None
    line_rate: float | None
    json: bool

    def made(self) -> Companion:
        """Return the companion that the options describe. Raises LinkError."""
        signing = None
        if self.key is not None:
            signing = Signing(read_key(self.key), Stamps(f"{self.key}.{self.system}.companion.stamps"), LINK_ID)
        return Companion(self.vehicle, self.serve, self.system, signing, self.line_rate, say_line)


@companion.callback(invoke_without_command=True)
def route(
    context: typer.Context,
    fcu: Annotated[
        str | None,
        option(f"Address of the flight controller; default: tcp://127.0.0.1:{Ports.FLIGHT_CONTROLLER} + index.", "URL"),
    ] = None,
    index: Index = 0,
    onboard: Annotated[list[str] | None, option("Address for clients with onboard rates; repeatable.", "URL")] = None,
    ground: Annotated[list[str] | None, option("Address for clients with ground rates; repeatable.", "URL")] = None,
    open_: Annotated[bool, flag("Let other computers connect too.", "--open")] = False,
    key: Annotated[
        Path | None, option("Sign its own messages with this key, and pass on signed messages only.", "FILE")
    ] = None,
    line_rate: Annotated[
        float | None, option("Capacity of the line to the flight controller [byte/s].", min=100.0)
    ] = None,
    json: Json = False,
) -> None:
    """Route MAVLink between the flight controller and several clients, each with its own streams.

    Without --onboard and --ground it serves as PX4 in simulation does: UDP 14580 + index to 14540 + index, 18570 +
    index to 14550, TCP 5760 + index, index 0 to 9. It prints a line `listening on URL` for each (with --json one line
    of JSON), and ends by Ctrl-C or SIGTERM with exit status 0.
    """
    if index >= MOST_DRONES and not (onboard or ground):
        raise typer.BadParameter(
            f"drones 0 to {MOST_DRONES - 1} have ports of their own: say where this one serves, --onboard or --ground",
            param_hint="--index",
        )
    chosen = [*(Serve(url, "onboard") for url in onboard or ()), *(Serve(url, "ground") for url in ground or ())]
    serve = tuple(chosen) or px4_links(index, open_)
    options = _Options(
        fcu or f"tcp://127.0.0.1:{Ports.FLIGHT_CONTROLLER + index}", serve, index + 1, key, line_rate, json
    )
    context.obj = options
    if context.invoked_subcommand is None:
        raise typer.Exit(asyncio.run(run_until_signal(_route(options))) or 0)


@companion.command()
def run(
    context: typer.Context,
    program: Annotated[Path, argument("A file with `async def main(drone)`.", "APP", exists=True, dir_okay=False)],
    restarts: Annotated[int, option("Most restarts in a row.", min=0, max=100)] = 4,
    memory: Annotated[int, option("Memory limit of the app [MiB].", min=64)] = 4096,
) -> None:
    """Route, and run your own program on board: restarted if it crashes, ended with the companion.

    Exit status: 0 it ended by itself, 1 it crashed too often, 2 it is not an app.
    """
    supervised = (program, RestartPolicy(most=restarts), AppLimits(memory=memory * MIB))
    raise typer.Exit(asyncio.run(run_until_signal(_fly(context.obj, *supervised))) or 0)


async def _route(options: _Options) -> int:
    async with options.made() as made:
        _print_links(options, made)
        await made.run()
    return 0


async def _fly(options: _Options, program: Path, restarts: RestartPolicy, limits: AppLimits) -> int:
    """Route until the app has ended; return its exit status."""
    options = replace(options, serve=(*options.serve, APP_LINK))
    async with options.made() as made:
        _print_links(options, made)
        url = made.urls[-1][0].replace("tcpin:", "tcp:")
        command = [sys.executable, "-u", "-m", "twodof.gcs.app", str(program), "--url", url]
        command += ["--key", str(options.key)] if options.key is not None else []
        supervised = asyncio.ensure_future(
            AppSupervisor(command, say_line, limits, restarts, killed=lambda: made.killed).run()
        )
        routing = asyncio.ensure_future(made.run())
        try:
            await asyncio.wait({supervised, routing}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            supervised.cancel()
            await asyncio.wait({supervised})
            routing.cancel()
        if supervised.cancelled():
            routing.result()
        status = supervised.result()
    return status if status in (0, MISTAKE) else 1


def _print_links(options: _Options, made: Companion) -> None:
    """Print where clients can connect."""
    rows = [{"url": url, "rates": rates} for url, rates in made.urls]
    links = "".join(f"listening on {url} ({rates} rates)\n" for url, rates in made.urls)
    text = f"flight controller {options.vehicle}, system {options.system}\n{links}"
    print_start(options.json, {"fcu": options.vehicle, "system": options.system, "serve": rows}, text)
