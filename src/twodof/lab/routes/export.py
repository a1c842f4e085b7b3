"""Export: what a plot shows, as a file for MATLAB."""

from __future__ import annotations

import asyncio
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from twodof.flightlog.files import write_log
from twodof.flightlog.provenance import versions
from twodof.flightlog.seen import log_of_rows
from twodof.lab.access import computes
from twodof.lab.access.declared import takes

router = APIRouter(prefix="/api/export", tags=["export"])
MOST = 64 << 20
"""Bytes: a quarter of an hour of fifteen columns."""
_BINARY = {"requestBody": {"content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}}}
Columns = Annotated[str, Query(max_length=4096, description="Names of the columns, separated by commas.")]


@router.post("/mat", openapi_extra=_BINARY, response_class=Response)
@computes
@takes(MOST)
async def mat(request: Request, columns: Columns) -> Response:
    """The rows of a plot as a .mat file with the channels of the drone's own logs.

    The body is float64[n] times [s], then float32[n] of each column, little-endian. 422 where it is not.
    """
    data = await request.body()
    content = await asyncio.to_thread(_mat, data, columns.split(","))
    return Response(content, media_type="application/octet-stream")


def _mat(data: bytes, columns: list[str]) -> bytes:
    now = datetime.now().astimezone().isoformat(timespec="seconds")
    log = log_of_rows(data, columns, {"seen": {"saved": now}, "versions": versions()})
    with TemporaryDirectory(prefix="twodof-") as folder:
        path = Path(folder) / "seen.mat"
        write_log(log, path)
        return path.read_bytes()
