"""Diagrams: drawn, checked, compiled, kept, rehearsed and flashed. They are data; nothing of them runs here."""

from __future__ import annotations

import hashlib
from functools import partial
from typing import Annotated, Any, Literal

from fastapi import Path, Request
from pydantic import BaseModel, ConfigDict, Field

from twodof.blocks.schema.json_form import MAX_BYTES, to_json
from twodof.errors import Rejected
from twodof.fleet.flash import FLYING
from twodof.flight.starters import STARTERS, starter
from twodof.gcs.async_drone import BUILDS
from twodof.lab import diagram_work
from twodof.lab.access import WATCHERS_MAY, CurrentClient, lab_router, takes
from twodof.lab.answers import NotThere
from twodof.lab.diagram_folder import DiagramFolder
from twodof.lab.lab import CurrentLab, Lab
from twodof.lab.processes import Told

router = lab_router("/api/diagrams", "diagrams")
FAST_S, COMPILE_S = 10.0, 30.0
MOST_TEXT = MAX_BYTES + (1 << 20)  # a text in JSON has its quotes escaped
Name = Annotated[str, Path(min_length=1, max_length=80, description="Of a file in the folder of diagrams, no ending.")]


class AskedDiagram(BaseModel):
    """A diagram's JSON, as a text: numbers keep how they are written."""

    model_config = ConfigDict(extra="forbid")
    text: str = Field(max_length=MAX_BYTES)


class AskedCode(AskedDiagram):
    """And the type of a real."""

    precision: Literal["float32", "float64"] = "float32"


class AskedLoop(AskedDiagram):
    """And the virtual rig that it is to fly."""

    rig: Literal["lab", "paper"] = "lab"


class AskedBlocks(BaseModel):
    """Blocks of the library, each {"type": ..., "config": {...}}."""

    model_config = ConfigDict(extra="forbid")
    blocks: list[dict[str, Any]] = Field(max_length=2000)


@router.get("/catalogue")
async def blocks(lab: CurrentLab) -> dict[str, Any]:
    """The library's blocks with ports, parameters, units and text; the starter diagrams; the drone's templates."""
    found: dict[str, Any] = await lab.workbench.do(diagram_work.catalogue, seconds=COMPILE_S)
    return found


@router.get("/starters/{name}")
async def starter_text(name: Name) -> dict[str, str]:
    """A starter diagram. 404 where there is none of that name."""
    if name not in STARTERS:
        raise NotThere("there is no such starter diagram", name, f"there are: {', '.join(STARTERS)}")
    return {"text": to_json(starter(name))}


@router.post("/shapes", dependencies=[WATCHERS_MAY])
async def shapes(lab: CurrentLab, request: Request, asked: AskedBlocks) -> list[dict[str, Any]]:
    """Of each block its ports, its parameters and a mark of its structure; or what, where and remedy of a refusal."""
    found: list[dict[str, Any]] = await _work(lab, request, diagram_work.shapes, asked.blocks, seconds=FAST_S)
    return found


@router.post("/read", dependencies=[WATCHERS_MAY, takes(MOST_TEXT)])
async def read(lab: CurrentLab, request: Request, asked: AskedDiagram) -> dict[str, str]:
    """The diagram in the form in which it is kept. 422 with the place where it is not a diagram."""
    found: dict[str, str] = await _work(lab, request, diagram_work.canonical, asked.text, seconds=FAST_S)
    return found


@router.post("/check", dependencies=[WATCHERS_MAY, takes(MOST_TEXT)])
async def check(lab: CurrentLab, request: Request, asked: AskedDiagram) -> dict[str, Any]:
    """Everything that is wrong or odd with it, by the path of the block; an algebraic loop with its signals."""
    found: dict[str, Any] = await _work(lab, request, diagram_work.check, asked.text, seconds=FAST_S)
    return found


@router.post("/code", dependencies=[WATCHERS_MAY, takes(MOST_TEXT)])
async def code(lab: CurrentLab, request: Request, asked: AskedCode) -> dict[str, Any]:
    """The C that it becomes at 250 Hz; each line as [text, path of its block or "", function]."""
    found: dict[str, Any] = await _work(lab, request, diagram_work.code, asked.text, asked.precision, seconds=FAST_S)
    return found


@router.post("/compile", dependencies=[WATCHERS_MAY, takes(MOST_TEXT)])
async def compile_loop(lab: CurrentLab, request: Request, asked: AskedLoop) -> dict[str, Any]:
    """The diagram in its closed loop with the virtual rig as WebAssembly (base 64), its interface and its start.

    It ends when the one who asked goes away.
    """
    found: dict[str, Any] = await _work(lab, request, diagram_work.compiled, asked.text, asked.rig, seconds=COMPILE_S)
    return found


async def _work(lab: CurrentLab, request: Request, work: Any, *arguments: Any, seconds: float) -> Any:
    return await lab.workbench.do(work, *arguments, seconds=seconds, gone=request.is_disconnected)


@router.get("/files")
async def files(lab: CurrentLab) -> list[dict[str, Any]]:
    """The diagrams that are kept here, the latest first: name, bytes, time of the change [s, unix]."""
    return DiagramFolder(lab.settings.folder).listed()


@router.get("/files/{name}")
async def file(lab: CurrentLab, name: Name) -> dict[str, str]:
    """A diagram that is kept here."""
    return {"text": DiagramFolder(lab.settings.folder).read(name)}


@router.put("/files/{name}", dependencies=[takes(MOST_TEXT)])
async def save(lab: CurrentLab, request: Request, name: Name, asked: AskedDiagram) -> dict[str, str]:
    """Keep a diagram under a name, in the place of what is there; answers the text that is in the file."""
    kept = await _work(lab, request, diagram_work.canonical, asked.text, seconds=FAST_S)
    DiagramFolder(lab.settings.folder).write(name, kept["text"])
    return {"text": kept["text"]}


@router.delete("/files/{name}")
async def delete(lab: CurrentLab, name: Name) -> dict[str, Any]:
    """Remove a diagram; answers its text, which `PUT` brings back."""
    return {"text": DiagramFolder(lab.settings.folder).remove(name)}


jobs_router = lab_router("/api/diagrams", "diagrams")
REHEARSAL = "rehearsal"
FLASH_S = 120.0


class AskedMargins(AskedDiagram):
    """And the rig that the loops are closed with."""

    rig: Literal["lab", "paper"] = "lab"


class AskedRehearsal(AskedDiagram):
    """And the drone, by its number: what changes is against what flies there."""

    drone: int = Field(ge=1, le=255)


class AskedFlash(AskedRehearsal):
    """And the job that rehearsed this diagram for this drone. `force`: although that found it unstable."""

    rehearsal: str = Field(max_length=40)
    force: bool = False


@jobs_router.post("/margins", status_code=202, dependencies=[WATCHERS_MAY, takes(MOST_TEXT)])
async def margins(lab: CurrentLab, client: CurrentClient, asked: AskedMargins) -> dict[str, Any]:
    """The margins and the Bode plots of the loops that a diagram closes; answers the job."""
    return lab.jobs.start("margins", diagram_work.margins, asked.text, asked.rig, client=client).told()


@jobs_router.post("/px4", status_code=202, dependencies=[WATCHERS_MAY, takes(MOST_TEXT)])
async def px4(lab: CurrentLab, client: CurrentClient, asked: AskedDiagram) -> dict[str, Any]:
    """The diagram as a module for PX4; answers the job, whose result has the folder as a zip file in base 64."""
    return lab.jobs.start("px4", diagram_work.px4_module, asked.text, client=client).told()


@jobs_router.post("/rehearsal", status_code=202, dependencies=[takes(MOST_TEXT)])
async def rehearsal(lab: CurrentLab, asked: AskedRehearsal) -> dict[str, Any]:
    """Everything that flashing does but the last step; answers the job. Nothing is changed on the drone."""
    template = await _template(lab, asked.text)
    before, origin = await _flies(lab, asked.drone, template)
    job = lab.jobs.start(REHEARSAL, diagram_work.rehearsal, asked.text, before, origin)
    lab.rehearsed = {name: kept for name, kept in lab.rehearsed.items() if _known(lab, name)}
    lab.rehearsed[job.id] = _mark(asked.drone, asked.text)
    return job.told()


@jobs_router.post("/flash", status_code=202, dependencies=[takes(MOST_TEXT)])
async def flash(lab: CurrentLab, asked: AskedFlash) -> dict[str, Any]:
    """Let a rehearsed diagram fly from now on; answers the job. It takes up to two minutes: the drone builds it.

    The job can be ended while the diagram is sent; then what flew before flies on. Once the drone builds it the job is
    `bound`. 409 for a diagram that was not rehearsed for this drone, and for an unstable one unless `force` says so.
    409 also while the drone is armed, and while another is flashed there.
    """
    where = f"drone {asked.drone}"
    job = lab.jobs[asked.rehearsal]
    if lab.rehearsed.get(job.id) != _mark(asked.drone, asked.text) or job.state != "done":
        raise Rejected("this diagram was not rehearsed for this drone", where, "rehearse it first")
    fault = job.result["trial"]["fault"]
    if fault and not asked.force:
        raise Rejected(f"it is unstable on the virtual rig: {fault}", where, "mend it, or confirm that it is to fly")
    if lab.drones[asked.drone].drone.state.armed:
        raise Rejected("it is armed", where, "disarm it first")
    if any(one.kind == f"flash {asked.drone}" and not one.over for one in lab.jobs.all):
        raise Rejected("another diagram is flashed there", where, "wait for its end")
    return lab.jobs.watch(f"flash {asked.drone}", partial(_flashed, lab, asked, job.result["template"])).told()


async def _flashed(lab: Lab, asked: AskedFlash, template: str, told: Told) -> dict[str, Any]:
    async with lab.drones[asked.drone].commanded() as drone:
        await drone.fly_controller(template, asked.text, FLASH_S, lambda text, share: told(share, text, text == BUILDS))
    return {"drone": asked.drone, "template": template}


async def _template(lab: Lab, text: str) -> str:
    found = await lab.workbench.do(diagram_work.template, text, seconds=COMPILE_S)
    return str(found["template"])


async def _flies(lab: Lab, number: int, template: str) -> tuple[str | None, str]:
    """The diagram of a user's that flies on a drone in a template's place, if there is one, and what it is."""
    drone = lab.drones[number].drone
    try:
        data = await drone.files.read(f"{FLYING}/{template}.json")
    except Rejected:  # it has no such file: the stock controller flies
        return None, "the stock controller"
    return data.decode("utf-8", "replace"), f"what flies on drone {number}"


def _mark(drone: int, text: str) -> str:
    return f"{drone} {hashlib.sha256(text.encode('utf-8', 'replace')).hexdigest()}"


def _known(lab: Lab, name: str) -> bool:
    return any(job.id == name for job in lab.jobs.all)
