"""Tuning: which model guards a drone's gains, and what changed gains would do on it before they are sent."""

from __future__ import annotations

import math
from typing import Annotated, Any

from fastapi import APIRouter, Body
from pydantic import Field

from twodof.errors import DiagramError, LogError, Rejected, Timeout
from twodof.lab.access import computes
from twodof.lab.current_lab import CurrentLab
from twodof.lab.models.measured_steps import measured_steps
from twodof.lab.refusals import NotThere
from twodof.lab.request_body import Finite, RequestBody
from twodof.lab.routes.drones import Number

router = APIRouter(prefix="/api/tuning", tags=["tuning"])
READING_S = 30.0
"""What reading a log may take."""
ModelName = Annotated[str, Field(min_length=1, max_length=60)]

StepSize = Annotated[Finite, Field(ge=0.001, le=0.8)]
USUAL_STEP = math.radians(10.0)


class AskedModel(RequestBody):
    """A model by its name; null for none."""

    model: ModelName | None


class AskedChanges(RequestBody):
    """Changed parameters by name, and the step of theta [rad] to be shown. `model` left out: the one that guards."""

    changes: dict[Annotated[str, Field(max_length=200)], Finite] = Field(default_factory=dict, max_length=200)
    goal: StepSize = USUAL_STEP
    model: ModelName | None = None


@router.get("/{number}")
async def guarded(lab: CurrentLab, number: Number) -> dict[str, Any]:
    """The model that guards the drone's gains, null for none, and whose law of the pitch flies ("": the stock one)."""
    return {"model": lab.models.chosen(number), "controller": lab.drones[number].state["controller"]}


@router.put("/{number}/model")
async def choose(lab: CurrentLab, number: Number, asked: AskedModel) -> dict[str, Any]:
    """Let a model guard the drone's gains: what its uncertainty does not keep stable then needs confirming."""
    lab.drones[number]
    lab.models.choose(number, asked.model)
    return await guarded(lab, number)


@router.post("/{number}/preview")
@computes
async def preview(lab: CurrentLab, number: Number, asked: AskedChanges) -> dict[str, Any]:
    """Margins, the band of step responses, figures and the verdict of the law as it would be with `changes`.

    `touches` tells whether they change the law of the pitch at all, `parameters` what does. `confirm` is the token
    that a change takes which is not kept stable. `why` says why there is nothing of that, "" where there is: the law
    that flies may have no linear model.
    """
    name = asked.model or lab.models.chosen(number)
    if name is None:
        raise NotThere("no model guards this drone", f"drone {number}", "identify one, or choose one")
    try:
        told = await lab.guard.judge(lab.drones[number], asked.changes, name, asked.goal)
    except DiagramError as reason:
        return {"why": f"{reason.what}: {reason.remedy}" if reason.remedy else reason.what, "model": name}
    return {
        "why": "",
        **told["preview"],
        "model": name,
        **{key: told[key] for key in ("controller", "touches", "parameters", "unstable")},
        "confirm": lab.guard.token(name, told),
    }


@router.post("/{number}/measured")
@computes
async def measured(
    lab: CurrentLab,
    number: Number,
    log: Annotated[str, Body(min_length=1, max_length=200)],
    goal: Annotated[StepSize, Body()] = USUAL_STEP,
) -> dict[str, Any]:
    """The steps of theta in a log, each scaled to `goal` [rad] and begun at 0.

    `unclear` says why there are none in a log that tells no modes, cannot be read, or was deleted meanwhile.
    """
    lab.drones[number]
    try:
        found = await lab.log_bench.do(measured_steps, str(lab.whole_log(log)), goal, seconds=READING_S)
    except (LogError, NotThere, Rejected, Timeout) as reason:
        found = {"steps": [], "unclear": reason.what}
    return {"log": log, **found}
