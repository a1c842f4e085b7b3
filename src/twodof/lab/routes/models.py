"""Models: what was identified and kept, and the controllers that are designed for them."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Response
from pydantic import Field

from twodof.errors import Rejected
from twodof.lab.access import takes
from twodof.lab.current_lab import CurrentLab
from twodof.lab.flights.designing import design
from twodof.lab.models.model_folder import MAX_BYTES
from twodof.lab.request_body import RequestBody

router = APIRouter(prefix="/api/models", tags=["models"])
ModelName = Annotated[str, Path(min_length=1, max_length=60, description="What the model was called when it was kept.")]
Name = Annotated[str, Field(min_length=1, max_length=60)]


class AskedKeeping(RequestBody):
    """The job of a fit whose model is kept, and what it is to be called."""

    job: Annotated[str, Field(max_length=40)]
    name: Name
    overwrite: bool = False


class AskedController(RequestBody):
    """What is designed: crossover of the rate loop [rad/s], its phase margin [rad], the method; the diagram's name."""

    name: Name
    crossover: Annotated[float, Field(ge=1.0, le=120.0, allow_inf_nan=False)] = 20.0
    phase_margin: Annotated[float, Field(gt=0.0, lt=math.pi / 2, allow_inf_nan=False)] | None = None
    method: Literal["cascade", "lqg"] = "cascade"
    overwrite: bool = False


@router.get("")
async def models(lab: CurrentLab) -> list[dict[str, Any]]:
    """The models that are kept; `pitch` tells whether tuning and design can use one, else `why` not."""
    return [lab.models.row(name) for name in lab.models.names()]


@router.get("/{name}")
async def model(lab: CurrentLab, name: ModelName) -> dict[str, Any]:
    """A model's document, as `twodof identify --out` writes it."""
    return lab.models.read(name)


@router.post("", status_code=201)
async def keep(lab: CurrentLab, asked: AskedKeeping) -> dict[str, Any]:
    """Keep the model that a job of /api/identification/fit has found."""
    job = lab.jobs[asked.job]
    document = job.result.get("model") if isinstance(job.result, dict) else None
    if not isinstance(document, dict):
        raise Rejected("this job has found no model", f"job {asked.job}", "keep that of a fit that is done")
    lab.models.save(asked.name, document, asked.overwrite)
    return lab.models.row(asked.name)


@router.put("/{name}", status_code=201)
@takes(MAX_BYTES)
async def bring(lab: CurrentLab, name: ModelName, document: dict[str, Any]) -> dict[str, Any]:
    """Keep a model's document from elsewhere: what `twodof identify --out` wrote. 409 where the name is taken."""
    lab.models.save(name, document)
    return lab.models.row(name)


@router.delete("/{name}", status_code=204)
async def delete(lab: CurrentLab, name: ModelName) -> Response:
    """Delete a model."""
    lab.models.delete(name)
    return Response(status_code=204)


@router.post("/{name}/controller", status_code=202)
async def controller(lab: CurrentLab, name: ModelName, asked: AskedController) -> dict[str, Any]:
    """Design a controller for a model, and promise its flight, as `twodof design controller`; answers the job.

    Its result has the diagram's `file` among the user's diagrams. What does not keep the family stable is not written.
    """
    family = lab.models.family(name)
    place = lab.settings.folder / "diagrams"
    given = (asked.name, asked.crossover, asked.phase_margin, asked.method, asked.overwrite)
    return lab.jobs.start("controller", design, family.to_json(), str(place), *given).told()
