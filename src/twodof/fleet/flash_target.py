"""Where `twodof flash` puts a controller: the simulator's slot, a module for PX4, a drone that flies it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from twodof.blocks import Diagram
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.compile.px4 import export
from twodof.errors import DiagramError, LinkError, Rejected, shown
from twodof.flight.controller_store import STOCK, simulator_controllers
from twodof.flight.starters import load_diagram, starter
from twodof.gcs.async_drone import DEFAULT_URL
from twodof.gcs.drone import Drone

SYSTEM = 252
"""What we call ourselves to a drone: another one than a script's `Drone`, so that its lease keeps us out."""

FLYING = "/etc/extras"
"""Where a drone shows the diagrams that fly, by template."""

SIM, FCU, PX4 = "sim", "fcu", "px4-dir"


class FlashTarget(NamedTuple):
    """Somewhere that one controller of a template can be put.

    `before` is what is there now, or else the stock controller, and `origin` says which. `place` is for people. `put`
    puts a diagram there; where that fails, what was there stays.
    """

    before: Diagram
    origin: str
    place: str
    put: Callable[[Diagram], object]


def check_target(to: str) -> None:
    """That `to` names a place or looks like a URL, asked before a controller is compiled. Raises LinkError."""
    if to not in (SIM, FCU, PX4) and "/" not in to and ":" not in to:
        raise LinkError(
            f"{shown(to)} is not {SIM}, {PX4}, {FCU} or a URL", "--to", f"a drone's URL is such as {DEFAULT_URL}"
        )


@contextmanager
def open_target(to: str, kind: str, out: Path | None, key: Path | None) -> Iterator[FlashTarget]:
    """The place that `to` names for a controller of the template `kind`.

    `to` is `SIM`, `PX4` with the folder `out`, `FCU` or a drone's URL, reached with `key`. Raises LinkError for what is
    not a URL, LinkLost where no drone answers, Rejected where somebody else has its lease. `put` raises DiagramError,
    CompileError, LogError, and Rejected with the drone's reason.
    """
    if to == SIM:
        slot = simulator_controllers()
        yield FlashTarget(*slot.flies(kind), str(slot.file(kind)), slot.flash)
    elif out is not None:
        yield FlashTarget(*_exported(out / "diagram.json", kind), str(out), lambda diagram: export(diagram, out))
    else:
        with Drone.connect(DEFAULT_URL if to == FCU else to, system=SYSTEM, key=key) as drone:
            place = f"drone {drone.there.session.system} at {drone.url}, /controllers/{kind}.json"
            yield FlashTarget(
                *_flying(drone, kind), place, lambda diagram: drone.fly_controller(kind, to_json(diagram))
            )


def _exported(file: Path, kind: str) -> tuple[Diagram, str]:
    if not file.exists():
        return _stock(kind)
    try:
        return load_diagram(file), str(file)
    except DiagramError as damage:
        return _stock(kind, f", as what is there is damaged: {damage}")


def _flying(drone: Drone, kind: str) -> tuple[Diagram, str]:
    try:
        diagram = from_json(drone.files.read(f"{FLYING}/{kind}.json"))
    except Rejected:  # it has no such file: no controller of a user's flies there
        return _stock(kind)
    except DiagramError as damage:
        return _stock(kind, f", as what flies cannot be read: {damage}")
    return diagram, f"{diagram.name}, which flies on drone {drone.there.session.system}"


def _stock(kind: str, why: str = "") -> tuple[Diagram, str]:
    return starter(STOCK[kind]), f"the stock controller ({STOCK[kind]}){why}"
