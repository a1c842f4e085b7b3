"""ModelFolder: identified models by name, as files of `twodof identify --out`."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from twodof.design.pitch_family import PitchFamily
from twodof.errors import LogError, ParameterError, Rejected, TwodofError, shown
from twodof.flightlog.atomic import atomic_write, check_free
from twodof.flightlog.provenance import read_bytes
from twodof.lab.refusals import NotThere

MAX_BYTES = 1 << 20
MOST = 500
SUFFIX = ".json"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+-]{0,59}")
_CHOICES = ".chosen"
"""Beside the models, under a name that no model can have."""


class ModelFolder:
    """The models in `folder`; each is read when it is asked for."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def names(self) -> list[str]:
        """Those that are there."""
        found = (path.stem for path in self._folder.glob(f"*{SUFFIX}") if _NAME.fullmatch(path.stem))
        return sorted(found)[:MOST]

    def read(self, name: str) -> dict[str, Any]:
        """A model's document. Raises NotThere, ParameterError for a damaged file."""
        try:
            found = json.loads(self._content(name))
        except (ValueError, RecursionError) as reason:
            raise ParameterError(f"it is not JSON: {shown(reason)}", f"model {name}", "identify it again") from reason
        if not isinstance(found, dict):
            raise ParameterError("it is not a model", f"model {name}", "identify it again")
        return found

    def family(self, name: str) -> PitchFamily:
        """The family of a pitch model, for tuning and design. Raises NotThere, ParameterError for another kind."""
        return PitchFamily.from_identified(self.read(name), f"model {name}")

    def digest(self, name: str) -> str:
        """Of its bytes: another model of the same name is another. Raises NotThere."""
        return hashlib.sha256(self._content(name)).hexdigest()

    def save(self, name: str, document: Mapping[str, Any], overwrite: bool = False) -> None:
        """Keep a model. Raises ParameterError for a name that cannot be, Rejected where it is there already."""
        path = self._place(name)
        self._folder.mkdir(parents=True, exist_ok=True)
        if len(self.names()) >= MOST:
            raise Rejected(f"there are {MOST} models", "models", "delete some that you no longer need")
        try:
            check_free(path, overwrite)
        except LogError as reason:
            raise Rejected(f"there is a model '{name}' already", "models", "choose another name") from reason
        with atomic_write(path, "w") as file:
            json.dump(document, file, indent=1, allow_nan=False)

    def delete(self, name: str) -> None:
        """Raises NotThere."""
        path = self._place(name)
        if not path.is_file():
            raise _missing(name)
        path.unlink()

    def row(self, name: str) -> dict[str, Any]:
        """What a list shows of one: `pitch` where tuning and design can use it, else `why` they cannot."""
        told: dict[str, Any] = {"name": name, "kept": self._place(name).stat().st_mtime, "values": [], "pitch": False}
        try:
            document = self.read(name)
            told |= {key: shown_text(document.get(key)) for key in ("experiment", "structure", "method")}
            told["values"] = _values(document)
            told["informative"] = document.get("informative")
            family = PitchFamily.from_identified(document, name)
            told |= {"pitch": True, "why": "", "family": {key: family.values[key] for key in family.values}}
        except TwodofError as reason:
            told["why"] = reason.what
        return told

    def chosen(self, drone: int) -> str | None:
        """The model that guards a drone's tuning; None where none was chosen, or it is gone."""
        name = self._choices().get(str(drone))
        return name if isinstance(name, str) and name in self.names() else None

    def choose(self, drone: int, name: str | None) -> None:
        """Let a model guard a drone's tuning, or none. Raises as `family`."""
        if name is not None:
            self.family(name)
        choices = {**self._choices(), str(drone): name}
        self._folder.mkdir(parents=True, exist_ok=True)
        with atomic_write(self._folder / _CHOICES, "w") as file:
            json.dump({key: value for key, value in choices.items() if value is not None}, file)

    def _choices(self) -> dict[str, Any]:
        try:
            found = json.loads((self._folder / _CHOICES).read_bytes()[:MAX_BYTES])
        except (OSError, ValueError):
            return {}
        return found if isinstance(found, dict) else {}

    def _content(self, name: str) -> bytes:
        path = self._place(name)
        if not path.is_file():
            raise _missing(name)
        return read_bytes(path, MAX_BYTES)

    def _place(self, name: str) -> Path:
        if not _NAME.fullmatch(name) or name.endswith(SUFFIX):
            remedy = "take letters, digits, space, . _ + -, at most 60, and begin with a letter or digit"
            raise ParameterError(f"{shown(name)} cannot be a model's name", "models", remedy)
        return self._folder / f"{name}{SUFFIX}"


def shown_text(value: object) -> str:
    """A text of a file, short."""
    return value[:80] if isinstance(value, str) else ""


def _values(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Of each unknown that is the machine's: name, value, standard deviation, unit."""
    estimates, sums = document.get("estimates"), document.get("sums")
    rows = {**(estimates if isinstance(estimates, dict) else {}), **(sums if isinstance(sums, dict) else {})}
    found = []
    for name, row in [*rows.items()][:50]:
        if isinstance(row, dict) and not name.endswith(("_0", "_trim", "_bias")):
            sigma = row.get("sigma_robust", row.get("sigma"))
            found.append({"name": name, "value": row.get("value"), "sigma": sigma, "unit": row.get("unit", "")})
    return found


def _missing(name: str) -> NotThere:
    return NotThere("there is no such model", f"model {name[:60]}", "GET /api/models lists them")
