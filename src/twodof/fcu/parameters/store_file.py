"""The file in which the vehicle's parameters persist: replaced as a whole by a thread, and checked when it is read."""

import json
import threading
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twodof.errors import ParameterError, TwodofError
from twodof.flightlog.atomic import atomic_write, make_folder

VERSION = 1
MAX_BYTES = 1 << 20
GATHER_S = 0.25
"""Time from a first change of the values until the file is written [s], with the changes that come meanwhile."""
RETRY_S = 5.0


@dataclass(frozen=True)
class TunedController:
    """Values that differ from the defaults in a controller, by path; `identity` is its diagram's SHA-256."""

    kind: str
    name: str
    identity: str
    values: Mapping[str, float]


@dataclass(frozen=True)
class StoredParameters:
    """Content of the file: values by name, and the tuned controllers, the latest last."""

    values: Mapping[str, float] = field(default_factory=dict)
    controllers: tuple[TunedController, ...] = ()


class StoreFile:
    """Reader and writer of the file; `failure` is the reason why the last writing failed, None if it succeeded."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.failure: TwodofError | None = None
        self._changed = threading.Condition()
        self._wanted: StoredParameters | None = None
        self._at_once = self._closing = False
        self._begun = self._tries = 0  # how often writing was begun, and ended
        self._thread: threading.Thread | None = None

    def read(self) -> tuple[StoredParameters, str]:
        """Read the file; return its content and its fault, "" if there is none. A damaged file becomes NAME.damaged."""
        try:
            if self.path.stat().st_size > MAX_BYTES:
                raise ValueError(f"is larger than {MAX_BYTES} bytes")
            return _kept(json.loads(self.path.read_text(encoding="utf-8"))), ""
        except FileNotFoundError:
            return StoredParameters(), ""
        except (OSError, ValueError, RecursionError, TypeError) as reason:
            return StoredParameters(), self._set_aside(str(reason))

    def write(self, kept: StoredParameters) -> None:
        """Write `kept` soon; returns at once."""
        with self._changed:
            self._wanted = kept
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name=f"store {self.path.name}", daemon=True)
                self._thread.start()
            self._changed.notify_all()

    def flush(self, deadline_s: float) -> None:
        """Write the waiting content now, and wait until it is on the disk.

        Raises ParameterError if the disk refuses, or does not answer within `deadline_s` [s].
        """
        with self._changed:
            self._at_once = self._wanted is not None
            number = self._begun + 1  # one that is under way may be writing what was given before
            self._changed.notify_all()
            done = self._changed.wait_for(lambda: self._wanted is None or self._tries >= number, deadline_s)
            if done and self._wanted is not None and self.failure is not None:
                remedy = "store them on another disk: the values fly, but are not stored"
                raise ParameterError(self.failure.what, self.failure.where, remedy)
            if not done:
                silent = f"the disk did not answer within {deadline_s:g} s"
                raise ParameterError(silent, str(self.path), "store them on another disk")

    def close(self, deadline_s: float) -> None:
        """Write the waiting content and end the thread. Raises ParameterError as `flush`."""
        thread = self._thread
        if thread is None or self._closing:
            return
        try:
            self.flush(deadline_s)
        finally:
            with self._changed:
                self._closing = True
                self._changed.notify_all()
            thread.join(deadline_s)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._wanted is not None or self._closing)
                wait_s = RETRY_S if self.failure is not None else GATHER_S
                self._changed.wait_for(lambda: self._at_once or self._closing, wait_s)
                kept = self._wanted
                if kept is None or self._closing:
                    return
                self._at_once = False
                self._begun += 1
            failure = self._store(kept)
            with self._changed:
                self.failure = failure
                self._tries += 1
                if failure is None and self._wanted is kept:
                    self._wanted = None
                self._changed.notify_all()

    def _store(self, kept: StoredParameters) -> TwodofError | None:
        try:
            make_folder(self.path.parent)
            with atomic_write(self.path, "w") as file:
                file.write(text_of(kept))
        except TwodofError as refusal:
            return refusal
        except OSError as refusal:
            return ParameterError(f"cannot be written: {refusal.strerror}", str(self.path), "choose another folder")
        return None

    def _set_aside(self, what: str) -> str:
        """Rename an unusable file, so that it is not overwritten; return the fault."""
        aside = self.path.with_name(f"{self.path.name}.damaged")
        try:
            self.path.replace(aside)
        except OSError as refusal:
            return f"{self.path}: {what}; the defaults fly ({refusal.strerror})"
        return f"{self.path}: {what}; the defaults fly, the file is kept as {aside.name}"


def text_of(kept: StoredParameters) -> str:
    """Return the content of the file as text."""
    values = dict(sorted(kept.values.items()))
    tuned = [{**vars(one), "values": dict(sorted(one.values.items()))} for one in kept.controllers]
    content = {"version": VERSION, "crc": _crc(values, tuned), "parameters": values}
    return json.dumps(content | ({"controllers": tuned} if tuned else {}), indent=2)


def _crc(values: Mapping[str, Any], tuned: object) -> int:
    return zlib.crc32(json.dumps([values, tuned] if tuned else values, sort_keys=True).encode())


def _kept(content: object) -> StoredParameters:
    """Read a file's content. Raises ValueError or TypeError for damage."""
    if not isinstance(content, dict) or content.get("version") != VERSION:
        raise ValueError(f"is not of version {VERSION}")
    values, tuned = content.get("parameters"), content.get("controllers", [])
    if not isinstance(values, dict) or not isinstance(tuned, list) or content.get("crc") != _crc(values, tuned):
        raise ValueError("its checksum is wrong")
    found = tuple(TunedController(**one) for one in tuned)
    if not all(isinstance(one.values, dict) for one in found):
        raise ValueError("the values of a controller must be a table")
    return StoredParameters(values, found)
