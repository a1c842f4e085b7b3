"""Where `twodof flash` puts a controller: the simulator's slot, a module for PX4, a drone that flies it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

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


class FlashTarget(Protocol):
    """Somewhere that one controller of a template can be put."""

    def before(self, kind: str) -> tuple[Diagram, str]:
        """What is there now, or else the stock controller, and what that is."""

    def put(self, kind: str, diagram: Diagram) -> None:
        """Puts `diagram` there; where that fails, what was there stays."""

    def name(self, kind: str) -> str:
        """The place, for people."""


class SimulatorTarget:
    """What `twodof simulate --controller flashed` flies."""

    def __init__(self) -> None:
        self._slot = simulator_controllers()

    def before(self, kind: str) -> tuple[Diagram, str]:
        """See `FlashTarget`."""
        return self._slot.flies(kind)

    def put(self, kind: str, diagram: Diagram) -> None:
        """See `FlashTarget`. Raises DiagramError for a diagram without a JSON form, LogError where the disk refuses."""
        self._slot.flash(diagram)

    def name(self, kind: str) -> str:
        """See `FlashTarget`."""
        return str(self._slot.file(kind))


class Px4ModuleTarget:
    """The folder of a module for PX4."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def before(self, kind: str) -> tuple[Diagram, str]:
        """See `FlashTarget`."""
        file = self._folder / "diagram.json"
        if not file.exists():
            return _stock(kind)
        try:
            return load_diagram(file), str(file)
        except DiagramError as damage:
            return _stock(kind, f"what is there is damaged: {damage}")

    def put(self, kind: str, diagram: Diagram) -> None:
        """See `FlashTarget`. Raises DiagramError, CompileError, LogError."""
        export(diagram, self._folder)

    def name(self, kind: str) -> str:
        """See `FlashTarget`."""
        return str(self._folder)


class DroneTarget:
    """A drone, which flies the controller in a sandbox from then on and keeps it."""

    def __init__(self, drone: Drone) -> None:
        self._drone = drone

    def before(self, kind: str) -> tuple[Diagram, str]:
        """See `FlashTarget`. Raises LinkLost, Timeout."""
        try:
            diagram = from_json(self._drone.files.read(f"{FLYING}/{kind}.json"))
        except Rejected:  # it has no such file: no controller of a user's flies there
            return _stock(kind)
        except DiagramError as damage:
            return _stock(kind, f"what flies cannot be read: {damage}")
        return diagram, f"{diagram.name}, which flies on drone {self._drone.there.session.system}"

    def put(self, kind: str, diagram: Diagram) -> None:
        """See `FlashTarget`. Raises Rejected with the drone's reason, LinkLost, Timeout."""
        self._drone.fly_controller(kind, to_json(diagram))

    def name(self, kind: str) -> str:
        """See `FlashTarget`."""
        return f"drone {self._drone.there.session.system} at {self._drone.url}, {_path(kind)}"


def check_target(to: str) -> None:
    """That `to` names a place or looks like a URL, asked before a controller is compiled. Raises LinkError."""
    if to not in (SIM, FCU, PX4) and "/" not in to and ":" not in to:
        raise LinkError(
            f"{shown(to)} is not {SIM}, {PX4}, {FCU} or a URL", "--to", f"a drone's URL is such as {DEFAULT_URL}"
        )


@contextmanager
def open_target(to: str, out: Path | None, key: Path | None) -> Iterator[FlashTarget]:
    """The place that `to` names: `SIM`, `PX4` with the folder `out`, `FCU` or a drone's URL, reached with `key`.

    Raises LinkError for what is no URL, LinkLost where no drone answers, Rejected where somebody else has its lease.
    """
    if to == SIM:
        yield SimulatorTarget()
    elif out is not None:
        yield Px4ModuleTarget(out)
    else:
        with Drone.connect(DEFAULT_URL if to == FCU else to, system=SYSTEM, key=key) as drone:
            yield DroneTarget(drone)


def _stock(kind: str, why: str = "") -> tuple[Diagram, str]:
    return starter(STOCK[kind]), f"the stock controller ({STOCK[kind]})" + (f", as {why}" if why else "")


def _path(kind: str) -> str:
    return f"/controllers/{kind}.json"
