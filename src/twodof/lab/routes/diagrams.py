"""Routes of diagrams: read, checked, compiled, kept, rehearsed and flashed. Nothing of them runs here."""

from __future__ import annotations

import hashlib
import re
from functools import partial
from pathlib import Path as FilePath
from typing import Annotated, Any, Literal

from fastapi import Path, Request
from pydantic import BaseModel, ConfigDict, Field

from twodof.blocks.schema.json_form import MAX_BYTES, to_json
from twodof.errors import DiagramError, Rejected
from twodof.fleet.flash import FLYING
from twodof.flight.starters import STARTERS, starter
from twodof.flightlog.atomic import atomic_write, make_folder
from twodof.gcs.async_drone import BUILDS
from twodof.lab import diagram_work
from twodof.lab.access import WATCHERS_MAY, CurrentClient, lab_router, takes
from twodof.lab.answers import NotThere
from twodof.lab.lab import CurrentLab, Lab
from twodof.lab.processes import Told

router = lab_router("/api/diagrams", "diagrams")
FAST_S, COMPILE_S = 10.0, 30.0
MOST_TEXT = MAX_BYTES + (1 << 20)  # a text in JSON has its quotes escaped
Name = Annotated[str, Path(min_length=1, max_length=80, description="Of a file in the folder of diagrams, no ending.")]


MOST_DIAGRAMS = 1000
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_. -]{0,79}")


class DiagramFolder:
    """Folder "diagrams" in the user's data folder; a name is that of a file in it, without .json."""

    def __init__(self, data: FilePath) -> None:
        self.folder = data / "diagrams"

    def listed(self) -> list[dict[str, Any]]:
        """List name, bytes and time of the last change [s, unix] of each, the latest first."""
        rows: list[dict[str, Any]] = []
        for path in self.folder.glob("*.json") if self.folder.is_dir() else ():
            if path.is_file() and _NAME.fullmatch(path.stem):
                found = path.stat()
                rows.append({"name": path.stem, "bytes": found.st_size, "changed": found.st_mtime})
        return sorted(rows, key=lambda row: -float(row["changed"]))[:MOST_DIAGRAMS]

    def read(self, name: str) -> str:
        """Return the text of a file. Raises NotThere."""
        path = self._path(name)
        if not path.is_file():
            raise NotThere("there is no such diagram", name, "open one of the list")
        with path.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
        if len(data) > MAX_BYTES:
            raise DiagramError("it is larger than a diagram may be", name, f"at most {MAX_BYTES} bytes are read")
        return data.decode("utf-8", "replace")

    def write(self, name: str, text: str) -> None:
        """Write a file, whole or not at all. Raises Rejected if there are too many."""
        path = self._path(name)
        make_folder(self.folder)
        if not path.exists() and len(self.listed()) >= MOST_DIAGRAMS:
            raise Rejected(f"there are {MOST_DIAGRAMS} diagrams already", "diagrams", "delete one")
        with atomic_write(path, "w") as file:
            file.write(text)

    def remove(self, name: str) -> str:
        """Remove a file and return its text. Raises NotThere."""
        text = self.read(name)
        self._path(name).unlink(missing_ok=True)
        return text

    def _path(self, name: str) -> FilePath:
        if not _NAME.fullmatch(name) or ".." in name:
            raise DiagramError(
                f"{name[:40]!r} is not a name for a file", "diagrams", "use letters, digits, spaces, _ . and -"
            )
        return self.folder / f"{name}.json"


class AskedDiagram(BaseModel):
    """JSON of a diagram as a text, so that numbers keep their form."""

    model_config = ConfigDict(extra="forbid")
    text: str = Field(max_length=MAX_BYTES)


class AskedCode(AskedDiagram):
    """Diagram, and the type of a real."""

    precision: Literal["float32", "float64"] = "float32"


class AskedLoop(AskedDiagram):
    """Diagram, and the virtual rig that it is to fly."""

    rig: Literal["lab", "paper"] = "lab"


class AskedBlocks(BaseModel):
    """Blocks of the library, each {"type": ..., "config": {...}}."""

    model_config = ConfigDict(extra="forbid")
    blocks: list[dict[str, Any]] = Field(max_length=2000)


@router.get("/catalogue")
async def blocks(lab: CurrentLab) -> dict[str, Any]:
    """List the library's blocks with ports, parameters, units and text, the starter diagrams, and the templates."""
    found: dict[str, Any] = await lab.workbench.do(diagram_work.catalogue, seconds=COMPILE_S)
    return found


@router.get("/starters/{name}")
async def starter_text(name: Name) -> dict[str, str]:
    """Return a starter diagram. 404 for an unknown name."""
    if name not in STARTERS:
        raise NotThere("there is no such starter diagram", name, f"there are: {', '.join(STARTERS)}")
    return {"text": to_json(starter(name))}


@router.post("/shapes", dependencies=[WATCHERS_MAY])
async def shapes(lab: CurrentLab, request: Request, asked: AskedBlocks) -> list[dict[str, Any]]:
    """Return each block's ports, parameters and mark of its structure; or what, where and remedy of an error."""
    found: list[dict[str, Any]] = await _work(lab, request, diagram_work.shapes, asked.blocks, seconds=FAST_S)
    return found


@router.post("/read", dependencies=[WATCHERS_MAY, takes(MOST_TEXT)])
async def read(lab: CurrentLab, request: Request, asked: AskedDiagram) -> dict[str, str]:
    """Return the diagram in the form of its file. 422 with the place of a mistake."""
    found: dict[str, str] = await _work(lab, request, diagram_work.canonical, asked.text, seconds=FAST_S)
    return found


@router.post("/check", dependencies=[WATCHERS_MAY, takes(MOST_TEXT)])
async def check(lab: CurrentLab, request: Request, asked: AskedDiagram) -> dict[str, Any]:
    """Check the diagram: problems and remarks by the path of the block, an algebraic loop with its signals."""
    found: dict[str, Any] = await _work(lab, request, diagram_work.check, asked.text, seconds=FAST_S)
    return found


@router.post("/code", dependencies=[WATCHERS_MAY, takes(MOST_TEXT)])
async def code(lab: CurrentLab, request: Request, asked: AskedCode) -> dict[str, Any]:
    """Return the diagram's C at 250 Hz; each line as [text, path of its block or "", function]."""
    found: dict[str, Any] = await _work(lab, request, diagram_work.code, asked.text, asked.precision, seconds=FAST_S)
    return found


@router.post("/compile", dependencies=[WATCHERS_MAY, takes(MOST_TEXT)])
async def compile_loop(lab: CurrentLab, request: Request, asked: AskedLoop) -> dict[str, Any]:
    """Compile the closed loop with the virtual rig to WebAssembly (base 64), with its interface and its start.

    The work ends if the client goes away.
    """
    found: dict[str, Any] = await _work(lab, request, diagram_work.compiled, asked.text, asked.rig, seconds=COMPILE_S)
    return found


async def _work(lab: CurrentLab, request: Request, work: Any, *arguments: Any, seconds: float) -> Any:
    return await lab.workbench.do(work, *arguments, seconds=seconds, gone=request.is_disconnected)


@router.get("/files")
async def files(lab: CurrentLab) -> list[dict[str, Any]]:
    """List the kept diagrams, the latest first: name, bytes, time of the change [s, unix]."""
    return DiagramFolder(lab.settings.folder).listed()


@router.get("/files/{name}")
async def file(lab: CurrentLab, name: Name) -> dict[str, str]:
    """Return a kept diagram."""
    return {"text": DiagramFolder(lab.settings.folder).read(name)}


@router.put("/files/{name}", dependencies=[takes(MOST_TEXT)])
async def save(lab: CurrentLab, request: Request, name: Name, asked: AskedDiagram) -> dict[str, str]:
    """Keep a diagram under a name, instead of an older one; return the text in the file."""
    kept = await _work(lab, request, diagram_work.canonical, asked.text, seconds=FAST_S)
    DiagramFolder(lab.settings.folder).write(name, kept["text"])
    return {"text": kept["text"]}


@router.delete("/files/{name}")
async def delete(lab: CurrentLab, name: Name) -> dict[str, Any]:
    """Remove a diagram; return its text, which `PUT` restores."""
    return {"text": DiagramFolder(lab.settings.folder).remove(name)}


jobs_router = lab_router("/api/diagrams", "diagrams")
REHEARSAL = "rehearsal"
FLASH_S = 120.0


class AskedMargins(AskedDiagram):
    """Diagram, and the rig that the loops are closed with."""

    rig: Literal["lab", "paper"] = "lab"


class AskedRehearsal(AskedDiagram):
    """Diagram, and the number of the drone whose active controller it is compared with."""

    drone: int = Field(ge=1, le=255)


class AskedFlash(AskedRehearsal):
    """Diagram, drone, and the job that rehearsed them; `force` flies it though that found it unstable."""

    rehearsal: str = Field(max_length=40)
    force: bool = False


@jobs_router.post("/margins", status_code=202, dependencies=[WATCHERS_MAY, takes(MOST_TEXT)])
async def margins(lab: CurrentLab, client: CurrentClient, asked: AskedMargins) -> dict[str, Any]:
    """Start a job for the margins and Bode plots of the loops that a diagram closes."""
    return lab.jobs.start("margins", diagram_work.margins, asked.text, asked.rig, client=client).told()


@jobs_router.post("/px4", status_code=202, dependencies=[WATCHERS_MAY, takes(MOST_TEXT)])
async def px4(lab: CurrentLab, client: CurrentClient, asked: AskedDiagram) -> dict[str, Any]:
    """Start a job that exports a module for PX4; its result has the folder as a zip file in base 64."""
    return lab.jobs.start("px4", diagram_work.px4_module, asked.text, client=client).told()


@jobs_router.post("/rehearsal", status_code=202, dependencies=[takes(MOST_TEXT)])
async def rehearsal(lab: CurrentLab, asked: AskedRehearsal) -> dict[str, Any]:
    """Start a job that does everything of flashing but the last step. Nothing is changed on the drone."""
    template = await _template(lab, asked.text)
    before, origin = await _flies(lab, asked.drone, template)
    job = lab.jobs.start(REHEARSAL, diagram_work.rehearsal, asked.text, before, origin)
    lab.rehearsed = {name: kept for name, kept in lab.rehearsed.items() if _known(lab, name)}
    lab.rehearsed[job.id] = _mark(asked.drone, asked.text)
    return job.told()


@jobs_router.post("/flash", status_code=202, dependencies=[takes(MOST_TEXT)])
async def flash(lab: CurrentLab, asked: AskedFlash) -> dict[str, Any]:
    """Start a job that flashes a rehearsed diagram. It takes up to two minutes: the drone builds it.

    The job can be ended while the diagram is sent; then the controller before flies on.

    While the drone builds it the job is `bound`.

    409 for a diagram that was not rehearsed for this drone, and for an unstable one without `force`.
    409 also while the drone is armed, and while another diagram is flashed there.
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
    """Return the user's diagram that flies for a template, or None, and a text of its origin."""
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
