"""Routes of parameters: changes and undo, files and snapshots, and previews on a model."""

import math
from contextlib import suppress
from datetime import datetime
from typing import Annotated, Any

from fastapi import Body, Path, Query, Request, Response
from pydantic import Field

from twodof import __version__
from twodof.errors import DiagramError, LogError, Rejected, Timeout
from twodof.gcs.parameter_file import MAX_BYTES, ParameterFile
from twodof.gcs.parameters import BY_NAME, INT32, ParameterEntry, SentChange, same_as
from twodof.lab.access import WATCHERS_MAY, lab_router, takes
from twodof.lab.answers import Finite, NotThere, RequestBody
from twodof.lab.drones.lab_drone import LabDrone
from twodof.lab.folders import FileName, LogName
from twodof.lab.lab import CurrentLab
from twodof.lab.models import judge, measured_steps, predicted_step
from twodof.lab.routes.session import NamedDrone

router = lab_router("/api/drones/{number}/parameters", "parameters")
Changes = Annotated[
    dict[Annotated[str, Field(max_length=200)], Finite],
    Body(min_length=1, max_length=200, description="New values by name, in the unit of each."),
]

Confirmed = Annotated[str, Query(max_length=64, description="The token of POST /api/tuning/{number}/preview.")]


@router.get("")
async def parameters(one: NamedDrone) -> list[dict[str, Any]]:
    """List every parameter: value, default, bounds, unit, text; `tuning` is True if a change needs no lease.

    `same_as` is twodof's name if this is the real drone's name of the same parameter, else "".
    """
    return [_row(entry) for entry in await one.connection.parameters.entries()]


@router.patch("")
async def change(lab: CurrentLab, one: NamedDrone, changes: Changes, confirm: Confirmed = "") -> dict[str, Any]:
    """Change several parameters at once, all or none; return each value before and now.

    422 for a wrong name or value, 409 with the drone's reason; then nothing was changed. 409 also for gains that the
    drone's model does not keep stable, until `confirm` has the token of their preview.
    """
    await lab.guard.check(one, changes, confirm)
    return _changed(await one.connection.drone.parameters.update(changes))


@router.post("/undo")
async def undo(lab: CurrentLab, one: NamedDrone, confirm: Confirmed = "") -> dict[str, Any]:
    """Undo the last change by this server; return each value before and now. The model guards this like a change.

    409 without a change to undo, or if another client has changed the same parameters since. 409 also for gains that
    the model does not keep stable, until `confirm` has their token.
    """
    parameters = one.connection.drone.parameters
    judged = parameters.last
    await lab.guard.check(one, judged.before, confirm)
    if parameters.last is not judged:
        raise Rejected("another change came before the undo", f"drone {one.number}", "look at it, then undo again")
    return _changed(await parameters.undo())


def _changed(made: SentChange) -> dict[str, Any]:
    rows = [{"name": name, "before": made.before[name], "value": value} for name, value in made.after.items()]
    return {"changed": rows}


def _row(entry: ParameterEntry) -> dict[str, Any]:
    tuning = any(row is not None and row.tuning for row in (entry.row, BY_NAME.get(entry.name)))
    kind = "int32" if entry.kind == INT32 else "float"
    return {**entry.to_json(), "kind": kind, "same_as": same_as(entry.name), "tuning": tuning}


files_router = lab_router("/api/drones/{number}/parameters", "parameters")
SnapshotName = Annotated[FileName, Path(description="Name of the snapshot.")]


class SnapshotRequest(RequestBody):
    """Name and note of a new snapshot."""

    name: FileName
    note: Annotated[str, Field(max_length=200)] = ""
    overwrite: bool = False


@files_router.get("/file", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
async def file(one: NamedDrone) -> Response:
    """Download all parameters as a file for QGroundControl (Vehicle Configuration, Parameters, Tools)."""
    return _download(await _now(one), f"drone-{one.number}")


@files_router.post("/file", dependencies=[WATCHERS_MAY, takes(MAX_BYTES)])
async def compared(one: NamedDrone, request: Request) -> dict[str, Any]:
    """Compare a file of QGroundControl, the request's body, with the drone; nothing is changed."""
    return await _against(one, ParameterFile.read(await request.body(), "the file"))


@files_router.get("/snapshots")
async def snapshots(lab: CurrentLab, one: NamedDrone) -> list[dict[str, Any]]:
    """List the snapshots of all drones, the newest first; `kept` is in s of Unix time."""
    return [{"name": row["name"], "kept": row["changed"]} for row in lab.snapshots.listed()]


@files_router.post("/snapshots", status_code=201)
async def keep(lab: CurrentLab, one: NamedDrone, asked: SnapshotRequest) -> dict[str, Any]:
    """Keep the drone's present parameters as a snapshot."""
    file = await _now(one, asked.note)
    lab.snapshots.save(asked.name, file.text(), asked.overwrite)
    return {"name": asked.name, "kept": lab.snapshots.there(asked.name).stat().st_mtime}


@files_router.get("/snapshots/{name}")
async def snapshot(lab: CurrentLab, one: NamedDrone, name: SnapshotName, other: str = "") -> dict[str, Any]:
    """Compare a snapshot with the drone, or with the snapshot `other`."""
    kept = _of(lab, name)
    if other:
        theirs = _of(lab, other).values
        names = sorted({*kept.values, *theirs})
        rows = [{"name": n, "before": theirs.get(n), "value": kept.values.get(n)} for n in names]
        return {"changes": [row for row in rows if row["before"] != row["value"]], "missing": [], "about": kept.about}
    return await _against(one, kept)


@files_router.get("/snapshots/{name}/file", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
async def snapshot_file(lab: CurrentLab, one: NamedDrone, name: SnapshotName) -> Response:
    """Download a snapshot as a file for QGroundControl."""
    return _download(_of(lab, name), name)


@files_router.delete("/snapshots/{name}", status_code=204)
async def delete(lab: CurrentLab, one: NamedDrone, name: SnapshotName) -> Response:
    """Delete a snapshot."""
    lab.snapshots.delete(name)
    return Response(status_code=204)


def _download(file: ParameterFile, name: str) -> Response:
    headers = {"content-disposition": f'attachment; filename="{name}.params"'}
    return Response(file.text(), media_type="text/plain; charset=utf-8", headers=headers)


def _of(lab: CurrentLab, name: str) -> ParameterFile:
    return ParameterFile.read(lab.snapshots.content(name), f"snapshot '{name}'")


async def _now(one: LabDrone, note: str = "") -> ParameterFile:
    drone = one.drone
    about = {
        "Stack": "twodof" if drone.ours else drone.state.autopilot,
        "Vehicle": drone.state.rig.name or f"drone {drone.session.system}",
        "Version": __version__,
        "Kept": datetime.now().astimezone().isoformat(timespec="seconds"),
        **({"Note": note} if note else {}),
    }
    return ParameterFile.of(await one.connection.parameters.entries(), drone.session.system, about=about)


async def _against(one: LabDrone, found: ParameterFile) -> dict[str, Any]:
    known = {entry.name: entry for entry in await one.connection.parameters.entries()}
    changes, missing = found.against(known)
    rows = [
        {"name": name, "before": known[name].value, "value": value, "unit": known[name].to_json()["unit"]}
        for name, value in changes.items()
    ]
    own = one.drone.session.system
    other = {"Vehicle-Id": f"{found.system}, while this drone is {own}"} if found.system not in (0, own) else {}
    return {"changes": rows, "missing": list(missing), "about": {**found.about, **other}}


tuning_router = lab_router("/api/tuning", "tuning")
StepSize = Annotated[Finite, Field(ge=0.001, le=0.8)]
USUAL_STEP = math.radians(10.0)


class ModelRequest(RequestBody):
    """Name of a model; null for none."""

    model: FileName | None


class ChangesRequest(RequestBody):
    """Changed parameters by name, the step of theta [rad] to show, and the `model`, by default the guarding one."""

    changes: dict[Annotated[str, Field(max_length=200)], Finite] = Field(default_factory=dict, max_length=200)
    goal: StepSize = USUAL_STEP
    model: FileName | None = None


@tuning_router.get("/{number}")
async def tuning_state(lab: CurrentLab, one: NamedDrone) -> dict[str, Any]:
    """Return the model that guards the drone's gains, or null, and the pitch controller ("" is the stock one).

    `undo` has the parameters of this server's last change, which POST undo would take back; none without a change.
    """
    rows: list[dict[str, Any]] = []
    with suppress(Rejected):
        rows = _changed(one.connection.drone.parameters.last)["changed"]
    return {"model": lab.models.chosen(one.number), "controller": one.state["controller"], "undo": rows}


@tuning_router.put("/{number}/model")
async def choose(lab: CurrentLab, one: NamedDrone, asked: ModelRequest) -> dict[str, Any]:
    """Choose the model that guards the drone's gains: gains that are unstable within its uncertainty need a token."""
    lab.models.choose(one.number, asked.model)
    return await tuning_state(lab, one)


@tuning_router.post("/{number}/preview", dependencies=[WATCHERS_MAY])
async def preview(lab: CurrentLab, one: NamedDrone, asked: ChangesRequest) -> dict[str, Any]:
    """Preview the pitch law with `changes`: margins, band of step responses, figures and verdict.

    `touches` is True if the changes affect the law; `parameters` are those that can. `confirm` is the token for an
    unstable change. `why` has the reason if the preview is missing, as for a law without a linear model, else "".
    """
    name = _model(lab, one, asked)
    try:
        told = await lab.guard.ask(judge, one, asked.changes, name, asked.goal)
    except DiagramError as reason:
        return {"why": f"{reason.what}: {reason.remedy}" if reason.remedy else reason.what, "model": name}
    return {
        "why": "",
        **told["preview"],
        "model": name,
        **{key: told[key] for key in ("controller", "touches", "parameters", "unstable")},
        "confirm": lab.guard.token(name, told),
    }


@tuning_router.post("/{number}/step", dependencies=[WATCHERS_MAY])
async def step(lab: CurrentLab, one: NamedDrone, asked: ChangesRequest) -> dict[str, Any]:
    """Predict the band of a step with `changes`, without margins and verdict: fast enough to follow a slider.

    `why` has the reason if the band is missing, as for a law without a linear model, else "".
    """
    try:
        model = _model(lab, one, asked)
        return {"why": "", **await lab.guard.ask(predicted_step, one, asked.changes, model, asked.goal)}
    except DiagramError as reason:
        return {"why": reason.what}


def _model(lab: CurrentLab, one: NamedDrone, asked: ChangesRequest) -> str:
    """Return the name of the model asked for, or of the one that guards the drone. Raise NotThere without one."""
    name = asked.model or lab.models.chosen(one.number)
    if name is None:
        raise NotThere("no model guards this drone", f"drone {one.number}", "choose a model, or identify one")
    return name


@tuning_router.post("/{number}/measured", dependencies=[WATCHERS_MAY])
async def measured(
    lab: CurrentLab, one: NamedDrone, log: Annotated[LogName, Body()], goal: Annotated[StepSize, Body()] = USUAL_STEP
) -> dict[str, Any]:
    """Return the steps of theta in a log, each shifted and scaled to go from 0 to `goal` [rad].

    `unclear` has the reason if there are none: the log has no modes, cannot be read, or was deleted.
    """
    try:
        found = await lab.log_bench.do(measured_steps, str(lab.whole_log(log)), goal)
    except (LogError, NotThere, Rejected, Timeout) as reason:
        found = {"steps": [], "unclear": reason.what}
    return {"log": log, **found}
