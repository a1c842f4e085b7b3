"""Parameters of a drone: listed with unit, bounds, default and help, changed together, undone."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Body, Query
from pydantic import Field

from twodof.gcs.parameters import BY_NAME, INT32, ParameterEntry, SentChange, same_as
from twodof.lab.current_lab import CurrentLab
from twodof.lab.request_body import Finite
from twodof.lab.routes.drones import Number

router = APIRouter(prefix="/api/drones/{number}/parameters", tags=["parameters"])
Changes = Annotated[
    dict[Annotated[str, Field(max_length=200)], Finite],
    Body(min_length=1, max_length=200, description="New values by name, in the unit of each."),
]

Confirmed = Annotated[str, Query(max_length=64, description="The token of POST /api/tuning/{number}/preview.")]


@router.get("")
async def parameters(lab: CurrentLab, number: Number) -> list[dict[str, Any]]:
    """Every parameter: value, default, bounds, unit, text; `tuning` says that to change it needs no lease.

    `same_as` is our name of a number that this is only the real drone's name of, else "".
    """
    return [_row(entry) for entry in await lab.drones[number].connection.parameters.entries()]


@router.patch("")
async def change(lab: CurrentLab, number: Number, changes: Changes, confirm: Confirmed = "") -> dict[str, Any]:
    """Change several at once, all or none; answers what each was before and is now.

    422 for a name or value that cannot be, 409 with the drone's reason; then nothing was changed. It is 409 too for
    gains that the drone's model does not keep stable, until `confirm` has the token of their preview.
    """
    one = lab.drones[number]
    await lab.guard.check(one, changes, confirm)
    return _changed(await one.connection.drone.parameters.update(changes))


@router.post("/undo")
async def undo(lab: CurrentLab, number: Number, confirm: Confirmed = "") -> dict[str, Any]:
    """Take back the last change that this server made; answers as that did. The drone's model guards it like a change.

    409 where there is none, and where somebody has changed the same since. 409 also for gains that the model does not
    keep stable, until `confirm` has the token of their preview.
    """
    one = lab.drones[number]
    parameters = one.connection.drone.parameters
    await lab.guard.check(one, parameters.last.before, confirm)
    return _changed(await parameters.undo())


def _changed(made: SentChange) -> dict[str, Any]:
    rows = [{"name": name, "before": made.before[name], "value": value} for name, value in made.after.items()]
    return {"changed": rows}


def _row(entry: ParameterEntry) -> dict[str, Any]:
    row = entry.row
    told = {"name": entry.name, "value": entry.value, "kind": "int32" if entry.kind == INT32 else "float"}
    told["same_as"] = same_as(entry.name)
    if row is None:
        return {**told, "default": None, "low": None, "high": None, "unit": "", "text": "", "path": "", "tuning": False}
    tuning = row.tuning or (entry.name in BY_NAME and BY_NAME[entry.name].tuning)
    described = {"default": row.default, "low": row.low, "high": row.high, "unit": row.unit, "text": row.text}
    return {**told, **described, "path": row.path, "tuning": tuning}
