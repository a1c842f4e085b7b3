"""Routes of diagrams, which are read, checked, compiled, kept, rehearsed and flashed. They never run in the server."""

import hashlib
from collections.abc import Callable
from functools import partial
from pathlib import Path as FilePath
from typing import Annotated, Any, Literal

from fastapi import Path, Query, Request
from pydantic import Field

from twodof.blocks.schema.json_form import MAX_BYTES, to_json
from twodof.errors import DiagramError, Rejected
from twodof.fleet.flash import FLYING
from twodof.flight.starters import STARTERS, starter
from twodof.gcs.async_drone import BUILDS
from twodof.lab import diagram_work
from twodof.lab.access import RAW, WATCHERS_MAY, lab_router, receive_file, takes
from twodof.lab.answers import NotThere, RequestBody
from twodof.lab.folders import FileName
from twodof.lab.lab import WARM_UP_S, CurrentLab, LabServer
from twodof.lab.processes import Answer, Told

router = lab_router("/api/diagrams", "diagrams")
COMPILE_S = 30.0
MOST_TEXT = MAX_BYTES + (1 << 20)  # a text in JSON has its quotes escaped
Name = Annotated[FileName, Path(description="Name of a file in the folder of diagrams, without its ending.")]


class DiagramRequest(RequestBody):
    """JSON of a diagram as a text, so that numbers keep their form."""

    text: str = Field(max_length=MAX_BYTES)


class CodeRequest(DiagramRequest):
    """Diagram, and the type of a real."""

    precision: Literal["float32", "float64"] = "float32"


class LoopRequest(DiagramRequest):
    """Diagram, and the virtual rig that it is to fly."""

    rig: Literal["lab", "paper"] = "lab"


class BlocksRequest(RequestBody):
    """Blocks of the library, each {"type": ..., "config": {...}}."""

    blocks: list[dict[str, Any]] = Field(max_length=2000, fail_fast=True)


@router.get("/catalogue")
async def blocks(lab: CurrentLab) -> dict[str, Any]:
    """List the library's blocks with ports, parameters, units and text, the starter diagrams, and the templates."""
    return await lab.workbench.do(diagram_work.catalogue, seconds=WARM_UP_S)


@router.get("/starters/{name}")
async def starter_text(name: Name) -> dict[str, str]:
    """Return a starter diagram. 404 for an unknown name."""
    if name not in STARTERS:
        raise NotThere("there is no such starter diagram", name, f"there are: {', '.join(STARTERS)}")
    return {"text": to_json(starter(name))}


@router.post("/shapes", dependencies=[WATCHERS_MAY, takes(1 << 20)])
async def shapes(lab: CurrentLab, request: Request, asked: BlocksRequest) -> list[dict[str, Any]]:
    """Return each block's ports, parameters and structure; for a wrong block what, where and remedy of the error."""
    return await _work(lab, request, diagram_work.shapes, asked.blocks)


@router.post("/read", dependencies=[WATCHERS_MAY, takes(MOST_TEXT)])
async def read(lab: CurrentLab, request: Request, asked: DiagramRequest) -> dict[str, str]:
    """Return the diagram in the form of its file. 422 with the place of a mistake."""
    return await _work(lab, request, diagram_work.canonical, asked.text)


@router.post("/check", dependencies=[WATCHERS_MAY, takes(MOST_TEXT)])
async def check(lab: CurrentLab, request: Request, asked: DiagramRequest) -> dict[str, Any]:
    """Check the diagram: problems and remarks by the path of the block, an algebraic loop with its signals."""
    return await _work(lab, request, diagram_work.check, asked.text)


@router.post("/code", dependencies=[WATCHERS_MAY, takes(MOST_TEXT)])
async def code(lab: CurrentLab, request: Request, asked: CodeRequest) -> dict[str, Any]:
    """Return the diagram's C at 250 Hz; each line as [text, path of its block or "", function]."""
    return await _work(lab, request, diagram_work.code, asked.text, asked.precision)


@router.post("/compile", dependencies=[WATCHERS_MAY, takes(MOST_TEXT)])
async def compile_loop(lab: CurrentLab, request: Request, asked: LoopRequest) -> dict[str, Any]:
    """Compile the closed loop with the virtual rig to WebAssembly (base 64), with its interface and its start.

    The work ends if the client goes away.
    """
    return await _work(lab, request, diagram_work.compiled, asked.text, asked.rig, seconds=COMPILE_S)


MOST_MODEL, MOST_FILES = 16 << 20, 12
_ModelFile = Annotated[str, Field(pattern=r"^\w[\w .()+-]{0,59}\.(?i:slx|mdl|m|mat)$")]
_FileSize = Annotated[int, Field(ge=0, le=MOST_MODEL)]


@router.post("/simulink", openapi_extra=RAW, dependencies=[WATCHERS_MAY, takes(MOST_MODEL)])
async def simulink(
    lab: CurrentLab,
    request: Request,
    name: Annotated[
        list[_ModelFile], Query(max_length=MOST_FILES, description="The model, its libraries and workspaces.")
    ],
    size: Annotated[list[_FileSize], Query(max_length=MOST_FILES, description="Bytes of each file.")],
    system: Annotated[str, Query(max_length=400, description="Path of a subsystem; left out: the model.")] = "",
) -> dict[str, Any]:
    """Draw a system of a Simulink model, list the model's systems, and translate the system; nothing is kept.

    The body is the files, one after the other. `text` is the diagram, "" if the `report` has blocks that are refused.
    """
    if len({*name}) < len(name) or len(name) != len(size):
        raise DiagramError("each file needs a name of its own and a size", "name, size", "give one of each for a file")
    with lab.logs.scratch() as folder:
        await receive_file(request, FilePath(folder) / "files")
        return await _work(lab, request, diagram_work.simulink, folder, name, size, system, seconds=COMPILE_S)


async def _work(
    lab: LabServer, request: Request, work: Callable[..., Answer], *arguments: Any, seconds: float | None = None
) -> Answer:
    return await lab.workbench.do(work, *arguments, seconds=seconds, gone=request.is_disconnected)


@router.get("/files")
async def files(lab: CurrentLab) -> list[dict[str, Any]]:
    """List the kept diagrams, the latest first: name, bytes, time of the change [s, unix]."""
    return lab.diagrams.listed()


@router.get("/files/{name}")
async def file(lab: CurrentLab, name: Name) -> dict[str, str]:
    """Return a kept diagram."""
    return {"text": lab.diagrams.content(name).decode("utf-8", "replace")}


@router.put("/files/{name}", dependencies=[takes(MOST_TEXT)])
async def save(lab: CurrentLab, request: Request, name: Name, asked: DiagramRequest) -> dict[str, str]:
    """Keep a diagram under a name, instead of an older one; return the text in the file."""
    kept = await _work(lab, request, diagram_work.canonical, asked.text)
    lab.diagrams.save(name, kept["text"], overwrite=True)
    return kept


@router.delete("/files/{name}")
async def delete(lab: CurrentLab, name: Name) -> dict[str, Any]:
    """Remove a diagram; return its text, which `PUT` restores."""
    kept = await file(lab, name)
    lab.diagrams.delete(name)
    return kept


jobs_router = lab_router("/api/diagrams", "diagrams")
FLASH_S = 120.0


class RehearsalRequest(DiagramRequest):
    """Diagram, and the number of the drone whose active controller it is compared with."""

    drone: int = Field(ge=1, le=255)


class FlashRequest(RehearsalRequest):
    """Diagram, drone, and the job of their rehearsal; `force` flies a diagram that the rehearsal found unstable."""

    rehearsal: str = Field(max_length=40)
    force: bool = False


@jobs_router.post("/margins", status_code=202, dependencies=[WATCHERS_MAY, takes(MOST_TEXT)])
async def margins(lab: CurrentLab, asked: LoopRequest) -> dict[str, Any]:
    """Start a job for the margins and Bode plots of the loops that a diagram closes."""
    return lab.jobs.start("margins", diagram_work.margins, asked.text, asked.rig, quick=True).to_json()


@jobs_router.post("/px4", status_code=202, dependencies=[WATCHERS_MAY, takes(MOST_TEXT)])
async def px4(lab: CurrentLab, asked: DiagramRequest) -> dict[str, Any]:
    """Start a job that exports a module for PX4; its result has the folder as a zip file in base 64."""
    return lab.jobs.start("px4", diagram_work.px4_module, asked.text).to_json()


@jobs_router.post("/rehearsal", status_code=202, dependencies=[takes(MOST_TEXT)])
async def rehearsal(lab: CurrentLab, asked: RehearsalRequest) -> dict[str, Any]:
    """Start a job that does every step of flashing but the last. Nothing is changed on the drone."""
    template = await lab.workbench.do(diagram_work.template, asked.text, seconds=COMPILE_S)
    before, origin = await _flies(lab, asked.drone, template)
    job = lab.jobs.start("rehearsal", diagram_work.rehearsal, asked.text, before, origin, quick=True)
    job.about = _mark(asked.drone, asked.text)
    return job.to_json()


@jobs_router.post("/flash", status_code=202, dependencies=[takes(MOST_TEXT)])
async def flash(lab: CurrentLab, asked: FlashRequest) -> dict[str, Any]:
    """Start a job that flashes a rehearsed diagram. It takes up to two minutes: the drone builds it.

    The job can be ended while the diagram is sent, then the controller before flies on; while the drone builds it the
    job is `bound`. 409 for a diagram that was not rehearsed for this drone, for an unstable one without `force`, while
    the drone is armed, and while another diagram is flashed there.
    """
    where = f"drone {asked.drone}"
    job = lab.jobs[asked.rehearsal]
    if job.about != _mark(asked.drone, asked.text) or job.state != "done":
        raise Rejected("this diagram was not rehearsed for this drone", where, "rehearse it first")
    fault = job.result["trial"]["fault"]
    if fault and not asked.force:
        what = f"the diagram is unstable on the virtual rig: {fault}"
        raise Rejected(what, where, "mend it, or confirm that it is to fly")
    if lab.drones[asked.drone].drone.state.armed:
        raise Rejected("the drone is armed", where, "disarm it first")
    if any(one.kind == f"flash {asked.drone}" and not one.over for one in lab.jobs.all):
        raise Rejected("another diagram is being flashed there", where, "wait for its end")
    return lab.jobs.watch(f"flash {asked.drone}", partial(_flashed, lab, asked, job.result["template"])).to_json()


async def _flashed(lab: LabServer, asked: FlashRequest, template: str, told: Told) -> dict[str, Any]:
    async with lab.drones[asked.drone].commanded() as drone:
        await drone.fly_controller(template, asked.text, FLASH_S, lambda text, share: told(share, text, text == BUILDS))
    return {"drone": asked.drone, "template": template}


async def _flies(lab: LabServer, number: int, template: str) -> tuple[str | None, str]:
    """Return the user's diagram that flies for a template, or None, and a text of its origin."""
    drone = lab.drones[number].drone
    try:
        data = await drone.files.read(f"{FLYING}/{template}.json")
    except Rejected:  # it has no such file: the stock controller flies
        return None, "the stock controller"
    return data.decode("utf-8", "replace"), f"what flies on drone {number}"


def _mark(drone: int, text: str) -> str:
    return f"{drone} {hashlib.sha256(text.encode('utf-8', 'replace')).hexdigest()}"
