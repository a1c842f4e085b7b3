"""Starter diagrams, from which a user's controller begins, by name, and diagrams in files."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

from twodof.blocks import Diagram
from twodof.blocks.schema.json_form import MAX_BYTES, from_json, to_json
from twodof.errors import DiagramError
from twodof.flight.starters import attitude, position
from twodof.flightlog.atomic import atomic_write, check_free

STARTERS: Mapping[str, Callable[[], Diagram]] = MappingProxyType(
    {
        "stock-attitude": attitude.stock_attitude,
        "pid-attitude": attitude.pid_attitude,
        "lqr-attitude": attitude.lqr_attitude,
        "notch-attitude": attitude.notch_attitude,
        "empty-attitude": attitude.empty_attitude,
        "stock-position": position.stock_position,
        "pid-position": position.pid_position,
        "empty-position": position.empty_position,
        "stock-motor": position.stock_motor,
        "direct-motor": position.direct_motor,
        "empty-motor": position.empty_motor,
    }
)
"""The function that makes each starter diagram, by name."""

DIAGRAM_HELP = f"A diagram's JSON file, or a starter diagram: {', '.join(STARTERS)}."
"""Help text for an argument that `load_diagram` reads."""


def starter(name: str) -> Diagram:
    """Return a new copy of the starter diagram `name`. Raises DiagramError for an unknown name."""
    if name not in STARTERS:
        raise DiagramError(f"no starter diagram called {name!r:.80}", "", f"there are: {', '.join(STARTERS)}")
    return STARTERS[name]()


def load_diagram(source: str | Path) -> Diagram:
    """Return the starter diagram called `source`, or the diagram in a JSON file. No code in the file is executed.

    Raises DiagramError for a file that cannot be read, is larger than 8 MiB or holds no diagram.
    """
    if isinstance(source, str) and source in STARTERS:
        return starter(source)
    path = Path(source)
    try:
        if not path.is_file():
            what = "this is not a file" if path.exists() else "this is neither a file nor a starter diagram"
            raise DiagramError(what, str(path), f"name a JSON file or one of {', '.join(STARTERS)}")
        with path.open("rb") as file:
            text = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as reason:
        why = reason.strerror if isinstance(reason, OSError) else reason
        raise DiagramError(
            f"cannot be read: {why}", f"{source!s:.200}", f"name a JSON file or one of {', '.join(STARTERS)}"
        ) from reason
    try:
        return from_json(text)
    except DiagramError as error:
        raise DiagramError(error.what, f"{path}: {error.where}".rstrip(": "), error.remedy) from error


def save_diagram(diagram: Diagram, path: str | Path, overwrite: bool = False) -> None:
    """Write `diagram` to a JSON file, for `load_diagram`; an interrupted write leaves the old file.

    Raises DiagramError for a block without a JSON form; LogError if the file exists and `overwrite` is false, or if it
    cannot be written.
    """
    text = to_json(diagram)
    check_free(path, overwrite)
    with atomic_write(path, "w") as file:
        file.write(text)


def new_diagram(name: str, path: str | Path, overwrite: bool = False) -> Diagram:
    """Write the starter diagram called `name` to the file `path` and return it.

    Raises DiagramError for an unknown name; LogError if the file exists and `overwrite` is false.
    """
    diagram = starter(name)
    save_diagram(diagram, path, overwrite)
    return diagram
