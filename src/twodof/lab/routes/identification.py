"""Routes of identification: experiments, flights, fits, kept models, and controllers designed for them."""

import asyncio
import math
import multiprocessing
from contextlib import ExitStack
from typing import Annotated, Any, Literal

from fastapi import Path, Response
from pydantic import Field

from twodof.errors import ParameterError, Rejected, listed, shown
from twodof.identify.experiments import KINDS
from twodof.identify.ready_made import AUTO, STRUCTURES
from twodof.lab.access import WATCHERS_MAY, lab_router, takes
from twodof.lab.answers import Finite, RequestBody
from twodof.lab.drones.lab_drone import LabDrone
from twodof.lab.flights import ExperimentRequest, check, design, fly_experiment, identify, offered, plan
from twodof.lab.folders import FileName, LogName
from twodof.lab.lab import CurrentLab
from twodof.lab.models import MAX_BYTES
from twodof.lab.processes import Job

router = lab_router("/api/identification", "identification")
Second = Annotated[Finite, Field(ge=0.0, le=1e6)]
Prior = Annotated[dict[str, Annotated[tuple[float, float], Field(strict=False)]], Field(max_length=20)]
DroneNumber = Annotated[int, Field(ge=1, le=255)]


class PlanRequest(RequestBody):
    """Experiment, and the drone for which it is planned; `rehearse` adds a simulated flight with noise, and its fit."""

    experiment: ExperimentRequest
    drone: DroneNumber | None = None
    model: FileName | None = None
    rehearse: bool = False


class FlightRequest(RequestBody):
    """Experiment, and the drone that flies it; `seed` is that of a virtual rig's noise."""

    experiment: ExperimentRequest
    drone: DroneNumber
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 1


class FitRequest(RequestBody):
    """Log to identify from, by its name among the flights.

    `kind` is the kind of experiment; left out, it comes from the log. `impulse` is a free response, from which a
    doublet's poles come; `others` validate. `window` [s] is a stretch of the log, `prior` has means and deviations.
    """

    log: LogName
    kind: Annotated[str, Field(max_length=40)] | None = None
    structure: Annotated[str, Field(max_length=40)] = AUTO
    impulse: LogName | None = None
    others: Annotated[list[LogName], Field(max_length=8)] = Field(default_factory=list)
    window: Annotated[tuple[Second, Second], Field(strict=False)] | None = None  # JSON has no tuples
    disturbance: Literal["auto", "white", "ar", "input"] = "auto"
    prior: Prior = Field(default_factory=dict)


@router.get("")
async def choices(lab: CurrentLab) -> dict[str, Any]:
    """List the experiments, the kinds of excitation, the structures, and the readable logs, the newest first."""
    written = lab.drones.recordings
    rows = await lab.log_bench.do(lab.logs.listed)
    logs = [row["name"] for row in rows if row["name"] not in written]
    return {**offered(), "structures": [AUTO, *STRUCTURES], "flights": logs}


@router.post("/plan", status_code=202, dependencies=[WATCHERS_MAY])
async def planned(lab: CurrentLab, asked: PlanRequest) -> dict[str, Any]:
    """Start a job that predicts accuracy and motion of an experiment. Nothing is flown."""
    rig = "" if asked.drone is None else str(lab.drones[asked.drone].state["rig"])
    values = {} if asked.model is None else lab.models.values(asked.model)
    await lab.log_bench.do(check, asked.experiment)
    return lab.jobs.start("plan", plan, asked.experiment, rig, values, asked.rehearse).to_json()


@router.post("/fly", status_code=202)
async def flown(lab: CurrentLab, asked: FlightRequest) -> dict[str, Any]:
    """Start a job that flies an experiment, as `twodof fly` does: arm, hold, excite on board, disarm.

    The server gives its lease up for it and records nothing itself: the job writes the log. A virtual drone is reset
    before and after, then with its rings as they were. 409 while the drone is armed.
    """
    one = lab.drones[asked.drone]
    made = await asyncio.to_thread(asked.experiment.experiment)
    if one.drone.state.armed:
        raise Rejected("the drone is armed", f"drone {asked.drone}", "disarm it first")
    await one.connection.pilot.give_up()
    stop = multiprocessing.get_context("forkserver").Event()
    key = None if lab.settings.key is None else str(lab.settings.key)
    given = (stop, one.url, asked.drone, key, made, asked.seed, str(lab.logs.folder))
    lent = ExitStack()
    lent.enter_context(one.lend())
    job = lab.jobs.start("flight", fly_experiment, *given, live=True)
    job.stop = stop
    job.task.add_done_callback(lambda _: _flown(one, lent, job))
    return job.to_json()


@router.post("/fly/{job}/stop")
async def stopped(lab: CurrentLab, job: Annotated[str, Path(max_length=40)]) -> dict[str, Any]:
    """End a flight: the drone disarms at once, and the log is kept."""
    found = lab.jobs[job]
    if found.stop is not None:
        found.stop.set()
    return found.to_json()


@router.post("/fit", status_code=202, dependencies=[WATCHERS_MAY])
async def fitted(lab: CurrentLab, asked: FitRequest) -> dict[str, Any]:
    """Start a job that identifies from a log by output error and by hand; its result has `view` and `model`."""
    if asked.kind is not None and asked.kind not in KINDS:
        what = f"nothing is identified from {shown(asked.kind)}"
        raise ParameterError(what, "kind", f"choose one of {listed(KINDS)}")
    impulse = None if asked.impulse is None else str(lab.whole_log(asked.impulse))
    others = [str(lab.whole_log(name)) for name in asked.others]
    given = (asked.kind, asked.structure, impulse, others, asked.window, asked.disturbance, asked.prior)
    return lab.jobs.start("fit", identify, str(lab.whole_log(asked.log)), *given).to_json()


def _flown(one: LabDrone, lent: ExitStack, job: Job) -> None:
    """Take the drone back from the job, and send the log's name to all clients."""
    lent.close()
    if isinstance(job.result, dict):
        one.tell("log", name=job.result["log"])


models_router = lab_router("/api/models", "models")
ModelName = Annotated[FileName, Path(description="Name under which the model was kept.")]


class KeepRequest(RequestBody):
    """Job of a fit whose model is kept, and the model's name."""

    job: Annotated[str, Field(max_length=40)]
    name: FileName
    overwrite: bool = False


class ControllerRequest(RequestBody):
    """Design: the diagram's name, crossover [rad/s] and phase margin [rad] of the rate loop, method."""

    name: FileName
    crossover: Annotated[float, Field(ge=1.0, le=120.0)] = 20.0
    phase_margin: Annotated[float, Field(gt=0.0, lt=math.pi / 2)] | None = None
    method: Literal["cascade", "lqg"] = "cascade"
    overwrite: bool = False


@models_router.get("")
async def models(lab: CurrentLab) -> list[dict[str, Any]]:
    """List the kept models; `pitch` is True for tuning and design, else `why` has the reason."""
    return await lab.log_bench.do(lab.models.rows)


@models_router.get("/{name}")
async def model(lab: CurrentLab, name: ModelName) -> dict[str, Any]:
    """Return a model's document, as `twodof identify --out` writes it."""
    return lab.models.read(name)


@models_router.post("", status_code=201)
async def keep(lab: CurrentLab, asked: KeepRequest) -> dict[str, Any]:
    """Keep the model of a job of /api/identification/fit."""
    job = lab.jobs[asked.job]
    document = job.result.get("model") if isinstance(job.result, dict) else None
    if not isinstance(document, dict):
        raise Rejected("this job has found no model", f"job {asked.job}", "choose a fit that is done")
    return lab.models.keep(asked.name, document, asked.overwrite)


@models_router.put("/{name}", status_code=201, dependencies=[takes(MAX_BYTES)])
async def bring(lab: CurrentLab, name: ModelName, document: dict[str, Any]) -> dict[str, Any]:
    """Keep a model whose document `twodof identify --out` wrote. 409 for an existing name."""
    return lab.models.keep(name, document)


@models_router.delete("/{name}", status_code=204)
async def delete(lab: CurrentLab, name: ModelName) -> Response:
    """Delete a model."""
    lab.models.delete(name)
    return Response(status_code=204)


@models_router.post("/{name}/controller", status_code=202)
async def controller(lab: CurrentLab, name: ModelName, asked: ControllerRequest) -> dict[str, Any]:
    """Start a job that designs a controller for a model, and promises its flight, as `twodof design controller`.

    Its result has the diagram's `file` among the user's diagrams. A controller that does not keep the family stable is
    not written.
    """
    lab.models.family(name)  # refused at once if it is not of the pitch
    given = (str(lab.diagrams.place(asked.name)), asked.crossover, asked.phase_margin, asked.method, asked.overwrite)
    return lab.jobs.start("controller", design, lab.models.read(name), *given).to_json()
