"""Drones: which there are, and how each stands."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path

from twodof.lab.current_lab import CurrentLab

router = APIRouter(prefix="/api/drones", tags=["drones"])
Number = Annotated[int, Path(ge=1, le=255, description="MAVLink system of the drone: 1 for the first virtual one.")]


@router.get("")
async def drones(lab: CurrentLab) -> list[dict[str, Any]]:
    """The drones that were heard, each as the event `drone` of the web socket tells it; angles in rad, times in s."""
    return lab.drones.states


@router.get("/{number}")
async def drone(lab: CurrentLab, number: Number) -> dict[str, Any]:
    """How one drone stands. 404 where none of that number was heard."""
    return lab.drones[number].state


@router.get("/{number}/texts")
async def texts(lab: CurrentLab, number: Number) -> list[dict[str, Any]]:
    """What the drone said in words, the oldest first, the last 200 lines; `time` is the drone's [s]."""
    return [*lab.drones[number].texts]
