"""Component metadata, fetched as QGroundControl does it: message, general file, parameter file, checksums, contents."""

import json
import struct
from pathlib import Path
from typing import Any

from tests.fcu.mavlink.test_ftp import Server
from twodof.fcu.mavlink.file_tree import Metadata, mavlink_crc32
from twodof.link.mavlink.ftp import FtpOperation

REQUEST_MESSAGE, COMPONENT_METADATA = 512, 397


def fetched(server: Server, uri: str) -> bytes:
    assert uri.startswith("mftp://")
    answer = server.one(FtpOperation.OPEN_RO, uri.removeprefix("mftp://").encode())
    assert answer.op == FtpOperation.ACK
    (size,) = struct.unpack_from("<I", answer.data)
    content = b""
    while len(content) < size:
        piece = server.one(FtpOperation.READ, session=answer.session, offset=len(content))
        content += piece.data[: piece.size]
    server.one(FtpOperation.TERMINATE, session=answer.session)
    return content


def metadata(tmp_path: Path) -> tuple[Server, Any]:
    server = Server(tmp_path)
    made = Metadata(server.store, lambda: 4 * server.controller.tick)
    server.made.update(made.files)
    server.px4.requests.on("COMPONENT_METADATA", made.message)
    assert server.command(REQUEST_MESSAGE, COMPONENT_METADATA) == 0
    (told,) = server.taken("COMPONENT_METADATA")
    return server, told


def test_the_files_are_where_they_are_said_to_be_with_the_checksums_said(tmp_path: Path) -> None:
    server, told = metadata(tmp_path)
    general = fetched(server, told.uri)
    assert mavlink_crc32(general) == told.file_crc
    rows = json.loads(general)
    assert rows["version"] == 1
    assert [row["type"] for row in rows["metadataTypes"]] == [1]  # COMP_METADATA_TYPE_PARAMETER
    for row in rows["metadataTypes"]:
        assert mavlink_crc32(fetched(server, row["uri"])) == row["fileCrc"]


def test_every_parameter_is_described_as_the_vehicle_enforces_it(tmp_path: Path) -> None:
    server, told = metadata(tmp_path)
    general = json.loads(fetched(server, told.uri))
    described = json.loads(fetched(server, general["metadataTypes"][0]["uri"]))
    assert described["version"] == 1
    assert [row["name"] for row in described["parameters"]] == [row.name for row in server.store.rows]
    for row, own in zip(described["parameters"], server.store.rows, strict=True):
        assert row["type"] == {"int32": "Int32", "float": "Float"}[own.kind]
        assert (row["min"], row["default"], row["max"]) == (own.low, own.default, own.high)
        assert (row["units"], row["group"]) == (own.unit, own.group)
        assert row["shortDesc"]
        # QGroundControl shows an int32's numbers as such.
        assert all(isinstance(row[key], int) == (own.kind == "int32") for key in ("min", "default", "max"))
