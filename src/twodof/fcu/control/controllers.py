"""The controllers that fly: those given at the start, and those uploaded since; rebuilt while disarmed."""

from collections.abc import Iterable, Mapping
from pathlib import Path

from twodof.blocks import Diagram
from twodof.blocks.schema.json_form import to_json
from twodof.errors import CompileError, ControllerFault, DiagramError
from twodof.fcu.control.flight_code import FlightCode
from twodof.flight.controller_store import STOCK, ControllerStore
from twodof.flight.starters import load_diagram, starter
from twodof.flight.templates import TEMPLATES, by_kind


class Controllers:
    """The diagrams that are to fly, and the build of their flight code.

    `given` are diagrams, JSON files or names of starter diagrams. Clients put others into the folder `uploads`, one for
    a template; these replace the given ones once they are built. The folder `kept` holds the uploads that fly, for the
    next start. The diagram of a stock controller stands for the stock controller. Uploads are never `trusted`; if one
    flies, no controller is. Raises DiagramError as `load_diagram` and `by_kind`.
    """

    def __init__(
        self,
        given: Iterable[str | Path | Diagram] = (),
        trusted: bool = False,
        uploads: Path | None = None,
        kept: Path | None = None,
        position_filter: str = "joint",
        precision: str = "float64",
        fuel: int | None = None,
    ) -> None:
        self.uploads = None if uploads is None else ControllerStore(uploads)
        self._kept = None if kept is None else ControllerStore(kept)
        self._given = by_kind(c if isinstance(c, Diagram) else load_diagram(c) for c in given)
        self._trusted = trusted
        self._position_filter = position_filter
        self._precision = precision
        self._fuel = fuel

    def build(self) -> tuple[FlightCode, str]:
        """Build the flight code of the given and the kept controllers; return it and "".

        If a kept one cannot be built, return the code without the kept ones and the reason. Raises ControllerFault for
        a given one that needs too much for a step, CompileError if a tool chain is missing.
        """
        damage = ""
        if self._kept is not None:
            try:
                return self._built(self._kept.flashed()), ""
            except (DiagramError, ControllerFault, CompileError) as error:
                damage = f"uploaded controllers left out: {error}"
        return self._built({}), damage

    def build_uploaded(self) -> tuple[FlightCode, dict[str, Diagram]]:
        """Build the flight code of the given and the uploaded controllers; return it and the uploads by template.

        It takes seconds, may run in any thread, and keeps nothing. Raises DiagramError for a file that is not a
        controller, ControllerFault for one that needs too much for a single step, CompileError if a tool chain is
        missing.
        """
        if self.uploads is None or self._kept is None:
            raise DiagramError("uploads are not kept", "controllers", "start the drone with a folder for its state")
        uploaded = self.uploads.flashed()
        return self._built(uploaded), uploaded

    def keep(self, uploaded: Mapping[str, Diagram]) -> None:
        """Store `uploaded`, and no others, to fly after a restart too. Raises LogError if the disk refuses."""
        _fill(self._kept, uploaded)

    def restore(self) -> None:
        """Set the folder of uploads back to those that fly, without one that could not be built.

        Raises LogError or DiagramError if the disk refuses.
        """
        if self._kept is not None and self.uploads is not None:
            for kind in TEMPLATES:  # first, as one that is kept may be damaged
                if not self._kept.file(kind).exists():
                    self.uploads.remove(kind)
            _fill(self.uploads, self._kept.flashed())

    def forget(self) -> None:
        """Delete all uploads. Raises as `restore`."""
        _fill(self.uploads, {})
        _fill(self._kept, {})

    def _built(self, uploaded: Mapping[str, Diagram]) -> FlightCode:
        stock = {kind for kind, diagram in uploaded.items() if to_json(diagram) == to_json(starter(STOCK[kind]))}
        flying = [diagram for kind, diagram in (self._given | dict(uploaded)).items() if kind not in stock]
        trusted = self._trusted and not uploaded
        return FlightCode(flying, trusted, self._position_filter, self._precision, self._fuel)


def _fill(store: ControllerStore | None, diagrams: Mapping[str, Diagram]) -> None:
    """Make a folder hold these diagrams, by template, and no others."""
    if store is None:
        return
    for kind in TEMPLATES:
        if kind in diagrams:
            store.flash(diagrams[kind])
        else:
            store.remove(kind)
