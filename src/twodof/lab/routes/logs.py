"""Routes of logs: listed, shown, compared, replayed, annotated, downloaded, uploaded and deleted.

Logs are read in a process of their own, each request within a time limit.
"""

from collections.abc import Callable
from pathlib import Path as FilePath
from typing import Annotated, Any, Literal, get_args

from fastapi import Path, Query, Request
from fastapi.responses import FileResponse, Response, StreamingResponse
from pydantic import Field, FiniteFloat
from starlette.background import BackgroundTask

from twodof.errors import LogError, Rejected, TwodofError
from twodof.flightlog.files import zipped
from twodof.flightlog.provenance import MAX_FILE_BYTES
from twodof.lab import log_work
from twodof.lab.access import RAW, lab_router, receive_file, takes
from twodof.lab.answers import RequestBody, without_folders
from twodof.lab.folders import KEPT_DAYS, MOST_NOTES, LogName
from twodof.lab.lab import CurrentLab, LabServer
from twodof.lab.log_work import summary as log_summary
from twodof.report.plots.comparison_view import MOST_FLIGHTS

router = lab_router("/api/logs", "logs")
MOST_SUMMARIES = 4000
MOST_UPLOADED = MAX_FILE_BYTES // 2
CONVERT_S = 90.0
MOST_ZIPPED, MOST_ZIP_BYTES = 50, 1 << 30
"""Most logs, and most bytes of them, in one zip file."""
Name = Annotated[LogName, Path(description="Name of a log in the list.")]
Moment = Annotated[FiniteFloat | None, Query(description="In the log's time [s]; left out: the whole log.")]
Points = Annotated[int, Query(ge=10, le=log_work.MOST_POINTS, description="Points of each curve, about.")]
Format = Literal["mcap", "mat", "parquet", "csv", "ulg"]
FORMATS: tuple[str, ...] = get_args(Format)


class LogNotes(RequestBody):
    """Notes about a log."""

    text: str = Field(max_length=MOST_NOTES)


@router.get("")
async def logs(lab: CurrentLab) -> dict[str, Any]:
    """List the logs, the latest first, and the deleted ones, which can be restored for `kept_days`."""
    written = lab.drones.recordings
    found = await lab.log_bench.do(lab.logs.listed)
    rows = [row | {"recording": row["name"] in written} for row in found]
    return {"logs": rows, "trash": lab.logs.trash.listed(), "kept_days": KEPT_DAYS}


@router.get("/compare")
async def compare(
    lab: CurrentLab,
    name: Annotated[list[str], Query(min_length=2, max_length=MOST_FLIGHTS, description="Name of each log.")],
    align: Literal["step", "start"] = "step",
    begin: Moment = None,
    end: Moment = None,
    points: Points = 2000,
    zero: Annotated[
        list[FiniteFloat] | None, Query(description="Time 0 [s] of each log, in place of its first step.")
    ] = None,
) -> dict[str, Any]:
    """Compare logs, with time 0 at the first step of a set-point, or at the start where `unaligned` says why."""
    if len(set(name)) < len(name):
        raise LogError("a log is given twice", ", ".join(one[:40] for one in name), "name each log once")
    paths = {one: str(lab.whole_log(one)) for one in name}
    return await lab.log_bench.do(log_work.compare, paths, align, _window(begin, end), points, zero or [])


@router.get("/zip", response_class=Response)
async def zip_file(
    lab: CurrentLab, name: Annotated[list[LogName], Query(max_length=MOST_ZIPPED, description="Name of each log.")]
) -> Response:
    """Download several logs, each in its own format, in one zip file, which is sent while it is written."""
    paths = {one.replace(":", "/"): lab.whole_log(one) for one in name}
    if sum(path.stat().st_size for path in paths.values()) > MOST_ZIP_BYTES:
        raise Rejected(f"these logs have more than {MOST_ZIP_BYTES >> 20} MiB", "logs", "choose fewer at once")
    headers = {"content-disposition": 'attachment; filename="twodof-logs.zip"'}
    return StreamingResponse(zipped(paths), media_type="application/zip", headers=headers)


@router.get("/{name}")
async def log(lab: CurrentLab, name: Name) -> dict[str, Any]:
    """Return a log's summary, channels, parameters, texts of the drone, changes of parameters, and notes.

    `unreadable` has the reason if the log cannot be read, and there are only the notes; else "". `formats` are the
    formats for download: only its own for a damaged log, none while it is being recorded.
    """
    path = lab.logs.place(name)
    kept = {"notes": lab.logs.notes(name), "ours": path.parent == lab.logs.folder}
    try:
        found = await lab.log_bench.do(log_work.facts, str(lab.whole_log(name)))
        return kept | {"unreadable": "", "formats": FORMATS} | found
    except LogError as reason:
        return kept | {"unreadable": _in_words(reason), "formats": [path.suffix.lower().removeprefix(".")]}
    except Rejected as reason:
        return kept | {"unreadable": _in_words(reason), "formats": []}


@router.get("/{name}/summary")
async def summary(lab: CurrentLab, name: Name) -> dict[str, Any]:
    """Return a log's row of the list, with the lowest and highest values of a small curve.

    `unreadable` has the reason if the log cannot be read, else "": it is damaged, being recorded, or deleted.
    """
    try:
        path = lab.whole_log(name)
        found = path.stat()
        key = (str(path), found.st_mtime_ns, found.st_size)
        if key not in lab.summaries:
            lab.summaries[key] = await lab.log_bench.do(log_summary, str(path))
            while len(lab.summaries) > MOST_SUMMARIES:
                del lab.summaries[next(iter(lab.summaries))]
        return {"unreadable": ""} | lab.summaries[key]
    except (TwodofError, OSError) as reason:
        return {"unreadable": _in_words(reason) if isinstance(reason, TwodofError) else "it was deleted"}


@router.get("/{name}/view")
async def view(
    lab: CurrentLab,
    name: Name,
    begin: Moment = None,
    end: Moment = None,
    points: Points = 2000,
    topic: Annotated[list[str] | None, Query(max_length=20, description="Signals; left out: the usual ones.")] = None,
    panel: Annotated[
        list[str] | None, Query(max_length=20, description="Own plot: its signals, a line each, at most 20.")
    ] = None,
) -> dict[str, Any]:
    """Plot a part of a log: curves thinned to lowest and highest values, modes, failsafe, excitations."""
    path = str(lab.whole_log(name))
    return await lab.log_bench.do(log_work.view, path, _window(begin, end), topic or [], points, panel or [])


@router.get("/{name}/signals")
async def signals(lab: CurrentLab, name: Name) -> list[list[str]]:
    """List the signals that can be plotted, each with description and unit."""
    return await lab.log_bench.do(log_work.signals, str(lab.whole_log(name)))


@router.get("/{name}/steps")
async def steps(lab: CurrentLab, name: Name) -> dict[str, Any]:
    """Return the steps of set-points with rise, overshoot, settling, peak and largest moment."""
    return await lab.log_bench.do(log_work.steps, str(lab.whole_log(name)))


@router.get("/{name}/fold")
async def fold(lab: CurrentLab, name: Name) -> list[dict[str, Any]]:
    """Lay the steps of each loop over each other: responses as a share of the step, their mean and deviation."""
    return await lab.log_bench.do(log_work.fold, str(lab.whole_log(name)))


@router.get("/{name}/replay")
async def replay(lab: CurrentLab, name: Name) -> dict[str, Any]:
    """Sample the drone's motion at equal times, for the 3-D view."""
    return await lab.log_bench.do(log_work.replay, str(lab.whole_log(name)))


@router.get("/{name}/file", response_class=Response)
async def file(
    lab: CurrentLab, name: Name, form: Annotated[Format | None, Query(description="Left out: that of the file.")] = None
) -> Response:
    """Download the log, in its own format or in another."""
    path = lab.whole_log(name)
    suffix = path.suffix.lower() if form is None else f".{form}"
    if suffix == path.suffix.lower():
        return FileResponse(path, filename=path.name, media_type="application/octet-stream")
    return await made_file(lab, path.with_suffix(suffix).name, log_work.converted, str(path))


@router.put("/{name}/notes")
async def note(lab: CurrentLab, name: Name, notes: LogNotes) -> dict[str, str]:
    """Keep notes beside a log; an empty text removes them."""
    lab.logs.write_notes(name, notes.text)
    return {"text": notes.text}


@router.post("/{name}/rename")
async def rename(lab: CurrentLab, name: Name, to: LogName) -> dict[str, str]:
    """Rename a log and its notes, in the same format; return the name, numbered if another log has it."""
    path = lab.whole_log(name, ours=True)
    return {"name": lab.logs.take_in(path, f"{to}{path.suffix}")}


@router.post("/trash/{entry}/restore")
async def restore(lab: CurrentLab, entry: Annotated[str, Path(max_length=300)]) -> dict[str, str]:
    """Restore a deleted log; return its name."""
    return {"name": lab.logs.trash.restore(entry)}


@router.post("/{name}/recover")
async def recover(lab: CurrentLab, name: Name) -> dict[str, Any]:
    """Recover the sound parts of a recording that was cut off, as a new log; return its name, and the damage."""
    path = lab.whole_log(name, ours=True)
    with lab.logs.scratch() as folder:
        made = FilePath(folder) / "recovered.mcap"
        told = await lab.log_bench.do(log_work.recovered, str(path), str(made), seconds=CONVERT_S)
        return {**told, "name": lab.logs.take_in(made, f"{path.stem}.{made.name}")}


@router.delete("/{name}")
async def delete(lab: CurrentLab, name: Name) -> dict[str, Any]:
    """Delete a log; for some days `restore` brings it back."""
    return lab.logs.trash.put(lab.whole_log(name, ours=True))


@router.post("/{name}", openapi_extra=RAW, dependencies=[takes(MOST_UPLOADED)])
async def upload(lab: CurrentLab, request: Request, name: Name) -> dict[str, Any]:
    """Upload a log as the file's bytes. It is read first; a file without a readable sample is refused."""
    lab.logs.check_new(name)
    with lab.logs.scratch() as folder:
        path = FilePath(folder) / name
        await receive_file(request, path)
        try:
            found = await lab.log_bench.do(log_summary, str(path), seconds=CONVERT_S)
        except LogError as reason:
            try:
                await lab.log_bench.do(log_work.recovered, str(path), f"{path}.recovered.mcap", seconds=CONVERT_S)
            except LogError:
                raise reason from None
            found = {"unreadable": _in_words(reason)}
        return {"name": lab.logs.take_in(path, name), "summary": found}


async def made_file(lab: LabServer, name: str, work: Callable[..., object], *arguments: Any) -> Response:
    """Let `work(*arguments, target)` write a file; return it for download under a name."""
    folder = lab.logs.scratch()
    try:
        made = str(FilePath(folder.name) / f"log{FilePath(name).suffix}")
        await lab.log_bench.do(work, *arguments, made, seconds=CONVERT_S)
    except BaseException:
        folder.cleanup()
        raise
    media, end = "application/octet-stream", BackgroundTask(folder.cleanup)
    return FileResponse(made, filename=name, media_type=media, background=end)


def _in_words(reason: TwodofError) -> str:
    return without_folders(f"{reason.what}: {reason.remedy}" if reason.remedy else reason.what)


def _window(begin: float | None, end: float | None) -> tuple[float, float] | None:
    if (begin is None) != (end is None):
        raise LogError("one end of the window is missing", "begin, end", "give both, or none")
    return None if begin is None or end is None else (begin, end)
