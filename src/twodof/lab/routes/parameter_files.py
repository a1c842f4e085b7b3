"""Parameter files: what QGroundControl saves and loads, and snapshots: sets of parameters kept by name."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any

from fastapi import APIRouter, Path, Request, Response
from pydantic import Field

from twodof import __version__
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.parameter_file import MAX_BYTES, ParameterFile, Snapshots
from twodof.gcs.parameters import ParameterEntry
from twodof.lab.access import computes, takes
from twodof.lab.current_lab import CurrentLab
from twodof.lab.refusals import NotThere
from twodof.lab.request_body import RequestBody
from twodof.lab.routes.drones import Number

router = APIRouter(prefix="/api/drones/{number}/parameters", tags=["parameters"])
SnapshotName = Annotated[str, Path(min_length=1, max_length=60, description="What the snapshot is called.")]
TEXT = "text/plain; charset=utf-8"


class AskedSnapshot(RequestBody):
    """What a snapshot is to be called."""

    name: Annotated[str, Field(min_length=1, max_length=60)]
    note: Annotated[str, Field(max_length=200)] = ""
    overwrite: bool = False


@router.get("/file", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
async def file(lab: CurrentLab, number: Number) -> Response:
    """All parameters as a file that QGroundControl loads (Vehicle Configuration, Parameters, Tools)."""
    text = (await _now(lab.drones[number].drone)).text()
    headers = {"content-disposition": f'attachment; filename="drone-{number}.params"'}
    return Response(text, media_type=TEXT, headers=headers)


@router.post("/file")
@computes
@takes(MAX_BYTES)
async def compared(lab: CurrentLab, number: Number, request: Request) -> dict[str, Any]:
    """What a file of QGroundControl, the request's body, would change; nothing is changed yet."""
    drone = lab.drones[number].drone
    return await _against(drone, ParameterFile.read(await request.body(), "the file"))


@router.get("/snapshots")
async def snapshots(lab: CurrentLab, number: Number) -> list[dict[str, Any]]:
    """The snapshots that are kept, of all drones, the newest first; `kept` is in s of Unix time."""
    lab.drones[number]
    kept = _kept(lab)
    return sorted(({"name": name, "kept": kept.kept(name)} for name in kept), key=lambda row: -float(row["kept"]))


@router.post("/snapshots", status_code=201)
async def keep(lab: CurrentLab, number: Number, asked: AskedSnapshot) -> dict[str, Any]:
    """Keep all parameters of the drone, as they are now, under a name."""
    kept = _kept(lab)
    kept.save(asked.name, await _now(lab.drones[number].drone, asked.note), asked.overwrite)
    return {"name": asked.name, "kept": kept.kept(asked.name)}


@router.get("/snapshots/{name}")
async def snapshot(lab: CurrentLab, number: Number, name: SnapshotName, other: str = "") -> dict[str, Any]:
    """What a snapshot would change on the drone; with `other` what differs from that snapshot."""
    kept = _of(lab, name)
    if other:
        theirs = _of(lab, other[:60]).values
        names = sorted({*kept.values, *theirs})
        rows = [{"name": n, "before": theirs.get(n), "value": kept.values.get(n)} for n in names]
        return {"changes": [row for row in rows if row["before"] != row["value"]], "missing": [], "about": kept.about}
    return await _against(lab.drones[number].drone, kept)


@router.get("/snapshots/{name}/file", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
async def snapshot_file(lab: CurrentLab, number: Number, name: SnapshotName) -> Response:
    """A snapshot as a file that QGroundControl loads."""
    lab.drones[number]
    headers = {"content-disposition": f'attachment; filename="{name}.params"'}
    return Response(_of(lab, name).text(), media_type=TEXT, headers=headers)


@router.delete("/snapshots/{name}", status_code=204)
async def delete(lab: CurrentLab, number: Number, name: SnapshotName) -> Response:
    """Delete a snapshot."""
    lab.drones[number]
    _of(lab, name)
    _kept(lab).delete(name)
    return Response(status_code=204)


def _kept(lab: CurrentLab) -> Snapshots:
    return Snapshots(lab.settings.folder / "snapshots")


def _of(lab: CurrentLab, name: str) -> ParameterFile:
    try:
        return _kept(lab)[name]
    except KeyError:
        raise NotThere("there is no such snapshot", f"snapshot {name[:60]}", "take one that the list shows") from None


async def _now(drone: AsyncDrone, note: str = "") -> ParameterFile:
    about = {
        "Stack": "twodof" if drone.ours else drone.state.autopilot,
        "Vehicle": drone.state.rig.name or f"drone {drone.session.system}",
        "Version": __version__,
        "Kept": datetime.now().astimezone().isoformat(timespec="seconds"),
        **({"Note": note} if note else {}),
    }
    return ParameterFile.of((await drone.parameters.all()).values(), drone.session.system, about=about)


async def _against(drone: AsyncDrone, found: ParameterFile) -> dict[str, Any]:
    known = await drone.parameters.all()
    changes, missing = found.against(known)
    rows = [
        {"name": name, "before": known[name].value, "value": value, "unit": _unit(known[name])}
        for name, value in changes.items()
    ]
    return {"changes": rows, "missing": list(missing), "about": dict(found.about)}


def _unit(entry: ParameterEntry) -> str:
    return "" if entry.row is None else entry.row.unit
