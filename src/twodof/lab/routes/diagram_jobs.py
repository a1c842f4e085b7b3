"""What takes longer with a diagram: margins, a module for PX4, and flashing: first rehearsed, then, confirmed, done."""

from __future__ import annotations

import hashlib
from functools import partial
from typing import Any, Literal

from fastapi import APIRouter
from pydantic import Field

from twodof.errors import Rejected
from twodof.fleet.flash import FLYING
from twodof.gcs.async_drone import BUILDS
from twodof.lab.access import computes, takes
from twodof.lab.access.lab_client import CurrentClient
from twodof.lab.current_lab import CurrentLab
from twodof.lab.jobs.jobs import Told
from twodof.lab.lab import Lab
from twodof.lab.routes.diagrams import COMPILE_S, MOST_TEXT, AskedDiagram
from twodof.lab.workbench import diagram_jobs, diagram_work

router = APIRouter(prefix="/api/diagrams", tags=["diagrams"])
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


@router.post("/margins", status_code=202)
@computes
@takes(MOST_TEXT)
async def margins(lab: CurrentLab, client: CurrentClient, asked: AskedMargins) -> dict[str, Any]:
    """The margins and the Bode plots of the loops that a diagram closes; answers the job."""
    return lab.jobs.start("margins", diagram_jobs.margins, asked.text, asked.rig, client=client).told()


@router.post("/px4", status_code=202)
@computes
@takes(MOST_TEXT)
async def px4(lab: CurrentLab, client: CurrentClient, asked: AskedDiagram) -> dict[str, Any]:
    """The diagram as a module for PX4; answers the job, whose result has the folder as a zip file in base 64."""
    return lab.jobs.start("px4", diagram_jobs.px4_module, asked.text, client=client).told()


@router.post("/rehearsal", status_code=202)
@takes(MOST_TEXT)
async def rehearsal(lab: CurrentLab, asked: AskedRehearsal) -> dict[str, Any]:
    """Everything that flashing does but the last step; answers the job. Nothing is changed on the drone."""
    template = await _template(lab, asked.text)
    before, origin = await _flies(lab, asked.drone, template)
    job = lab.jobs.start(REHEARSAL, diagram_jobs.rehearsal, asked.text, before, origin)
    lab.rehearsed = {name: kept for name, kept in lab.rehearsed.items() if _known(lab, name)}
    lab.rehearsed[job.id] = _mark(asked.drone, asked.text)
    return job.told()


@router.post("/flash", status_code=202)
@takes(MOST_TEXT)
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
