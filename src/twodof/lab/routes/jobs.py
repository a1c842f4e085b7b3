"""Jobs: what is computed in the background, how far it is, and how it is ended."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path

from twodof.lab.current_lab import CurrentLab

router = APIRouter(prefix="/api/jobs", tags=["jobs"])
JobId = Annotated[str, Path(max_length=40, description="The id that the route told which started it.")]


@router.get("")
async def jobs(lab: CurrentLab) -> list[dict[str, Any]]:
    """The jobs that run and those that ended lately, the oldest first, without their results."""
    return [job.told(with_result=False) for job in lab.jobs.all]


@router.get("/{job}")
async def job(lab: CurrentLab, job: JobId) -> dict[str, Any]:
    """One job: state, fraction 0 to 1, what it does now, at its end its result or its error."""
    return lab.jobs[job].told()


@router.delete("/{job}")
async def cancel(lab: CurrentLab, job: JobId) -> dict[str, Any]:
    """End a job; its process ends with it. One that is over stays as it is."""
    return (await lab.jobs.cancel(job)).told()
