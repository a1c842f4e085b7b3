"""Controller store: keeps the flashed controllers, one diagram for each template, until others are flashed."""

import os
from pathlib import Path

from twodof.blocks import Diagram
from twodof.blocks.declarations import unknown_name
from twodof.errors import DiagramError
from twodof.flight.starters import load_diagram, save_diagram
from twodof.flight.templates import TEMPLATES, check_template
from twodof.flightlog.atomic import make_folder, sync_folder

STOCK = {"attitude_control": "stock-attitude", "position_control": "stock-position", "motor_control": "stock-motor"}
"""The starter diagram of the stock controller, by template; it flies if no diagram was flashed."""


def data_folder() -> Path:
    """Return the user's data folder: TWODOF_DATA, or XDG_DATA_HOME/twodof, or ~/.local/share/twodof.

    Raises DiagramError if the user has no home folder.
    """
    named = os.environ.get("TWODOF_DATA")
    if named:
        return Path(named)
    base = os.environ.get("XDG_DATA_HOME")
    try:
        return (Path(base) if base else Path.home() / ".local" / "share") / "twodof"
    except RuntimeError as reason:
        raise DiagramError(
            "the user has no home folder for flashed controllers", "TWODOF_DATA", "set this variable to a folder"
        ) from reason


class ControllerStore:
    """A folder that holds a JSON diagram for each template that was flashed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def file(self, kind: str) -> Path:
        """Return the path of the diagram flashed for the template `kind`. Raises DiagramError for an unknown one."""
        if kind not in TEMPLATES:
            raise unknown_name("template", kind, TEMPLATES, str(self.folder))
        return self.folder / f"{kind}.json"

    def flashed(self) -> dict[str, Diagram]:
        """Return the flashed diagrams by template.

        Raises DiagramError for a file that holds no diagram, or one that does not fit its template.
        """
        found = {}
        for kind in TEMPLATES:
            path = self.file(kind)
            if path.exists():
                found[kind] = load_diagram(path)
                check_template(found[kind], kind)
        return found

    def in_use(self, kind: str) -> tuple[Diagram, str]:
        """Return the diagram in use for the template `kind` and its origin: a file, or the stock controller.

        If the file is damaged, return the stock controller; the origin then says so.
        """
        path = self.file(kind)
        stock = f"the stock controller ({STOCK[kind]})"
        if not path.exists():
            return load_diagram(STOCK[kind]), stock
        try:
            return load_diagram(path), str(path)
        except DiagramError as damage:
            return load_diagram(STOCK[kind]), f"{stock}, as what was flashed is damaged: {damage}"

    def flash(self, diagram: Diagram) -> Path:
        """Store `diagram` as the controller of its template, and return its file.

        Raises DiagramError for a diagram that fits no template or has no JSON form, or if the folder cannot be made;
        LogError if the file cannot be written. The controller in use then stays.
        """
        path = self.file(check_template(diagram).name)
        try:
            make_folder(self.folder)
        except OSError as reason:
            what = f"the folder cannot be made: {reason.strerror}"
            raise DiagramError(what, str(self.folder), "set TWODOF_DATA to a folder that is writable") from reason
        save_diagram(diagram, path, overwrite=True)
        return path

    def remove(self, kind: str) -> bool:
        """Return to the stock controller of the template `kind`; return True if another one was flashed.

        Raises DiagramError or LogError if the file system refuses.
        """
        path = self.file(kind)
        try:
            path.unlink()
        except FileNotFoundError:
            return False
        except OSError as reason:
            raise DiagramError(
                f"cannot be removed: {reason.strerror}", str(path), "make its folder writable"
            ) from reason
        sync_folder(self.folder)
        return True


def simulator_controllers() -> ControllerStore:
    """Return the store that `twodof flash --to sim` writes and `twodof simulate --controller flashed` reads."""
    return ControllerStore(data_folder() / "flashed" / "sim")
