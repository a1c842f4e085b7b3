"""Tree of the files that clients read and write by MAVLink FTP, with the descriptions of the parameters.

A path is looked up and never handed to the system, so that no path leads out of the tree. `/etc/extras` holds the
descriptions and the diagrams that fly, `/controllers` the diagrams that clients have sent. All is bounded. Logs are
fetched by LOG_REQUEST_LIST (log_transfer.py).

COMPONENT_METADATA names component_general.json, which names parameters.json. Sources: MAVLink guide, "Component
Metadata Protocol"; schemas general and parameter, version 1.
"""

import json
import re
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from twodof.errors import LogError
from twodof.fcu.mavlink.background import read_block
from twodof.fcu.mavlink.service import MASK_32
from twodof.fcu.parameters.parameter_store import ParametersRelisted, ParameterStore
from twodof.fcu.parameters.table import VehicleParameter
from twodof.flightlog.atomic import atomic_write, make_folder, sync_folder
from twodof.link.mavlink.ftp import FtpError
from twodof.link.mavlink.messages import message

EXTRAS, CONTROLLERS = "/etc/extras", "/controllers"
MAX_UPLOAD = 8 << 20
"""Largest upload [byte]: that of a diagram that the loader accepts."""
MOST_UPLOADS = 32
_UPLOADED = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,58}\.json")


class FileFault(LogError):
    """A file cannot be read or written; `code` is the error of MAVLink FTP."""

    def __init__(self, code: FtpError) -> None:
        super().__init__(code.name)
        self.code = code


class OpenFile(NamedTuple):
    """File opened for reading: its bytes or its path, and its size [byte] when it was opened."""

    content: bytes | Path
    size: int

    def read(self, offset: int, count: int) -> bytes:
        """Read at most `count` bytes from `offset`; none behind the end. Raises OSError."""
        count = min(count, self.size - offset)
        if count <= 0:
            return b""
        if isinstance(self.content, Path):
            return read_block(self.content, offset, count)
        return self.content[offset : offset + count]


class FileTree:
    """Tree of files: `made` returns those in /etc/extras by name, `controllers` is the folder of uploads, if any."""

    def __init__(self, made: Callable[[], Mapping[str, bytes]], controllers: Path | None = None) -> None:
        self._made = made
        self._controllers = controllers

    def entries(self, path: str) -> list[tuple[str, int | None]]:
        """List names and sizes in a folder, sorted by name; the size of a folder is None. Raises FileFault."""
        folders: dict[str, list[tuple[str, int | None]]] = {
            "/": [("controllers", None), ("etc", None)] if self._controllers else [("etc", None)],
            "/etc": [("extras", None)],
            EXTRAS: [(name, len(content)) for name, content in sorted(self._made().items())],
        }
        if self._controllers:
            folders[CONTROLLERS] = [(path.name, path.lstat().st_size) for path in self._uploads()]
        found = folders.get("/".join(_split(path)))
        if found is None:
            raise FileFault(FtpError.NOT_FOUND)
        return found

    def open(self, path: str) -> OpenFile:
        """Open a file to read. Raises FileFault, OSError."""
        folder, name = _split(path)
        content = self._made().get(name) if folder == EXTRAS else None
        if content is not None:
            return OpenFile(content, len(content))
        found = self._upload(folder, name)
        return OpenFile(found, found.stat().st_size)

    def checksum(self, path: str) -> int:
        """Return a file's checksum of MAVLink FTP: CRC-32 begun with 0 and not inverted. Raises FileFault."""
        file = self.open(path)
        return mavlink_crc32(file.read(0, file.size))

    def target(self, path: str) -> Path:
        """Return the file for an upload to `path`. Raises FileFault if it is not allowed there, or one too many."""
        folder, name = _split(path)
        if folder != CONTROLLERS or self._controllers is None or not _UPLOADED.fullmatch(name):
            raise FileFault(FtpError.PROTECTED)
        target, there = self._controllers / name, self._uploads()
        if target.is_symlink():
            raise FileFault(FtpError.PROTECTED)
        if target not in there and len(there) >= MOST_UPLOADS:
            raise FileFault(FtpError.FAIL)
        return target

    def upload(self, path: str, content: bytes) -> None:
        """Write an upload, whole or not at all. Raises FileFault, OSError, LogError."""
        target = self.target(path)
        make_folder(target.parent)
        with atomic_write(target) as file:
            file.write(content)

    def remove(self, path: str) -> None:
        """Delete an upload, on the disk too when it returns. Raises FileFault, OSError, LogError."""
        folder, name = _split(path)
        if folder != CONTROLLERS:
            raise FileFault(FtpError.PROTECTED)
        found = self._upload(folder, name)
        found.unlink()
        sync_folder(found.parent)

    def _upload(self, folder: str, name: str) -> Path:
        found = next((path for path in self._uploads() if path.name == name), None)
        if folder != CONTROLLERS or found is None:
            raise FileFault(FtpError.NOT_FOUND)
        return found

    def _uploads(self) -> list[Path]:
        if self._controllers is None or not self._controllers.is_dir():
            return []
        found = [path for path in self._controllers.iterdir() if _UPLOADED.fullmatch(path.name)]
        return sorted(path for path in found if path.is_file() and not path.is_symlink())


def mavlink_crc32(data: bytes) -> int:
    """Return the CRC-32 of MAVLink FTP and PX4: zlib's polynomial, begun with 0, not inverted."""
    return zlib.crc32(data, 0xFFFFFFFF) ^ 0xFFFFFFFF


def _split(path: str) -> tuple[str, str]:
    """Return folder and name of a path from the root; a slash at its end says nothing. Raises FileFault for `..`."""
    names = [name for name in path.split("/") if name not in ("", ".")]
    if ".." in names or "\0" in path:
        raise FileFault(FtpError.NOT_FOUND)
    return "".join(f"/{name}" for name in names[:-1]), "".join(names[-1:])


GENERAL, PARAMETERS = "component_general.json", "parameters.json"
_PARAMETER_TYPE = 1
"""COMP_METADATA_TYPE_PARAMETER."""
_KINDS = MappingProxyType({"int32": "Int32", "float": "Float"})


class Metadata:
    """The files in /etc/extras, and the answer to a request for COMPONENT_METADATA.

    `files`, by name, are the descriptions of the parameters and the users' diagrams that fly. They are made from
    `store`, and made again when other parameters are listed there.
    """

    def __init__(self, store: ParameterStore, time_boot_ms: Callable[[], int] = lambda: 0) -> None:
        self._store = store
        self._time_boot_ms = time_boot_ms
        self._make()
        store.bus.subscribe(ParametersRelisted, lambda _: self._make())

    def _make(self) -> None:
        diagrams = {f"{one.kind}.json": one.text.encode() for one in self._store.carried}
        self.files: Mapping[str, bytes] = metadata_files(self._store.rows) | diagrams

    def message(self, _command: object = None) -> Iterable[Any]:
        """Return COMPONENT_METADATA as a list of one message."""
        made = {"file_crc": mavlink_crc32(self.files[GENERAL]), "uri": _uri(GENERAL)}
        return [message("COMPONENT_METADATA", time_boot_ms=self._time_boot_ms() & MASK_32, **made)]


def metadata_files(rows: Sequence[VehicleParameter]) -> dict[str, bytes]:
    """Return component_general.json and parameters.json, by name, for the parameters `rows`."""
    parameters = _json({"version": 1, "parameters": [_parameter(row) for row in rows]})
    described = {"type": _PARAMETER_TYPE, "uri": _uri(PARAMETERS), "fileCrc": mavlink_crc32(parameters)}
    return {GENERAL: _json({"version": 1, "metadataTypes": [described]}), PARAMETERS: parameters}


def _parameter(row: VehicleParameter) -> dict[str, Any]:
    text = row.text if row.user_path else row.text[0].upper() + row.text[1:] if row.text else row.name
    conditions = [f"Another name of {row.of}."] if row.of else []
    if row.fixed or row.disarmed:
        conditions.append("Fixed." if row.fixed else "Changed only while disarmed.")
    made = {
        "name": row.name,
        "type": _KINDS[row.kind],
        "shortDesc": text,
        "units": row.unit,
        "default": row.kept(row.default),
        "group": row.group,
        "category": "Standard" if row.acts else "Developer",
        "rebootRequired": row.reboot,
        "readOnly": row.fixed,
        "min": row.kept(row.low) if row.bounded else None,
        "max": row.kept(row.high) if row.bounded else None,
        "path": row.user_path or None,  # no key of the schema's, which allows others: by this our own clients find it
        "longDesc": " ".join(conditions) or None,
        "decimalPlaces": 6 if row.kind == "float" else None,
    }
    return {name: value for name, value in made.items() if value is not None}


def _uri(name: str) -> str:
    return f"mftp://{EXTRAS}/{name}"


def _json(content: object) -> bytes:
    return json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
