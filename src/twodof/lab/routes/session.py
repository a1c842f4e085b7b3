"""Routes of a client's session: drones, jobs, the web socket, and plots saved as files."""

import asyncio
from contextlib import suppress
from pathlib import Path as FilePath
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Query, Request, Response, WebSocket
from starlette.websockets import WebSocketDisconnect

from twodof import __version__
from twodof.errors import Rejected
from twodof.gcs.full_rate import BatchRows
from twodof.lab.access import CLIENT, WATCHERS_MAY, Role, lab_router, receive_file, takes
from twodof.lab.drones.lab_drone import LabDrone
from twodof.lab.lab import CurrentLab
from twodof.lab.log_work import mat_of_rows
from twodof.lab.routes.logs import made_file
from twodof.lab.telemetry_client import SocketRefused, TelemetryClient
from twodof.link.mavlink.messages import channel_mask

router = lab_router("/api/session", "session")


@router.get("")
async def session(lab: CurrentLab) -> dict[str, Any]:
    """Return this client's role, the server's version, and the path of the link for watching only.

    `watch_link` is empty for a client that only watches, and on a server without such a link.
    """
    role = CLIENT.get().role
    token = lab.settings.watch_token if role is Role.COMMAND else ""
    return {
        "role": role,
        "version": __version__,
        "watch_link": f"/?token={token}" if token else "",
        "clients": len(lab.audience),
    }


drones_router = lab_router("/api/drones", "drones")
Number = Annotated[int, Path(ge=1, le=255, description="MAVLink system of the drone: 1 for the first virtual one.")]


async def named_drone(lab: CurrentLab, number: Number) -> LabDrone:
    """Return the drone that a path names. Raises NotThere."""
    return lab.drones[number]


NamedDrone = Annotated[LabDrone, Depends(named_drone)]


@drones_router.get("")
async def drones(lab: CurrentLab) -> list[dict[str, Any]]:
    """List the drones that were heard, as in the event `drone` of the web socket; angles in rad, times in s."""
    return lab.drones.states


@drones_router.get("/{number}")
async def drone(one: NamedDrone) -> dict[str, Any]:
    """Return the state of one drone. 404 for an unknown number."""
    return one.state


@drones_router.get("/{number}/texts")
async def texts(one: NamedDrone) -> list[dict[str, Any]]:
    """List the last 200 lines of text of a drone, the oldest first; `time` is the drone's [s]."""
    return [*one.texts]


@drones_router.get("/{number}/telemetry")
async def rows(
    one: NamedDrone,
    column: Annotated[list[str], Query(min_length=1, max_length=40, description="Column of a log, as estimate.q.")],
    seconds: Annotated[float, Query(ge=0.02, le=2.0, description="Length of time from now on [s].")] = 0.1,
) -> dict[str, Any]:
    """Return the samples of the next `seconds` at the full rate: `time` of the drone [s], and each column by name.

    A column has null where it has no new sample. This is for programs without a web socket. 409 for a drone in
    lockstep, whose time is not this computer's.
    """
    if one.drone.session.lockstep:
        where = f"drone {one.drone.session.system}"
        raise Rejected("its time passes in lockstep", where, "start it without --lockstep")
    async with one.drone.batches.rows(BatchRows(tuple(column)), channel_mask(column)) as taken:
        await asyncio.sleep(seconds)
    values = dict(zip(taken.columns, taken.values.T.tolist(), strict=True))
    return {"time": taken.time.tolist(), **values}


jobs_router = lab_router("/api/jobs", "jobs")
JobId = Annotated[str, Path(max_length=40, description="Id from the answer of the route that started the job.")]


@jobs_router.get("")
async def jobs(lab: CurrentLab) -> list[dict[str, Any]]:
    """List running and recently ended jobs, the oldest first, without their results."""
    return [job.to_json(with_result=False) for job in lab.jobs.all]


@jobs_router.get("/{job}")
async def job(lab: CurrentLab, job: JobId) -> dict[str, Any]:
    """Return one job: state, fraction 0 to 1, text, and at its end its result or its error."""
    return lab.jobs[job].to_json()


@jobs_router.delete("/{job}")
async def cancel(lab: CurrentLab, job: JobId) -> dict[str, Any]:
    """End a job and its process; a job that has ended stays as it is."""
    return (await lab.jobs.cancel(job)).to_json()


export_router = lab_router("/api/export", "export")
MOST = 64 << 20
"""Largest body [bytes]: a quarter of an hour of fifteen columns."""
_BINARY = {"requestBody": {"content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}}}
Columns = Annotated[str, Query(max_length=1200, description="Names of the columns, separated by commas.")]


@export_router.post("/mat", openapi_extra=_BINARY, response_class=Response, dependencies=[WATCHERS_MAY, takes(MOST)])
async def mat(lab: CurrentLab, request: Request, columns: Columns) -> Response:
    """Return the rows of a plot as a .mat file with the channels of the drone's own logs.

    The body is float64[n] times [s], then float32[n] of each column, little-endian. 422 for any other body.
    """
    role, address = CLIENT.get()
    with lab.logs.scratch() as folder:
        async with lab.exports[role].turn(address):
            path = FilePath(folder) / "rows"
            await receive_file(request, path)
            return await made_file(lab, "plot.mat", mat_of_rows, str(path), columns.split(","))


telemetry_router = APIRouter(tags=["telemetry"])


@telemetry_router.websocket("/api/telemetry")
async def telemetry(websocket: WebSocket, lab: CurrentLab) -> None:
    """Serve telemetry and events, see docs/reference/lab-routes.md."""
    await websocket.accept()
    try:
        async with TelemetryClient(websocket, CLIENT.get(), lab) as served:
            await served.serve()
    except SocketRefused as reason:
        with suppress(RuntimeError, WebSocketDisconnect):
            await websocket.close(reason.code, str(reason)[:120])
    except (WebSocketDisconnect, TimeoutError):
        pass
