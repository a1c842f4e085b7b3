"""`twodof companion`: pass MAVLink between the flight controller and several clients."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path
from typing import Annotated

import typer

from twodof.cli.output import Json, print_json, table_console
from twodof.errors import LinkError
from twodof.fcc.companion import Companion, Serve, px4_links
from twodof.link.key import read_key
from twodof.link.signing import Signing
from twodof.link.stamps import Stamps

app = typer.Typer(add_completion=False)


@app.callback(invoke_without_command=True)
def companion(
    context: typer.Context,
    fcu: Annotated[
        str | None, typer.Option(help="URL of the flight controller [tcp://127.0.0.1:5790, plus the index].")
    ] = None,
    index: Annotated[int, typer.Option(min=0, max=99, help="Which drone: its ports and its system id.")] = 0,
    onboard: Annotated[list[str] | None, typer.Option(help="Serve clients at this URL with onboard rates.")] = None,
    ground: Annotated[list[str] | None, typer.Option(help="Serve clients at this URL with ground rates.")] = None,
    open_: Annotated[bool, typer.Option("--open", help="Let other machines in, not this one alone.")] = False,
    key: Annotated[Path | None, typer.Option(help="Sign its own messages with the key in this file.")] = None,
    line_rate: Annotated[
        float | None, typer.Option(min=100.0, help="What the line to the flight controller carries [byte/s].")
    ] = None,
    json: Json = False,
) -> None:
    """Pass MAVLink between the flight controller and several clients, each with its own streams.

    Without --onboard and --ground it serves as PX4 in simulation does: UDP 14580 + index to 14540 + index, 18570 +
    index to 14550, TCP 5760 + index. Ends at Ctrl-C or SIGTERM.
    """
    if context.invoked_subcommand is not None:
        return
    chosen = [*(Serve(url, "onboard") for url in onboard or ()), *(Serve(url, "ground") for url in ground or ())]
    serve = tuple(chosen) or px4_links(index, open_)
    signing = None if key is None else Signing(read_key(str(key)), Stamps(str(key.with_suffix(".stamps"))))
    vehicle = fcu or f"tcp://127.0.0.1:{5790 + index}"
    if json:
        print_json({"fcu": vehicle, "system": index + 1, "serve": [{"url": s.url, "rates": s.rates} for s in serve]})
    else:
        console = table_console()
        console.print(f"flight controller {vehicle}, system {index + 1}", markup=False)
        for one in serve:
            console.print(f"clients at {one.url} ({one.rates} rates)", markup=False)
    asyncio.run(_serve(Companion(vehicle, serve, index + 1, signing, line_rate)))


async def _serve(made: Companion) -> None:
    """Until somebody asks it to end."""
    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    async with made:
        running = asyncio.ensure_future(made.run())
        waiting = asyncio.ensure_future(ended.wait())
        await asyncio.wait({running, waiting}, return_when=asyncio.FIRST_COMPLETED)
        waiting.cancel()
        if running.done() and not running.cancelled():
            raise running.exception() or LinkError("it ended by itself", made.vehicle, "report this")
        running.cancel()
