"""Diagrams: what the editor needs to draw, check, compile and keep them. What is sent is data; nothing of it runs here.

A diagram is compiled to WebAssembly, which runs in the browser that sent it. Its text is read within the limits of
docs/reference/diagram-files.md, by a process of its own that is ended when it takes too long.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Request
from pydantic import BaseModel, ConfigDict, Field

from twodof.blocks.schema.json_form import MAX_BYTES, to_json
from twodof.flight.starters import STARTERS, starter
from twodof.lab.access import computes, takes
from twodof.lab.current_lab import CurrentLab
from twodof.lab.diagram_folder import DiagramFolder
from twodof.lab.refusals import NotThere
from twodof.lab.workbench import diagram_work

router = APIRouter(prefix="/api/diagrams", tags=["diagrams"])
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


@router.post("/shapes")
@computes
async def shapes(lab: CurrentLab, request: Request, asked: AskedBlocks) -> list[dict[str, Any]]:
    """Of each block its ports, its parameters and a mark of its structure; or what, where and remedy of a refusal."""
    found: list[dict[str, Any]] = await _work(lab, request, diagram_work.shapes, asked.blocks, seconds=FAST_S)
    return found


@router.post("/read")
@computes
@takes(MOST_TEXT)
async def read(lab: CurrentLab, request: Request, asked: AskedDiagram) -> dict[str, str]:
    """The diagram in the form in which it is kept. 422 with the place where it is not a diagram."""
    found: dict[str, str] = await _work(lab, request, diagram_work.canonical, asked.text, seconds=FAST_S)
    return found


@router.post("/check")
@computes
@takes(MOST_TEXT)
async def check(lab: CurrentLab, request: Request, asked: AskedDiagram) -> dict[str, Any]:
    """Everything that is wrong or odd with it, by the path of the block; an algebraic loop with its signals."""
    found: dict[str, Any] = await _work(lab, request, diagram_work.check, asked.text, seconds=FAST_S)
    return found


@router.post("/code")
@computes
@takes(MOST_TEXT)
async def code(lab: CurrentLab, request: Request, asked: AskedCode) -> dict[str, Any]:
    """The C that it becomes at 250 Hz; each line as [text, path of its block or "", function]."""
    found: dict[str, Any] = await _work(lab, request, diagram_work.code, asked.text, asked.precision, seconds=FAST_S)
    return found


@router.post("/compile")
@computes
@takes(MOST_TEXT)
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


@router.put("/files/{name}")
@takes(MOST_TEXT)
async def save(lab: CurrentLab, request: Request, name: Name, asked: AskedDiagram) -> dict[str, str]:
    """Keep a diagram under a name, in the place of what is there; answers the text that is in the file."""
    kept = await _work(lab, request, diagram_work.canonical, asked.text, seconds=FAST_S)
    DiagramFolder(lab.settings.folder).write(name, kept["text"])
    return {"text": kept["text"]}


@router.delete("/files/{name}")
async def delete(lab: CurrentLab, name: Name) -> dict[str, Any]:
    """Remove a diagram; answers its text, which `PUT` brings back."""
    return {"text": DiagramFolder(lab.settings.folder).remove(name)}
