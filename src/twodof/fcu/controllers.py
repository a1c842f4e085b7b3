"""Which controllers fly: those given at the start, and those that were uploaded since; rebuilt while disarmed."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path

from twodof.blocks import Diagram
from twodof.blocks.schema import to_json
from twodof.errors import DiagramError
from twodof.fcu.flight_code import FlightCode
from twodof.fcu.services.own_telemetry import Flown
from twodof.flight.slot import STOCK, Slot
from twodof.flight.starters import load_diagram, starter
from twodof.flight.templates import by_kind


class Controllers:
    """Builds the flight code of the diagrams that are to fly.

    `given` are diagrams, JSON files or names of starter diagrams. Those in the folder `uploads`, one a template, come
    in their place; a stock controller's own diagram there means the stock controller. Uploaded ones are never
    `trusted`, and then none is. Raises DiagramError as `load_diagram` and `by_kind`.
    """

    def __init__(
        self,
        given: Iterable[str | Path | Diagram] = (),
        trusted: bool = False,
        uploads: Path | None = None,
        position_filter: str = "joint",
        precision: str = "float64",
        fuel: int | None = None,
    ) -> None:
        self.slot = None if uploads is None else Slot(uploads)
        self._given = by_kind(c if isinstance(c, Diagram) else load_diagram(c) for c in given)
        self._trusted = trusted
        self._position_filter = position_filter
        self._precision = precision
        self._fuel = fuel

    def build(self) -> FlightCode:
        """The flight code with what is to fly now; may take seconds, in any thread.

        Raises DiagramError for a file that is no controller any more, CompileError where a tool chain is missing.
        """
        uploaded = {} if self.slot is None else self.slot.flashed()
        chosen = self._given | uploaded
        stock = {kind for kind, diagram in uploaded.items() if to_json(diagram) == to_json(starter(STOCK[kind]))}
        flying = [diagram for kind, diagram in chosen.items() if kind not in stock]
        return self._code(flying, self._trusted and not uploaded)

    def build_safely(self) -> tuple[FlightCode, str]:
        """As `build`; where what was uploaded is damaged or cannot be built, without it, and why."""
        try:
            return self.build(), ""
        except DiagramError as error:
            code = self._code(self._given.values(), self._trusted)
            return code, f"uploaded controller left out: {error}"

    def _code(self, diagrams: Iterable[Diagram], trusted: bool) -> FlightCode:
        return FlightCode(diagrams, trusted, self._position_filter, self._precision, self._fuel)


def flown(code: FlightCode) -> Flown:
    """What flies in `code`."""
    if not code.controllers:
        return Flown()
    names = "+".join(diagram.name for diagram in code.controllers)
    digest = hashlib.sha256("".join(to_json(diagram) for diagram in code.controllers).encode())
    return Flown(names, int.from_bytes(digest.digest()[:8], "big"))
