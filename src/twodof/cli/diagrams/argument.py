"""How commands name a diagram: a JSON file, or a starter's name."""

from __future__ import annotations

from twodof.blocks import Diagram
from twodof.flight.starters import STARTERS, load_diagram

DIAGRAM_HELP = f"A diagram's JSON file, or a starter diagram: {', '.join(STARTERS)}."


def read_diagram(text: str) -> Diagram:
    """The diagram that an argument names: a starter's name, or a JSON file, of which nothing is executed.

    Raises DiagramError, with the names of the starters, for what is neither, and for a file that is not a diagram.
    """
    return load_diagram(text)
